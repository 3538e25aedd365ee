"""Channels stamped parts of a row off, and instants within a tick, are no departures; what departs
is found beside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed.config.yaml_source import dump_yaml, read_source
from hiltestbed.diagnosis import stamps, timing
from hiltestbed.diagnosis.adequacy import judge_of_compensation
from hiltestbed.diagnosis.certainty import certainty
from hiltestbed.diagnosis.find import Judged, judge
from hiltestbed.diagnosis.fit import Fit, fit, null_fit
from hiltestbed.diagnosis.floors import smooth_levels
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.links import CompensationLink, DynamicsLink, Timing
from hiltestbed.diagnosis.links.base import ModelLink, moved
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import COMPENSATION_FLOOR, CORRELATED_ROWS
from hiltestbed.effects import EFFECTS
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.measured import load_dataset
from hiltestbed.scenario import Scenario, scenario_from
from tests.equipment.independent_rig import Nuisances, draw_set, write_set
from tests.slow import SLOW, slow

from .made import H, contact_link, effect, link_run, platform_link, scenario
from .test_verdict import candidates


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


@pytest.mark.parametrize(
    ("channel", "rows", "seed", "links"),
    [
        slow("pose_cmd", 1.0, 810014, {"platform": -1.0}),
        ("wrench_comp", -0.4, 810005, {"compensation": -0.4, "dynamics": 0.4}),
    ],
)
def test_a_channel_that_is_stamped_rows_off_is_no_departure(
    tmp_path: Path, channel: str, rows: float, seed: int, links: dict[str, float]
) -> None:
    found, _ = judged(tmp_path, seed, Nuisances(stamps={channel: rows}))
    assert found.verdict.verdict == "no_discrepancy"
    for link, expected in links.items():
        assert timing.output_shift_rows(found.findings.explanations[link]) == pytest.approx(
            expected, abs=0.03
        )
    assert timing.clock_offsets(found.findings.explanations)


@SLOW
def test_instants_within_a_tick_and_a_stamp_of_the_encoder_are_no_departures(
    tmp_path: Path,
) -> None:
    found, _ = judged(tmp_path, 810016, Nuisances(read=0.3, move=0.2, encoder=0.4, step=0.25))
    assert found.verdict.verdict == "no_discrepancy"
    assert timing.output_shift_rows(found.findings.explanations["dynamics"]) == pytest.approx(
        0.25, abs=0.01
    )


def test_a_late_sensor_is_found_on_the_path_as_it_was_measured(tmp_path: Path) -> None:
    """The command stands half a row late in the record: half a row of the path would be taken off
    the sensor's delay.
    """
    found, hidden = judged(
        tmp_path, 810020, Nuisances(stamps={"pose_cmd": 0.5}), "sensor.delay", every=3
    )
    assert [c.effect for c in found.verdict.causes] == ["sensor.delay"]
    cause, tick = found.verdict.causes[0], found.findings.layout.runs[0].scenario.tick
    assert cause.fit.effects()[cause.index].parameters()["delay"] == pytest.approx(
        hidden["delay"], abs=0.05 * tick
    )


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
    assert cause.fit.effects()[cause.index].parameters()["factor"] == pytest.approx(
        hidden["factor"], abs=0.2 * worth
    )
    assert timing.output_shift_rows(found.findings.explanations["wrench"]) == pytest.approx(
        -0.1, abs=0.02
    )


def test_what_is_made_of_readings_between_rows_lies_between_its_own_rows() -> None:
    """A linear compensation of ``(1 - p) w_k + p w_(k+1)`` gives ``(1 - p) u_k + p u_(k+1)``, noise
    and all.
    """
    s, noise = phase_lead(), np.random.default_rng(1).normal(0, 0.5, (300, 6))
    given = CompensationLink([link_run(s, 300)], [noise], {}).shown(0)
    link = CompensationLink([link_run(s, given)], [moved(noise, -0.3)], {})
    left = [
        np.abs(link.runs[0].measured - at.shown(0))[20:-20].max()
        for at in (link, link.with_timing(Timing(before=0.3 * H)))
    ]
    assert left[0] > 1.0
    assert left[1] < 1e-9


def phase_lead() -> Scenario:
    method = {"force": {"kind": "phase_lead"}, "motion": {"kind": "none"}}
    return scenario_from(scenario().model_dump(mode="json") | {"compensation": method})


def stamped_compensation(output: float, given: float, seed: int = 1) -> CompensationLink:
    """A phase lead on noise and a bump, with its output and its input stamped so many rows late,
    both interpolated between rows.
    """
    s, readings = phase_lead(), np.random.default_rng(seed).normal(0, 0.5, (2000, 6))
    readings[150:250, 2] += 40.0 * np.sin(np.pi * np.arange(100) / 100)
    touching = np.zeros(2000, dtype=bool)
    touching[150:250] = True
    made = CompensationLink([link_run(s, 2000)], [readings], {}).shown(0)
    sigma = COMPENSATION_FLOOR * 0.5 * math.sqrt(CORRELATED_ROWS)  # as laid out
    run = link_run(s, moved(made, output), sigma, touching)
    return CompensationLink([run], [moved(readings, given)], {})


def exactly(link: CompensationLink) -> Timing | None:
    noise = {name.replace("comp", "meas"): 0.5 for name in link.channels}
    found = stamps.exactly_stamped(Residual(link), Search((), judge_of_compensation(link, noise)))
    return found and found.link.timing


@pytest.mark.parametrize(
    ("output", "given"),
    [(0.05, 0.44), (-0.77, 0.0), (0.3, -0.6), (-0.03, 0.98), (0.0, 0.4), (1.0, -0.345)],
)
def test_a_linear_compensation_shows_both_stamps(output: float, given: float) -> None:
    found = exactly(stamped_compensation(output, given))
    assert found is not None
    assert found.delay == pytest.approx(output * H, abs=0.02 * H)
    assert found.before == pytest.approx(-given * H, abs=0.02 * H)


@pytest.mark.parametrize(("output", "given"), [(1.0, 0.0), (0.0, 1.0), (0.0, 1.6)])
def test_whole_rows_and_an_input_later_than_a_row_are_left_to_others(
    output: float, given: float
) -> None:
    assert exactly(stamped_compensation(output, given)) is None


def test_readings_taken_again_between_two_rows_follow_from_no_stamp() -> None:
    link = stamped_compensation(-0.4, 0.0)
    other = stamped_compensation(-0.4, 0.0, seed=2)  # another noise
    assert exactly(CompensationLink(link.runs, other.wrenches, {})) is None


def test_an_old_twist_in_the_new_pose_lies_between_both_integrators() -> None:
    wrench = np.zeros((200, 6))
    wrench[50:100] = [3.0, -2.0, 40.0, 0.5, 1.0, -0.3]
    link = DynamicsLink([link_run(scenario(), 200)], [wrench])
    implicit, explicit = (
        link.shown(0),
        link.shown(0, [EFFECTS["dynamics.integrator"].hypothesis({}, scheme="explicit_euler")]),
    )
    np.testing.assert_array_equal(link.with_timing(Timing(old=1.0)).shown(0), explicit)
    between = link.with_timing(Timing(old=0.25)).shown(0)
    np.testing.assert_allclose(between, 0.75 * implicit + 0.25 * explicit, rtol=0, atol=1e-9)


def test_a_late_output_and_a_late_input_of_the_numerical_model_differ_by_the_approach() -> None:
    link = DynamicsLink([link_run(scenario(), 100)], [np.zeros((100, 6))])
    timings = (Timing(), Timing(delay=0.4 * H), Timing(before=0.4 * H))
    prompt, late, before = (link.with_timing(at).shown(0)[:, 2] for at in timings)
    np.testing.assert_allclose(prompt - late, 0.03 * 0.4 * H, rtol=1e-6)
    np.testing.assert_array_equal(before, prompt)


@pytest.mark.parametrize("rows", [0, 1, -1])
def test_the_numerical_model_shows_whole_rows_that_the_compensation_does_not(rows: int) -> None:
    wrench = 0.5 * np.random.default_rng(4).standard_normal((400, 6))
    wrench[150:250, 2] += 40.0
    shown = DynamicsLink([link_run(scenario(), 400)], [wrench]).shown(0)
    run = link_run(scenario(), shown, 1e-12)
    link = DynamicsLink([run], [moved(wrench, float(rows))])
    choices = stamps.rows_in_common({"wrench_meas": 0.0, "wrench_comp": 0.0}, H)
    assert choices == [0, 1, -1]
    links = [link.stamped(before=-n * H).with_unknown_start(np.ones(6)) for n in choices]
    assert choices[stamps.least_left(links)] == rows


def test_channels_have_no_row_in_common_beyond_what_one_may_be_off() -> None:
    assert stamps.rows_in_common({"wrench_meas": -0.3 * H, "wrench_comp": 0.0}, H) == [0, 1]
    assert stamps.rows_in_common({"wrench_meas": 1.03 * H, "wrench_comp": -0.5 * H}, H) == [0]


def explained(
    link: ModelLink, *effects: tuple[str, dict[str, Any]], adequate: bool = True
) -> Explanation:
    """An explanation with these causes."""
    causes = tuple(
        Candidate(EFFECTS[kind], (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), given)
        for kind, given in effects
    )
    null = null_fit(Residual(link))
    chosen = Fit(causes, np.zeros(0), null.chi2, null.residual, null.jacobian)
    return Explanation(Residual(link), (), null, chosen, adequate, bool(effects), {}, {})


def test_a_stamp_and_the_instants_of_encoder_and_platform_are_told_from_a_mode() -> None:
    """A row and 0.22 of a row late, and 0.4 of a tick: more than one instant can be."""
    hidden = effect("platform.mode", frequency=9.3, damping_ratio=0.1)
    link = platform_link([hidden, Timing(delay=1.22 * H, obeyed=0.4 * H)])
    scales = Scales(force=300.0, depth=3e-3, stiffness=1e5, tick=H, noise=0.1, slow=0.03, fast=0.06)
    kinds = ("platform.mode", "platform.scale", "platform.backlash")
    searched = tuple(c for kind in kinds for c in EFFECTS[kind].candidates(scales))
    found = timing.explain_with_timing(Residual(link), Search(searched))
    assert found.adequate
    assert found.chosen.kinds == ("platform.mode",)
    assert list(found.chosen.theta[:2]) == pytest.approx([9.3, 0.1], rel=0.01)


def test_a_part_of_a_tick_is_a_cause_alone_and_none_beside_others() -> None:
    late = ("platform.delay", {"delay": 0.6 * H})
    contact = contact_link(seed=None)
    alone = {"platform": explained(platform_link(), late), "wrench": explained(contact)}
    assert timing.delays_not_causes(alone) == {}
    beside = alone | {"wrench": explained(contact, ("contact.stiffness", {"factor": 0.8}))}
    assert timing.delays_not_causes(beside) == {"platform": {"platform.delay": pytest.approx(0.6)}}
    assert "platform.delay" in timing.clock_offsets(beside)[0].sentence()


def test_whole_ticks_are_causes_unless_another_link_takes_them_back() -> None:
    def found(rows: float, platform: float) -> dict[str, dict[str, float]]:
        dynamics = DynamicsLink([platform_link().runs[0]], [np.zeros((500, 6))])
        return timing.delays_not_causes({
            "platform": explained(platform_link().with_timing(Timing(delay=platform * H))),
            "wrench": explained(contact_link(seed=None), ("contact.stiffness", {"factor": 0.8})),
            "dynamics": explained(dynamics, ("dynamics.step_delay", {"ticks": int(rows)})),
        })  # fmt: skip

    assert found(1, 0.0) == {}
    assert found(1, -1.0) == {"dynamics": {"dynamics.step_delay": 1.0}}
    assert found(2, -1.0) == {}


def test_a_whole_tick_is_a_stamp_where_the_platform_is_early() -> None:
    """A platform cannot be early: its command is stamped a row late, of which its own instants take
    back a part.
    """
    found = {
        "platform": explained(platform_link().with_timing(Timing(delay=-0.4 * H))),
        "wrench": explained(contact_link(seed=None), ("contact.stiffness", {"factor": 0.8})),
        "dynamics": explained(
            DynamicsLink([platform_link().runs[0]], [np.zeros((500, 6))]),
            ("dynamics.step_delay", {"ticks": 1}),
        ),
    }
    assert timing.delays_not_causes(found) == {"dynamics": {"dynamics.step_delay": 1.0}}


@pytest.mark.parametrize(("rows", "cause"), [(0.4, False), (3.0, True)])
def test_what_cannot_be_told_from_a_part_of_a_tick_is_no_cause(rows: float, cause: bool) -> None:
    lag = explained(platform_link(), ("platform.lag", {"bandwidth": 90.0}))
    delay = explained(platform_link(), ("platform.delay", {"delay": rows * H})).chosen
    contact = explained(contact_link(seed=None), ("contact.stiffness", {"factor": 0.8}))
    found = timing.delays_not_causes(
        {"platform": replace(lag, rivals=((delay,),)), "wrench": contact}
    )
    assert found == ({} if cause else {"platform": {"platform.lag": pytest.approx(rows)}})


def test_a_delay_counts_beyond_what_stamps_take_back_around_the_loop() -> None:
    """The command is stamped a row early: the platform is late by that, and by the parts of a tick
    that need no fault.
    """

    def found(delay: float, stamped: float) -> bool:
        dynamics = DynamicsLink([platform_link().runs[0]], [np.zeros((500, 6))]).with_timing(
            Timing(delay=-stamped * H)
        )
        late = ("platform.delay", {"delay": delay * H})
        both = {"platform": explained(platform_link(), late), "dynamics": explained(dynamics)}
        return (
            timing.delays_not_causes(
                both
                | {
                    "wrench": explained(
                        contact_link(seed=None), ("contact.stiffness", {"factor": 0.8})
                    )
                }
            )
            == {}
        )

    assert not found(1.45, 1.0)
    assert found(1.45, 0.0)
    assert found(2.45, 1.0)


def test_stamps_that_links_without_noise_show_are_those_of_the_next() -> None:
    link = stamped_compensation(0.05, 0.44).with_timing(Timing(delay=0.05 * H, before=-0.44 * H))
    dynamics = DynamicsLink([platform_link().runs[0]], [np.zeros((500, 6))]).with_timing(
        Timing(delay=-0.3 * H, before=-0.05 * H)
    )
    found = {"compensation": explained(link), "dynamics": explained(dynamics)}
    assert stamps.stamps_known(found) == pytest.approx(
        {"wrench_meas": 0.44 * H, "wrench_comp": 0.05 * H, "pose_cmd": -0.3 * H}
    )
    assert stamps.stamps_known({"dynamics": explained(dynamics, adequate=False)}) == {}


def test_a_delay_is_known_to_a_row_where_stamps_are_off() -> None:
    contact = explained(contact_link(seed=None), ("contact.stiffness", {"factor": 0.8}))
    platform = {
        shift: explained(platform_link().with_timing(Timing(delay=shift * H)))
        for shift in (0.0, 0.4)
    }
    assert timing.instants_off({"wrench": contact, "platform": platform[0.0]}) == 0.0
    assert (
        timing.instants_off({"wrench": contact, "platform": platform[0.4]})
        == timing.MAX_UNNAMED_DELAY_ROWS * H
    )
    residual = Residual(contact_link([effect("sensor.delay", delay=3.0 * H)]))
    late = candidates("sensor.delay")[0]
    found = fit(residual, (late,), late.grid)
    known, less = (certainty("wrench", residual, found, off=off).ends for off in (0.0, 1.05 * H))
    np.testing.assert_allclose(less - known, [[-1.05 * H, 1.05 * H]], rtol=1e-9)


def test_a_whole_tick_of_delay_stays_a_cause_beside_others() -> None:
    found = {
        "platform": explained(platform_link(), ("platform.delay", {"delay": 2.0 * H})),
        "wrench": explained(contact_link(seed=None), ("contact.stiffness", {"factor": 0.8})),
    }
    assert timing.delays_not_causes(found) == {}


@pytest.mark.parametrize(("seed", "latched"), [(810008, False), (810066, True)])
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


@pytest.mark.parametrize(("rows", "stamp"), [(3.05, False), (0.6, True)])
def test_a_shift_that_would_have_to_be_larger_than_the_largest_is_none(
    rows: float, stamp: bool
) -> None:
    """Beside a scale, the platform is late by three rows, which no stamp is; or by part of one."""
    residual = Residual(
        platform_link(
            [
                effect("platform.scale", factor=1.05, axis="z"),
                effect("platform.delay", delay=rows * H),
            ]
        )
    )
    scale = candidates("platform.scale")[0]
    there = timing.timing_under(residual, fit(residual, (scale,), scale.grid))
    assert (there is not residual) is stamp


@pytest.mark.parametrize(
    ("rows", "old", "within"), [(1.0, 0.3, True), (1.0, 1.0, True), (2.25, 0.3, False)]
)
def test_stamps_at_the_ends_of_their_search_are_none(rows: float, old: float, within: bool) -> None:
    """Output and input as late as each other lie as far apart as with no stamps off; all of an old
    twist is explicit Euler, and no end.
    """
    link = contact_link(seed=None)
    shift = timing.shift_candidate(
        link, {"delay": timing.EITHER, "before": timing.EITHER, "old": timing.OLD_TWIST_RANGE}
    )
    fitted = replace(
        null_fit(Residual(link)), causes=(shift,), theta=np.array([rows * H, -rows * H, old])
    )
    assert timing.within_range(link, fitted) is within
