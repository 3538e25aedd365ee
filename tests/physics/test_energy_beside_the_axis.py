"""What the rig makes is what the vehicles gain, wherever they touch."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.loop import Loop


def kinetic(loop: Loop) -> float:
    """[J] of both vehicles of the only run."""
    craft, total = loop.model, 0.0
    for b in range(2):
        v = craft.v[0, b]
        total += 0.5 * craft.mass[0, b] * float(v[:3] @ v[:3]) + 0.5 * float(
            v[3:] @ craft.inertia[0, b] @ v[3:]
        )
    return total


@pytest.mark.parametrize(("offset", "gap"), [((0.06, -0.02), 0.07), ((0.15, 0.0), 0.16)])
def test_a_contact_that_takes_nothing_leaves_the_vehicles_what_the_rig_made(offset, gap) -> None:
    """A spring without damper and friction gives all back: the energy of the rig is the change of
    both vehicles' kinetic energy.
    """
    keys = {
        "approach": {
            "gap": gap,
            "offset": list(offset),
            "velocity": [0.0, 0.0, 0.08],
            "attitude_deg": [1.0, 0.0, 0.0],
        },
        "mechanism": {"kind": "probe_cone", "contact": {"stiffness": 5.0e4}},
        "sensor": {"delay": 0.006},
        "duration": 1.2,
        "compensation.force.kind": "none",
        "identification.kind": "none",
    }
    s = load_scenario("09-docking", keys)
    loop = Loop([s])
    before, apart = kinetic(loop), 0
    while loop.k < s.ticks and apart < 40:
        loop.step(None)
        apart = apart + 1 if loop.tally.contacts[0] and not loop.plant.contact[0] else 0
    gained = kinetic(loop) - before
    assert apart == 40
    assert gained > 0.1
    assert loop.tally.energy[0] == pytest.approx(gained, rel=1e-3)
    assert np.isfinite(loop.tally.figures(0).cor_normal or np.nan)
