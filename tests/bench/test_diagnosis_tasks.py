"""Which sets the benchmark of the diagnosis draws, and what it makes of their records."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from hiltestbed.bench.diagnosis import FULL, Task, docking_tasks, noise_tasks, summarise, tasks
from hiltestbed.bench.diagnosis_report import diagnosis_report
from hiltestbed.bench.independent_rig import NOISE_KINDS, acting_in
from hiltestbed.bench.reliability import reliability, wilson
from hiltestbed.cli import main


def record(task: Task, verdict: str, right: bool) -> dict[str, Any]:
    return {
        "seed": task.seed, "kind": task.kind, "design": task.design, "scale": 1.0, "hidden": [{"kind": n} for n in task.names or ()],
        "noise": list(task.noise) if task.noise else None, "strengths": [5.0], "verdict": verdict, "link": None, "right": right,
        "intervals_held": 0, "intervals": 0, "causes": [], "alarm": {"taken_off": 1.0, "excess": 0.5}, "cpu": 3.0, "gain": None,
        "gain_true": None,
    }  # fmt: skip


def test_every_effect_that_acts_in_a_docking_comes_up_in_a_design_in_which_it_acts() -> None:
    drawn = docking_tasks({"single": 200})
    assert set(Counter(t.design for t in drawn)) == {"docking", "mounted", "held"}
    for t in drawn:
        assert t.names is not None
        assert t.names[0] in acting_in(t.design)  # type: ignore[arg-type]
    everything = [*drawn, *tasks(FULL, False), *noise_tasks(60)]
    assert len({t.seed for t in everything}) == len(everything)


def test_every_kind_of_noise_is_tried_at_each_of_its_strengths() -> None:
    drawn = Counter(t.noise for t in noise_tasks(3))
    assert set(drawn) == {(name, s) for name, kind in NOISE_KINDS.items() for s in kind.strengths}
    assert set(drawn.values()) == {3}


def test_bumpers_dockings_and_noises_are_counted_apart() -> None:
    bumper = [Task(1, "healthy"), Task(2, "single", ("sensor.delay",))]
    docking, noise = Task(3, "single", ("sensor.gain",), design="docking"), Task(4, "healthy", noise=("pink", 1.0))
    summary = summarise(
        [
            record(bumper[0], "no_discrepancy", True), record(bumper[1], "named", True), record(docking, "unknown", False),
            record(noise, "unknown", False),
        ]
    )  # fmt: skip
    assert (summary["named_rate"], summary["docking_named_rate"], summary["false_alarm_rate"]) == (1.0, 0.0, 0.0)
    assert summary["noise_alarms"] == {"pink 1": "1 of 1"}
    assert summary["confusion"] == {"sensor.delay": {"": 1}, "sensor.gain": {"unknown": 1}}
    assert diagnosis_report([], summary) is not None


def test_false_names_are_counted_in_part_and_for_what_no_name_is_right() -> None:
    def said(task: Task, verdict: str, *names: str) -> dict[str, Any]:
        causes = [{"effect": name, "indistinguishable_from": [], "probability": 1.0} for name in names]
        return record(task, verdict, False) | {"causes": causes}

    in_part = said(Task(1, "single", ("sensor.delay",)), "named_in_part", "sensor.delay", "sensor.gain")
    foreign = [Task(s, "foreign", ("unknown.play",)) for s in (2, 3, 4)]
    summary = summarise(
        [in_part, said(foreign[0], "named_in_part", "sensor.lag"), said(foreign[1], "unknown"), said(foreign[2], "unknown")]
    )
    assert summary["named_in_part_wrong_rate"] == pytest.approx(2 / 3)
    assert summary["foreign_named_rate"] == pytest.approx(1 / 3)
    assert summarise([said(foreign[0], "unknown")])["named_in_part_wrong_rate"] is None


def test_stated_probabilities_are_counted_against_what_was_hidden() -> None:
    def said(name: str, probability: float) -> dict[str, Any]:
        found = record(Task(1, "single", ("sensor.delay",)), "named", True)
        return found | {"causes": [{"effect": name, "indistinguishable_from": [], "probability": probability}]}

    rows = reliability([said("sensor.delay", 1.0)] * 3 + [said("sensor.gain", 0.999), said("sensor.delay", 0.6)])
    assert [(r["low"], r["right"], r["causes"]) for r in rows] == [(0.5, 1, 1), (0.99, 3, 4)]
    low, high = wilson(6, 6)
    assert (low, high) == (pytest.approx(6.0 / (6.0 + 1.96**2), rel=1e-3), pytest.approx(1.0))


def test_options_of_another_benchmark_are_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["hiltestbed", "bench", "cor", "--noise"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "bench diagnosis alone" in capsys.readouterr().err
