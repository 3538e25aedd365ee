"""Response G of a scenario's rig to its command and compliance Y to a force, on six axes, measured
on the simulated rig itself.

Effects and friction of its drives are included, and a motion compensation that changes the command
without measurements. For each axis, one run follows a sum of sines along the axis, and one holds
its position under a force that is a sum of sines.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.build import motion_command, runnable_from
from hiltestbed.frames import Array, rotation_vectors
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import AXES

Complex = NDArray[np.complex128]
LINES = 100  # [Hz] sines at 1, 2, ... Hz
PERIOD = 1.0  # [s] of their sum, measured after a lead-in of the same length
# physics steps of a measurement, at most: half a minute along one axis, three minutes on six
MOST_INSTANTS = 1_000_000
# [m], [m/s^2] largest amplitude and acceleration of a sine
MAX_AMPLITUDE, MAX_ACCELERATION = 1e-3, 0.3
FORCE_AMPLITUDE = 20.0  # [N] amplitude of each sine of the force
ARM = 0.6  # [m] converts angles to lengths and forces to torques: the height of a docking mechanism
FINE = 50  # interpolated points per line spacing
ALONG = AXES.index("z")  # the axis of the insertion


@dataclass(frozen=True)
class RigResponse:
    """Measured along one direction, all (L,): frequency [Hz] from 0 on; follows, pose over command;
    yields, to the contact force [m/N].
    """

    frequency: Array
    follows: Complex
    yields: Complex

    def finer(self) -> RigResponse:
        """Interpolated to :data:`FINE` points per line spacing."""
        f = np.linspace(self.frequency[0], self.frequency[-1], FINE * (len(self.frequency) - 1) + 1)
        parts = [
            np.interp(f, self.frequency, x.real) + 1j * np.interp(f, self.frequency, x.imag)
            for x in (self.follows, self.yields)
        ]
        return RigResponse(f, parts[0], parts[1])


EXACT = RigResponse(
    np.arange(0.0, 2001.0), np.ones(2001, dtype=complex), np.zeros(2001, dtype=complex)
)


@dataclass(frozen=True)
class SixAxisResponse:
    """Measured on six axes: frequency (L,) [Hz]; follows (L, 6, 6), pose over command; yields (L,
    6, 6), to the contact's wrench at A.

    The index of the responding axis precedes that of the moved or pushed axis; rotations are
    rotation vectors.
    """

    frequency: Array
    follows: Complex
    yields: Complex

    def along(self, row: Array, mobility: Array) -> RigResponse:
        """The response of the penetration x = ``row`` (6,) q between bodies with relative
        ``mobility`` (6, 6) [1/kg, ...].

        A force F along x moves the numerical model by M^-1 J^T F, so G becomes J G M^-1 J^T over J
        M^-1 J^T, and Y becomes J Y J^T.
        """
        way = mobility @ row
        return RigResponse(
            self.frequency, (self.follows @ way) @ row / (row @ way), (self.yields @ row) @ row
        )


def measured_response(scenario: Scenario) -> RigResponse:
    """The response of a scenario's rig along the insertion; measured once per process."""
    if _exact(scenario):
        return EXACT
    found = _measured(_quiet(scenario), (ALONG,))
    return RigResponse(found.frequency, found.follows[:, 0, ALONG], found.yields[:, 0, ALONG])


def six_axis_response(scenario: Scenario) -> SixAxisResponse:
    """The response of a scenario's rig on all axes; each rig is measured once per process."""
    if _exact(scenario):
        follows = np.tile(np.eye(6, dtype=complex), (len(EXACT.frequency), 1, 1))
        return SixAxisResponse(EXACT.frequency, follows, np.zeros_like(follows))
    found = _measured(_quiet(scenario), tuple(range(6)))
    return SixAxisResponse(
        found.frequency, np.swapaxes(found.follows, 1, 2), np.swapaxes(found.yields, 1, 2)
    )


def beyond_measure(scenario: Scenario) -> str | None:
    """Why the loop of a scenario is not judged, if its physics steps are so short that this would
    take minutes; otherwise None.
    """
    instants = 2.0 * PERIOD * scenario.rate * scenario.substeps
    if instants <= MOST_INSTANTS:
        return None
    most = MOST_INSTANTS / (2.0 * PERIOD)
    return (
        f"{instants:.3g} steps of the physics would be needed; with a physics_rate up to "
        f"{most:.3g} Hz it is"
    )


def _exact(scenario: Scenario) -> bool:
    return scenario.rig.platform.tracking == "ideal" and not any(
        e.link == "platform" for e in scenario.effects
    )


def _quiet(scenario: Scenario) -> str:
    """The rig of a scenario as text: vehicles and contact, without influence, are standard."""
    data, body = resolved(scenario), {"mass": 1000.0, "inertia": [500.0, 500.0, 500.0]}
    quiet = {
        "name": "response",
        "description": "",
        "seed": 0,
        "duration": 1.0,
        "sensor": {},
        "identification": {"kind": "none"},
        "safety": dict.fromkeys(data["safety"]),
        "effects": [e for e in data["effects"] if e["kind"].startswith("platform.")],
        "approach": {"gap": 0.0, "velocity": [0.0, 0.0, 0.0]},
        "spacecraft": {"chaser": body, "target": body},
    }
    quiet["compensation"] = {
        "force": {"kind": "none"},
        "motion": scenario.compensation.motion.of_the_rig(),
    }
    quiet["rig"] = data["rig"] | {"upper": {"kind": "fixed"}}
    quiet["mechanism"] = {k: v for k, v in data["mechanism"].items() if k != "latch"}
    if isinstance(quiet["mechanism"].get("contact"), dict):
        quiet["mechanism"]["contact"] = {"stiffness": 1.0e4, "damping": 0.0, "friction": 0.0}
    return json.dumps(data | quiet, sort_keys=True)


@lru_cache(maxsize=64)
def _measured(scenario: str, axes: tuple[int, ...]) -> SixAxisResponse:
    return _measure(runnable_from(json.loads(scenario)), axes)


class _Pushes:
    """A sum of sines along one axis on each run that holds its position, no force on others."""

    def __init__(self, wave: Array, axes: Sequence[int]) -> None:
        self._wave, self._at, self._wrench = wave, 0, np.zeros((2 * len(axes), 6))
        self._pushed = [(2 * a + 1, axis) for a, axis in enumerate(axes)]

    def next(self) -> Array:
        for run, axis in self._pushed:
            self._wrench[run, axis] = self._wave[self._at % len(self._wave)] * (
                1.0 if axis < 3 else ARM
            )
        self._at += 1
        return self._wrench


def _measure(scenario: Scenario, axes: Sequence[int]) -> SixAxisResponse:
    """``follows``, ``yields`` (L, len(axes), 6): response to a motion or force along each axis."""
    tick, m = scenario.tick, scenario.substeps
    still = np.zeros((1, len(axes), 6), dtype=complex)
    still[0, range(len(axes)), list(axes)] = 1.0
    lines = np.arange(1, int(min(LINES, 0.1 * scenario.rate)) + 1)
    # the loop is so slow that a period of the lowest frequency is shorter than ten ticks
    if not len(lines):
        return SixAxisResponse(np.zeros(1), still, np.zeros_like(still))
    phase = -math.pi * lines * (lines - 1) / len(lines)  # Schroeder phases: a low crest factor
    w = 2.0 * math.pi * lines / PERIOD
    size = np.minimum(MAX_AMPLITUDE, MAX_ACCELERATION / w**2)
    period = round(PERIOD / tick)

    def wave(t: NDArray[Any], order: int) -> Array:
        """The sum of sines, or its first or second derivative."""
        return (size * w**order * np.sin(w * t[:, None] + phase + 0.5 * math.pi * order)).sum(
            axis=1
        )

    ends = np.arange(1, 2 * period + 1) * tick
    place = wave(ends, 0)
    # The velocity of a tick refers to its middle, its acceleration to its start.
    speed, bend = wave(ends - 0.5 * tick, 1), wave(ends - tick, 2)
    instants = np.arange(period * m) * tick / m
    push = FORCE_AMPLITUDE * np.sin(w * instants[:, None] + phase).sum(axis=1)
    runs = 2 * len(axes)
    plant = plant_of([scenario] * runs, force=_Pushes(push, axes))
    pose, twist, accel = (
        np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (runs, 1)),
        np.zeros((runs, 6)),
        np.zeros((runs, 6)),
    )

    def put(x: float, v: float, a: float) -> None:
        for run, axis in enumerate(axes):
            scale = 1.0 if axis < 3 else 1.0 / ARM
            if axis < 3:
                pose[2 * run, axis] = x
            else:
                pose[2 * run, axis], pose[2 * run, 6] = (
                    math.sin(0.5 * scale * x),
                    math.cos(0.5 * scale * x),
                )
            twist[2 * run, axis], accel[2 * run, axis] = scale * v, scale * a

    put(wave(np.zeros(1), 0)[0], wave(np.zeros(1), 1)[0], 0.0)
    accel[:] = 0.0
    plant.reset(pose, twist)
    changed = motion_command([scenario] * runs) if scenario.compensation.motion.open_loop else None
    if changed:
        changed.start(twist)
    nothing: Any = None  # such a method reads no measurement
    reached = np.empty((2 * period, runs, 6))
    for k in range(2 * period):
        put(place[k], speed[k], bend[k])
        if changed:
            changed.update(pose, twist, nothing)
            plant.advance(changed.pose, changed.twist, changed.acceleration)
        else:
            plant.advance(pose, twist, accel)
        reached[k, :, :3] = plant.pose_act[:, :3]
        reached[k, :, 3:] = rotation_vectors(plant.pose_act[:, 3:])
    answer = np.fft.rfft(reached[period:], axis=0)[lines]
    scale = np.array([1.0 if axis < 3 else 1.0 / ARM for axis in axes])[:, None]
    follows = answer[:, 0::2] / (np.fft.rfft(place[period:])[lines][:, None, None] * scale)
    # The force at t_k, beginning with the start, is one row behind the pose, which is reached at
    # the end of a tick.
    force = np.fft.rfft(np.roll(push[::m], -1))[lines]
    yields = -answer[:, 1::2] / (force[:, None, None] / scale)
    return SixAxisResponse(
        np.concatenate([[0.0], lines / PERIOD]),
        np.concatenate([still, follows]),
        np.concatenate([yields[:1].real.astype(complex), yields]),
    )
