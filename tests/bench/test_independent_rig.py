"""The second rig: its effects stay in their link. What they do there is compared with the package's
own in tests/physics.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.equipment.independent_rig import (
    EFFECTS,
    FOREIGN,
    NEEDS,
    PLAIN,
    SIZES,
    Facility,
    draw_effects,
    draw_facility,
    link_of,
    rig_of,
    silence,
    simulate,
)
from tests.slow import ALL

CHANGED = {
    "platform": {"pose_act", "wrench_meas", "wrench_comp"},
    "contact": {"wrench_meas", "wrench_comp"},
    "sensor": {"wrench_meas", "wrench_comp"},
    "compensation": {"wrench_comp"},
    "dynamics": {"pose_cmd"},
    "log": {"wrench_meas"},
}


def changed_by(facility: Facility, effects: list[dict], rng: np.random.Generator) -> set[str]:
    """Channels that the nominal links, each on what a rig with these effects recorded as its input,
    give otherwise than that rig.
    """
    rig, healthy = (rig_of(facility, 3, e, PLAIN) for e in (effects, []))
    noise = silence(rig.ticks)._replace(
        delay=rng.standard_normal(rig.ticks), repeat=rng.random(rig.ticks)
    )
    records = simulate(rig, noise)
    replayed = simulate(healthy, noise, pose_cmd=records.pose_cmd, wrench_comp=records.wrench_comp)
    floors = {"pose_cmd": 1e-9, "pose_act": 1e-9, "wrench_meas": 1e-4, "wrench_comp": 1e-3}
    return {
        c
        for c, floor in floors.items()
        if np.abs(getattr(records, c) - getattr(replayed, c)).max() > floor
    }


@pytest.mark.parametrize(
    "name", [*EFFECTS, *FOREIGN] if ALL else {link_of(n): n for n in (*FOREIGN, *EFFECTS)}.values()
)
def test_an_effect_changes_what_its_link_gives_and_nothing_else(name: str) -> None:
    rng = np.random.default_rng(11)
    facility = draw_facility(rng, frozenset({"slide"}) | NEEDS.get(name, frozenset()))
    effects = draw_effects(rng, (name,), facility)
    assert changed_by(facility, effects, rng) == CHANGED[link_of(name)]


def test_every_effect_has_a_size_and_the_touch_falls_between_ticks() -> None:
    assert set(SIZES) == set(EFFECTS)
    facility = draw_facility(np.random.default_rng(6), frozenset({"slide"}))
    for changes, speed in zip(facility.runs, facility.speeds, strict=True):
        assert 0.2 < (changes["approach.gap"] / speed * facility.scenario["rate"]) % 1.0 < 0.8
