"""Two free bodies that carry the sides of a shipped mechanism, in MuJoCo alone: contacts, latches
and phases as mechanism.yaml says.

A contact's stiffness is that of the pair over the number of its points, written before each step; a
ball or a rod on a mesh touches a facet in the mesh's tangent plane; friction is MuJoCo's cone,
viscous below it.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch
from scipy.spatial.transform import Rotation

from hiltestbed.contact.active_ring import ActiveRing
from hiltestbed.contact.description import Closure, Condition, Touching, matching, read
from hiltestbed.contact.legs import RingLegs, stand_on_legs
from hiltestbed.contact.surfaces.surface import Surface, of_mesh, segment_distance, signed_distance

MODELS = Path(__file__).resolve().parents[2] / "models"
IMPEDANCE = 1e-4
SOLIMP = (IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 1.0)
# MuJoCo's cone: friction is full from the speed CREEP on at 100 N, viscous below. The solver raises
# the normal force by the share mu^2 v/CREEP (1/IMPRATIO + IMPEDANCE) at the speed v: 5e-4 for mu =
# 0.3 at 5 cm/s.
IMPRATIO = 1e5
CREEP = 1e-3  # [m/s]
POS = int(mujoco.mjtStage.mjSTAGE_POS)
ROUND = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)
EVERY = 8  # steps between two looks at the phases
FACET = 0.01  # [m] half thickness


class Facet:
    """The tangent plane of a mesh under a ball or a rod, and the ball that stands for the rod's
    nearest place.
    """

    def __init__(self, model: mujoco.MjModel, ball: int, mesh: int, facet: int, proxy: int) -> None:
        self.ball, self.mesh, self.facet, self.proxy = ball, mesh, facet, proxy
        data = model.geom_dataid[mesh]
        first, count = model.mesh_vertadr[data], model.mesh_vertnum[data]
        faces = model.mesh_face[model.mesh_faceadr[data] :][: model.mesh_facenum[data]]
        surface, findings = of_mesh(model.mesh_vert[first : first + count].astype(float), faces)
        assert surface is not None, findings
        self.surface: Surface = surface
        self.radius = float(model.geom_size[ball, 0])
        self.half = float(model.geom_size[ball, 1]) if model.geom_type[ball] == ROUND[1] else 0.0


class Rig:
    """A chaser of 500 kg and a target of 2,000 kg; at first A is ``gap`` before P.

    Attributes:
        rules: the rule of each pair. done: names of the phases that have begun. data: after each
            step, positions as new as the state.
    """

    def __init__(
        self,
        name: str,
        timestep: float = 2.5e-4,
        edit=None,
        free_target: bool = True,
        dissipative: bool = True,
        friction: float | None = None,
        ring: ActiveRing | None = None,
    ) -> None:
        """``edit`` changes the spec before it is compiled; not ``dissipative``: nothing damps;
        ``friction`` replaces that of all pairs; ``ring``: on legs, with their phases.
        """
        self.description = read(MODELS / name / "mechanism.yaml")
        if ring is not None:
            driven = {"phases": self.description.actuated}
            self.description = self.description.model_copy(update=driven)
        if friction is not None or not dissipative:
            rules = [
                r.model_copy(update={"friction": friction or 0.0}) for r in self.description.contact
            ]
            self.description = self.description.model_copy(update={"contact": rules})
        self.spec = spec = mujoco.MjSpec()
        option = spec.option
        option.timestep, option.gravity, option.cone, option.impratio = (
            timestep,
            [0.0, 0.0, 0.0],
            mujoco.mjtCone.mjCONE_ELLIPTIC,
            IMPRATIO,
        )
        option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        sides = {
            side: mujoco.MjSpec.from_file(str(MODELS / name / f"{side}.xml"))
            for side in ("active", "passive")
        }
        if ring is not None:
            stand_on_legs(sides["active"], ring)
        self._carry(sides["passive"], "passive", "P", 2000.0, 1.0, free_target)
        self._carry(sides["active"], "active", "A", 500.0, -1.0, True)
        if edit is not None:
            edit(spec)
        self.dissipative = dissipative
        self._pair(spec.compile())
        self._latches()
        self.model = spec.compile()
        if not dissipative:
            self.model.dof_damping[:] = 0.0
            self.model.dof_frictionloss[:] = 0.0
        self._bind()
        self.legs = None if ring is None else RingLegs(self.batch, ring, 1, timestep)
        self.done: list[str] = []
        self.held = 0.0
        self.closed: dict[str, float] = {}

    def _carry(
        self, side: mujoco.MjSpec, prefix: str, port: str, mass: float, arm: float, free: bool
    ) -> None:
        """A body which with the mechanism's ``side`` has the ``mass`` [kg], its centre ``arm`` [m]
        behind the port.
        """
        body = self.spec.worldbody.add_body(name=f"{prefix}_bus")
        if free:
            body.add_freejoint(name=f"{prefix}_free")
        mass -= sum(b.mass for b in side.bodies)
        body.mass, body.ipos, body.inertia, body.explicitinertial = (
            mass,
            [0.0, 0.0, arm],
            [0.4 * mass] * 3,
            True,
        )
        offset = np.array(side.site(port).pos)
        self.spec.attach(side, prefix=f"{prefix}_", frame=body.add_frame(pos=-offset))

    def _pair(self, model: mujoco.MjModel) -> None:
        """One explicit pair for each pair of geoms of a rule, and a sensor of the number of its
        points.
        """
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        names = [model.geom(i).name for i in range(model.ngeom)]
        self.rules: list[Touching] = []
        self._facets: list[tuple[str, str, str, str]] = []
        for rule in self.description.contact:
            for a in matching(f"active_{rule.active}", names):
                for p in matching(f"passive_{rule.passive}", names):
                    if rule.reach is None or _apart(model, data, a, p) < rule.reach:
                        self._add(model, rule, a, p)

    def _add(self, model: mujoco.MjModel, rule: Touching, a: str, p: str) -> None:
        if model.geom(p).type[0] == mujoco.mjtGeom.mjGEOM_MESH:
            a, p = self._with_facet(model, a, p)
        k = len(self.rules)
        mu = max(rule.friction, 1e-5)
        pair = {
            "condim": 3 if rule.friction > 0.0 else 1,
            "solimp": SOLIMP,
            "friction": [mu, mu, 0.005, 1e-4, 1e-4],
        }
        self.spec.add_pair(name=f"pair_{k}", geomname1=a, geomname2=p, **pair)
        sensor = self.spec.add_sensor(
            name=f"found_{k}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=a,
        )
        sensor.reftype, sensor.refname, sensor.intprm = mujoco.mjtObj.mjOBJ_GEOM, p, [1, 0, 1]
        self.rules.append(rule)

    def _with_facet(self, model: mujoco.MjModel, a: str, p: str) -> tuple[str, str]:
        number = len(self._facets)
        facet, proxy = f"facet_{number}", f"proxy_{number}"
        bodies = [self.spec.body(model.body(model.geom(g).bodyid[0]).name) for g in (a, p)]
        free = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 5}
        bodies[1].add_geom(
            name=facet,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.2, 0.2, FACET],
            pos=[0, 0, 1],
            quat=[0.9, 0.1, 0.2, 0.3],
            **free,
        )
        bodies[0].add_geom(
            name=proxy,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[model.geom(a).size[0], 0, 0],
            pos=[0, 0, -1],
            **free,
        )
        self._facets.append((a, p, facet, proxy))
        return proxy, facet

    def _latches(self) -> None:
        for phase in self.description.phases:
            if phase.close is not None:
                bodies = [
                    self.spec.site(f"{s}_{getattr(phase.close, s)}").parent.name
                    for s in ("passive", "active")
                ]
                kind = (
                    mujoco.mjtEq.mjEQ_WELD
                    if phase.close.kind == "weld"
                    else mujoco.mjtEq.mjEQ_CONNECT
                )
                eq = self.spec.add_equality(
                    name=phase.name,
                    type=kind,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    name1=bodies[0],
                    name2=bodies[1],
                )
                eq.active, eq.solimp = False, SOLIMP

    def _bind(self) -> None:
        m = self.model
        weight = m.body_invweight0
        pairs = np.stack([m.geom_bodyid[m.pair_geom1], m.geom_bodyid[m.pair_geom2]])
        self._inverse = weight[pairs, 0].sum(axis=0)
        # MuJoCo sorts its pairs
        order = np.argsort([m.pair(f"pair_{k}").id for k in range(m.npair)])
        self.rules = [self.rules[k] for k in order]
        self._count = np.array([m.sensor(f"found_{k}").adr[0] for k in order])
        self.stiffness = np.array([r.stiffness for r in self.rules])
        self.damping = np.array([r.damping if self.dissipative else 0.0 for r in self.rules])
        self.batch = b = Batch(m, 1, 1, persistent=True)
        self.solref, friction = b.expand("pair_solref")[0], b.expand("pair_solreffriction")[0]
        viscous = (
            np.array([max(r.friction, 1e-9) for r in self.rules])
            * 100.0
            / CREEP
            * (1.0 + IMPEDANCE * IMPRATIO)
        )
        friction[:, 0], friction[:, 1] = -1e-9 * self._inverse, -viscous * self._inverse / IMPRATIO
        self.facets = [Facet(m, *(m.geom(n).id for n in names)) for names in self._facets]
        self._place, self._turn = b.expand("geom_pos")[0], b.expand("geom_quat")[0]
        self.qpos, self.qvel, self.ctrl = b.bind("qpos")[0], b.bind("qvel")[0], b.bind("ctrl")[0]
        self.found, self.energy = b.bind("sensordata")[0], b.bind("energy")[0]
        self._site, self._site_mat = (
            b.bind("site_xpos")[0],
            b.bind("site_xmat")[0].reshape(-1, 3, 3),
        )
        self._xpos, self._xmat = b.bind("xpos")[0], b.bind("xmat")[0].reshape(-1, 3, 3)
        self._geom, self._geom_mat = (
            b.bind("geom_xpos")[0],
            b.bind("geom_xmat")[0].reshape(-1, 3, 3),
        )
        self._eq_solref, self._eq_data, self._eq_active = (
            b.expand("eq_solref")[0],
            b.expand("eq_data")[0],
            b.bind("eq_active")[0],
        )
        self.dropped = np.zeros(m.npair, dtype=bool)
        self._before = self._site.copy()

    def start(
        self, gap: float, velocity=(0.0, 0.0, 0.0), offset=(0.0, 0.0), attitude_deg=(0.0, 0.0, 0.0)
    ) -> None:
        """A stands ``gap`` [m] before P, aside by ``offset`` [m], turned about x, y, z, and moves
        with ``velocity`` [m/s].
        """
        self.batch.reset(stage=0)
        q, v = self.model.joint("active_free").qposadr[0], self.model.joint("active_free").dofadr[0]
        self.qpos[q : q + 3] = (*offset, -gap)
        self.qpos[q + 3 : q + 7] = Rotation.from_euler("xyz", attitude_deg, degrees=True).as_quat(
            scalar_first=True
        )
        self.qvel[v : v + 3] = velocity
        self.batch.forward(stage=POS)
        self._share()

    def step(self) -> None:
        """One step, with the stiffness shared by the points that touch at its start."""
        self._before[:] = self._site
        if self.legs is not None:
            self.legs.push()
        self.batch.step(stage=POS)
        if self.facets:
            for facet in self.facets:
                self._follow(facet)
            self.batch.forward(stage=POS)
        self._share()

    def _share(self) -> None:
        points = np.maximum(self.found[self._count], 1.0)
        alive = np.where(self.dropped, 1e-9, 1.0)
        self.solref[:, 0] = -self.stiffness * alive * self._inverse / points
        self.solref[:, 1] = np.minimum(-self.damping * alive * self._inverse / points, -1e-12)

    def _follow(self, f: Facet) -> None:
        """Put the facet where the ball, or the rod's nearest place, is about to touch."""
        centre, turn = self._geom[f.mesh], self._geom_mat[f.mesh]
        local = turn.T @ (self._geom[f.ball] - centre)
        along = turn.T @ self._geom_mat[f.ball, :, 2] * f.half
        normal, nearest = np.zeros(3), local.copy()
        if f.half > 0.0:
            d = segment_distance(f.surface, local - along, local + along, f.radius, normal, nearest)
            # beyond its reach it gives the reach itself, where ball and facet would just touch
            d += FACET if d >= f.radius else 0.0
        else:
            d = signed_distance(f.surface, local, math.inf, normal)
        body = self.model.geom_bodyid
        place = turn @ (nearest - (d + FACET) * normal) + centre
        self._place[f.facet] = self._xmat[body[f.facet]].T @ (place - self._xpos[body[f.facet]])
        self._turn[f.facet] = _towards(self._xmat[body[f.facet]].T @ (turn @ normal))
        self._place[f.proxy] = self._xmat[body[f.proxy]].T @ (
            turn @ nearest + centre - self._xpos[body[f.proxy]]
        )

    def holds(self, when: Condition) -> bool:
        """Whether the condition holds at this instant."""
        near = 0
        for name, (low, high) in when.joints.items():
            if not low <= self.qpos[self.model.joint(f"active_{name}").qposadr[0]] <= high:
                return False
        for a, p in when.pairs:
            i, j = self.model.site(f"active_{a}").id, self.model.site(f"passive_{p}").id
            angle = math.degrees(
                math.acos(min(float(self._site_mat[i, :, 2] @ self._site_mat[j, :, 2]), 1.0))
            )
            slow = np.linalg.norm(self.speed(i) - self.speed(j)) <= when.speed
            near += bool(
                np.linalg.norm(self._site[i] - self._site[j]) <= when.within
                and angle <= when.angle_deg
                and slow
            )
        return near >= (when.count or len(when.pairs))

    def speed(self, site: int) -> np.ndarray:
        """Velocity (3,) of a site over the last step [m/s]."""
        return (self._site[site] - self._before[site]) / self.model.opt.timestep

    def advance(self, elapsed: float) -> None:
        """Begin the next phase if its condition has held for as long as it must, ``elapsed`` [s]
        after it was last asked.
        """
        if len(self.done) == len(self.description.phases):
            return
        phase = self.description.phases[len(self.done)]
        self.held = self.held + elapsed if self.holds(phase.when) else 0.0
        if self.held <= phase.when.lasting:
            return
        self.held = 0.0
        self.done.append(phase.name)
        if self.legs is not None:
            self.legs.begin(phase.name, np.array([True]))
        for name, value in phase.command.items():
            self.ctrl[self.model.actuator(f"active_{name}").id] = value
        for geom in phase.drop_contacts:
            of = self.model.geom(f"active_{geom}").id
            balls = [f.proxy if f.ball == of else -1 for f in self.facets] + [of]
            self.dropped |= np.isin(self.model.pair_geom1, balls) | np.isin(
                self.model.pair_geom2, balls
            )
        if phase.close is not None:
            self._close(phase.name, phase.close)

    def _close(self, name: str, latch: Closure) -> None:
        m, e = self.model, self.model.equality(name).id
        b1, b2 = m.eq_obj1id[e], m.eq_obj2id[e]
        a, b = m.body_invweight0[[b1, b2]].sum(axis=0)
        sites = [m.site(f"passive_{latch.passive}").id, m.site(f"active_{latch.active}").id]
        if latch.hold == "here":
            sites[0] = sites[1]
        turn = self._site_mat[sites]
        self._eq_solref[e] = -latch.stiffness * a, -latch.damping * a
        on1, on2 = (
            self._xmat[i].T @ (self._site[s] - self._xpos[i])
            for i, s in zip((b1, b2), sites, strict=True)
        )
        if latch.radius is None:
            self._eq_data[e, 0:3], self._eq_data[e, 3:6] = on1, on2
        else:  # the anchor in the second body, then in the first
            relative = Rotation.from_matrix(self._xmat[b1].T @ turn[0] @ turn[1].T @ self._xmat[b2])
            self._eq_data[e, 0:3], self._eq_data[e, 3:6] = on2, on1
            self._eq_data[e, 6:10], self._eq_data[e, 10] = (
                relative.as_quat(scalar_first=True),
                2.0 * latch.radius * math.sqrt(b / a),
            )
        self._eq_active[e] = 1.0

    def run(self, duration: float, phases: bool = True) -> None:
        """On for ``duration`` [s]."""
        for k in range(round(duration / self.model.opt.timestep)):
            self.step()
            if phases and k % EVERY == 0:
                self.advance(EVERY * self.model.opt.timestep)

    def site(self, name: str) -> np.ndarray:
        """Place (3,) of a site [m]."""
        return self._site[self.model.site(name).id].copy()

    def momentum(self) -> np.ndarray:
        """``(6,)`` of the whole [N s], [N m s] about the origin."""
        data = self.batch.get_data(0)
        mujoco.mj_forward(self.model, data)
        mujoco.mj_subtreeVel(self.model, data)
        linear = data.subtree_linvel[0] * self.model.body_subtreemass[0]
        return np.concatenate(
            [linear, data.subtree_angmom[0] + np.cross(data.subtree_com[0], linear)]
        )


def _apart(model: mujoco.MjModel, data: mujoco.MjData, a: str, p: str) -> float:
    """Least distance across the axis of two capsules or balls [m]."""
    points = []
    for name in (a, p):
        i = model.geom(name).id
        half = model.geom_size[i, 1] if model.geom_type[i] == ROUND[1] else 0.0
        along = data.geom_xmat[i].reshape(3, 3)[:, 2] * half
        points.append((data.geom_xpos[i] + np.linspace(-1.0, 1.0, 9)[:, None] * along)[:, :2])
    return float(np.linalg.norm(points[0][:, None] - points[1][None], axis=2).min())


def _towards(normal: np.ndarray) -> np.ndarray:
    q = np.array([1.0 + normal[2], -normal[1], normal[0], 0.0])
    return q / np.linalg.norm(q) if np.linalg.norm(q) > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])
