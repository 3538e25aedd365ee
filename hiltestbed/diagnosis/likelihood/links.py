"""The computed links of the loop on records whose log has errors of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.layout import Layout, compensation_link, levels
from hiltestbed.diagnosis.links import CompensationLink, DynamicsLink, LinkRun, flat_pose
from hiltestbed.diagnosis.settings import COMPENSATION_FLOOR, CORRELATED_ROWS, DYNAMICS_FLOOR
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun, Record
from hiltestbed.replay.compensation import needs
from hiltestbed.signals import GROUPS

# of the variance of the noise: what lies between two rows has its own, and a quarter of that of
# each of the two beside
LOST_NOISE = 1.5
FORGOTTEN = 0.01  # of the variance of a reading, below which a compensation has forgotten it
STEP_SIGMA = 1.0 / math.sqrt(12.0)  # of a step, standard deviation of the error by rounding to it


def compensation(layout: Layout, rows: Sequence[int]) -> CompensationLink:
    """The compensation on the first ``rows`` of each run; that of the rules where it does not
    respond linearly to the readings. Rows do not count that depend on readings which are not on
    record: one wrong reading shows in many rows of the output.
    """
    noise = levels(layout, "wrench_meas")
    level = COMPENSATION_FLOOR * max(noise[2], 1e-6) * math.sqrt(CORRELATED_ROWS)
    pairs = list(zip(layout.runs, rows, strict=True))
    groups = {g for r in layout.runs for g in needs(r.scenario)} - {"wrench_meas"}
    if groups or layout.logged:
        return compensation_link(layout, rows)
    wrenches = [np.ascontiguousarray(r.record.filled("wrench_meas")[:n]) for r, n in pairs]
    first = [_computed(r, r.record.data["wrench_comp"], level, n) for r, n in pairs]
    link, runs = CompensationLink(first, wrenches, {}), []
    for (r, n), run in zip(pairs, first, strict=True):
        own = r.record.rounding("wrench_comp")[:n]
        passed = link.passed(input_variance(r.record, "wrench_meas", noise)[:n])
        sigma = np.sqrt(run.sigma**2 + own**2 + passed)
        bridged = np.where(r.record.lost("wrench_meas")[:n, None], noise**2, 0.0)
        sigma[link.passed(bridged) > FORGOTTEN * noise**2] = np.inf
        sigma[:, [name in r.record.absent for name in GROUPS["wrench_meas"].columns]] = np.inf
        runs.append(replace(run, sigma=sigma))
    return CompensationLink(runs, wrenches, {})


def dynamics(layout: Layout, rows: Sequence[int]) -> DynamicsLink:
    """The numerical model on the first ``rows`` of each run."""
    level = DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)
    noise, runs, wrenches, variance = levels(layout, "wrench_comp"), [], [], []
    for r, n in zip(layout.runs, rows, strict=True):
        run = _computed(r, flat_pose(r.record.data["pose_cmd"]), level, n)
        written = r.record.rounding("pose_cmd")[:n, :6] * np.array([1, 1, 1, 2, 2, 2])
        steps = [r.record.steps.get(name, 0.0) for name in GROUPS["pose_cmd"].columns[:6]]
        quantised = STEP_SIGMA * np.array(steps) * np.array([1, 1, 1, 2, 2, 2])
        runs.append(replace(run, sigma=np.sqrt(run.sigma**2 + written**2 + quantised**2)))
        wrenches.append(np.ascontiguousarray(r.record.filled("wrench_comp")[:n]))
        variance.append(input_variance(r.record, "wrench_comp", noise)[:n])
    link = DynamicsLink(runs, wrenches)
    return link.with_input_errors(variance) if any(v.any() for v in variance) else link


def input_variance(record: Record, group: str, noise: Array) -> Array:
    """(ticks, 6) variance of the errors of recorded wrenches, where they are the input of a link:
    of written digits, of converter steps, and of what bridges lost rows: noise, and the difference
    of the rows beside, by as much as which a reading jumps at a touch. ``noise``: (6,) of it.
    """
    out = record.rounding(group) ** 2
    for j, name in enumerate(GROUPS[group].columns):
        if name in record.absent:
            continue
        out[:, j] += (STEP_SIGMA * record.steps.get(name, 0.0)) ** 2
        known = np.flatnonzero(record.measured(name))
        lost = record.lost(group) & ~record.measured(name)
        if not lost.any() or not len(known):
            continue
        values = record.column(name)[known]
        at = np.searchsorted(known, np.flatnonzero(lost))
        before, after = values[np.maximum(at - 1, 0)], values[np.minimum(at, len(known) - 1)]
        inside = (at > 0) & (at < len(known))
        error = np.where(inside, np.abs(after - before), np.maximum(abs(before), abs(after)))
        # the errors of one stretch are alike
        edges = np.flatnonzero(np.diff(np.r_[False, lost, False])).reshape(-1, 2)
        length = np.repeat(edges[:, 1] - edges[:, 0], edges[:, 1] - edges[:, 0])
        out[lost, j] += length * error**2 + LOST_NOISE * noise[j] ** 2
    return out


def _computed(run: MeasuredRun, values: Array, level: float, rows: int) -> LinkRun:
    sigma = np.where(np.isfinite(values[:rows]), level, np.inf)
    return LinkRun(run.scenario, np.nan_to_num(values[:rows]), sigma, run.touching(rows))
