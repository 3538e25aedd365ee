"""Stage "select": spectral lines in the residual of contact and sensor, as starts for a hum."""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.fit import Fit, fit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.frames import Array
from hiltestbed.sensor.effects import SensorHum

# derived: of a line over that of the noise, from which it is tried as a hum: 1e-13 of exponential
# noise a frequency
MIN_LINE_POWER = 30.0
MIN_SPECTRUM_ROWS = 1 << 15  # chosen: length of the transform: 0.06 Hz at 2 kHz
# chosen: of a line within the contact of a run; a slower one is the shape of the contact
MIN_CYCLES = 4.0
MIN_FREQUENCY = 0.7  # chosen: [Hz] of a line outside contacts; slower ones are drifts

Line = tuple[float, float, float]  # [Hz], [N], [rad]


def lines(link: WrenchLink) -> dict[str, Line]:
    """Axis to the strongest line of the readings outside contacts that exceeds the noise; in
    contact where it is held throughout.
    """
    parts = []
    shown = link.predict([(i, ()) for i in range(len(link.runs))])
    held = all(run.touching.all() for run in link.runs)
    for run, prediction in zip(link.runs, shown, strict=True):
        free = (run.touching if held else ~run.touching) & np.isfinite(run.sigma[:, :3]).all(axis=1)
        r = np.where(free[:, None], run.measured[:, :3] - prediction[:, :3], 0.0)
        r -= np.where(free[:, None], r[free].mean(axis=0) if free.any() else 0.0, 0.0)
        parts.append((r, free))
    longest = max(len(r) for r, _ in parts) * link.runs[0].scenario.tick
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
    longest = max(int(counts.sum()) for _, counts in parts) * link.runs[0].scenario.tick
    found = _strongest(link, parts, MIN_CYCLES / longest) if longest > 0.0 else {}
    fits = []
    for axis, line in found.items():
        c = SensorHum.near(axis, *line)
        fits.append(
            fit(
                residual,
                (*base.causes, c),
                [np.concatenate([t, c.grid[0]]) for t in _starts(base)],
                known=known,
            )
        )
    return min(fits, key=lambda f: f.score, default=None)


def _starts(base: Fit) -> list[Array]:
    """Theta of `base`, and the grid of a lone threshold: fitted without the tone, chi-square had
    its minimum elsewhere.
    """
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
    frequencies = np.fft.rfftfreq(size, link.runs[0].scenario.tick)
    total[:, frequencies < slowest] = 0.0
    out = {}
    for j, axis in enumerate("xyz"):
        at = int(np.argmax(np.abs(total[j])))
        if abs(total[j, at]) ** 2 > MIN_LINE_POWER * count * level[j] ** 2:
            line = total[j, at]
            out[axis] = (
                float(frequencies[at]),
                2.0 * abs(line) / count,
                float(np.angle(line) + math.pi / 2.0),
            )
    return out
