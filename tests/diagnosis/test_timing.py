"""Channels stamped parts of a row off, and instants within a tick, are no departures; what departs
is found beside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace as Fake
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from hiltestbed.config.yaml_source import dump_yaml, read_source
from hiltestbed.diagnosis import timing
from hiltestbed.diagnosis.explain import explain
from hiltestbed.diagnosis.find import Judged, judge
from hiltestbed.diagnosis.floors import smooth_levels
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.link_model import (
    INSTANT_SIGMA,
    SHIFT_SIGMA,
    TIME_ERROR,
    LinkModel,
)
from hiltestbed.diagnosis.links import DynamicsLink, Timing
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.measured import load_dataset
from tests.equipment.independent_rig import Nuisances, draw_set, write_set
from tests.slow import SLOW, slow

from .made import H, candidates, effect, link_run, platform_link, scenario
from .made import explained as explained_link


def judged(
    folder: Path, seed: int, nuisances: Nuisances, *hidden: str, every: int = 1
) -> tuple[Judged, Mapping[str, Any]]:
    """The judgement on a set of the independent rig, or on one run of so many in it, and what was
    hidden.
    """
    options: dict[str, Any] = {"names": hidden} if hidden else {}
    made = draw_set(
        np.random.default_rng(seed),
        "single" if hidden else "healthy",
        nuisances=nuisances,
        **options,
    )
    write_set(folder, made)
    dataset = read_source(folder / "dataset.yaml").data
    (folder / "dataset.yaml").write_text(dump_yaml(dataset | {"runs": dataset["runs"][::every]}))
    return judge(investigate(load_dataset(folder / "dataset.yaml"))), made.effects[
        0
    ] if hidden else {}


@SLOW
@pytest.mark.parametrize(
    ("channel", "rows", "seed", "links"),
    [
        ("pose_cmd", 1.0, 810014, {"platform": -1.0}),
        ("wrench_comp", -0.4, 810005, {"compensation": -0.4, "dynamics": 0.4}),
    ],
)
def test_a_channel_that_is_stamped_rows_off_is_no_departure(
    tmp_path: Path, channel: str, rows: float, seed: int, links: dict[str, float]
) -> None:
    found, _ = judged(tmp_path, seed, Nuisances(stamps={channel: rows}))
    assert found.verdict.verdict == "no_discrepancy"
    for link, expected in links.items():
        assert timing.shift_rows(found.findings.explanations[link]) == pytest.approx(
            expected, abs=0.03
        )
    assert timing.clock_offsets(found.findings.explanations)


@SLOW
def test_instants_within_a_tick_and_a_stamp_of_the_encoder_are_no_departures(
    tmp_path: Path,
) -> None:
    found, _ = judged(tmp_path, 810016, Nuisances(read=0.3, move=0.2, encoder=0.4, step=0.25))
    assert found.verdict.verdict == "no_discrepancy"
    assert timing.shift_rows(found.findings.explanations["dynamics"]) == pytest.approx(
        0.25, abs=0.01
    )


@SLOW
def test_a_late_sensor_is_found_on_the_path_as_it_was_measured(tmp_path: Path) -> None:
    """The command stands half a row late in the record: half a row of the path would be taken off
    the sensor's delay.
    """
    found, hidden = judged(
        tmp_path, 810020, Nuisances(stamps={"pose_cmd": 0.5}), "sensor.delay", every=3
    )
    assert [c.effect for c in found.verdict.causes] == ["sensor.delay"]
    cause, tick = found.verdict.causes[0], found.findings.layout.runs[0].scenario.tick
    assert cause.fitted.parameters()["delay"] == pytest.approx(hidden["delay"], abs=0.05 * tick)


@SLOW
def test_a_cause_is_named_beside_instants_and_stamps_that_are_off(tmp_path: Path) -> None:
    """0.3 rows of the encoder less 0.2 of the sensor are worth a damping of k times that time, and
    are fitted beside it.
    """
    nuisances = Nuisances(read=0.2, encoder=0.3, step=0.3, stamps={"wrench_comp": -0.4})
    found, hidden = judged(tmp_path, 810009, nuisances, "contact.damping", every=2)
    assert [c.effect for c in found.verdict.causes] == ["contact.damping"]
    cause, believed = found.verdict.causes[0], found.findings.layout.runs[0].scenario
    contact = believed.mechanism.contact
    worth = contact.stiffness * 0.1 * believed.tick / contact.damping
    assert cause.fitted.parameters()["factor"] == pytest.approx(hidden["factor"], abs=0.2 * worth)
    assert timing.shift_rows(found.findings.explanations["wrench"]) == pytest.approx(-0.1, abs=0.02)


def explained(*effects: tuple[str, dict[str, Any]], shift: Timing = NO_SHIFT) -> Any:
    """An explanation with these causes, under the timing ``shift``."""
    return Fake(
        departs=bool(effects),
        adequate=True,
        kinds=tuple(kind for kind, _ in effects),
        timing=lambda: shift,
        stamp_error=lambda: 0.0,
        link=Fake(tick=H, runs=[Fake(scenario=scenario())]),
    )


def test_a_stamp_and_the_instants_of_encoder_and_platform_are_told_from_a_mode() -> None:
    """A row and 0.22 of a row late, and 0.4 of a tick: more than one instant can be."""
    hidden = effect("platform.mode", frequency=9.3, damping_ratio=0.1)
    link = platform_link([hidden, Timing(delay=1.22 * H, obeyed=0.4 * H)])
    found = explained_link(link, "platform.mode", "platform.scale", "platform.backlash")
    assert found.adequate
    assert found.kinds == ("platform.mode",)
    values = {e.name: e.value for e in found.causes[0].estimates}
    assert [values["frequency"], values["damping_ratio"]] == pytest.approx([9.3, 0.1], rel=0.01)


def loop(**shifts: float) -> dict[str, Any]:
    """Explanations of all links, those named late by so many rows."""
    given = {n: Timing(delay=shifts.get(n, 0.0) * H) for n in timing.LINK_CHANNELS}
    return {name: explained(shift=shift) for name, shift in given.items()}


def test_stamps_cancel_around_the_loop() -> None:
    """What the other links are late in sum, the last one is early, but for the instants at which
    the facility reads and obeys; old twists are no stamps.
    """
    found = loop(platform=0.57, compensation=0.07, dynamics=0.61)
    found["dynamics"] = explained(shift=Timing(delay=0.61 * H, old=0.3))
    mean, sigma = timing.clocks_of("wrench", found)
    assert mean == pytest.approx(-1.25)
    assert sigma == pytest.approx(math.sqrt(2.0) * INSTANT_SIGMA)


def test_where_all_other_clocks_are_exact_the_last_one_is() -> None:
    assert timing.clocks_of("wrench", loop()) == (0.0, 0.0)


def test_of_a_link_alone_a_stamp_is_known_to_what_loggers_do() -> None:
    assert timing.clocks_of("wrench", {"wrench": explained()}) == pytest.approx((0.0, SHIFT_SIGMA))


def test_a_link_with_a_delay_tells_nothing_of_stamps() -> None:
    found = loop(platform=1.0)
    found["dynamics"] = explained(("dynamics.step_delay", {"ticks": 1}))
    mean, sigma = timing.clocks_of("wrench", found)
    assert mean == 0.0
    # a scatter of sqrt(0.5) rows by two shifts, with Student's 95 % interval: wider than any prior
    assert student.ppf(0.975, 2) / norm.ppf(0.975) * math.sqrt(0.5) > timing.SHIFT_SIGMA
    assert sigma == timing.SHIFT_SIGMA


@pytest.mark.parametrize(
    ("shifts", "causes", "again"),
    [
        ({"dynamics": 1.0}, {}, True),
        # within a tick a facility may obey when it likes
        ({"dynamics": 0.4}, {}, False),
        # wrench_comp is stamped a row early
        ({"dynamics": 1.0, "compensation": -1.0}, {}, False),
        ({}, {"dynamics": ("dynamics.step_delay", {"ticks": 1})}, True),
    ],
)
def test_an_offset_that_the_other_links_do_not_share_is_a_delay(
    shifts: dict[str, float], causes: dict[str, tuple[str, dict[str, Any]]], again: bool
) -> None:
    """A channel that is stamped off is the output of one link and the input of the next."""
    found = loop(**shifts) | {name: explained(cause) for name, cause in causes.items()}
    assert ("dynamics" in timing.judged_again(found)) == again


@pytest.mark.parametrize("late", [0, 1])
def test_a_tick_of_delay_is_one_where_the_channels_are_known_to_be_stamped_right(late: int) -> None:
    """Alone, a numerical model's own tick and a stamp of its output are the same record."""
    rng, runs, wrenches = np.random.default_rng(3), [], []
    hidden = [effect("dynamics.step_delay", ticks=1)] * late
    for _ in range(2):
        wrenches.append(rng.normal(0.0, [30.0, 20.0, 200.0, 5.0, 8.0, 3.0], (400, 6)))
        made = DynamicsLink([link_run(scenario(), 400)], wrenches[-1:])
        shown = made.shown(0, hidden)
        runs.append(link_run(scenario(), shown + rng.normal(0.0, 1e-9, shown.shape), 1e-9))
    model = LinkModel(DynamicsLink(runs, wrenches))
    causes = candidates("dynamics.step_delay", "dynamics.mass")
    alone, beside = explain(model, causes), explain(model.clocked(0.0, TIME_ERROR), causes)
    assert alone.kinds == ()
    assert timing.shift_rows(alone) == pytest.approx(late, abs=0.01)
    assert beside.kinds == ("dynamics.step_delay",) * late
    assert timing.shift_rows(beside) == pytest.approx(0.0, abs=0.01)
    assert alone.adequate
    assert beside.adequate


@pytest.mark.parametrize(("seed", "latched"), [(810008, False), slow(810066, True)])
def test_the_noise_of_poses_between_two_samples_is_judged_by_that_of_the_samples(
    tmp_path: Path, seed: int, latched: bool
) -> None:
    levels = {}
    for rows in (0.0, 0.4):
        nuisances = Nuisances(stamps={"pose_act": rows} if rows else {})
        made = draw_set(np.random.default_rng(seed), "healthy", nuisances=nuisances)
        write_set(tmp_path / str(rows), made)
        levels[rows] = smooth_levels(load_dataset(tmp_path / str(rows) / "dataset.yaml").runs)
    assert made.facility.scenario["mechanism"]["kind"] == ("latched" if latched else "bumper")
    assert levels[0.0] == {}
    for name in ("pose_act.px", "pose_act.py", "pose_act.pz"):
        assert levels[0.4][name] == pytest.approx(made.facility.pose_noise, rel=0.15)
