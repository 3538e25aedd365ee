"""Entrants of HILDOCK-1, each in a few lines of one axis."""

from __future__ import annotations

from hiltestbed.bench.hildock.problem import MASS, SPEED, START, TICK

LAG = 0.0005  # [s] T2 of the phase lead
BLEND = 0.004  # [s] over which a corrected prediction is taken over
ENOUGH = 8  # samples of contact before k and c are used: the noise of two parameters is then halved


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


class PhaseLead(Uncompensated):
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


class Resynchronised:
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


METHODS = (Uncompensated, PhaseLead, Extrapolation, Resynchronised)
