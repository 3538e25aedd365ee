"""Stage "select": a driven axis: position and force on record, of a machine that started where it
stood.

The link is that of the numerical model, but measured: the position carries an encoder's noise, the
run does not begin in free flight at the scenario's approach, and the log decides whether a position
belongs to the row before or after its force. So position and speed at the start are estimated from
the record, the stamp is fitted with the causes, and a regression of the force on the motion (the
inverse model of robot identification: M. Gautier, P. Poignet, 2001) gives the start of the search.
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
from hiltestbed.diagnosis.settings import (
    CORRELATED_ROWS,
    DYNAMICS_FLOOR,
    MIN_POSE_NOISE,
    SELECTION_INADEQUATE,
)
from hiltestbed.effects.search import Candidate, DrivenAxis
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.driven import PLACE
from hiltestbed.measured.noise import white_noise

MASS, FORCE = "dynamics.mass", "dynamics.force"
AXIS_EFFECTS = (MASS, FORCE)  # the stamp takes the place of delay effects
# calibrated: [s] of the displacements that are fitted: 0.1 to 3 s give the same within a percent
DISPLACEMENT_SPAN = 0.3
# chosen: of a parabola that gives position and speed at the start
START_ROWS = (12, 17, 24, 34, 48, 68, 96)
# chosen: share of the speed gained over these rows: what a parabola misses of a drive that starts
MAX_START_ERROR = 0.05
# chosen: [Hz] of the filter before the regression, or less where the log is slow
CUTOFF_FREQUENCY = 20.0
# chosen: of the largest speed: slower rows, where dry friction reverses, are left out of the
# regression
MIN_SPEED_SHARE = 0.03
# chosen: sample periods to each side, within which the stamp of a position is sought
MAX_STAMP_SHIFT = 3.0
# derived: ticks by which a position read with its force is older: a tick, and half a tick of the
# integration step
STAMP_START = 1.5


def _force(run: MeasuredRun) -> Array:
    return np.ascontiguousarray(run.record.filled("wrench_comp")[:, 2])


def axis_link(runs: Sequence[MeasuredRun]) -> AxisLink:
    """The link on whole runs."""
    starts = [_start(run) for run in runs]
    return AxisLink(
        [_link_run(run) for run in runs],
        [_force(run) for run in runs],
        [p for p, _ in starts],
        [v for _, v in starts],
    )


def _link_run(run: MeasuredRun) -> LinkRun:
    place = run.record.column(PLACE)
    noise = max(
        white_noise(place), run.record.steps.get(PLACE, 0.0) / math.sqrt(12.0), MIN_POSE_NOISE
    )
    sigma = np.where(
        np.isfinite(place), math.hypot(noise, DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)), np.inf
    )
    sigma[0] = np.inf  # the start is taken from it
    return LinkRun(
        run.scenario,
        np.nan_to_num(place)[:, None],
        sigma[:, None],
        np.zeros(len(place), dtype=bool),
    )


def _start(run: MeasuredRun) -> tuple[float, float]:
    """Position [m] and speed [m/s] at row 0, of a parabola through as few rows as noise allows."""
    place, tick = run.record.column(PLACE), run.scenario.tick
    known = np.flatnonzero(np.isfinite(place))
    noise = max(white_noise(place), MIN_POSE_NOISE)
    found = (float(place[known[0]]), 0.0)
    for count in START_ROWS:
        rows = known[:count]
        span = max(float(rows[-1] * tick), tick)
        c, b, a = np.polyfit(rows * tick, place[rows], 2)
        found = (float(a), float(b))
        # error of b against the bias
        if noise * math.sqrt(192.0 / count) / span < MAX_START_ERROR * max(
            abs(2.0 * c) * span, abs(b)
        ):
            break
    return found


def regression(runs: Sequence[MeasuredRun]) -> DrivenAxis:
    """Mass, friction and offset by least squares of the filtered force on the filtered motion."""
    parts = [_filtered(run) for run in runs]
    fastest = max(float(np.abs(v).max()) for _, v, _ in parts)
    rows = [np.abs(v) > MIN_SPEED_SHARE * fastest for _, v, _ in parts]
    a, v, f = (
        np.concatenate([part[j][keep] for part, keep in zip(parts, rows, strict=True)])
        for j in range(3)
    )
    basis = np.column_stack([a, v, np.sign(v), np.ones_like(v)])
    scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    mass, viscous, coulomb, offset = np.linalg.lstsq(basis / scale, f, rcond=None)[0] / scale
    period = max(
        max(run.scenario.tick, 1.0 / run.record.sample_rate if run.record.sample_rate else 0.0)
        for run in runs
    )
    return DrivenAxis(
        factor=_factor(runs[0], float(mass)),
        viscous=max(float(viscous), 0.0),
        coulomb=max(float(coulomb), 0.0),
        offset=float(offset),
        fastest=max(fastest, 1e-9),
        stamp=STAMP_START * runs[0].scenario.tick,
        stamps=MAX_STAMP_SHIFT * period,
    )


def _factor(run: MeasuredRun, mass: float) -> float:
    """Factor on the chaser's mass for which both bodies have the inertia ``mass`` [kg]; 1: none."""
    chaser, target = run.scenario.spacecraft.chaser.mass, run.scenario.spacecraft.target.mass
    return target * mass / (target - mass) / chaser if 0.0 < mass < 0.99 * target else 1.0


def simplest_force(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Without the force hypotheses of more parameters, which :func:`mass_and_force` compares."""
    least = min((len(c.names) for c in candidates if c.kind == FORCE), default=0)
    return tuple(c for c in candidates if c.kind != FORCE or len(c.names) == least)


def mass_and_force(candidates: Sequence[Candidate]) -> Special:
    """The combined hypotheses of a wrong mass and a force that resists it: where both hold, neither
    alone comes near.

    A further parameter must lower the misfit by more than chance does over the independent
    stretches of the record: ``n ln(chi-square ratio)``, with the noise level unknown.
    """
    masses, forces = ([c for c in candidates if c.kind == kind] for kind in (MASS, FORCE))
    tried = [(*mass, force) for force in forces for mass in ((), *((m,) for m in masses))]

    def make(residual: Residual, base: Fit, _known: float) -> Fit | None:
        if base.causes or not forces:
            return None
        seconds = sum(
            residual.link.runs[i].rows * residual.link.runs[i].scenario.tick for i in residual.runs
        )
        witnesses = seconds / min(residual.link.witnesses)
        best = fit(residual, tried[0], tried[0][0].grid)
        for causes in tried[1:]:
            other = fit(residual, causes, [np.concatenate([c.grid[0] for c in causes])])
            if (
                witnesses * math.log(max(best.chi2, 1e-300) / max(other.chi2, 1e-300))
                > SELECTION_INADEQUATE
            ):
                best = other
        return best if best.causes != tried[0] else None

    return make


def _filtered(run: MeasuredRun) -> tuple[Array, Array, Array]:
    """Acceleration, speed and driving force, (N,) each, through one zero-phase filter."""
    tick = run.scenario.tick
    rate = min(run.scenario.rate, run.record.sample_rate or run.scenario.rate)
    b, a = butter(2, min(CUTOFF_FREQUENCY, 0.05 * rate) * 2.0 * tick)  # type: ignore[misc]
    place, force = (
        np.asarray(filtfilt(b, a, x)) for x in (run.record.filled("pose_cmd")[:, 2], -_force(run))
    )
    speed = np.gradient(place, tick)
    edge = min(len(speed) // 10, round(2.0 / (CUTOFF_FREQUENCY * tick)))
    inner = slice(edge, len(speed) - edge)
    return np.gradient(speed, tick)[inner], speed[inner], force[inner]
