"""Entrants of HILDOCK-1: methods in a few lines of one axis, and those of the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.bench.contacts import ARM, BenchContact
from hiltestbed.bench.contenders import CONTENDERS, Contender
from hiltestbed.bench.hildock.problem import MASS, SPEED, START, TICK
from hiltestbed.compensation.blocks import make_drive
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.numerical_model.model import NumericalModel

LAG = 0.0005  # [s] T2 of the phase lead
BLEND = 0.004  # [s] over which a corrected prediction is taken over
ENOUGH = 8  # samples of contact before k and c are used: the noise of two parameters is then halved
FELT = 5.0  # standard deviations of the noise above which a force is one: 1 in 3 million ticks
SEARCHED = (0.6, 1.5)  # times the delay that is told: +-30 % of the true one, and a margin
GRID = 31
NEAR = 4  # [ticks] to either side in which a later fit searches
GROWTH = 1.25  # samples of contact until the next fit, over those until the last
AXIAL = 2
# a scenario needs a contact, which no method for a first contact reads
UNREAD = BenchContact(1.0, 0.01, 0.05)


class Uncompensated:
    """The measured force drives the numerical model: semi-implicit Euler."""

    name = "none"

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        self.x, self.v, self.delay = START, SPEED, delay

    def step(self, tick: int, force: float) -> float:
        self.v -= TICK * self.used(force) / MASS
        self.x += TICK * self.v
        return self.x

    def used(self, force: float) -> float:
        """[N] what drives the model."""
        return force

    def end(self) -> tuple[float, float] | None:
        return None


class PhaseLeadEntrant(Uncompensated):
    """(T1 s + 1)/(T2 s + 1), T1 = delay + T2, by backward differences (C. Qi et al., J. Intell.
    Robot. Syst. 2016).
    """

    name = "phase_lead"

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        super().start(case, ticks, delay, noise)
        self.before = self.out = 0.0

    def used(self, force: float) -> float:
        a, b = LAG / TICK, (self.delay + LAG) / TICK
        self.out = (self.out * a + force + b * (force - self.before)) / (1.0 + a)
        self.before = force
        return self.out


class Extrapolation(Uncompensated):
    """A parabola through the forces now, one delay ago and two delays ago, taken one delay on:
    3 F(t) - 3 F(t - d) + F(t - 2 d) (T. Horiuchi et al., Earthq. Eng. Struct. Dyn. 28, 1999, the
    second order of their Lagrange prediction).
    """

    name = "lagrange_2"

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        super().start(case, ticks, delay, noise)
        self.lag, self.past = max(1, round(delay / TICK)), []

    def used(self, force: float) -> float:
        self.past.append(force)
        one, two = (
            self.past[-1 - n] if len(self.past) > n else 0.0 for n in (self.lag, 2 * self.lag)
        )
        return 3.0 * force - 3.0 * one + two


class ResynchronisedEntrant:
    """A delayed copy of the model, driven by the force as what it is, and a prediction over the
    delay with k and c identified from force and position of the same instant.
    """

    name = "resynchronised"

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        self.delay, self.past = delay, [START]  # commanded positions at ticks 0, 1, ...
        self.x, self.v = START - delay * SPEED, SPEED  # of the delayed copy, at t - delay
        self.xx = self.xv = self.vv = self.xf = self.vf = self.force = 0.0
        self.count = 0

    def step(self, tick: int, force: float) -> float:
        self._identify(tick, force)
        self.force = force
        x, v = self.x, self.v = advance(self.x, self.v, self._driving(tick, force), TICK)
        found = self.end()
        left = self.delay
        while left > 1e-12:  # [s] round-off of the subtractions
            h = min(TICK, left)
            if found is None:
                predicted = self.force if self.count else 0.0
            else:
                predicted = max(0.0, found[0] * x + found[1] * v) if x > 0.0 else 0.0
            x, v = advance(x, v, predicted, h)
            left -= h
        here = self.past[-1]
        self.past.append(here + TICK * v + (x - TICK * v - here) * TICK / BLEND)
        return self.past[-1]

    def _driving(self, tick: int, force: float) -> float:
        """[N] what drives the delayed copy."""
        return force

    def _identify(self, tick: int, force: float) -> None:
        at = tick - self.delay / TICK
        j = int(at)
        if at < 1.0 or self.past[j] <= 0.0:
            return
        a, b, share = self.past[j], self.past[min(j + 1, tick)], at - j
        x = a + share * (b - a)
        before = (a - self.past[j - 1]) / TICK
        v = before + share * ((b - a) / TICK - before)
        if x <= 0.0 or force <= 0.0:
            return
        self.count += 1
        self.xx += x * x
        self.xv += x * v
        self.vv += v * v
        self.xf += x * force
        self.vf += v * force

    def end(self) -> tuple[float, float] | None:
        whole = self.xx * self.vv - self.xv * self.xv
        if self.count < ENOUGH or whole <= 0.0:
            return None
        k = (self.xf * self.vv - self.vf * self.xv) / whole
        return k, (self.vf * self.xx - self.xf * self.xv) / whole


def advance(x: float, v: float, force: float, h: float) -> tuple[float, float]:
    v -= h * force / MASS
    return x + h * v, v


class TouchFitted(ResynchronisedEntrant):
    """The prediction, run again from the start whenever the delay, a third unknown beside k and c,
    is fitted anew.

    During the contact c absorbs an error of the delay; the touch does not: the force at x <= 0 is
    zero, and the measured force is interpolated between ticks, so that k, c and the delay are one
    least-squares problem over all samples from before the touch until the force has gone. It is
    linear in k and c, and the delay is searched. It needs the position of the touch, which
    HILDOCK-1 tells.
    """

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
    """Sum of squares [N^2] that a delay leaves, with its k and c, by normal equations."""
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


class Shipped:
    """A method of the package for a first contact, with the identification by least squares: the
    very blocks that a scenario runs, with one axis in use.
    """

    def __init__(self, contender: Contender) -> None:
        self.name, self._contender = f"shipped {contender.name}", contender

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        changes: dict[str, Any] = {
            "sensor.delay": delay,
            "sensor.noise": noise,
            "sensor.torque_noise": ARM * noise,
            "approach.gap": -START,
            "duration": (ticks + 1) * TICK,
        }
        contact = BenchContact(1.0, delay, 0.05, changes=changes)
        runs = [contact.scenario(self._contender.force(UNREAD))]
        model = NumericalModel(runs)
        self._drive = make_drive(runs, model)
        self._identification = IDENTIFIERS["rls"].start(runs)
        pose, twist = self._drive.pose, self._drive.twist
        estimate = self._identification
        wrench, captured = np.zeros((1, 6)), np.zeros(1, dtype=bool)
        self._read = Measurement(
            wrench, pose.copy(), twist.copy(), estimate.stiffness, estimate.damping, captured
        )

    def step(self, tick: int, force: float) -> float:
        read = self._read
        read.wrench[0, AXIAL] = force
        self._identification.update(read.wrench, read.pose, read.twist)
        before = self._drive.pose[0, AXIAL]
        self._drive.advance(read)
        read.pose[:] = self._drive.pose
        read.twist[0, AXIAL] = (self._drive.pose[0, AXIAL] - before) / TICK
        return float(self._drive.pose[0, AXIAL])

    def end(self) -> tuple[float, float] | None:
        k = float(self._identification.stiffness[0, AXIAL])
        c = float(self._identification.damping[0, AXIAL])
        return (k, c) if np.isfinite([k, c]).all() else None


def shipped() -> list[Shipped]:
    """The methods for a first contact whose settings need nothing of it."""
    return [Shipped(c) for c in CONTENDERS if c.contact == "first" and c.name != "dead_zone"]


METHODS = (Uncompensated, PhaseLeadEntrant, Extrapolation, ResynchronisedEntrant)
