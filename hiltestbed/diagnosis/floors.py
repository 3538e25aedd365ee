"""Stage "layout": the noise floor of every channel of a dataset."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.noise import undithered
from hiltestbed.diagnosis.pose_noise import smooth_levels
from hiltestbed.diagnosis.settings import (
    MAX_AXIS_NOISE_RATIO,
    MIN_FREE_ROWS,
    MIN_NOISE_ROWS,
    WHITE_NOISE_ERROR,
)
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import white_noise


def floors(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel to noise floor: third differences away from contacts, pooled; a channel that is
    constant there is estimated otherwise.
    """
    out, smooth = {}, smooth_levels(runs)
    for name in dict.fromkeys(c for r in runs for c in r.record.columns()):
        found, still = [], 0
        for r in runs:
            if not r.record.has(name):
                continue
            values, step = r.record.column(name), r.record.steps.get(name, 0.0)
            outside = (
                values[~r.touching(len(values))]
                if name.startswith("wrench") and r.survey.contacts
                else values
            )
            # a latched mechanism is never free
            outside = outside if len(outside) > MIN_FREE_ROWS else values
            changes = np.diff(outside)
            changes = changes[np.isfinite(changes)]  # rows may be lost
            still += int(len(changes) >= 10 and np.median(np.abs(changes)) == 0.0)
            found.append(max(white_outside(outside, values, step), step / math.sqrt(12.0)))
        level = float(np.sqrt(np.mean(np.square(found)))) if found else 0.0
        # a dead zone, or a sensor that is off between contacts
        if name.startswith("wrench_meas") and still * 2 > len(runs):
            believed = (
                runs[0].scenario.sensor.noise
                if ".f" in name
                else runs[0].scenario.sensor.torque_noise
            )
            inside = [
                white_noise(r.record.column(name)[r.touching(r.record.ticks)])
                for r in runs
                if r.survey.contacts
            ]
            level = believed or (float(np.median(inside)) if inside else 0.0)
            steps = [r.record.steps.get(name, 0.0) for r in runs]
            level = (
                math.hypot(level, max(steps) / math.sqrt(12.0))
                if any(undithered(r, name) for r in runs)
                else level
            )
        # of a force: in its colour
        sampled = (
            [r.record.sampled.get(name, 0.0) for r in runs] if name.startswith("pose_act") else []
        )
        out[name] = max(level, smooth.get(name, 0.0), *sampled)
    places = [n for n in ("pose_act.px", "pose_act.py", "pose_act.pz") if out.get(n)]
    for name in places:  # stick-slip looks like noise on the axis that moves most
        out[name] = min(out[name], MAX_AXIS_NOISE_RATIO * min(out[n] for n in places))
    return out | {
        f"pose_act.r{axis}": 2.0 * out[f"pose_act.q{axis}"]
        for axis in "xyz"
        if f"pose_act.q{axis}" in out
    }


def white_outside(outside: Array, values: Array, step: float = 0.0) -> float:
    """White noise of the rows ``outside`` contacts; where these are few and agree with it, that of
    all ``values``. step: of both.
    """
    found, everywhere = white_noise(outside, step), white_noise(values, step)
    few = (
        len(outside) < MIN_NOISE_ROWS
        and abs(everywhere - found)
        < 2.0 * WHITE_NOISE_ERROR / math.sqrt(max(1, len(outside))) * everywhere
    )
    return everywhere if few else found
