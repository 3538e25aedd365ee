"""The contacts of `n` runs in MuJoCo: facets, pairs and latches as they are before each step.

A step of MuJoCo's takes what a pair's ``solref`` says at its start for F = K x + C v. Before each step, therefore,

- the box of a facet is re-posed to the tangent plane at the point of the surface that is nearest to the ball or the rod;
- a linear law is written as (-K g, -C g), any other as (-F g/x, -0), g = A for bodies that yield (:mod:`hiltestbed.contact.solref`);
- friction is written as its secant: the pair's ``solreffriction`` is (-0, -mu |F|/sqrt(v^2 + v_0^2) g), with a cone ten times as wide,
  which never acts;
- a native pair of c points gets a share 1/c of all that;
- a weld holds A in S by springs and dampers. A law that is not linear moves the weld's anchor along z: K (z - z_hold) + C v = F.

What pulls without being latched (adhesion, a frame that rings) cannot come from a contact of MuJoCo's: that part is :attr:`pull`, to be
applied from outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numba import njit
from numpy.typing import NDArray

from hiltestbed.contact import composition
from hiltestbed.contact.composition import AWAY, DIST, FACET, FOUND, IMPEDANCE, LATCH, LINVEL, NORMAL, POS, READ, Structure
from hiltestbed.contact.geometry import ACTIVE, FRAMES, PASSIVE, RADIUS, ROUND_FRAME, ROW, SIDE, SURFACE_FRAME, VALUES
from hiltestbed.contact.law import STATES, contact_force
from hiltestbed.contact.parameters import ADHESION, DAMPING, FRICTION, LINEAR, MODE, OFFSET, STIFFNESS, ContactParameters, believed_contacts, contact_rows
from hiltestbed.contact.solref import NO_DAMPING
from hiltestbed.contact.wrench import LATCH_RADIUS, add_at, add_contact, held_at, law_of, meet_all, relate_one, tilts
from hiltestbed.frames import Array, quat_mul, rotate, rotate_back

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

WIDE = 10.0  # times the friction coefficient: MuJoCo's cone, which must not act
NO_FRICTION = -1e-9  # [1/s^2] of a stiffness along the surface, per A
LEAST = 1e-9  # [m] of the penetration that MuJoCo is shown where a law pushes without any
SCALARS, POINT, NORM, SLIP, PUSH, DRAG, MET = 0, 2, 5, 8, 11, 12, 13  # columns of `met`; the first two are penetration and rate


class Engagement:
    """The contacts of `n` runs.

    Attributes:
        met: (n, T, MET) of each facet and each native pair: penetration [m], negative while apart, and its rate [m/s]; where the force
            acts [m], the direction in which the passive side is pushed and the slip of the active side [m/s], all (3,) in W; normal force
            [N] and what friction is worth [N s/m].
        touching: (n,) bool. latched: (n,) bool; hold: (n, 7) the pose of A in S that the latch holds.
        pull: (n, 6) the part of the wrench on the passive side that MuJoCo's contacts do not exert, in W at W's origin; pulls: whether
            there can be any. stage: up to which MuJoCo has to be forward before :meth:`update`.
        tilt: (n, 7) pose of S in the passive side's nominal place.
    """

    def __init__(self, batch: Batch, scenarios: Sequence[Scenario], structure: Structure, dt: float, least_creep: float, placed: bool) -> None:
        """``dt`` [s] between two instants; ``least_creep`` [m/s per N] bounds the slope of friction from above by that of a step,
        v_0 >= least_creep mu |F|; ``placed``: the active side is put in place, it does not yield."""
        n, model, sides = len(scenarios), batch.model, structure.sides
        self._dt, self._least_creep = dt, least_creep
        self._geometry, self._facets = sides.geometry, len(sides.facets)
        pairs = (*sides.facets, *sides.native)
        self.parameters = np.array([_rows(s, sides.rules) for s in scenarios])
        self._linear = _linear(self.parameters[:, :-1])
        self._live = np.ones((n, len(pairs)), dtype=bool)
        self.tilt = tilts(self.parameters[:, -1])
        self._bodies = _Bodies(batch, structure, self.tilt)
        self._pairs = _Pairs(batch, structure, self.parameters, placed)
        self.state = np.zeros((n, len(pairs) + 1, STATES))
        self.met = np.zeros((n, len(pairs), MET))
        self.wrench, self.pull, self.touching = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros(n, dtype=bool)
        self.pulls = bool((self.parameters[:, :-1, ADHESION] > 0.0).any() or (self.parameters[:, :-1, MODE] > 0.0).any())
        self._captured = scenarios[0].mechanism.captured
        self.latched, self.hold = np.zeros(n, dtype=bool), np.zeros((n, 7))
        self._latch = _Latch(batch, structure, self.parameters[:, -1], placed) if structure.latched else None
        self._pose, self._twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._reading = self._pairs.reading
        moves = bool(sides.native or sides.frames)
        self.stage = int(mujoco.mjtStage.mjSTAGE_VEL if moves else mujoco.mjtStage.mjSTAGE_NONE)
        self.reset()

    def reset(self) -> None:
        """Unlatched, or latched with A at P where the mechanism always is."""
        self.state[:] = 0.0
        self.latched[:] = False
        self._live[:] = True
        self.hold[:] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        if self._latch is not None:
            self._latch.open()
        if self._captured and self._latch is not None:
            self.latched[:] = True
            self._latch.close(self.latched, self.hold, self._bodies.carry)

    def update(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """Make MuJoCo's contacts those of the state: pose (n, 7) and twist (n, 6) of A in W, and those of S; once an instant."""
        b, p = self._bodies, self._pairs
        b.observe(pose, twist, place, motion)
        self.pull[:] = 0.0
        if self._facets:
            _touch_facets(
                *self._geometry, p.ids, self._dt, self._least_creep, self.parameters, self._linear, self._live, p.gain, b.frames, b.motions,
                b.carry, self.state, self.met, p.geom_pos, p.geom_quat, p.solref, p.friction, self.wrench, self.pull, self.touching,
            )  # fmt: skip
        else:
            self.wrench[:] = 0.0
            self.touching[:] = False
        if self._reading.shape[1]:
            _touch_natively(
                self._facets, p.ids, self._dt, self._least_creep, self.parameters, self._linear, self._live, p.gain, self.state, self._reading,
                self.met, p.solref, p.friction, self.wrench, self.pull, self.touching,
            )  # fmt: skip
        if self._latch is not None:
            relate_all(b.frames, b.motions, self._pose, self._twist)
            self.touching |= self.latched
            self._latch.hold(self._pose, self._twist, self._dt, self.latched, self.hold, self.state, b.carry)

    def close(self, which: NDArray[np.bool_]) -> None:
        """Latch the runs ``which`` (n,) where they are, under the force that they bear; what touched touches no more."""
        new = which & ~self.latched
        if self._latch is None or not new.any():
            return
        for i in np.flatnonzero(new):
            held_at(self._pose[i], self.wrench[i], self._bodies.frames[i, PASSIVE], self.parameters[i, -1], self.hold[i])
        self._latch.close(new, self.hold, self._bodies.carry)
        self.latched |= new
        self._live[new] = False
        self._pairs.part(new)

    def relative(self) -> tuple[Array, Array]:
        """Pose (n, 7) and twist (n, 6) of A in S at the last update, of a mechanism that latches."""
        return self._pose, self._twist


def _rows(scenario: Scenario, rules: Sequence[int]) -> Array:
    """``(T + 1, PARAMETERS)`` of each pair and of the latch, effects included."""
    contacts = [c.with_effects(scenario.effects) for c in believed_contacts(scenario.mechanism)]
    return contact_rows(contacts, rules, scenario.mechanism.captured)


def _linear(rows: Array) -> NDArray[np.bool_]:
    """Where nothing but a spring and a damper acts along the normal."""
    neutral = ContactParameters(1.0).row()
    return np.all(rows[..., LINEAR] == neutral[list(LINEAR)], axis=-1)


class _Bodies:
    """Where the frames are in which something stands still.

    Attributes:
        frames, motions: (n, F, 7), (n, F, 6) poses and twists in W of A, S, and of parts that move. carry: (n, F, 7) where each frame is
        in MuJoCo's body that carries it.
    """

    def __init__(self, batch: Batch, structure: Structure, tilt: Array) -> None:
        n, m = len(tilt), batch.model
        names = structure.sides.frames
        self.frames, self.motions = np.zeros((n, FRAMES + len(names), 7)), np.zeros((n, FRAMES + len(names), 6))
        self.carry = np.zeros((n, FRAMES + len(names), 7))
        self.carry[..., 6] = 1.0
        for f, (prefix, port) in enumerate(((composition.ACTIVE, "A"), (composition.PASSIVE, "P"))):
            site = m.site(prefix + port)
            self.carry[:, f, :3] = site.pos
            self.carry[:, f, 3:] = site.quat[[1, 2, 3, 0]]
        for i in range(n):
            q = np.empty(4)
            quat_mul(self.carry[i, PASSIVE, 3:7], tilt[i, 3:7], q)
            self.carry[i, PASSIVE, 3:7] = q
        prefixes = {"A": composition.ACTIVE, "P": composition.PASSIVE}
        self._ids = np.array([m.body(prefixes[side] + body).id for side, body in names], dtype=np.int64)
        if names:
            self._root = m.body_rootid[self._ids].astype(np.int64)
            bind = batch.bind
            self._xpos, self._xquat = bind("xpos").reshape(n, -1, 3), bind("xquat").reshape(n, -1, 4)
            self._cvel, self._com = bind("cvel").reshape(n, -1, 6), bind("subtree_com").reshape(n, -1, 3)

    def observe(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """Move on to the state: A, S and the parts that move."""
        self.frames[:, ACTIVE], self.motions[:, ACTIVE] = pose, twist
        self.frames[:, PASSIVE], self.motions[:, PASSIVE] = place, motion
        if len(self._ids):
            _parts(self._ids, self._root, self._xpos, self._xquat, self._cvel, self._com, self.frames, self.motions)


class _Pairs:
    """MuJoCo's pairs and facets.

    Attributes:
        ids: (T, 3) of each contact its pair, its facet and its ball; -1 where there is none. gain: (T,) g [1/kg].
        geom_pos, geom_quat, solref, friction: MuJoCo's, of each run. reading: (n, READ native pairs) what their sensors say.
    """

    def __init__(self, batch: Batch, structure: Structure, parameters: Array, placed: bool) -> None:
        m, sides = batch.model, structure.sides
        names = [f"facet_{k}" for k in range(len(sides.facets))] + [f"native_{k}" for k in range(len(sides.native))]
        pairs = [m.pair(name).id for name in names]
        facets = [(m.geom(f"facet_{k}").id, m.geom(f"ball_{k}").id) for k in range(len(sides.facets))] + [(-1, -1)] * len(sides.native)
        self.ids = np.array([(p, *f) for p, f in zip(pairs, facets, strict=True)], dtype=np.int64).reshape(len(pairs), 3)
        bodies = m.geom_bodyid[np.stack([m.pair_geom1[pairs], m.pair_geom2[pairs]])] if pairs else np.zeros((2, 0), dtype=int)
        self.gain = gain(m, bodies, placed)[0]
        self.geom_pos, self.geom_quat = batch.expand("geom_pos"), batch.expand("geom_quat")
        self.solref, self.friction = batch.expand("pair_solref"), batch.expand("pair_solreffriction")
        self.friction[:] = 2.0 * NO_DAMPING
        if structure.rubs:
            batch.expand("pair_friction")[:, pairs, :2] = WIDE * np.maximum(parameters[:, :-1, FRICTION, None], 1e-4)
        if (parameters[:, :-1, OFFSET] < 0.0).any() and sides.native:
            batch.expand("pair_margin")[:, pairs] = np.maximum(-parameters[:, :-1, OFFSET], 0.0)
        reading = batch.bind("sensordata")
        first = int(m.sensor("native_0").adr[0]) if sides.native else 0
        self.reading = reading[:, first : first + READ * len(sides.native)]


    def part(self, which: NDArray[np.bool_]) -> None:
        """Let nothing touch in the runs ``which`` (n,)."""
        facets = self.ids[self.ids[:, 1] >= 0, 1]
        self.geom_pos[np.ix_(which, facets, [2])] = AWAY
        self.solref[np.ix_(which, self.ids[:, 0])] = NO_DAMPING


def gain(model: mujoco.MjModel, bodies: NDArray[np.int_], placed: bool) -> Array:
    """``(2, k)`` what a stiffness [N/m] is multiplied with in a direct solref between ``bodies`` (2, k): for shifts and for turns [1/kg].

    That is A, the sum of both inverse weights, less d times the part of it that belongs to a body which is put in place (``placed``):
    such a body does not yield, though MuJoCo is told that it had the inverse weight of 1/kg.
    """
    weight = model.body_invweight0[bodies]
    immovable = placed & (model.body_weldid[bodies] == model.body_weldid[model.site_bodyid[model.site(composition.ACTIVE + "A").id]])
    total = weight.sum(axis=0)
    return (total - IMPEDANCE * np.where(immovable[..., None], weight, 0.0).sum(axis=0)).T


class _Latch:
    """The weld that holds A in S."""

    def __init__(self, batch: Batch, structure: Structure, rows: Array, placed: bool) -> None:
        m = batch.model
        self._id = e = m.equality(LATCH).id
        bodies = np.array([[m.eq_obj1id[e]], [m.eq_obj2id[e]]])
        shift = float(gain(m, bodies, placed)[0, 0])
        a, b = m.body_invweight0[bodies[:, 0]].sum(axis=0)
        solref, data = batch.expand("eq_solref"), batch.expand("eq_data")
        solref[:, e, 0] = -rows[:, STIFFNESS] * shift
        solref[:, e, 1] = np.minimum(-rows[:, DAMPING] * shift, NO_DAMPING)
        data[:, e, 10] = 2.0 * LATCH_RADIUS * math.sqrt(b / a)
        self._rows, self._data, self._active = rows, data, batch.bind("eq_active")
        self._straight = bool(_linear(rows).all())

    def open(self) -> None:
        """Hold nothing."""
        self._active[:, self._id] = 0

    def close(self, which: NDArray[np.bool_], hold: Array, carry: Array) -> None:
        """Hold A where ``hold`` (n, 7) says, in the runs ``which`` (n,)."""
        _anchor(which, hold, carry, self._id, self._data)
        self._active[which, self._id] = 1

    def hold(self, pose: Array, twist: Array, dt: float, latched: NDArray[np.bool_], hold: Array, state: Array, carry: Array) -> None:
        """Move the anchors so that the weld exerts the law along z."""
        if not self._straight:
            _follow_law(self._rows, dt, pose, twist, latched, hold, state, carry, self._id, self._data)


@njit(cache=True)
def relate_all(frames, motions, pose, twist):
    """Pose (n, 7) and twist (n, 6) of A in S."""
    work = np.empty((1, 3))
    for i in range(pose.shape[0]):
        relate_one(frames[i, ACTIVE], motions[i, ACTIVE], frames[i, PASSIVE], motions[i, PASSIVE], pose[i], twist[i], work)


@njit(cache=True)
def _parts(ids, roots, xpos, xquat, cvel, com, frames, motions):
    """Poses and twists of MuJoCo's bodies; ``cvel`` is that of the body at the centre of mass of its tree, angular first."""
    for i in range(frames.shape[0]):
        for k in range(ids.shape[0]):
            b, at = ids[k], com[i, roots[k]]
            pose, twist = frames[i, FRAMES + k], motions[i, FRAMES + k]
            for j in range(3):
                pose[j] = xpos[i, b, j]
                pose[3 + j] = xquat[i, b, 1 + j]
                twist[3 + j] = cvel[i, b, j]
            pose[6] = xquat[i, b, 0]
            rx, ry, rz = pose[0] - at[0], pose[1] - at[1], pose[2] - at[2]
            twist[0] = cvel[i, b, 3] + twist[4] * rz - twist[5] * ry
            twist[1] = cvel[i, b, 4] + twist[5] * rx - twist[3] * rz
            twist[2] = cvel[i, b, 5] + twist[3] * ry - twist[4] * rx


@njit(cache=True)
def _touch_facets(
    index, values, ids, dt, least_creep, p, linear, live, gain, frames, motions, carry, state, met, geom_pos, geom_quat, solref, friction,
    wrench, pull, touching,
):  # fmt: skip
    """Facets, springs and friction of each run from where its sides are."""
    count = index[-1]
    depth, rate = np.empty(count), np.empty(count)
    point, normal, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    work, f = np.empty((9, 7)), np.empty(6)
    for i in range(met.shape[0]):
        wrench[i], pull[i] = 0.0, 0.0
        touching[i] = False
        meet_all(index, values, p[i], frames[i], motions[i], work, depth, rate, point, normal, slip)
        for c in range(count):
            row, out = p[i, c], met[i, c]
            out[0], out[1], out[PUSH], out[DRAG] = depth[c], rate[c], 0.0, 0.0
            if not live[i, c]:
                geom_pos[i, ids[c, 1], 2] = AWAY
                continue
            push, drag = law_of(dt, least_creep, row, state[i, c], depth[c], rate[c], slip[c])
            if depth[c] <= row[OFFSET] and push == 0.0:
                geom_pos[i, ids[c, 1], 2] = AWAY
                continue
            touching[i] = True
            out[PUSH], out[DRAG] = push, drag
            surface, side = index[c * ROW + SURFACE_FRAME], index[c * ROW + SIDE]
            _outwards(point[c], normal[c], slip[c], frames[i, surface], side, out)
            add_contact(push, drag, point[c], normal[c], slip[c], frames[i, surface], side, f, wrench[i])
            if push < 0.0:
                add_contact(push, drag, point[c], normal[c], slip[c], frames[i, surface], side, f, pull[i])
            if push < 0.0:
                geom_pos[i, ids[c, 1], 2] = AWAY
                continue
            show = max(depth[c] - row[OFFSET], LEAST)
            _pose_facet(
                point[c], normal[c], show, values[c * VALUES + RADIUS], frames[i], carry[i], surface, index[c * ROW + ROUND_FRAME],
                ids[c], geom_pos[i], geom_quat[i], work,
            )  # fmt: skip
            _spring(linear[i, c], row, push, drag, show, gain[c], solref[i, ids[c, 0]], friction[i, ids[c, 0]])


@njit(cache=True)
def _spring(linear, row, push, drag, show, g, solref, friction):
    """What MuJoCo is told of a contact that it sees ``show`` [m] deep, for a normal force ``push`` and a friction worth ``drag``."""
    if linear:
        solref[0] = -row[STIFFNESS] * g
        solref[1] = min(-row[DAMPING] * g, NO_DAMPING)
    else:
        solref[0] = min(-push * g / show, NO_DAMPING)
        solref[1] = NO_DAMPING
    friction[0] = NO_FRICTION * g
    friction[1] = min(-drag * g, NO_DAMPING)


@njit(cache=True)
def _outwards(point, normal, slip, place, side, out):
    """Point, normal and slip in W: what pushes the passive side, and how the active side slips."""
    rotate(place[3:7], point, out[POINT : POINT + 3])
    rotate(place[3:7], normal, out[NORM : NORM + 3])
    rotate(place[3:7], slip, out[SLIP : SLIP + 3])
    for j in range(3):
        out[POINT + j] += place[j]
        out[NORM + j] *= side
        out[SLIP + j] *= side


@njit(cache=True)
def _pose_facet(point, normal, show, radius, frames, carry, surface, round_, ids, geom_pos, geom_quat, work):
    """Put the facet in the tangent plane and the ball ``show`` [m] into it, so that MuJoCo's contact is at ``point`` (3,)."""
    at, turn = work[0], work[1]
    for j in range(3):
        at[j] = point[j] + normal[j] * (FACET[2] - 0.5 * show)
    rotate(carry[surface, 3:7], at[0:3], at[0:3])
    for j in range(3):
        geom_pos[ids[1], j] = at[j] + carry[surface, j]
    turn[0], turn[1], turn[2], turn[3] = normal[1], -normal[0], 0.0, 1.0 - normal[2]  # turns z to -normal
    length = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[3] ** 2)
    if length > 1e-9:
        turn[0], turn[1], turn[3] = turn[0] / length, turn[1] / length, turn[3] / length
    else:
        turn[0], turn[1], turn[3] = 1.0, 0.0, 0.0
    whole = work[2]
    quat_mul(carry[surface, 3:7], turn[0:4], whole[0:4])
    out = geom_quat[ids[1]]
    out[0], out[1], out[2], out[3] = whole[3], whole[0], whole[1], whole[2]
    for j in range(3):
        at[j] = point[j] - normal[j] * (radius - 0.5 * show)
    rotate(frames[surface, 3:7], at[0:3], at[0:3])
    for j in range(3):
        at[j] += frames[surface, j] - frames[round_, j]
    rotate_back(frames[round_, 3:7], at[0:3], at[0:3])
    rotate(carry[round_, 3:7], at[0:3], at[0:3])
    for j in range(3):
        geom_pos[ids[2], j] = at[j] + carry[round_, j]


@njit(cache=True)
def _touch_natively(
    facets, ids, dt, least_creep, p, linear, live, gain, state, reading, met, solref, friction, wrench, pull, touching
):  # fmt: skip
    """Springs and friction of the pairs that MuJoCo collides itself, from what their sensors say of the deepest points."""
    f, slip = np.empty(6), np.zeros(3)
    for i in range(met.shape[0]):
        for k in range(ids.shape[0] - facets):
            c, said = facets + k, reading[i, k * READ : (k + 1) * READ]
            row, out, points = p[i, c], met[i, c], said[FOUND]
            out[:] = 0.0
            out[0] = -said[DIST] if points > 0.0 else -1.0
            if points == 0.0:
                law_of(dt, least_creep, row, state[i, c], -1.0, 0.0, slip)
                continue
            depth, out[1] = out[0], -said[LINVEL]
            slip[0], slip[1] = said[LINVEL + 1], said[LINVEL + 2]
            push, drag = law_of(dt, least_creep, row, state[i, c], depth, out[1], slip) if live[i, c] else (0.0, 0.0)
            show = max(depth + max(-row[OFFSET], 0.0), LEAST)
            _spring(linear[i, c] and live[i, c], row, max(push, 0.0), drag, show, gain[c] / points, solref[i, ids[c, 0]], friction[i, ids[c, 0]])
            if push == 0.0 and depth <= 0.0:
                continue
            touching[i] |= live[i, c]
            out[PUSH], out[DRAG] = push, drag
            for j in range(3):
                out[POINT + j], out[NORM + j] = said[POS + j], said[NORMAL + j]
                f[j] = push * said[NORMAL + j]
            add_at(out[POINT : POINT + 3], f, wrench[i])
            if push < 0.0:
                add_at(out[POINT : POINT + 3], f, pull[i])


@njit(cache=True)
def _anchor(which, hold, carry, e, data):
    """Write into ``data`` (n, neq, 11) of a weld between the passive and the active body where it holds A: ``hold`` (n, 7) in S."""
    q, back, at = np.empty(4), np.empty(4), np.empty(3)
    for i in range(hold.shape[0]):
        if not which[i]:
            continue
        s, a = carry[i, PASSIVE], carry[i, ACTIVE]
        rotate(s[3:7], hold[i, 0:3], at)
        for j in range(3):
            data[i, e, j] = a[j]
            data[i, e, 3 + j] = at[j] + s[j]
            back[j] = -a[3 + j]
        back[3] = a[6]
        quat_mul(s[3:7], hold[i, 3:7], q)
        whole = np.empty(4)
        quat_mul(q, back, whole)
        data[i, e, 6], data[i, e, 7], data[i, e, 8], data[i, e, 9] = whole[3], whole[0], whole[1], whole[2]


@njit(cache=True)
def _follow_law(rows, dt, pose, twist, latched, hold, state, carry, e, data):
    """Move the anchor along z of S so that K (z - z_hold) + C v is what the law asks for."""
    last, moved = state.shape[1] - 1, np.empty((1, 7))
    on = np.ones(1, dtype=np.bool_)
    for i in range(pose.shape[0]):
        if not latched[i]:
            continue
        force = contact_force(pose[i, 2] - hold[i, 2], twist[i, 2], dt, rows[i], state[i, last], True)
        moved[0] = hold[i]
        moved[0, 2] = pose[i, 2] - (force - rows[i, DAMPING] * twist[i, 2]) / rows[i, STIFFNESS]
        _anchor(on, moved, carry[i : i + 1], e, data[i : i + 1])
