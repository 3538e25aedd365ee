"""Stage "layout": orders of magnitude of the data (force, depth, speed, time), from which a search
takes its starts and bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.effects.search import Scales
from hiltestbed.measured import MeasuredRun


def scales_of(runs: Sequence[MeasuredRun], noise: Mapping[str, float]) -> Scales:
    """Scales of a dataset; ``noise``: channel to its floor."""
    contacts = [c for r in runs for c in r.survey.contacts]
    first = runs[0].scenario
    stiffness = float(np.median([r.scenario.mechanism.contact.stiffness for r in runs]))
    force = max([abs(c.peak_force or 0.0) for c in contacts], default=0.0)
    depth = _depth(runs, force / stiffness)
    force = force or stiffness * depth
    speeds = (
        [abs(v) for r in runs for v in r.scenario.approach.velocity if v]
        or _commanded_speeds(runs)
        or [0.01]
    )
    peaks = sorted({round(abs(c.peak_force), 6) for c in contacts if c.peak_force}, reverse=True)
    return Scales(
        force=force,
        depth=depth,
        stiffness=stiffness,
        tick=first.tick,
        noise=noise.get("wrench_meas.fz", 0.01 * force) or 1e-3 * force,
        slow=min(speeds),
        fast=max(speeds),
        duration=min(r.record.ticks * r.scenario.tick for r in runs),
        reading=tuple(peaks[:3]),
        travel=max(
            (
                float(np.max(np.ptp(r.record.filled("pose_cmd")[:, :3], axis=0)))
                for r in runs
                if r.record.has("pose_cmd")
            ),
            default=0.0,
        ),
        substeps=first.substeps,
        captured=first.mechanism.captured,
        slides=_slides(runs),
    )


def _depth(runs: Sequence[MeasuredRun], pressed: float) -> float:
    """Largest penetration [m]: measured on a flat surface, else derived from the peak force."""
    contacts = [c for r in runs for c in r.survey.contacts]
    if runs[0].scenario.mechanism.flat or runs[0].scenario.mechanism.captured or not pressed:
        return max([c.penetration or 0.0 for c in contacts], default=1e-3) or 1e-3
    return pressed


def _slides(runs: Sequence[MeasuredRun]) -> bool:
    """Whether the tip moves across the surface."""
    first = runs[0].scenario
    lateral = any(any(r.scenario.approach.velocity[:2]) for r in runs)
    return (
        lateral
        or first.mechanism.contact.friction > 0
        or not (first.mechanism.flat or first.mechanism.captured)
    )


def _commanded_speeds(runs: Sequence[MeasuredRun]) -> list[float]:
    """The largest speed [m/s] that each run commands on any axis."""
    rates = [
        np.diff(r.record.filled("pose_cmd")[:, :3], axis=0) / r.scenario.tick
        for r in runs
        if r.record.has("pose_cmd")
    ]
    return [float(np.max(np.abs(v))) for v in rates if v.any()]
