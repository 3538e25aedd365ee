"""Measurements on the model of a rig with its mechanism; commands and wrenches refer to A, the tip
of the mechanism.

Response in six axes to sines, of the command and of a wrench at A, one run of a batch for each axis
and frequency: a sine and a cosine are fitted by least squares over whole cycles after the
transient. Command and response are samples at t_k, without a hold in between.

Modes with active drives: the one-tick map, linearised by central differences, one run
of a batch for each perturbed state.

The state consists of positions and velocities that the loops allow, and the drives' own state
(pressures, spools). With a constant command, the map z_(k+1) = Phi z_k has the eigenvalues e^(s h):
|s| is a mode's natural frequency, -Re s/|s| its damping ratio. Friction is omitted.

Reach of a facility from home, along and about each axis of A, and what limits it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array, pose_step, rotation_vectors
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import UPRIGHT, Facility
from hiltestbed.platform.facilities.kinematics import AXES, LEVER, direction
from hiltestbed.platform.facilities.stand import Stand, Stands

AMPLITUDE = 2e-3  # [m]; divided by LEVER for a rotation
PULL = 4.0  # [m/s^2] largest acceleration of a sine
FORCE, TORQUE = 200.0, 60.0  # [N], [N m]
CYCLES = 3  # number of cycles fitted
LEAD_IN = 1.0  # [s] transient, in the first half of which the sine's amplitude grows
LEVERS = np.array([1.0] * 3 + [LEVER] * 3)  # a rotation times its lever is a length


@dataclass(frozen=True)
class FrequencyResponse:
    """Response of A to its command.

    Attributes:
        frequency: (F,) [Hz]. own: (6, F) complex ratio of each axis. cross: (6, F) largest relative
            amplitude of another axis.
    """

    frequency: Array
    own: NDArray[np.complex128]
    cross: Array

    def gain_db(self) -> Array:
        """(6, F) [dB]."""
        return 20.0 * np.log10(np.abs(self.own))

    def phase_deg(self) -> Array:
        """(6, F) [deg], unwrapped."""
        return np.degrees(np.unwrap(np.angle(self.own), axis=1))

    def delay(self, axis: int = 2) -> float:
        """Delay at the lowest frequency [s]."""
        return float(-np.angle(self.own[axis, 0]) / (2.0 * math.pi * self.frequency[0]))

    def bandwidth(self, axis: int = 2) -> float:
        """Frequency [Hz] at which the response first lags by 90 deg or falls by 3 dB,
        interpolated; inf: above all measured.
        """
        low = np.minimum(3.0 + self.gain_db()[axis], 90.0 + self.phase_deg()[axis])
        below = np.flatnonzero(low < 0.0)
        if not len(below):
            return math.inf
        k = int(below[0])
        if k == 0:
            return float(self.frequency[0])
        f = np.log(self.frequency[k - 1 : k + 1])
        return float(np.exp(f[0] + (f[1] - f[0]) * low[k - 1] / (low[k - 1] - low[k])))


def frequency_response(
    stands: Stands,
    frequency: Array | Sequence[float],
    axes: Sequence[int] = range(6),
    amplitude: float = AMPLITUDE,
) -> FrequencyResponse:
    """Ratio of reached to commanded pose of A at the frequencies [Hz], about home; the motion of
    the other axes is the cross response. Axes that are left out are NaN.
    """
    f = np.asarray(frequency, dtype=float)
    stand = stands(len(axes) * len(f))
    axis, w = np.repeat(np.asarray(axes), len(f)), 2.0 * math.pi * np.tile(f, len(axes))
    size = np.minimum(amplitude, PULL / w**2) / LEVERS[axis]
    ratios = _fitted(_command_sines(stand, axis, w, size), w, stand.tick) / size[:, None]
    own, cross = np.full((6, len(f)), np.nan, dtype=complex), np.full((6, len(f)), np.nan)
    for i, ratio in enumerate(ratios):
        row, column = int(axis[i]), i % len(f)
        own[row, column] = ratio[row]
        cross[row, column] = np.delete(np.abs(ratio) * LEVERS / LEVERS[row], row).max()
    return FrequencyResponse(f, own, cross)


def dynamic_stiffness(stands: Stands, frequency: Array | Sequence[float]) -> NDArray[np.complex128]:
    """``(6, F)`` complex stiffness of each axis at A, force over displacement, with a constant
    command and without friction [N/m, N m/rad].
    """
    f = np.asarray(frequency, dtype=float)
    n = 6 * len(f)
    stand = stands(n)
    stand.drives.release()
    axis, w, runs = np.repeat(np.arange(6), len(f)), 2.0 * math.pi * np.tile(f, 6), np.arange(n)
    size = np.where(axis < 3, FORCE, TORQUE)
    pose, still = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
    stand.reset(pose, still)
    record = np.empty((_ticks(w, stand.tick), n, 6))
    for k in range(len(record)):
        t = (k + 0.5) * stand.tick  # the wrench is constant over a tick
        stand.wrench[runs, axis] = _grown(t) * size * np.sin(w * t)
        stand.advance(pose, still, still)
        record[k] = _placed(stand)
    moved = _fitted(record, w, stand.tick)[runs, axis]
    return (size / moved).reshape(6, len(f))


def _command_sines(stand: Stand, axis: NDArray[np.intp], w: Array, size: Array) -> Array:
    """``(ticks, n, 6)`` position and rotation vector of A under sines that grow smoothly."""
    n, h = len(axis), stand.tick
    runs = np.arange(n)
    place, speed, bend = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6))
    pose = np.tile(UPRIGHT, (n, 1))
    stand.reset(pose, speed)
    out = np.empty((_ticks(w, h), n, 6))
    for k in range(1, len(out) + 1):
        t = k * h
        # The velocity of a tick belongs to its middle, its acceleration to its start.
        place[runs, axis] = size * _grown(t) * np.sin(w * t)
        speed[runs, axis] = size * _grown(t) * w * np.cos(w * (t - 0.5 * h))
        bend[runs, axis] = -size * _grown(t) * w * w * np.sin(w * (t - h))
        pose[:, :3] = place[:, :3]
        half = 0.5 * np.linalg.norm(place[:, 3:], axis=1, keepdims=True)
        pose[:, 3:6] = 0.5 * place[:, 3:] * np.sinc(half / math.pi)
        pose[:, 6] = np.cos(half[:, 0])
        stand.advance(pose, speed, bend)
        out[k - 1] = _placed(stand)
    return out


def _placed(stand: Stand) -> Array:
    """``(n, 6)`` position and rotation vector of A."""
    return np.hstack([stand.pose[:, :3], rotation_vectors(stand.pose[:, 3:])])


def _ticks(w: Array, tick: float) -> int:
    return math.ceil((LEAD_IN + CYCLES * 2.0 * math.pi / w.min()) / tick)


def _fitted(record: Array, w: Array, tick: float) -> NDArray[np.complex128]:
    """``(n, 6)`` complex amplitudes of a record (ticks, n, 6) of sines of w (n,)."""
    t, out = np.arange(1, len(record) + 1) * tick, np.empty(record.shape[1:], dtype=complex)
    for i, w_i in enumerate(w):
        window = t > t[-1] - 2.0 * math.pi * CYCLES / w_i
        phase = w_i * t[window]
        basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones(len(phase))])
        fit = np.linalg.lstsq(basis, record[window, i], rcond=None)[0]
        out[i] = fit[0] + 1j * fit[1]
    return out


def _grown(t: float) -> float:
    """Fraction of the amplitude at time ``t`` [s]: a smooth start over half the lead-in."""
    u = min(2.0 * t / LEAD_IN, 1.0)
    return u * u * (3.0 - 2.0 * u)


NUDGE = 1e-6  # [m], [rad], and per second for a velocity: size of a perturbation
SLOWEST, FASTEST = 0.05, 200.0  # [Hz] of a mode
LIGHTLY = 0.95  # damping ratio below which a motion counts as a mode
SETTLE = 0.5  # [s] time to reach static equilibrium
STILL = 1e-3  # scale of components of the drives' own state that are 0 at rest


@dataclass(frozen=True)
class Mode:
    """A mode of the rig.

    Attributes:
        frequency: natural [Hz]. damping_ratio: [-]. shape: (6,) motion of A, largest component 1,
            rotations times 0.5 m.
        motion: the shape in words.
    """

    frequency: float
    damping_ratio: float
    shape: Array
    motion: str


def modes(stands: Stands) -> tuple[Mode, ...]:
    """The modes up to :data:`FASTEST` at home, in order of frequency."""
    probe = stands(1)
    allowed = probe.drives.kinematics.allowed(probe.drives.kinematics.home)
    own = probe.drives.feedback().shape[1]
    count = 2 * allowed.shape[1] + own
    stand = stands(2 * count)
    stand.drives.release()
    phi = _map(probe, stand, allowed, count)
    values, vectors = np.linalg.eig(phi)
    kinematics, found = stand.drives.kinematics, []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag <= 1e-9:
            continue
        s = np.log(value) / stand.tick
        frequency, zeta = abs(s) / (2.0 * math.pi), -s.real / abs(s)
        if not SLOWEST < frequency < FASTEST or abs(zeta) > LIGHTLY:
            continue
        rates = allowed @ vector[allowed.shape[1] : 2 * allowed.shape[1]]
        shape = _shape(kinematics, rates)
        found.append(Mode(float(frequency), float(zeta), shape, direction(shape)))
    return tuple(sorted(found, key=lambda mode: mode.frequency))


def _map(probe: Stand, stand: Stand, allowed: Array, count: int) -> Array:
    """``(N, N)`` one-tick map of allowed positions and velocities, and of the drives' state."""
    n, free = 2 * count, allowed.shape[1]
    pose, still = np.tile(UPRIGHT, (n, 1)), np.zeros((n, 6))
    probe.drives.release()
    probe.reset(pose[:1], still[:1])
    for _ in range(round(SETTLE / probe.tick)):
        probe.advance(pose[:1], still[:1], still[:1])
    stand.reset(pose, still)
    stand.qpos[:], stand.qvel[:] = probe.qpos[0], 0.0
    own = stand.drives.feedback()
    own[:] = probe.drives.feedback()[0]
    step = np.concatenate([np.full(2 * free, NUDGE), np.maximum(np.abs(own[0]), STILL) * NUDGE])
    rest = stand.qpos[0].copy()
    for c in range(count):
        for run, sign in ((2 * c, 1.0), (2 * c + 1, -1.0)):
            if c < free:
                moved = rest.copy()
                mujoco.mj_integratePos(stand.model, moved, sign * step[c] * allowed[:, c], 1.0)
                stand.qpos[run] = moved
            elif c < 2 * free:
                stand.qvel[run] += sign * step[c] * allowed[:, c - free]
            else:
                own[run, c - 2 * free] += sign * step[c]
    stand.advance(pose, still, still)
    phi, between = np.empty((count, count)), np.empty(stand.model.nv)
    for c in range(count):
        up, down = 2 * c, 2 * c + 1
        mujoco.mj_differentiatePos(stand.model, between, 1.0, stand.qpos[down], stand.qpos[up])
        change = np.concatenate(
            [
                allowed.T @ between,
                allowed.T @ (stand.qvel[up] - stand.qvel[down]),
                own[up] - own[down],
            ]
        )
        phi[:, c] = change / (2.0 * step[c])
    return phi


def _shape(kinematics, rates: Array) -> Array:
    """Motion of A relative to P for complex joint rates, at the phase of its largest component."""
    parts = [
        kinematics.twists(kinematics.home, np.ascontiguousarray(x))
        for x in (rates.real, rates.imag)
    ]
    twist = parts[0][0] + 1j * parts[1][0]
    if len(parts[0]) == 2:
        twist = twist - (parts[0][1] + 1j * parts[1][1])
    twist[3:] *= LEVER
    top = twist[int(np.argmax(np.abs(twist)))]
    return (twist / top).real if abs(top) > 0.0 else np.zeros(6)


STRIDE = (0.02, math.radians(1.0))  # [m], [rad] between two poses that are checked
FURTHEST = (3.0, math.radians(180.0))
HALVINGS = 6  # of the last stride: to 0.3 mm and 0.02 deg


@dataclass(frozen=True)
class Reach:
    """Reach from home along one axis.

    Attributes:
        axis: x, y, z, rx, ry, rz. low, high: [m, rad]. stops: what limits it below and above; empty
            at the end of the search range.
    """

    axis: str
    low: float
    high: float
    stops: tuple[str, str]


def workspace(facility: Facility) -> tuple[Reach, ...]:
    """The reach of A from home, axis by axis: up to travel, a singularity or the reach."""
    drives = Stand(facility).drives
    out = []
    for k, axis in enumerate(AXES):
        ends = [_walk(drives, k, sign) for sign in (-1.0, 1.0)]
        out.append(Reach(axis, -ends[0][0], ends[1][0], (ends[0][1], ends[1][1])))
    return tuple(out)


def _walk(drives: Drives, k: int, sign: float) -> tuple[float, str]:
    """Distance that A can move from home in one direction, and what limits it."""
    stride, most = STRIDE[k // 3], FURTHEST[k // 3]
    reached, far, q, why = 0.0, stride, drives.kinematics.home.copy(), ""
    while far <= most and not why:
        why, q_next = _look(drives, k, sign * far, q)
        if not why:
            reached, q, far = far, q_next, far + stride
    if not why:
        return reached, ""
    for _ in range(HALVINGS):
        middle = 0.5 * (reached + far)
        found, q_next = _look(drives, k, sign * middle, q)
        if found:
            far, why = middle, found
        else:
            reached, q = middle, q_next
    return reached, why


def _look(drives: Drives, k: int, shift: float, q: Array) -> tuple[str, Array]:
    """Why A cannot be at ``shift`` on axis ``k`` (empty: it can), and the joints, from ``q``."""
    step, pose = np.zeros(6), np.empty((1, 7))
    step[k] = shift
    pose_step(UPRIGHT, step, 1.0, pose[0])
    drives.allocate(pose, np.zeros((1, 6)), np.zeros((1, 6)), 0.0)
    kinematics = drives.kinematics
    solved, left = kinematics.solve(drives.poses[0], drives.held[0], q)
    if not left < 1e-7:
        return "out of reach", q
    past = kinematics.past_travel(solved)
    if past:
        return past[0], q
    lost = kinematics.lost_motion(solved)
    return (f"singular: {lost}", q) if lost else ("", solved)
