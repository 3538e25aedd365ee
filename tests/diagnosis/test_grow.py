"""Growing an explanation cause by cause, where no one or two effects come near the noise."""

from __future__ import annotations

import numpy as np
import pytest
from hiltestbed.diagnosis.candidates import Scales, platform_candidates

from hiltestbed.diagnosis.fit import Residual, fit
from hiltestbed.diagnosis.grow import far_off, grow
from hiltestbed.diagnosis.links import LinkRun, PlatformLink
from hiltestbed.diagnosis.search import Explanation, contact_leftovers, null_fit
from hiltestbed.scenario import scenario_from

H, ROWS, NOISE = 0.01, 1500, 1e-6
TRUTH = [("platform.lag", {"bandwidth": 3.0}), ("platform.backlash", {"width": 2e-4}), ("platform.scale", {"factor": 0.9, "axis": "x"})]


def link():
    """Two runs of a platform with three effects: sweeps of 2 mm, from 0.2 Hz up, on x."""
    body = {"mass": 500.0, "inertia": [200.0, 180.0, 150.0]}
    s = scenario_from({
        "name": "grow", "duration": ROWS * H, "rate": 1 / H, "physics_rate": 4 / H, "spacecraft": {"chaser": body, "target": body},
        "approach": {"velocity": [0, 0, 0], "gap": 0.1}, "mechanism": {"contact": {"stiffness": 1e5, "damping": 0.0}},
        "rig": {"platform": {"tracking": "ideal"}},
    })  # fmt: skip
    rng, t, commands, runs = np.random.default_rng(4), (np.arange(ROWS) + 1) * H, [], []
    for fastest in (1.0, 1.6):
        command = np.zeros((ROWS, 7))
        command[:, 0] = 2e-3 * np.sin(2 * np.pi * (0.2 + 0.5 * (fastest - 0.2) * t / t[-1]) * t)
        sigma = np.full((ROWS, 3), np.inf)
        sigma[1:, 0] = NOISE
        commands.append(command)
        runs.append(LinkRun(s, np.zeros((ROWS, 3)), sigma, np.zeros(ROWS, dtype=bool)))
    out = PlatformLink(runs, commands)
    for i, run in enumerate(runs):
        run.measured = out.predict(i, TRUTH) + NOISE * rng.standard_normal((ROWS, 3))
    return out


def test_three_causes_are_found_from_one():
    residual = Residual(link())
    candidates = platform_candidates(Scales(1.0, 1e-3, 1e5, H, 1.0, 0.01, 0.02, ROWS * H, travel=4e-3), 4, {})
    lag = next(c for c in candidates if c.effect == "platform.lag")
    one = fit(residual, (lag,), lag.grid)
    before, left = (contact_leftovers(residual, effects) for effects in ((), one.effects()))
    found = Explanation(null_fit(residual), one, False, True, left, before, [one])
    assert far_off(found)
    grown = dict(grow(residual, found, candidates).effects())
    assert sorted(grown) == sorted(kind for kind, _ in TRUTH)
    assert grown["platform.lag"]["bandwidth"] == pytest.approx(3.0, rel=2e-3)
    assert grown["platform.backlash"]["width"] == pytest.approx(2e-4, rel=5e-3)
    assert grown["platform.scale"]["factor"] == pytest.approx(0.9, rel=1e-3)
