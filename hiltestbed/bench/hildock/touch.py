"""Resynchronised prediction with the delay as a third unknown beside k and c.

During the contact c absorbs an error of the delay; the touch does not: the force at x <= 0 is zero,
and the measured force is interpolated between ticks, so that k, c and the delay are one
least-squares problem over all samples from before the touch until the force has gone. It is linear
in k and c, and the delay is searched. It needs the position of the touch, which HILDOCK-1 tells.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.bench.hildock.methods import ENOUGH, Resynchronised, advance
from hiltestbed.bench.hildock.problem import SPEED, START, TICK
from hiltestbed.frames import Array

FELT = 5.0  # standard deviations of the noise above which a force is one: 1 in 3 million ticks
SEARCHED = (0.6, 1.5)  # times the delay that is told: +-30 % of the true one, and a margin
GRID = 31
NEAR = 4  # [ticks] to either side in which a later fit searches
GROWTH = 1.25  # samples of contact until the next fit, over those until the last


class TouchFitted(Resynchronised):
    """The prediction, run again from the start whenever the delay is fitted anew."""

    name = "resynchronised_touch_fitted"

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        super().start(case, ticks, delay, noise)
        self.told, self.noise, self.forces = delay, noise, []
        self.law: tuple[float, float] | None = None
        self.next, self.gone = ENOUGH, False

    def _identify(self, tick: int, force: float) -> None:
        self.forces.append(force)
        felt = force > FELT * self.noise
        self.gone = self.gone or (self.count > ENOUGH and not felt)
        self.count += felt and not self.gone
        if self.count >= self.next and felt and not self.gone:
            self.next = int(GROWTH * self.count) + 1
            self._fit()

    def _fit(self) -> None:
        x = np.array(self.past)
        touching = x > 0.0
        v = np.diff(x, prepend=START - TICK * SPEED) / TICK
        shown, forces = np.where(touching, (x, v), 0.0), np.array(self.forces)
        if self.law is None:
            delays = np.linspace(SEARCHED[0] * self.told, SEARCHED[1] * self.told, GRID)
        else:
            delays = self.delay + TICK * np.arange(-NEAR, NEAR + 1)
        left = [_solve(d, shown, forces)[0] for d in delays]
        i = int(np.argmin(left))
        found: Any = minimize_scalar(
            lambda d: _solve(d, shown, forces)[0],
            bounds=(delays[max(i - 1, 0)], delays[min(i + 1, len(delays) - 1)]),
            method="bounded",
            options={"xatol": 1e-3 * TICK},
        )
        self.delay = float(found.x)
        self.law = _solve(self.delay, shown, forces)[1]
        commanded = np.array(self.law) @ _late(self.delay, shown)
        self.x, self.v = START - self.delay * SPEED, SPEED
        for force, law in zip(self.forces[:-1], commanded[:-1], strict=True):
            self._step(force - float(law))  # the last one is still to come

    def _step(self, beyond: float) -> None:
        self.x, self.v = advance(self.x, self.v, beyond + self._of_the_law(), TICK)

    def _of_the_law(self) -> float:
        """[N] at the delayed copy."""
        if self.law is None or self.x <= 0.0:
            return 0.0
        return max(0.0, self.law[0] * self.x + self.law[1] * self.v)

    def _driving(self, tick: int, force: float) -> float:
        """The command was not always where the copy now is: the law corrects the force for that."""
        if self.law is None:
            return force
        at = max(tick - self.delay / TICK, 1.0)
        j = int(at)
        before, a, b = self.past[j - 1], self.past[j], self.past[min(j + 1, tick)]
        first = (self.law[0] * a + self.law[1] * (a - before) / TICK) if a > 0.0 else 0.0
        second = (self.law[0] * b + self.law[1] * (b - a) / TICK) if b > 0.0 else 0.0
        commanded = first + (at - j) * (second - first)
        return force - max(0.0, commanded) + self._of_the_law()

    def end(self) -> tuple[float, float] | None:
        return self.law


def _late(delay: float, shown: Array) -> Array:
    """``(2, ticks)`` commanded depth and speed in contact, as a sensor with a delay shows them."""
    ticks = np.arange(shown.shape[1])
    return np.array([np.interp(ticks - delay / TICK, ticks, u) for u in shown])


def _solve(delay: float, shown: Array, forces: Array) -> tuple[float, tuple[float, float]]:
    """Sum of squares [N^2] that a delay leaves, with its k and c: normal equations of two columns
    that are scaled to length one.
    """
    rows = _late(delay, shown)
    scale = np.sqrt((rows * rows).sum(axis=1)) + 1e-300
    rows /= scale[:, None]
    a, b = rows @ forces
    r = float(rows[0] @ rows[1])
    whole = 1.0 - r * r
    if whole < 1e-9:  # nothing of the contact, or one of its samples
        return float(forces @ forces), (0.0, 0.0)
    k, c = (a - r * b) / whole, (b - r * a) / whole
    rest = forces - k * rows[0] - c * rows[1]
    return float(rest @ rest), (float(k / scale[0]), float(c / scale[1]))
