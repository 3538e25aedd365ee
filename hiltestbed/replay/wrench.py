"""Contact and sensor on recorded poses: what the sensor should have read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from hiltestbed.contact.cone import PLANE, TIP_RADIUS, Surfaces, beyond_rim, cone_distance, meet
from hiltestbed.contact.latch import closes
from hiltestbed.contact.law import STATES
from hiltestbed.contact.mount import BODY, SCRATCH, MountDynamics, mount_place, mount_reading, mount_step
from hiltestbed.contact.parameters import BRANCH_STIFFNESS, DRAG, LEVER, MODE, OFFSET, STIFFNESS, TILT_X, TILT_Y, ContactParameters
from hiltestbed.contact.touch import contact_wrench, relate_one, surface_wrench, tilts, to_frame
from hiltestbed.frames import Array, quat_exp, quat_mul, rotate, rotate_back, twist_between
from hiltestbed.log import LogParameters
from hiltestbed.sensor.chain import condition, passes
from hiltestbed.sensor.parameters import SensorParameters, stack

WHOLE = 1e-6  # ticks that a delay may be off a whole number
NEAR = 2.5e-3  # [m] by which the surfaces may be nearer than believed for rows to be passed over by geometry alone


@dataclass(frozen=True)
class Felt:
    """What the lanes of a replay share: recorded paths and the mechanism that moved along them.

    Attributes:
        poses: (R, N, 7) of A in P at t_k. before: (R, 7) at t_(-1). tick: [s]. surfaces: of the mechanism.
        captured: (R,) bool, latched from the start. latch: (R, 3) least depth [m], cosine, speed [m/s] of the latch condition; never met
            where there is no latch. mount: of the runs, or None for a rigid one.
        substeps: instants of the physics a tick, at which a compliant mount is integrated.
        twists: (R, N, 6) over the tick that ends at each row. near: (R, N) whether the surfaces may touch in it.
        lever: where in the overlap the force acts. rates: (R, N, 6) twist at t_k, where it is known, as under a servo; None: the slope of
            the pose over the tick that ends there.
        least_creep: [m/s per N] bounds the slope of friction from above, see :class:`hiltestbed.contact.touch.Touch`.
        met: geometry at t_k while nothing is tilted, see :func:`hiltestbed.contact.cone.meet`: it does not depend on what the law is
            thought to be.
    """

    poses: Array
    before: Array
    tick: float
    surfaces: Surfaces
    captured: np.ndarray
    latch: Array
    mount: MountDynamics | None
    substeps: int
    lever: float = 0.5
    rates: Array | None = None
    least_creep: float = 0.0
    twists: Array = field(init=False)
    near: np.ndarray = field(init=False)
    met: tuple[Array, Array, Array, Array, Array] = field(init=False)

    def __post_init__(self) -> None:
        rows = self.poses.shape[:2]
        twists, near = np.empty((*rows, 6)), np.empty(rows, dtype=bool)
        met = (np.full((*rows, 2), -1.0), np.zeros((*rows, 2)), np.zeros((*rows, 2, 3)), np.zeros((*rows, 2, 3)), np.zeros((*rows, 2, 3)))
        _slopes(self.poses, self.before, self.tick, twists)
        _near(self.surfaces.kind, self.surfaces.sizes, self.poses, self.before, NEAR, near)
        object.__setattr__(self, "twists", twists)
        _meet(self.surfaces.kind, self.surfaces.sizes, self.lever, self.poses, self.ends, near, *met)
        object.__setattr__(self, "near", near)
        object.__setattr__(self, "met", met)

    @property
    def ends(self) -> Array:
        """(R, N, 6) twist with which the contact is felt at t_k."""
        return self.twists if self.rates is None else self.rates


class Lane(NamedTuple):
    """One lane: the run that drives it and the numbers of contact, sensor and record; later: [s] that it is read later than those say."""

    run: int
    contact: ContactParameters
    sensor: SensorParameters
    log: LogParameters
    later: float = 0.0


def replay_wrench(felt: Felt, lanes: Sequence[Lane], grid: int | None = None) -> Array:
    """``(L, N, 6)`` noiseless readings of the sensor, as the record should hold them.

    Args:
        grid: instants a tick between which a late reading lies on a straight line, as in a facility that computes its contact step by
            step; None: a late reading is that of the instant at which it left the contact. A compliant mount is integrated on the
            instants of the physics in any case.
    """
    h = felt.tick
    delay = np.array([max(lane.sensor.delay + lane.later + lane.log.skew * lane.log.reread, 0.0) for lane in lanes])
    ticks = delay / h
    whole = np.abs(ticks - np.round(ticks)) < WHOLE
    ticks[whole] = np.round(ticks[whole])
    instants = grid if felt.mount is None else max(grid or 0, felt.substeps)
    if instants:
        parts = np.tile(np.arange(1, instants + 1) / instants, (len(lanes), 1))
    else:
        parts = np.ones((len(lanes), 2))
        parts[:, 0] = np.where(whole, 1.0, 1.0 - (ticks - np.floor(ticks)))
    rows = np.array([lane.contact.row() for lane in lanes])
    chain = stack([lane.sensor for lane in lanes])
    if chain.tone.shape[1]:
        again = np.array([lane.log.skew * lane.log.reread for lane in lanes])
        chain.tone[:, :, 4] -= 2.0 * math.pi * chain.tone[:, :, 3] * again[:, None]  # a tone goes on until it is read anew
    run = np.array([lane.run for lane in lanes])
    out = np.empty((len(lanes), felt.poses.shape[1], 6))
    dynamics = (felt.mount.stiffness, felt.mount.damping, felt.mount.body) if felt.mount is not None else _RIGID
    _replay(
        run, felt.poses, felt.twists, felt.ends, felt.rates is not None, felt.before, felt.near, felt.met, felt.lever, h,
        felt.least_creep, felt.surfaces.kind, felt.surfaces.sizes, felt.captured, felt.latch, dynamics, parts, bool(instants), ticks, rows,
        tilts(rows), chain.elements(), out,
    )  # fmt: skip
    for i, lane in enumerate(lanes):
        if lane.log.skew and not lane.log.reread:
            out[i] = shifted(out[i], -lane.log.skew / h)
    return out


_RIGID = (np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(BODY))


def shifted(values: Array, ticks: float) -> Array:
    """``values`` (N, C) read ``ticks`` rows later (or earlier), linearly between rows; the first and the last row are held."""
    rows = np.clip(np.arange(len(values)) + ticks, 0.0, len(values) - 1.0)
    low = np.floor(rows).astype(int)
    part = (rows - low)[:, None]
    return values[low] + part * (values[np.minimum(low + 1, len(values) - 1)] - values[low])


@njit(cache=True)
def _replay(
    run, poses, twists, ends, bent, before, near, met, lever, h, creep, kind, sizes, captured, latch, mount, parts, between, ticks, p,
    tilt, elements, out,
):  # fmt: skip
    """All lanes, one after the other: each is a run from its first row to its last."""
    calibration, lag, leak, offset, drift, tone, deadzone, limit, step = elements
    stages = max(lag.shape[1], leak.shape[1])
    low, high, last_in = np.zeros((stages, 6)), np.zeros((stages, 6)), np.zeros((stages, 6))
    quiet, late = np.zeros(6), np.zeros(6)
    sub = np.empty((poses.shape[1], parts.shape[1], 6))
    for i in range(len(run)):
        r = run[i]
        _contact(
            poses[r], twists[r], ends[r], bent, before[r], near[r], met, lever, h, creep, kind, sizes, captured[r], latch[r], r, mount,
            parts[i], between, p[i], tilt[i], sub,
        )  # fmt: skip
        low[:], high[:], last_in[:] = 0.0, 0.0, 0.0
        back = int(math.floor(ticks[i]))
        if not between and passes(calibration[i], lag[i], leak[i], offset[i], drift[i], tone[i], deadzone[i], limit[i]):
            out[i, :back] = 0.0
            out[i, back:] = sub[: out.shape[1] - min(back, out.shape[1]), 0]
            continue
        for k in range(out.shape[1]):
            if between:
                _interpolated(sub, k * parts.shape[1] - ticks[i] * parts.shape[1], late)
            else:
                for j in range(6):
                    late[j] = sub[k - back, 0, j] if k >= back else 0.0
            condition(
                late, k * h, quiet, calibration[i], lag[i], leak[i], offset[i], drift[i], tone[i], deadzone[i], limit[i], step[i] * 0.0,
                low, high, last_in, out[i, k],
            )  # fmt: skip


@njit(cache=True)
def _interpolated(sub, at, late):
    """The wrench at the instant ``at`` of ``sub`` (N, m, 6), of which the last in row k is the instant k m; zero before the start."""
    m = sub.shape[1]
    if abs(at - round(at)) < WHOLE:
        at = round(at)
    first = math.floor(at)
    part = at - first
    for j in range(6):
        a = sub[(first + m - 1) // m, (first + m - 1) % m, j] if first >= 0 else 0.0
        if part > 0.0:
            b = sub[(first + m) // m, (first + m) % m, j] if first + 1 >= 0 else 0.0
            a += part * (b - a)
        late[j] = a


@njit(cache=True)
def _contact(
    poses, twists, ends, bent, before, near, met, lever, h, creep, kind, sizes, captured, latch, r, mount, parts, between, p, tilt, sub
):  # fmt: skip
    """What the sensor feels along one path: ``sub`` (N, m, 6) at the instants ``parts`` (m,) of the tick that ends at each row."""
    stiffness, damping, body = mount
    mounted = stiffness.shape[0] > 0
    state, hold = np.zeros((2, STATES)), np.zeros(7)
    hold[6] = 1.0
    depth, closing, point, normal, slip = np.zeros(2), np.zeros(2), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3))
    at, rate, local_pose, local_twist, turn = np.empty(7), np.empty(6), np.empty(7), np.empty(6), np.empty(7)
    wrench, local, work, place, motion = np.zeros(6), np.empty(6), np.empty((6, 3)), tilt.copy(), np.zeros(6)
    q, qd, joints = np.zeros(6), np.zeros(6), np.empty((SCRATCH, 3))
    latched, touched = captured, False
    sub[:] = 0.0
    m = parts.shape[0]
    depths, rates, points, normals, slips = met
    level = p[TILT_X] == 0.0 and p[TILT_Y] == 0.0
    remembers = p[BRANCH_STIFFNESS] > 0.0 or p[DRAG] > 0.0 or p[MODE] > 0.0 or latch[1] < 1.5
    plain = level and not mounted and latch[1] > 1.5 and p[LEVER] == lever and -p[OFFSET] <= NEAR
    for k in range(poses.shape[0]):
        last = before if k == 0 else poses[k - 1]
        if not latched and not mounted and p[MODE] == 0.0:
            if level and -p[OFFSET] <= NEAR:
                apart = not near[k] or (
                    k > 0 and max(met[0][r, k, 0], met[0][r, k, 1], met[0][r, k - 1, 0], met[0][r, k - 1, 1]) <= p[OFFSET]
                )
            else:
                apart = _apart(kind, sizes, p, tilt, last, poses[k], work)
            if apart:
                if touched:
                    state[:] = 0.0
                    touched = False
                continue
            touched = True
        twist = twists[k]
        passed = 0.0
        for s in range(m):
            if s > 0 and (parts[s] == parts[s - 1] or not (between or remembers)):
                sub[k, s] = sub[k, s - 1]
                continue
            dt = h * (parts[s] - passed)
            passed = parts[s]
            if parts[s] == 1.0 and plain and not latched:
                surface_wrench(
                    dt, creep, p, state, depths[r, k], rates[r, k], points[r, k], normals[r, k], slips[r, k], work[5], sub[k, s]
                )  # fmt: skip
                continue
            if parts[s] < 1.0:
                _within(last, twist, ends[k - 1] if bent and k > 0 else ends[k], ends[k], h, parts[s], turn, at, rate)
            else:
                at[:], rate[:] = poses[k], ends[k]
            if mounted and k > 0:  # at t = 0 the mount is at rest, and has borne nothing yet
                mount_step(stiffness[r], damping[r], body, dt, wrench, q, qd, joints)
                mount_place(q, qd, tilt, place, motion)
            relate_one(at, rate, place, motion, local_pose, local_twist, work)
            contact_wrench(
                kind, sizes, dt, creep, p, local_pose, local_twist, latched, hold, state, depth, closing, point, normal, slip, work, local
            )  # fmt: skip
            to_frame(place, local, wrench)
            if mounted:
                mount_reading(stiffness[r], damping[r], q, qd, sub[k, s])
            else:
                sub[k, s] = wrench
        if not latched and closes(local_pose, local_twist, latch):
            latched = True
            hold[:] = local_pose
            for j in range(3):
                hold[j] -= wrench[j] / p[STIFFNESS]


@njit(cache=True)
def _within(pose, slope, start, end, h, part, turn, out, rate):
    """Pose ``out`` (7,) and twist ``rate`` (6,) at a ``part`` of a tick that leaves ``pose`` with the twist ``start`` and ends with
    ``end``: a parabola about the straight path of the twist ``slope``. ``turn`` (7,) is scratch."""
    for j in range(6):
        bend = end[j] - start[j]
        way = h * part * (slope[j] + 0.5 * (part - 1.0) * bend)
        rate[j] = end[j] + (part - 1.0) * bend
        if j < 3:
            out[j] = pose[j] + way
        else:
            turn[j - 3] = way
    quat_exp(turn[0:3], turn[3:7])
    quat_mul(turn[3:7], pose[3:7], out[3:7])


@njit(cache=True)
def _apart(kind, sizes, p, tilt, pose_0, pose_1, work):
    """Whether the surfaces are so far apart at both ends of a tick that they cannot touch within it."""
    return _clear(kind, sizes, p[OFFSET], tilt, pose_0, pose_1, 0.0, work)


@njit(cache=True)
def _clear(kind, sizes, offset, tilt, pose_0, pose_1, spare, work):
    reach = max(0.0, -offset) + spare
    centre, axis, free = work[0], work[1], work[2]
    way = math.sqrt((pose_1[0] - pose_0[0]) ** 2 + (pose_1[1] - pose_0[1]) ** 2 + (pose_1[2] - pose_0[2]) ** 2)
    for e in range(2):
        pose = pose_0 if e == 0 else pose_1
        axis[0] = axis[1] = 0.0
        axis[2] = 1.0
        rotate(pose[3:7], axis, axis)
        for j in range(3):
            centre[j] = pose[j] - sizes[TIP_RADIUS] * axis[j]
        rotate_back(tilt[3:7], centre, centre)
        if kind == PLANE:
            if -centre[2] - sizes[TIP_RADIUS] <= reach:
                return False
        elif beyond_rim(sizes, centre) or cone_distance(sizes, centre, free) - sizes[TIP_RADIUS] <= reach + way:
            return False
    return True


@njit(cache=True)
def _near(kind, sizes, poses, before, spare, out):
    """``out`` (R, N) bool: whether the surfaces may touch in the tick that ends at a row, were they ``spare`` [m] nearer."""
    level, work = np.zeros(7), np.empty((6, 3))
    level[6] = 1.0
    for r in range(poses.shape[0]):
        for k in range(poses.shape[1]):
            out[r, k] = not _clear(kind, sizes, 0.0, level, before[r] if k == 0 else poses[r, k - 1], poses[r, k], spare, work)


@njit(cache=True)
def _meet(kind, sizes, lever, poses, twists, near, depth, rate, point, normal, slip):
    work = np.empty((6, 3))
    for r in range(poses.shape[0]):
        for k in range(poses.shape[1]):
            if near[r, k]:
                meet(
                    kind, sizes, poses[r, k], twists[r, k], lever, 1.0, work, depth[r, k], rate[r, k], point[r, k], normal[r, k], slip[r, k]
                )  # fmt: skip


@njit(cache=True)
def _slopes(poses, before, h, out):
    for r in range(poses.shape[0]):
        for k in range(poses.shape[1]):
            twist_between(before[r] if k == 0 else poses[r, k - 1], poses[r, k], h, out[r, k])
