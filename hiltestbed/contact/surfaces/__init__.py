"""Surfaces for contact with a ball or rod: nearest point, signed distance and normal, exact or to
the mesh's triangles.
"""
