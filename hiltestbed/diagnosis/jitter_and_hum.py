"""Stage "select": hypotheses that are derived from the residual of contact and sensor: jitter, a
delay that varies from sample to sample, as noise in proportion to the rate of the reading, by
likelihood; and spectral lines, as starts for a hum.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, fit, null_fit, refit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import MIN_LINEAR_GAIN
from hiltestbed.effects.search import Candidate
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.sensor.effects import SensorHum

MIN_JITTER_SPREAD = 1.2  # chosen: times the noise: spread from which the jitter of a sample shows
# chosen: with the next sample or the rate of the reading, above which it is not jitter
MAX_JITTER_CORRELATION = 0.3

MAX_SIGMA = 0.02  # chosen: [s] largest standard deviation that is searched
SIGMAS_TRIED = 40
# chosen: of neighbours on a channel, whose correlation then is known to pi / 2 over ten: 0.16
MIN_PAIRS = 100
# chosen: on the first estimate, which treats the noise of a delay as small
REFINEMENT_FACTORS = (0.92, 1.0, 1.08)
# derived: of a line over that of the noise, from which it is tried as a hum: 1e-13 of exponential
# noise a frequency
MIN_LINE_POWER = 30.0
MIN_SPECTRUM_ROWS = 1 << 15  # chosen: length of the transform: 0.06 Hz at 2 kHz
# chosen: of a line within the contact of a run; a slower one is the shape of the contact
MIN_CYCLES = 4.0
MIN_FREQUENCY = 0.7  # chosen: [Hz] of a line outside contacts; slower ones are drifts

Line = tuple[float, float, float]  # [Hz], [N], [rad]


def jitter_beside(residual: Residual, base: Fit, _known: float = math.inf) -> Fit | None:
    """Jitter beside `base`; None where the data show none."""
    link, effects = residual.link, base.effects()
    if not isinstance(link, WrenchLink) or JITTER in base.kinds:
        return None
    slopes = link.slopes(effects)
    worth = np.concatenate([(slopes[i] * residual.weight[i]).ravel() for i in residual.runs])

    def cost(sigma: float) -> float:
        s2 = 1.0 + (sigma * worth) ** 2
        return float(np.sum(base.residual**2 / s2 + np.log(s2)))

    sigmas = np.geomspace(1e-6, MAX_SIGMA, SIGMAS_TRIED)
    costs = [cost(s) for s in sigmas]
    at = int(np.argmin(costs))
    if at == SIGMAS_TRIED - 1:  # a spread that large explains any misfit
        return None
    ends = (sigmas[max(at - 1, 0)], sigmas[min(at + 1, SIGMAS_TRIED - 1)])
    found: Any = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-9})
    if found.fun > base.chi2 - MIN_LINEAR_GAIN:
        return None
    best = float(found.x)
    spread = np.sqrt(1.0 + (best * worth) ** 2)
    z = base.residual / spread
    if not _independent(z, spread > MIN_JITTER_SPREAD, len(link.channels)) or not _centred(
        z, worth / spread, spread > MIN_JITTER_SPREAD
    ):
        return None
    tried = [
        (best * f, *_likelihood(link, residual, effects, best * f)) for f in REFINEMENT_FACTORS
    ]
    sigma, chi2, r = min(tried, key=lambda item: item[1])
    low, high, log = np.array([0.0]), np.array([MAX_SIGMA]), np.array([False])
    cause = Candidate(EFFECTS[JITTER], ("sigma",), low, high, log, ((0.0,),))
    jacobian = np.column_stack([base.jacobian, np.zeros(len(r))])
    return Fit((*base.causes, cause), np.append(base.theta, sigma), chi2, r, jacobian)


def again(residual: Residual, found: Fit, known: float = math.inf) -> Fit:
    """The same hypothesis fitted again under other weights; known: as of :func:`fit`."""
    if not found.causes or found.kinds[-1] != JITTER:
        return refit(residual, found, known)
    rest = replace(found, causes=found.causes[:-1], theta=found.theta[:-1])
    base = refit(residual, rest) if rest.causes else null_fit(residual)
    return jitter_beside(residual, base) or found


def _likelihood(
    link: WrenchLink, residual: Residual, effects: Effects, sigma: float
) -> tuple[float, Array]:
    """-2 log of the likelihood under a jitter ``sigma``, and the residual over the spread."""
    total, parts = 0.0, []
    for i in residual.runs:
        mean, spread = link.shaken(i, effects, sigma)
        s2 = 1.0 + (spread * residual.weight[i]) ** 2
        z = residual.left(i, mean) * residual.weight[i] / np.sqrt(s2)
        total += float(np.sum(z * z) + np.sum(np.log(s2)))
        parts.append(z.ravel())
    return total, np.concatenate(parts)


def _independent(z: Array, where: np.ndarray, channels: int) -> bool:
    """Whether neighbouring samples are independent, as jitter makes them: together, and on each
    channel with enough of them.

    By their signs, of which a share of asin(r) / pi more than half agree at a correlation of r (W.
    F. Sheppard, Phil. Trans. A 192, 1899): a few samples that are far off, as at a touch, do not
    hide that all others follow one another.
    """
    signs, where = np.sign(z).reshape(-1, channels), where.reshape(-1, channels)
    pairs = where[1:] & where[:-1]
    counts = np.sum(pairs, axis=0)
    products = np.sum(np.where(pairs, signs[1:] * signs[:-1], 0.0), axis=0)
    many = counts >= MIN_PAIRS
    most = 2.0 / math.pi * math.asin(MAX_JITTER_CORRELATION)
    alike = abs(float(products.sum())) < most * int(counts.sum())
    return alike and bool(np.all(products[many] < most * counts[many]))


def _centred(z: Array, worth: Array, where: np.ndarray) -> bool:
    """Whether the delay varies about the believed one: it would else follow the rate, `worth`."""
    z, worth = z[where], worth[where]
    return abs(float(np.sum(z * worth))) < MAX_JITTER_CORRELATION * math.sqrt(
        square(z) * square(worth)
    )


def lines(link: WrenchLink) -> dict[str, Line]:
    """Axis to the strongest line of the readings outside contacts; inside where always held."""
    parts = []
    shown = link.shown_in_all()
    held = all(run.touching.all() for run in link.runs)
    for run, prediction in zip(link.runs, shown, strict=True):
        free = (run.touching if held else ~run.touching) & np.isfinite(run.sigma[:, :3]).all(axis=1)
        r = np.where(free[:, None], run.measured[:, :3] - prediction[:, :3], 0.0)
        r -= np.where(free[:, None], r[free].mean(axis=0) if free.any() else 0.0, 0.0)
        parts.append((r, free))
    longest = max(len(r) for r, _ in parts) * link.tick
    out = _strongest(link, parts, MIN_CYCLES / longest if held else MIN_FREQUENCY)
    if len(out) > 1:
        out["all"] = out.get("z", next(iter(out.values())))
    return out


def hum_beside(residual: Residual, base: Fit, known: float = math.inf) -> Fit | None:
    """A hum beside `base`, where the residual of `base` in contact has a line; a dead zone hides it
    everywhere else.

    known: as of :func:`~hiltestbed.diagnosis.fit.fit`.
    """
    link = residual.link
    if not isinstance(link, WrenchLink) or not base.causes or "sensor.hum" in base.kinds:
        return None
    parts = []
    for i, left in zip(residual.runs, residual.by_run([base.effects()])[0], strict=True):
        weight = residual.weight[i][:, :3]
        counts = (weight > 0).all(axis=1) & link.runs[i].touching
        r = np.where(
            counts[:, None] & (weight > 0), left[:, :3] / np.where(weight > 0, weight, 1.0), 0.0
        )
        parts.append((r, counts))
    longest = max(int(counts.sum()) for _, counts in parts) * link.tick
    found = _strongest(link, parts, MIN_CYCLES / longest) if longest > 0.0 else {}
    fits = []
    for axis, line in found.items():
        c = SensorHum.near(axis, *line)
        starts = [np.concatenate([t, c.grid[0]]) for t in _starts(base)]
        fits.append(fit(residual, (*base.causes, c), starts, known=known))
    return min(fits, key=lambda f: f.score, default=None)


def _starts(base: Fit) -> list[Array]:
    """Theta of `base`, and the grid of a lone threshold, which the tone may have misled."""
    out, only = [base.theta], base.causes[0]
    if len(base.causes) == len(only.names) == 1 and only.effect.jumps == only.names[0]:
        out += [np.array(start) for start in only.grid]
    return out


def _strongest(
    link: WrenchLink, parts: list[tuple[Array, np.ndarray]], slowest: float
) -> dict[str, Line]:
    """Axis to its strongest line above `slowest` [Hz], its phase counted from the start of each
    run.

    parts: of each run the residual (N, 3) [N], zero where it does not count, and where it counts
        (N,).
    """
    size = max(MIN_SPECTRUM_ROWS, *(1 << (len(r) - 1).bit_length() for r, _ in parts))
    total = np.zeros((3, size // 2 + 1), dtype=complex)
    for r, _ in parts:
        total += np.fft.rfft(r, size, axis=0).T
    count = sum(int(counts.sum()) for _, counts in parts)
    if count < 50:
        return {}
    levels = [
        np.min(np.where(np.isfinite(run.sigma[:, :3]), run.sigma[:, :3], 1e9), axis=0)
        for run in link.runs
    ]
    level = np.median(levels, axis=0)
    frequencies = np.fft.rfftfreq(size, link.tick)
    total[:, frequencies < slowest] = 0.0
    return strongest_lines(total, frequencies, np.full(3, count), level)


def strongest_lines(
    spectra: np.ndarray, frequencies: np.ndarray, counts: np.ndarray, levels: Array
) -> dict[str, Line]:
    """Axis to the strongest line of its spectrum (3, F) of so many samples, if it exceeds white
    noise of the ``levels`` (3,) [N].
    """
    out = {}
    for axis, spectrum, count, level in zip("xyz", spectra, counts, levels, strict=True):
        at = int(np.argmax(np.abs(spectrum)))
        line = spectrum[at]
        if count and abs(line) ** 2 > MIN_LINE_POWER * count * level**2:
            phase = float(np.angle(line) + math.pi / 2.0)
            out[axis] = (float(frequencies[at]), 2.0 * abs(line) / count, phase)
    return out
