"""Modes of a rig with active drives: the one-tick map, linearised by central differences, one run
of a batch for each perturbed state.

The state consists of positions and velocities that the loops allow, and the drives' own state
(pressures, spools). With a constant command, the map z_(k+1) = Phi z_k has the eigenvalues e^(s h):
|s| is a mode's natural frequency, -Re s/|s| its damping ratio. Friction is omitted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import LEVER, direction
from hiltestbed.platform.facilities.stand import Stand, Stands

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
    pose, still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 6))
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
