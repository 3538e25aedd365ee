"""The known motions of a commissioning: small oscillations in free space, and presses against the
contact.

A press begins at rest in free space, moves in, oscillates about its depth and moves out again. On a
flat mechanism it is repeated off-axis, which produces torques of known sign and size; a captured
mechanism is moved in all six axes about its pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.contact.touch import axis_truth
from hiltestbed.devices.motion import blend
from hiltestbed.frames import Array, pose_step
from hiltestbed.scenario import Scenario

CLEAR = 0.003  # [m] clearance before a press
LARGEST = 0.004  # [m] largest depth of a press, or amplitude of an oscillation
WIDEST = math.radians(0.5)  # largest amplitude of an angular oscillation
FREE = 0.002  # [m] amplitude of the oscillations in free space
ARM = 0.05  # [m] lateral offset of the off-axis presses
FREQUENCIES = (1.3, 2.1, 3.4)  # [Hz] of x, y, z in free space
PRESS_FREQUENCY, PRESS_PERIODS = 3.0, 6
REST = 0.3  # [s] before each motion, and after a press
# [s] part of the rest in which the platform settles; the record of the motion begins after it
SETTLED = 0.2
ENTRY = 0.6  # [s] to move in, and to move out
FREE_TIME = 3.0  # [s]


@dataclass(frozen=True)
class TestMotion:
    """A named path that begins and ends at rest at the same pose.

    Attributes:
        start: (7,) of A in P. offsets: (K, 6) from it, linear [m] and rotation vector [rad], one
            row per tick. touches: whether the motion is meant to make contact.
    """

    name: str
    start: Array
    offsets: Array
    touches: bool

    def poses(self) -> Iterator[Array]:
        """The poses (7,) to command, one per tick."""
        for offset in self.offsets:
            out = np.empty(7)
            pose_step(self.start, offset, 1.0, out)
            yield out

    def after_rest(self, ticks: int) -> TestMotion:
        """The same motion after a rest of ``ticks``."""
        return replace(self, offsets=np.concatenate([np.zeros((ticks, 6)), self.offsets]))


def motions(scenario: Scenario, force: float) -> list[TestMotion]:
    """The motions for the mechanism of ``scenario``, with presses of about ``force`` [N]."""
    if scenario.mechanism.captured:
        return [_shaken(scenario, force).after_rest(round(REST / scenario.tick))]
    depth = min(force / scenario.mechanism.contact.stiffness, LARGEST)
    away = -(CLEAR + 2.0 * FREE)
    t = _instants(FREE_TIME, scenario.tick)
    free = np.zeros((len(t), 6))
    for axis, frequency in enumerate(FREQUENCIES):
        free[:, axis] = FREE * _window(t / FREE_TIME) * np.sin(2.0 * np.pi * frequency * t)
    found = [TestMotion("open", _at(0.0, 0.0, away), free, touches=False)]
    arms = [(0.0, 0.0), (ARM, 0.0), (0.0, ARM), (-ARM, -0.8 * ARM)]
    press = _press(scenario.tick, depth)
    for number, (x, y) in enumerate(arms if scenario.mechanism.flat else arms[:1]):
        found.append(TestMotion(f"press {number}", _at(x, y, -CLEAR), press, touches=True))
    return [motion.after_rest(round(REST / scenario.tick)) for motion in found]


def _at(x: float, y: float, z: float) -> Array:
    return np.array([x, y, z, 0.0, 0.0, 0.0, 1.0])


def _instants(duration: float, tick: float) -> Array:
    """The ends of the ticks [s]."""
    return np.asarray(tick * np.arange(1, round(duration / tick) + 1), dtype=float)


def _window(x: Array) -> Array:
    """Window that rises smoothly to 1 over the first fifth and falls to 0 over the last fifth."""
    return np.array([blend(min(1.0, 5.0 * v)) * blend(min(1.0, 5.0 * (1.0 - v))) for v in x])


def _press(tick: float, depth: float) -> Array:
    """Move in to two thirds of ``depth``, oscillate by a third of it, and move out."""
    ticks = range(1, round(ENTRY / tick) + 1)
    inward = np.array([blend(min(1.0, k * tick / ENTRY)) for k in ticks])
    duration = PRESS_PERIODS / PRESS_FREQUENCY
    t = _instants(duration, tick)
    deep = CLEAR + 2.0 * depth / 3.0
    swing = depth / 3.0 * _window(t / duration) * np.sin(2.0 * np.pi * PRESS_FREQUENCY * t)
    z = [deep * inward, deep + swing, deep * inward[::-1], np.zeros(round(REST / tick))]
    out = np.zeros((sum(map(len, z)), 6))
    out[:, 2] = np.concatenate(z)
    return out


def _shaken(scenario: Scenario, force: float) -> TestMotion:
    """Oscillate one axis after the other, as far as ``force`` or its torque allows."""
    tick, truth = scenario.tick, axis_truth(scenario.impact)
    duration = PRESS_PERIODS / PRESS_FREQUENCY
    t = _instants(duration, tick)
    wave = _window(t / duration) * np.sin(2.0 * np.pi * PRESS_FREQUENCY * t)
    out = np.zeros((6 * len(t), 6))
    for axis in range(6):
        known = truth[axis]
        stiffness = known[0] if known is not None else scenario.mechanism.contact.stiffness
        size = min(force / stiffness, LARGEST) if axis < 3 else min(ARM * force / stiffness, WIDEST)
        out[axis * len(t) : (axis + 1) * len(t), axis] = size * wave
    return TestMotion("shaken", _at(0.0, 0.0, 0.0), out, touches=True)
