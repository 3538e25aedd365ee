"""Lines in what a contact and sensor link leaves: where a hum is worth trying."""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.fit import Fit, fit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.frames import Array
from hiltestbed.sensor.effects.additions import SensorHum

POWER = 30.0  # of a line over that of the noise, from which it is tried as a hum: 1e-13 of exponential noise a frequency
SPECTRUM = 1 << 15  # rows, at least: 0.06 Hz at 2 kHz
CYCLES = 4.0  # of a line within what a run holds of contact: a slower one is the shape of the contact
SLOWEST = 0.7  # [Hz] of a line outside contacts: slower ones are drifts

Line = tuple[float, float, float]  # [Hz], [N], [rad]


def lines(link: WrenchLink) -> dict[str, Line]:
    """Axis to the strongest line of the readings outside contacts, where it stands out of the noise; of what is held throughout, within."""
    parts = []
    shown = link.predict([(i, ()) for i in range(len(link.runs))])
    held = all(run.touching.all() for run in link.runs)
    for run, prediction in zip(link.runs, shown, strict=True):
        free = (run.touching if held else ~run.touching) & np.isfinite(run.sigma[:, :3]).all(axis=1)
        r = np.where(free[:, None], run.measured[:, :3] - prediction[:, :3], 0.0)
        r -= np.where(free[:, None], r[free].mean(axis=0) if free.any() else 0.0, 0.0)
        parts.append((r, free))
    longest = max(len(r) for r, _ in parts) * link.runs[0].scenario.tick
    out = _strongest(link, parts, CYCLES / longest if held else SLOWEST)
    if len(out) > 1:
        out["all"] = out.get("z", next(iter(out.values())))
    return out


def hum_beside(residual: Residual, base: Fit) -> Fit | None:
    """A hum beside `base`, where what base leaves in contact holds a line: a dead zone hides it everywhere else."""
    link = residual.link
    if not isinstance(link, WrenchLink) or not base.causes or "sensor.hum" in base.kinds:
        return None
    parts = []
    for i, left in zip(residual.runs, residual.by_run([base.effects()])[0], strict=True):
        weight = residual.weight[i][:, :3]
        counts = (weight > 0).all(axis=1) & link.runs[i].touching
        r = np.where(counts[:, None] & (weight > 0), left[:, :3] / np.where(weight > 0, weight, 1.0), 0.0)
        parts.append((r, counts))
    longest = max(int(counts.sum()) for _, counts in parts) * link.runs[0].scenario.tick
    found = _strongest(link, parts, CYCLES / longest) if longest > 0.0 else {}
    fits = []
    for axis, line in found.items():
        c = SensorHum.near(axis, *line)
        fits.append(fit(residual, (*base.causes, c), [np.concatenate([t, c.grid[0]]) for t in _starts(base)]))
    return min(fits, key=lambda f: f.score, default=None)


def _starts(base: Fit) -> list[Array]:
    """Theta of `base`, and with the grid of a lone threshold: without the tone, chi-square had its well elsewhere."""
    out, only = [base.theta], base.causes[0]
    if len(base.causes) == len(only.names) == 1 and only.effect.jumps == only.names[0]:
        out += [np.array(start) for start in only.grid]
    return out


def _strongest(link: WrenchLink, parts: list[tuple[Array, np.ndarray]], slowest: float) -> dict[str, Line]:
    """Axis to its strongest line above `slowest` [Hz], its phase counted from the start of each run.

    parts: of each run what is left (N, 3) [N], zero where it does not count, and where it counts (N,).
    """
    size = max(SPECTRUM, *(1 << (len(r) - 1).bit_length() for r, _ in parts))
    total = np.zeros((3, size // 2 + 1), dtype=complex)
    for r, _ in parts:
        total += np.fft.rfft(r, size, axis=0).T
    count = sum(int(counts.sum()) for _, counts in parts)
    if count < 50:
        return {}
    levels = [np.min(np.where(np.isfinite(run.sigma[:, :3]), run.sigma[:, :3], 1e9), axis=0) for run in link.runs]
    level = np.median(levels, axis=0)
    frequencies = np.fft.rfftfreq(size, link.runs[0].scenario.tick)
    total[:, frequencies < slowest] = 0.0
    out = {}
    for j, axis in enumerate("xyz"):
        at = int(np.argmax(np.abs(total[j])))
        if abs(total[j, at]) ** 2 > POWER * count * level[j] ** 2:
            line = total[j, at]
            out[axis] = (float(frequencies[at]), 2.0 * abs(line) / count, float(np.angle(line) + math.pi / 2.0))
    return out
