"""An MJCF model as a part of another: a side of a mechanism, or a rig.

What its compiler settings mean for all of its bodies together (a total mass, inertias from geoms of
some groups only) would be lost in the other model: it is written out first. Settings of a whole
model (gravity, time step, solver) are not those of a part.
"""

from __future__ import annotations

import math
import warnings
from functools import lru_cache
from pathlib import Path

import mujoco

from hiltestbed.config.mjcf import KEPT, PackedMjcf
from hiltestbed.config.models import model_of
from hiltestbed.errors import InputError


def compiled(file: Path) -> mujoco.MjModel:
    """The model in an MJCF ``file`` alone, with geoms and bodies named. Raises InputError."""
    return _resolved(model_of(file), file)[1]


def named(file: Path) -> mujoco.MjSpec:
    """The model in an MJCF ``file``, to be attached, with all names. Raises InputError."""
    return _resolved(model_of(file), file)[0].copy()


@lru_cache(KEPT)
def _resolved(whole: PackedMjcf, file: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The specification and the model of a part, in which every mass is written out."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are among the remarks on the model
            spec = whole.part().spec()
            for what, things in (("geom", spec.geoms), ("body", spec.bodies)):
                for i, thing in enumerate(things):
                    if not thing.name:
                        thing.name = f"{what}_{i}"
            # nothing is left out that a pair may name, and a hull has as many vertices as it needs
            spec.compiler.fusestatic = spec.compiler.discardvisual = False
            for mesh in spec.meshes:
                mesh.maxhullvert = -1
            model = spec.compile()
    except ValueError as error:
        raise InputError(
            f"{file}: is not a model that MuJoCo compiles: {' '.join(str(error).split())}"
        ) from error
    for body in spec.bodies[1:]:
        own = model.body(body.name)
        body.mass, body.inertia = float(own.mass[0]), own.inertia
        body.ipos, body.iquat, body.explicitinertial = own.ipos, own.iquat, True
        body.fullinertia = [math.nan] * 6
    first, last = spec.compiler.inertiagrouprange
    for geom in spec.worldbody.geoms:  # the world has no inertia, but what carries the part has
        if not first <= geom.group <= last:
            geom.mass = 0.0
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.compiler.settotalmass = -1.0
    return spec, model
