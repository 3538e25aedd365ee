"""The contacts of `n` runs in MuJoCo: facets, pairs and latches, updated before each step.

A MuJoCo step evaluates F = K x + C v at its start, with K and C from the pair's ``solref``. Before
each step, therefore,

- the box of a facet is re-posed to the tangent plane at the point of the surface that is nearest to
  the ball or the rod;
- a linear law is written as (-K g, -C g), any other as (-F g/x, -0), g = A for bodies that yield
  (:mod:`hiltestbed.contact.composition`);
- friction is written as its secant: the pair's ``solreffriction`` is (-0, -mu |F|/sqrt(v^2 + v_0^2)
  g), with a cone ten times as wide, which never acts;
- a native pair of c points gets 1/c of these per point;
- the anchors of closed latches are updated (:mod:`hiltestbed.contact.latches`).

MuJoCo's contacts cannot pull, as adhesion and the frame's mode may without a latch: that part of
the force is :attr:`pull`, to be applied as an external wrench.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.contact import parameters as cp
from hiltestbed.contact.composition import (
    ACTIVE,
    LATCH,
    NO_DAMPING,
    PASSIVE,
    PREFIXES,
    READ,
    Structure,
    inverse_mass,
)  # fmt: skip
from hiltestbed.contact.facets import (
    MET,
    CarriedFrames,
    FacetState,
    Inputs,
    Laws,
    touch_facets,
    touch_natively,
)
from hiltestbed.contact.geometry import ACTIVE as A
from hiltestbed.contact.geometry import FRAMES
from hiltestbed.contact.geometry import PASSIVE as S
from hiltestbed.contact.latches import Latches, hold
from hiltestbed.contact.law import STATES
from hiltestbed.contact.legs import RingLegs
from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.contact.wrench import tilts
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, quat_mul, rotate_back

WIDE = 10.0  # friction coefficient of MuJoCo's cone, which must not act, over the true one


class Engagement:
    """The contacts of `n` runs.

    Attributes:
        met: (n, T, MET) of each facet and each native pair: penetration [m], negative while apart,
            and its rate [m/s]; point of application of the force [m], direction of the force on the
            passive side and slip of the active side [m/s], all (3,) in W; normal force [N] and
            friction coefficient [N s/m].
        linear: (n, T) whether only a linear spring and damper act along the normal; parameters: (n,
            T + 1, PARAMETERS) of the laws, the latch's last. touching: (n,) bool. latched: (n,)
            bool, whether any latch is closed. latches: all of them. legs: of an active
            ring, or None.
        pull: (n, 6) the part of the wrench on the passive side that MuJoCo's contacts do not exert,
            in W at W's origin; pulls: whether there can be any. stage: up to which MuJoCo must have
            computed the forward dynamics
                before :meth:`update`.
        tilt: (n, 7) pose of S in its nominal frame.
    """

    def __init__(
        self,
        batch: Batch,
        laws: Array,
        structure: Structure,
        dt: float,
        least_creep: float,
    ) -> None:
        """``laws``: (n, T + 1, PARAMETERS), the latch's last. ``dt`` [s] between two instants;
        ``least_creep`` [m/s per N] limits the slope of friction to what one step can resolve, v_0
        >= least_creep mu |F|.
        """
        n, sides = len(laws), structure.sides
        pairs = (*sides.facets, *sides.native)
        self.parameters = laws
        neutral = ContactParameters(1.0).row()
        # whether only a linear spring and damper act along the normal
        self.linear = np.all(laws[:, :-1, cp.LINEAR] == neutral[cp.LINEAR], axis=-1)
        self._live = np.ones((n, len(pairs)), dtype=bool)
        self.tilt = tilts(self.parameters[:, -1])
        self._bodies, self._parts = _carried(batch, structure, self.tilt)
        self._inputs, gain, self._reading = _inputs(batch, structure, laws)
        self.state = np.zeros((n, len(pairs) + 1, STATES))
        self.met = np.zeros((n, len(pairs), MET))
        self.wrench = np.zeros((n, 6))
        self.pull = np.zeros((n, 6))
        self.touching = np.zeros(n, dtype=bool)
        self.pulls = bool(
            (self.parameters[:, :-1, cp.ADHESION] > 0.0).any()
            or (self.parameters[:, :-1, cp.MODE] > 0.0).any()
        )
        self.latches = Latches(batch, structure, self.parameters[:, -1])
        ring = structure.mechanism.actuated()
        self.legs = None if ring is None else RingLegs(batch, ring, n, dt)
        self._captured = structure.mechanism.captured
        self.latched = np.zeros(n, dtype=bool)
        own = Laws(dt, least_creep, self.parameters, self.linear, self._live, gain)
        felt = FacetState(self.state, self.met, self.wrench, self.pull, self.touching)
        bodies, inputs, count = self._bodies, self._inputs, len(sides.facets)
        facets = (sides.geometry, own, bodies, inputs, felt) if count else None
        native = (count, self._reading, own, inputs, felt) if sides.native else None
        given = self._parts, felt, facets, native, self.latches.holding(dt, bodies), self.latched
        self._updated = Call(_update, (GIVEN,) * 4, bodies, *given)
        k = self.latches.number(LATCH) if structure.latched else None
        self._relative = None if k is None else (self.latches.pose[:, k], self.latches.twist[:, k])
        moves = bool(sides.native or sides.frames)
        self.stage = int(mujoco.mjtStage.mjSTAGE_VEL if moves else mujoco.mjtStage.mjSTAGE_NONE)
        self.reset()

    def reset(self) -> None:
        """Return to the start: unlatched, or A latched at P if captured from the start."""
        self.state[:] = 0.0
        self.latched[:] = self._captured
        self._live[:] = True
        self.latches.open(captured=self._captured)
        if self.legs is not None:
            self.legs.reset()

    @property
    def frames(self) -> Array:
        """(n, F, 7) poses in W of A, S and moving parts, at the last update."""
        return self._bodies.frames

    @property
    def motions(self) -> Array:
        """(n, F, 6) their twists."""
        return self._bodies.motions

    def update(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """Update MuJoCo's contacts, once per instant, for poses and twists in W of A and of S."""
        self._updated.on(pose, twist, place, motion)()
        if self.legs is not None:
            self.legs.push()

    def capture(self, which: NDArray[np.bool_]) -> None:
        """Latch the runs ``which`` (n,) as they are, from the next instant on, without contacts."""
        new = which & ~self.latched
        if not new.any():
            return
        k, force = self.latches.number(LATCH), np.zeros((len(new), 3))
        for i in np.flatnonzero(new):
            interpreted(rotate_back)(self.frames[i, S, 3:7], self.wrench[i, :3], force[i])
        self.close(k, new, force)
        self._live[new] = False

    def close(self, k: int, which: NDArray[np.bool_], force: Array) -> None:
        """Close closure ``k``; its springs carry ``force`` (n, 3), in the passive site's frame."""
        self.latches.close(k, which, force)
        self.latched |= which

    def release(self, which: NDArray[np.bool_], contacts: NDArray[np.int_]) -> None:
        """Switch off the ``contacts`` in the runs ``which`` (n,) from the next instant on."""
        self._live[np.ix_(which, contacts)] = False

    def relative(self) -> tuple[Array, Array]:
        """Pose (n, 7) and twist (n, 6) of A in S at the last update; needs a latch."""
        if self._relative is None:
            raise InputError(
                "this mechanism has no latch between A and S; allowed are mechanisms that have one"
            )
        return self._relative


def _carried(batch: Batch, structure: Structure, tilt: Array) -> tuple[CarriedFrames, Any]:
    """The frames; MuJoCo's indices and arrays of moving parts, None without any."""
    n, m, names = len(tilt), batch.model, structure.sides.frames
    count = FRAMES + len(names)
    carry = np.zeros((n, count, 7))
    carry[..., 6] = 1.0
    for f, (prefix, port) in enumerate(((ACTIVE, "A"), (PASSIVE, "P"))):
        site = m.site(prefix + port)
        carry[:, f, :3], carry[:, f, 3:] = site.pos, site.quat[[1, 2, 3, 0]]
    for i in range(n):
        q = np.empty(4)
        interpreted(quat_mul)(carry[i, S, 3:7], tilt[i, 3:7], q)
        carry[i, S, 3:7] = q
    bodies = CarriedFrames(np.zeros((n, count, 7)), np.zeros((n, count, 6)), carry)
    if not names:
        return bodies, None
    ids = np.array([m.body(PREFIXES[side] + body).id for side, body in names], dtype=np.int64)
    columns = {"xpos": 3, "xquat": 4, "cvel": 6, "subtree_com": 3}
    read = [batch.bind(name).reshape(n, -1, size) for name, size in columns.items()]
    return bodies, (ids, m.body_rootid[ids].astype(np.int64), *read)


def _inputs(batch: Batch, structure: Structure, laws: Array) -> tuple[Inputs, Array, Array]:
    """MuJoCo's arrays of the pairs; (n, T) g [1/kg]; (n, READ native pairs) their sensors."""
    m, sides = batch.model, structure.sides
    facets, native = range(len(sides.facets)), range(len(sides.native))
    names = [*(f"facet_{k}" for k in facets), *(f"native_{k}" for k in native)]
    pairs = [m.pair(name).id for name in names]
    geoms = [(m.geom(f"facet_{k}").id, m.geom(f"ball_{k}").id) for k in facets]
    geoms += [(-1, -1)] * len(sides.native)
    ids = np.array(
        [(pair, *g) for pair, g in zip(pairs, geoms, strict=True)], dtype=np.int64
    ).reshape(len(pairs), 3)
    bodies = (
        m.geom_bodyid[np.stack([m.pair_geom1[pairs], m.pair_geom2[pairs]])]
        if pairs
        else np.zeros((2, 0), dtype=int)
    )
    arrays = ("geom_pos", "geom_quat", "pair_solref", "pair_solreffriction")
    inputs = Inputs(ids, *(batch.expand(name) for name in arrays))
    inputs.friction[:, pairs] = 2.0 * NO_DAMPING
    if structure.rubs:
        batch.expand("pair_friction")[:, pairs, :2] = WIDE * np.maximum(
            laws[:, :-1, cp.FRICTION, None], 1e-4
        )
    if (laws[:, :-1, cp.OFFSET] < 0.0).any() and sides.native:
        batch.expand("pair_margin")[:, pairs] = np.maximum(-laws[:, :-1, cp.OFFSET], 0.0)
    first = int(m.sensor("native_0").adr[0]) if sides.native else 0
    reading = batch.bind("sensordata")[:, first : first + READ * len(sides.native)]
    return inputs, np.tile(inverse_mass(m, bodies), (len(laws), 1)), reading


@njit(cache=True)
def _update(sides, bodies, parts, felt, facets, native, closures, latched):
    """The frames: A and S from ``sides``, those of moving parts from MuJoCo; and what touches."""
    pose, twist, place, motion = sides
    frames, motions = bodies.frames, bodies.motions
    for i in range(pose.shape[0]):
        for j in range(7):
            frames[i, A, j], frames[i, S, j] = pose[i, j], place[i, j]
        for j in range(6):
            motions[i, A, j], motions[i, S, j] = twist[i, j], motion[i, j]
    if parts is not None:
        ids, roots, xpos, xquat, cvel, com = parts
        # ``cvel`` is at the centre of mass of its tree, angular first
        for i in range(frames.shape[0]):
            for k in range(ids.shape[0]):
                b, at = ids[k], com[i, roots[k]]
                frame, moved = frames[i, FRAMES + k], motions[i, FRAMES + k]
                for j in range(3):
                    frame[j] = xpos[i, b, j]
                    frame[3 + j] = xquat[i, b, 1 + j]
                    moved[3 + j] = cvel[i, b, j]
                frame[6] = xquat[i, b, 0]
                rx, ry, rz = frame[0] - at[0], frame[1] - at[1], frame[2] - at[2]
                moved[0] = cvel[i, b, 3] + moved[4] * rz - moved[5] * ry
                moved[1] = cvel[i, b, 4] + moved[5] * rx - moved[3] * rz
                moved[2] = cvel[i, b, 5] + moved[3] * ry - moved[4] * rx
    if facets is not None:
        touch_facets(*facets)
    else:
        felt.wrench[:] = 0.0
        felt.pull[:] = 0.0
        felt.touching[:] = False
    if native is not None:
        touch_natively(*native)
    if closures is not None:
        hold(*closures)
        for i in range(latched.shape[0]):
            felt.touching[i] |= latched[i]
