"""An axis that a force drives: position and force on record, of a machine that started where it stood.

The same link as the numerical model's, but measured: the position carries an encoder's noise, the run does not begin in free flight at
the scenario's approach, and which row a position belongs to, the one before the force or after it, depends on the log. So place and speed
at the start are read from the record, the stamp is fitted beside what is sought, and a regression of the force on the motion (the inverse
model of robot identification: M. Gautier, P. Poignet, 2001) says where to start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, filtfilt

from hiltestbed.diagnosis.fit import Fit, fit
from hiltestbed.diagnosis.links import AxisLink, LinkRun
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Special
from hiltestbed.diagnosis.settings import CORRELATED, DYNAMICS_FLOOR, NO_POSE_NOISE, SELECTION_INADEQUATE
from hiltestbed.effects.search import Candidate, DrivenAxis
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.driven import PLACE
from hiltestbed.measured.noise import white_noise

MASS, FORCE = "dynamics.mass", "dynamics.force"
ALONG_AN_AXIS = (MASS, FORCE)  # the stamp stands for late steps
WAY = 0.3  # [s] between the places whose way a fit looks at: 0.1 to 3 s give the same within a percent
BEGINNINGS = (12, 17, 24, 34, 48, 68, 96)  # rows of a parabola from which place and speed at the start are read
UNEVEN_START = 0.05  # of the speed that the acceleration brings over these rows: what a parabola misses of a drive that starts
CUTOFF = 20.0  # [Hz] of the filter before the regression, or less where the log is slow
SLOWEST = 0.03  # of the largest speed: slower rows are left out of the regression, where dry friction turns round
STAMPS = 3.0  # sample periods to each side, within which the stamp of a position is sought
HALF_STEP = 1.5  # ticks by which a position that was read with its force is older: a tick, and the half by which the step is early


def _force(run: MeasuredRun) -> Array:
    return np.ascontiguousarray(run.record.filled("wrench_comp")[:, 2])


def axis_link(runs: Sequence[MeasuredRun]) -> AxisLink:
    """The link on whole runs."""
    starts = [_start(run) for run in runs]
    return AxisLink([_link_run(run) for run in runs], [_force(run) for run in runs], [p for p, _ in starts], [v for _, v in starts])


def _link_run(run: MeasuredRun) -> LinkRun:
    place = run.record.column(PLACE)
    noise = max(white_noise(place), run.record.steps.get(PLACE, 0.0) / math.sqrt(12.0), NO_POSE_NOISE)
    sigma = np.where(np.isfinite(place), math.hypot(noise, DYNAMICS_FLOOR * math.sqrt(CORRELATED)), np.inf)
    sigma[0] = np.inf  # the start stands for itself
    return LinkRun(run.scenario, np.nan_to_num(place)[:, None], sigma[:, None], np.zeros(len(place), dtype=bool))


def _start(run: MeasuredRun) -> tuple[float, float]:
    """Place [m] and speed [m/s] at row 0: of a parabola through as few of the first rows as the noise allows."""
    place, tick = run.record.column(PLACE), run.scenario.tick
    known = np.flatnonzero(np.isfinite(place))
    noise = max(white_noise(place), NO_POSE_NOISE)
    found = (float(place[known[0]]), 0.0)
    for count in BEGINNINGS:
        rows = known[:count]
        span = max(float(rows[-1] * tick), tick)
        c, b, a = np.polyfit(rows * tick, place[rows], 2)
        found = (float(a), float(b))
        if noise * math.sqrt(192.0 / count) / span < UNEVEN_START * max(abs(2.0 * c) * span, abs(b)):  # error of b against what it misses
            break
    return found


def regression(runs: Sequence[MeasuredRun]) -> DrivenAxis:
    """Mass, friction and offset by least squares of the filtered force on the filtered motion."""
    parts = [_filtered(run) for run in runs]
    fastest = max(float(np.abs(v).max()) for _, v, _ in parts)
    rows = [np.abs(v) > SLOWEST * fastest for _, v, _ in parts]
    a, v, f = (np.concatenate([part[j][keep] for part, keep in zip(parts, rows, strict=True)]) for j in range(3))
    basis = np.column_stack([a, v, np.sign(v), np.ones_like(v)])
    scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    mass, viscous, coulomb, offset = np.linalg.lstsq(basis / scale, f, rcond=None)[0] / scale
    period = max(max(run.scenario.tick, 1.0 / run.record.sample_rate if run.record.sample_rate else 0.0) for run in runs)
    return DrivenAxis(
        factor=_factor(runs[0], float(mass)),
        viscous=max(float(viscous), 0.0),
        coulomb=max(float(coulomb), 0.0),
        offset=float(offset),
        fastest=max(fastest, 1e-9),
        stamp=HALF_STEP * runs[0].scenario.tick,
        stamps=STAMPS * period,
    )


def _factor(run: MeasuredRun, mass: float) -> float:
    """Of the chaser's mass, with which both bodies together have the inertia ``mass`` [kg] against each other; 1 where none has."""
    chaser, target = run.scenario.spacecraft.chaser.mass, run.scenario.spacecraft.target.mass
    return target * mass / (target - mass) / chaser if 0.0 < mass < 0.99 * target else 1.0


def one_force(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Without the forces that have more parameters, which are weighed by :func:`mass_and_force`."""
    least = min((len(c.names) for c in candidates if c.kind == FORCE), default=0)
    return tuple(c for c in candidates if c.kind != FORCE or len(c.names) == least)


def mass_and_force(candidates: Sequence[Candidate]) -> Special:
    """The hypotheses that the mass is another and a force resists it: neither alone comes near where both are.

    Each further parameter has to lower the misfit by what the independent stretches of the record bear: ``n ln(chi-square ratio)``, the
    scale unknown.
    """
    masses, forces = ([c for c in candidates if c.kind == kind] for kind in (MASS, FORCE))
    tried = [(*mass, force) for force in forces for mass in ((), *((m,) for m in masses))]

    def make(residual: Residual, base: Fit) -> Fit | None:
        if base.causes or not forces:
            return None
        seconds = sum(residual.link.runs[i].rows * residual.link.runs[i].scenario.tick for i in residual.runs)
        witnesses = seconds / min(residual.link.witnesses)
        best = fit(residual, tried[0], tried[0][0].grid)
        for causes in tried[1:]:
            other = fit(residual, causes, [np.concatenate([c.grid[0] for c in causes])])
            if witnesses * math.log(max(best.chi2, 1e-300) / max(other.chi2, 1e-300)) > SELECTION_INADEQUATE:
                best = other
        return best if best.causes != tried[0] else None

    return make


def _filtered(run: MeasuredRun) -> tuple[Array, Array, Array]:
    """Acceleration, speed and the force that drives it, (N,) each, through one filter of no phase."""
    tick = run.scenario.tick
    rate = min(run.scenario.rate, run.record.sample_rate or run.scenario.rate)
    b, a = butter(2, min(CUTOFF, 0.05 * rate) * 2.0 * tick)  # type: ignore[misc]
    place, force = (np.asarray(filtfilt(b, a, x)) for x in (run.record.filled("pose_cmd")[:, 2], -_force(run)))
    speed = np.gradient(place, tick)
    edge = min(len(speed) // 10, round(2.0 / (CUTOFF * tick)))
    inner = slice(edge, len(speed) - edge)
    return np.gradient(speed, tick)[inner], speed[inner], force[inner]
