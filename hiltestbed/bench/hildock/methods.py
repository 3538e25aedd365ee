"""Entrants of HILDOCK-1: methods in a few lines of one axis, and those of the package."""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed import build
from hiltestbed.bench.contacts import ARM, AXIAL, BenchContact
from hiltestbed.bench.contenders import Contender, contenders
from hiltestbed.bench.hildock.problem import MASS, SPEED, START, TICK
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.numerical_model.model import NumericalModel

LAG = 0.0005  # [s] T2 of the phase lead
BLEND = 0.004  # [s] over which a corrected prediction is taken over
ENOUGH = 8  # samples of contact before k and c are used: the noise of two parameters is then halved
# a scenario needs a contact, which no method for a first contact reads
UNREAD = BenchContact(1.0, 0.01, 0.05).briefing


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
        x, v = self.x, self.v = advance(self.x, self.v, force, TICK)
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


class Shipped:
    """A method of the package for a first contact, with the identification by least squares: the
    very blocks that a scenario runs, with one axis in use.
    """

    def __init__(self, contender: Contender) -> None:
        self.name = f"{'own' if contender.own else 'shipped'} {contender.name}"
        self._contender = contender

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        changes: dict[str, Any] = {
            "physics_rate": round(1.0 / TICK),  # the page: the force is known at ticks
            "sensor.delay": delay,
            "sensor.noise": noise,
            "sensor.torque_noise": ARM * noise,
            "approach.gap": -START,
            "duration": (ticks + 1) * TICK,
        }
        contact = BenchContact(1.0, delay, 0.05, changes=changes)
        runs = [contact.scenario(self._contender.force(UNREAD))]
        model = NumericalModel(runs)
        self._drive = build.drive(runs, model)
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
        drive = self._drive
        if isinstance(drive, ResynchronisedDrive):  # it identifies the contact with the delay
            k, c = float(drive.stiffness[0]), float(drive.damping[0])
            return (k, c) if k > 0.0 else None
        k = float(self._identification.stiffness[0, AXIAL])
        c = float(self._identification.damping[0, AXIAL])
        return (k, c) if np.isfinite([k, c]).all() else None


def shipped() -> list[Shipped]:
    """The methods for a first contact whose settings need nothing of it, and those of plugins."""
    return [Shipped(c) for c in contenders() if c.contact == "first" and c.name != "dead_zone"]


METHODS = (Uncompensated, PhaseLeadEntrant, Extrapolation, ResynchronisedEntrant)
