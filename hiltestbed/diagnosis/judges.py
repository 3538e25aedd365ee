"""Stage "select": adequacy of an explanation of a computed channel, which has no noise to compare
the residual with.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.links import AxisLink, CompensationLink
from hiltestbed.diagnosis.links.base import NO_SHIFT, Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Judge
from hiltestbed.diagnosis.settings import (
    CORRELATED_ROWS,
    DYNAMICS_FLOOR,
    DYNAMICS_INTERPOLATION,
    MAX_COMPUTED_RESIDUAL,
    MAX_PROPAGATED_NOISE,
    SIGNIFICANCE_SIGMA,
    SMOOTHING_ROWS,
)
from hiltestbed.frames import Array

NEIGHBOURS = 2  # chosen: rows to each side whose squares may be alike
# chosen: of the ratio of propagated noise in contact to that outside it, however many rows there
# are
MIN_VARIANCE_LIMIT = 1.3


def of_compensation(link: CompensationLink, noise: Mapping[str, float]) -> Judge:
    """Computed, not measured: the residual is zero, or propagated noise of the record that is no
    larger in contact than outside it.
    """
    gain = link.noise_gain()

    def judge(residual: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        left = residual.by_run([effects])[0]
        late = any(e.link == "log" for e in effects)
        for c, name in enumerate(residual.link.channels):
            level = min(float(residual.link.runs[i].sigma[:, c].min()) for i in residual.runs)
            if not math.isfinite(level):  # an axis that was not measured, or whose input was not
                continue
            inside = np.concatenate(
                [
                    r[residual.link.runs[i].touching, c]
                    for i, r in zip(residual.runs, left, strict=True)
                ]
            )
            outside = np.concatenate(
                [
                    r[~residual.link.runs[i].touching, c]
                    for i, r in zip(residual.runs, left, strict=True)
                ]
            )
            rms_in, rms_out = (
                float(np.sqrt(np.mean(x * x))) * level if len(x) else 0.0 for x in (inside, outside)
            )
            led = gain * noise.get(name.replace("comp", "meas"), 0.0)
            # a latched mechanism is never free
            apart = rms_out if len(outside) > SMOOTHING_ROWS else rms_in
            if late:  # from a late record the loop's readings are known up to its noise
                apart = led
            floor = max(level / math.sqrt(CORRELATED_ROWS), min(apart, MAX_PROPAGATED_NOISE * led))
            out[name] = Leftover(
                (max(rms_in, rms_out) / floor) ** 2,
                0.0,
                max(MIN_VARIANCE_LIMIT, _chance(residual, c, left)),
                1.0,
                len(inside),
            )
        return out

    return judge


def _chance(residual: Residual, channel: int, left: Sequence[Array]) -> float:
    """The largest ratio of the variances in contact and outside it by chance; left: (N, C) residual
    of each run.

    The logarithm of a variance of n rows on record has an error of sqrt(s/n): s is 2 for
    independent normal ones, and what the rows outside contact show it to be where their noise
    differs from row to row or follows their neighbours', as between the rows of a slower log.
    """
    inside, outside = 0, []
    for i, r in zip(residual.runs, left, strict=True):
        run = residual.link.runs[i]
        known = np.isfinite(run.sigma[:, channel])
        inside += int((known & run.touching).sum())
        outside.append(r[known & ~run.touching, channel] ** 2)
    rows, spread = sum(map(len, outside)), 2.0
    mean = sum(float(x.sum()) for x in outside) / max(rows, 1)
    if rows > SMOOTHING_ROWS and mean > 0.0:
        off = [x / mean - 1.0 for x in outside]
        lags = [
            sum(float(x[lag:] @ x[: len(x) - lag]) for x in off) / rows
            for lag in range(NEIGHBOURS + 1)
        ]
        spread = max(spread, lags[0] + 2.0 * sum(max(lag, 0.0) for lag in lags[1:]))
    return math.exp(SIGNIFICANCE_SIGMA * math.sqrt(spread / max(inside, 1) + spread / max(rows, 1)))


def of_dynamics(residual: Residual) -> Judge:
    """Computed: no more than integrators may differ by, or a hundredth of the departure that was
    explained.
    """
    departures = _rms(residual, ())

    def judge(of: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        for name, rms, departure in zip(
            residual.link.channels, _rms(of, effects), departures, strict=True
        ):
            floor = DYNAMICS_FLOOR + (0.0 if of.link.timing == NO_SHIFT else DYNAMICS_INTERPOLATION)
            allowed = max(floor, MAX_COMPUTED_RESIDUAL * departure if effects else 0.0)
            out[name] = Leftover((rms / allowed) ** 2, 0.0, 1.0, 1.0, len(residual.runs))
        return out

    return judge


def of_axis(link: AxisLink) -> Judge:
    """Measured, and integrated twice: no more than the noise, or than a hundredth of the motion."""
    motion = float(
        np.sqrt(
            np.mean(
                np.concatenate([(r.measured - r.measured.mean(axis=0)) ** 2 for r in link.runs])
            )
        )
    )
    noise = min(float(r.sigma.min()) for r in link.runs)
    allowed = max(noise, MAX_COMPUTED_RESIDUAL * motion)

    def judge(of: Residual, effects: Effects) -> dict[str, Leftover]:
        placed = of.as_judged()
        left = [
            float(np.mean(z[placed.weight[i] > 0] ** 2)) * noise**2
            for i, z in zip(of.runs, placed.by_run([effects])[0], strict=True)
        ]
        return {link.channels[0]: Leftover(max(left) / allowed**2, 0.0, 1.0, 1.0, len(of.runs))}

    return judge


def _rms(residual: Residual, effects: Effects) -> list[float]:
    z = np.concatenate(residual.by_run([effects])[0])
    return [
        float(v) * DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)
        for v in np.sqrt(np.mean(z * z, axis=0))
    ]
