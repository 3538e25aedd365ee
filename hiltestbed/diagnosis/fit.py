"""Bounded least squares for a handful of parameters: grid first, then Levenberg-Marquardt from the best starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.candidates import Candidate
from hiltestbed.diagnosis.links import Effects, Link
from hiltestbed.frames import Array

FAR = 1e6  # sigma
STEP = 1e-4  # of a parameter's scale, for differences
ITERATIONS = 25
SETTLED = 1e-4  # change of chi-square below which a fit has settled
SCANNED = 21  # places within a tenth of a parameter in which chi-square has jumps
ROUGH = {
    "sensor.deadzone": "width", "sensor.saturation": "limit", "contact.hard_stop": "position", "platform.friction": "stick",
    "loop.deadzone": "width", "platform.speed_limit": "speed", "sensor.delay": "delay", "log.skew": "delay",
    "contact.touch_offset": "offset",
}  # fmt: skip
LEAST_PENALTY = math.log(1000.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis fitted to a link.

    Attributes:
        causes: the candidates. theta: their parameters, one after the other. chi2: sum of squares in units of the noise.
        jacobian: (M, P) of the residual in scaled parameters. scale: (P,) d theta / d scaled.
    """

    causes: tuple[Candidate, ...]
    theta: Array
    chi2: float
    residual: Array
    jacobian: Array
    scale: Array

    @property
    def penalty(self) -> float:
        """Cost of the parameters and of the choices made, in chi-square."""
        return sum(len(c.names) * LEAST_PENALTY + 2.0 * math.log(c.choices) + (len(c.names) == 0) for c in self.causes)

    @property
    def score(self) -> float:
        """Chi-square and penalty: smaller is better."""
        return self.chi2 + self.penalty

    def effects(self) -> list[tuple[str, dict]]:
        return effects_at(self.causes, self.theta)

    def part(self, index: int) -> Array:
        """Theta of one cause."""
        start = sum(len(c.names) for c in self.causes[:index])
        return self.theta[start : start + len(self.causes[index].names)]


def effects_at(causes: Sequence[Candidate], theta: Array) -> list[tuple[str, dict]]:
    """The effects of `causes` at theta."""
    out, at = [], 0
    for c in causes:
        out.append(c.with_effect(theta[at : at + len(c.names)]))
        at += len(c.names)
    return out


class Residual:
    """The residual of a link, in units of its noise, as a function of effects.

    Attributes:
        weight: one over the noise, (N, C) a run, zero where nothing was measured.
        run: (M,) which run each entry belongs to.
    """

    def __init__(self, link: Link) -> None:
        self.link, self.runs = link, list(range(len(link.runs)))
        self.weight = {i: np.where(np.isfinite(link.runs[i].sigma), 1.0 / link.runs[i].sigma, 0.0) for i in self.runs}
        self.measured = {i: np.nan_to_num(link.runs[i].measured) for i in self.runs}

    def beware(self, effects: Effects) -> bool:
        """Give less weight to samples that `effects` make depend on how finely the physics is divided; whether any was added."""
        doubt = getattr(self.link, "doubt", None)
        if doubt is None:
            return False
        doubts = {i: doubt(i, effects) * self.weight[i] for i in self.runs}
        if not any(np.any(u > 1.0) for u in doubts.values()):
            return False
        for i, u in doubts.items():
            self.weight[i] = self.weight[i] / np.sqrt(1.0 + u * u)
        return True

    def on(self, runs: Sequence[int]) -> Residual:
        """The same on fewer runs."""
        out = copy(self)
        out.runs = list(runs)
        return out

    def through(self, link: Link) -> Residual:
        """The same, under the same weights, of another reading of the link."""
        out = copy(self)
        out.link = link
        return out

    def of_run(self, i: int, effects: Effects) -> Array:
        """(N, C) of run i; FAR where a prediction has left the finite numbers, so that misfits can be put in order."""
        r = (self.measured[i] - self.link.predict(i, effects)) * self.weight[i]
        if not np.isfinite(r).all():
            r = np.clip(np.nan_to_num(r, nan=FAR), -FAR, FAR)
        return r

    def __call__(self, effects: Effects) -> Array:
        """(M,) of all runs."""
        return np.concatenate([self.of_run(i, effects).ravel() for i in self.runs])


def fit(residual: Residual, causes: Sequence[Candidate], starts: Sequence[Sequence[float] | Array], tries: int = 2) -> Fit:
    """The best of several descents from the best of `starts` (each for all causes, one after the other)."""
    causes = tuple(causes)
    low, high = np.concatenate([c.low for c in causes]), np.concatenate([c.high for c in causes])
    log = np.concatenate([c.log for c in causes]).astype(bool)

    def run(theta: Array) -> Array:
        return residual(effects_at(causes, theta))

    rated = []
    for s in starts:
        theta = np.clip(np.array(s, dtype=float), low, high)
        r = run(theta)
        rated.append((square(r), theta, r))
    rated.sort(key=lambda item: item[0])
    if len(low) == 0:
        chi2, theta, r = rated[0]
        return Fit(causes, theta, chi2, r, np.zeros((len(r), 0)), np.zeros(0))
    best: Fit | None = None
    for chi2, theta, r in rated[:tries]:
        found = _descend(run, causes, theta, r, chi2, low, high, log)
        if best is None or found.chi2 < best.chi2:
            best = found
    assert best is not None
    return _polish(run, best, low, high)


def _polish(run: Callable[[Array], Array], found: Fit, low: Array, high: Array) -> Fit:
    """Scan and pattern search on the parameters in which chi-square has jumps, where a gradient is no guide."""
    rough = [ROUGH.get(c.effect) == name for c in found.causes for name in c.names]
    theta, chi2, r = found.theta, found.chi2, found.residual
    for j in np.flatnonzero(rough):
        step = 0.1
        for part in np.linspace(-step, step, SCANNED):  # a valley between two jumps may be narrower than a step
            moved = theta.copy()
            moved[j] = np.clip(found.theta[j] * (1.0 + part), low[j], high[j])
            r_new = run(moved)
            if square(r_new) < chi2 - SETTLED:
                theta, r, chi2 = moved, r_new, square(r_new)
        while step > 1e-3:
            better = False
            for sign in (1.0, -1.0):
                moved = theta.copy()
                moved[j] = np.clip(theta[j] * (1.0 + sign * step), low[j], high[j])
                r_new = run(moved)
                if square(r_new) < chi2 - SETTLED:
                    theta, r, chi2, better = moved, r_new, square(r_new), True
                    break
            step = step if better else 0.4 * step
    return replace(found, theta=theta, residual=r, chi2=chi2) if theta is not found.theta else found


def square(r: Array) -> float:
    """Sum of squares."""
    return float(np.einsum("m,m->", r, r))


def refit(residual: Residual, found: Fit) -> Fit:
    """The same hypothesis again, from where it was, after the weights have changed."""
    return fit(residual, found.causes, [found.theta], tries=1)


def scales(theta: Array, low: Array, high: Array, log: np.ndarray) -> Array:
    """d theta / d scaled parameter: theta itself where searched by ratio, else a hundredth of the range or the value itself."""
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    return np.where(log, np.abs(theta), np.maximum(np.abs(theta), 0.01 * width))


def _descend(run: Callable[[Array], Array], causes: tuple[Candidate, ...], theta: Array, r: Array, chi2: float, low: Array, high: Array,
             log: np.ndarray) -> Fit:  # fmt: skip
    damping = 1e-3
    jacobian, scale = np.zeros((len(r), len(theta))), scales(theta, low, high, log)
    for _ in range(ITERATIONS):
        scale = scales(theta, low, high, log)
        jacobian = differences(run, theta, r, scale, low, high)
        gradient, normal = np.einsum("mi,m->i", jacobian, r), np.einsum("mi,mj->ij", jacobian, jacobian)
        improved = False
        for _ in range(8):
            step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            step = np.clip(step, -1.0, 1.0)
            moved = np.where(log, theta * np.exp(step), theta + step * scale)
            moved = np.clip(moved, low, high)
            r_new = run(moved)
            new = square(r_new)
            if new < chi2:
                improved = True
                break
            damping = max(damping, 1e-4) * 8.0
        if not improved:
            break
        gain, theta, r, chi2 = chi2 - new, moved, r_new, new
        damping = max(damping / 10.0, 1e-9)
        if gain < SETTLED * max(1.0, chi2 / len(r)) or gain < 1e-7 * chi2:
            break
    return Fit(causes, theta, chi2, r, jacobian, scale)


def differences(run: Callable[[Array], Array], theta: Array, r: Array, scale: Array, low: Array, high: Array, step: float = STEP) -> Array:
    """(M, P) derivative of the residual by the scaled parameters; a step that would leave the bounds goes the other way."""
    out = np.empty((len(r), len(theta)))
    for j in range(len(theta)):
        d = step * scale[j]
        if theta[j] + d > high[j]:
            d = -d
        moved = theta.copy()
        moved[j] += d
        out[:, j] = (run(moved) - r) / (d / scale[j])
    return out
