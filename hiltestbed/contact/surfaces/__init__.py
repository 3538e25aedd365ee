"""Surfaces for contact with a ball or rod: nearest point, signed distance and normal, exact or to
the mesh's triangles.
"""

from hiltestbed.contact.surfaces.revolution import Revolution, recognise
from hiltestbed.contact.surfaces.soundness import MeshFault, examine
from hiltestbed.contact.surfaces.surface import (
    Surface,
    hollow,
    of_geom,
    of_mesh,
    segment_distance,
    signed_distance,
)

__all__ = [
    "MeshFault",
    "Revolution",
    "Surface",
    "examine",
    "hollow",
    "of_geom",
    "of_mesh",
    "recognise",
    "segment_distance",
    "signed_distance",
]
