"""One side of a mechanism, compiled alone: where its geoms and sites are, and their surfaces."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.part import compiled
from hiltestbed.contact.geometry import ACTIVE, FRAMES, PASSIVE
from hiltestbed.contact.surfaces import surface as surf
from hiltestbed.contact.surfaces.soundness import MeshFault
from hiltestbed.contact.surfaces.surface import Surface, hollow, of_geom, of_mesh
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, quat_from_mujoco

WIDTHS = np.array([7, 4, 1, 1])  # numbers in qpos of a free, ball, slide and hinge joint


# by port of a side and name of its moving body: number of the frame, after those of A and S
Frames = dict[tuple[str, str], int]


class Side:
    """One side, compiled alone."""

    def __init__(self, file: str, site: str) -> None:
        self.file, self.port = file, site
        self.model = m = compiled(Path(file))
        self.data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, self.data)
        found = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, site)
        if found < 0:
            have = ", ".join(m.site(i).name for i in range(m.nsite)) or "none"
            raise InputError(
                f"{file}: has no site {site!r} (sites: {have}); the port's frame is a site of "
                f"that name, its +z along the insertion"
            )
        if m.body_weldid[m.site_bodyid[found]] != 0:
            raise InputError(
                f"{file}: the site {site!r} is on a part that moves; the port's frame must be "
                f"fixed to its side; put the site on a body without joints, at the place of the "
                f"tip at rest"
            )
        self.origin = self.data.site_xpos[found].copy()
        self.axes = self.data.site_xmat[found].reshape(3, 3).copy()
        self.findings: dict[str, list[MeshFault]] = {}
        self._surfaces: dict[int, Surface] = {}

    def releases(self) -> bool:
        """Whether it has actuators, sprung tendons, or joints whose springs start loaded."""
        m = self.model
        loaded = [
            not np.array_equal(m.qpos_spring[a : a + n], m.qpos0[a : a + n])
            for a, n, k in zip(m.jnt_qposadr, WIDTHS[m.jnt_type], m.jnt_stiffness, strict=True)
            if k > 0.0
        ]
        return bool(m.nu or any(loaded) or (m.tendon_stiffness > 0.0).any())

    def name(self, geom: int) -> str:
        return self.model.geom(geom).name

    def type(self, geom: int) -> int:
        return int(self.model.geom_type[geom])

    def touching(self) -> list[int]:
        """Geoms that MuJoCo would let collide with something."""
        m = self.model
        return [g for g in range(m.ngeom) if m.geom_contype[g] or m.geom_conaffinity[g]]

    def in_frame(self, geom: int, frames: Frames) -> tuple[int, tuple[Array, Array]]:
        """Number of a geom's frame, and its position (3,) and axes (3, 3) in it."""
        d = self.data
        return self._in_frame(
            self.model.geom_bodyid[geom], d.geom_xpos[geom], d.geom_xmat[geom].reshape(3, 3), frames
        )

    def _in_frame(
        self, body: int, place: Array, turn: Array, frames: Frames
    ) -> tuple[int, tuple[Array, Array]]:
        m, d = self.model, self.data
        root = int(m.body_weldid[body])
        if root == 0:
            return (ACTIVE if self.port == "A" else PASSIVE), (
                (place - self.origin) @ self.axes,
                self.axes.T @ turn,
            )
        axes = d.xmat[root].reshape(3, 3)
        number = frames.setdefault((self.port, m.body(root).name), FRAMES + len(frames))
        return number, (
            (place - d.xpos[root]) @ axes,
            axes.T @ turn,
        )

    def site(self, name: str, frames: Frames) -> tuple[int, Array]:
        """Number of a site's frame, and its pose (7,) in it. Raises InputError if there is none."""
        m, d = self.model, self.data
        found = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, name)
        if found < 0:
            have = ", ".join(m.site(i).name for i in range(m.nsite))
            raise InputError(
                f"{self.file}: has no site {name!r}, which a phase of capture names; its sites "
                f"are {have}"
            )
        frame, (place, turn) = self._in_frame(
            m.site_bodyid[found], d.site_xpos[found], d.site_xmat[found].reshape(3, 3), frames
        )
        return frame, np.concatenate([place, quaternion(turn)])

    def surface(self, geom: int) -> Surface:
        """The surface of a facet. Raises InputError for a mesh that cannot be used."""
        m = self.model
        if m.geom_type[geom] != surf.MESH:
            return of_geom(int(m.geom_type[geom]), m.geom_size[geom])
        mesh = int(m.geom_dataid[geom])
        if mesh in self._surfaces:
            return self._surfaces[mesh]
        found, self.findings[self.name(geom)] = of_mesh(*self._mesh(mesh))
        if found is None:
            raise InputError(
                f"{self.file}: mesh of the geom {self.name(geom)!r}: "
                + "; ".join(f.message for f in self.findings[self.name(geom)] if not f.usable)
            )
        self._surfaces[mesh] = found
        return found

    def not_convex(self, geom: int) -> str | None:
        """Why MuJoCo's own collision does not see the true surface of a geom; None: it does."""
        m, kind = self.model, self.type(geom)
        if kind in surf.KINDS:
            return None
        if kind != surf.MESH:
            name = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
            return (
                f"{self.name(geom)} is of type {name}, whose contact points share no stiffness; "
                f"give its surface as a mesh, which balls and rods touch exactly"
            )
        depth = hollow(*self._mesh(int(m.geom_dataid[geom])))
        if depth is None:
            return None
        return (
            f"the mesh of {self.name(geom)} is not convex (faces {1e3 * depth:.3g} mm inside its "
            f"hull), and MuJoCo's collision takes the hull; divide it into convex geoms, or touch "
            f"it with balls and rods (capsules), which meet its true surface"
        )

    def apart(self) -> list[tuple[str, str]]:
        """Pairs of geoms of this side that MuJoCo would let collide, but in no pair of the file."""
        m = self.model
        pairs = {tuple(sorted(p)) for p in zip(m.pair_geom1, m.pair_geom2, strict=True)}
        excluded = set(m.exclude_signature.tolist())
        found = []
        for g in self.touching():
            for h in self.touching():
                one, other = sorted((int(m.geom_bodyid[g]), int(m.geom_bodyid[h])))
                welds = int(m.body_weldid[one]), int(m.body_weldid[other])
                meets = (
                    m.geom_contype[g] & m.geom_conaffinity[h]
                    or m.geom_contype[h] & m.geom_conaffinity[g]
                )
                above = [int(m.body_weldid[m.body_parentid[w]]) for w in welds]
                kin = (welds[0] and welds[0] == above[1]) or (welds[1] and welds[1] == above[0])
                if (
                    g < h
                    and meets
                    and welds[0] != welds[1]
                    and not kin
                    and (g, h) not in pairs
                    and (one << 16) + other not in excluded
                ):
                    found.append((self.name(g), self.name(h)))
        return found

    def _mesh(self, mesh: int) -> tuple[Array, NDArray[np.int_]]:
        """Vertices (nv, 3) [m] and faces (nf, 3) of a mesh."""
        m = self.model
        vertices = m.mesh_vert[m.mesh_vertadr[mesh] :][: m.mesh_vertnum[mesh]].astype(float)
        return vertices, m.mesh_face[m.mesh_faceadr[mesh] :][: m.mesh_facenum[mesh]]

    def ends(self, geom: int) -> Array:
        """``(k, 2)`` lateral positions [m], in the port's axes, on a rod, or of a centre."""
        half = self.model.geom_size[geom, 1] if self.type(geom) == surf.CAPSULE else 0.0
        along = self.data.geom_xmat[geom].reshape(3, 3)[:, 2] * half
        points = self.data.geom_xpos[geom] + np.linspace(-1.0, 1.0, 9)[:, None] * along
        return ((points - self.origin) @ self.axes)[:, :2]


def quaternion(axes: Array) -> Array:
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(axes).ravel())
    return quat_from_mujoco(q)
