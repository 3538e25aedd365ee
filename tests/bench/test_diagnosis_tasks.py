"""Which sets the benchmark of the diagnosis draws, and what it makes of their records."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hiltestbed
from hiltestbed.cli import main
from tests.equipment.diagnosis import run as bench
from tests.equipment.diagnosis.report import diagnosis_report
from tests.equipment.diagnosis.run import diagnosis
from tests.equipment.diagnosis.summary import groups, reliability, summarise
from tests.equipment.diagnosis.tasks import (
    COMPUTING_FULL,
    FULL,
    NOISE_FULL,
    Task,
    computing_tasks,
    docking_tasks,
    noise_tasks,
    tasks,
)
from tests.equipment.independent_rig import NOISE_KINDS, Nuisances, acting_in, alike


def record(task: Task, verdict: str, right: bool) -> dict[str, Any]:
    same = "seed", "kind", "design", "scale", "computing", "noise"
    return {
        **{name: getattr(task, name) for name in same},
        **{"verdict": verdict, "right": right, "causes": [], "strengths": [5.0], "cpu": 3.0},
        "hidden": [{"kind": n} for n in task.names or ()],
        **{"link": None, "intervals_held": 0, "intervals": 0, "gain": None, "gain_true": None},
    }


def cause(name: str, probability: float = 1.0) -> dict[str, Any]:
    return {"effect": name, "indistinguishable_from": [], "probability": probability}


def test_every_effect_that_acts_in_a_docking_comes_up_in_a_design_in_which_it_acts() -> None:
    drawn = docking_tasks({"single": 200})
    assert set(Counter(t.design for t in drawn)) == {"docking", "mounted", "held"}
    for t in drawn:
        assert t.names[0] in acting_in(t.design)  # type: ignore[arg-type]
    everything = [
        *drawn,
        *tasks(FULL, True),
        *noise_tasks(NOISE_FULL),
        *computing_tasks(COMPUTING_FULL),
    ]
    assert len({(t.seed, t.scale) for t in everything}) == len(everything)


def test_every_kind_of_noise_is_tried_at_each_of_its_strengths() -> None:
    drawn = Counter(t.noise for t in noise_tasks({"healthy": 3}))
    assert set(drawn) == {(name, s) for name, kind in NOISE_KINDS.items() for s in kind.strengths}
    assert set(drawn.values()) == {3}


def test_bumpers_dockings_and_noises_are_counted_apart() -> None:
    bumper = [Task(1, "healthy"), Task(2, "single", ("sensor.delay",))]
    docking, noise = (
        Task(3, "single", ("sensor.gain",), design="docking"),
        Task(4, "healthy", noise=("pink", 1.0)),
    )
    named = [record(bumper[0], "no_discrepancy", True), record(bumper[1], "named", True)]
    summary = summarise(
        [*named, record(docking, "unknown", False), record(noise, "unknown", False)]
    )
    assert (summary["named_rate"], summary["false_alarm_rate"]) == (1.0, 0.0)
    rates = {(g["rig"], g["kind"]): (g["right"], g["sets"]) for g in summary["groups"]}
    assert rates["docking", "single"] == rates["pink 1", "healthy"] == (0, 1)
    assert summary["confusion"] == {"sensor.delay": {"": 1}, "sensor.gain": {"unknown": 1}}
    assert diagnosis_report([], summary | {"planned": 4, "done": 4}) is not None


def test_names_that_were_not_hidden_are_counted() -> None:
    single, foreign = Task(1, "single", ("sensor.delay",)), Task(2, "foreign", ("unknown.play",))
    said = {
        single: ("named_in_part", "sensor.delay", "sensor.gain"),
        replace(single, seed=3): ("named", "sensor.delay"),
        foreign: ("named_in_part", "sensor.lag"),
        replace(foreign, seed=4): ("unknown",),
    }
    records = [
        record(task, verdict, False) | {"causes": [cause(name) for name in names]}
        for task, (verdict, *names) in said.items()
    ]
    assert [g["misnamed"] for g in groups(records)] == [1, 1]


def test_stated_probabilities_are_counted_against_what_was_hidden() -> None:
    def said(name: str, probability: float) -> dict[str, Any]:
        found = record(Task(1, "single", ("sensor.delay",)), "named", True)
        return found | {"causes": [cause(name, probability)]}

    rows = reliability(
        [said("sensor.delay", 1.0)] * 3 + [said("sensor.gain", 0.999), said("sensor.delay", 0.6)]
    )
    assert [(r["low"], r["right"], r["causes"]) for r in rows] == [(0.5, 1, 1), (0.99, 3, 4)]


def test_options_of_another_benchmark_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["hiltestbed", "bench", "cor", "--noise"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "bench diagnosis only" in capsys.readouterr().err


def test_without_the_sources_a_bench_that_needs_test_equipment_says_how_to_get_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, call: Callable[..., Any]
) -> None:
    monkeypatch.setattr("hiltestbed.bench.CHECKOUT", tmp_path)
    status, _, err = call("bench", "diagnosis", "--out", str(tmp_path / "out"))
    message = " ".join(err.split())
    assert status == 1
    assert "bench diagnosis: its test equipment is not part of the installed package" in message
    assert "pip install -e ." in message
    assert not (tmp_path / "out").exists()


def test_nothing_else_of_the_package_reaches_for_the_tests() -> None:
    package = Path(hiltestbed.__file__).parent
    asking = [
        str(file.relative_to(package))
        for file in package.rglob("*.py")
        if re.search(r'(from |import |")tests\.', file.read_text(encoding="utf-8"))
    ]
    assert asking == ["bench/__init__.py"]


def test_a_facility_that_divides_its_ticks_otherwise_keeps_its_clocks() -> None:
    every = computing_tasks({"single": 6})
    divided, clocks = (
        next(t for t in every if t.computing == way).draw().nuisances
        for way in ("divided", "clocks")
    )
    plain = replace(Nuisances(), substeps=divided.substeps, lever=divided.lever)
    assert divided == plain != Nuisances()
    assert 0.0 < clocks.read <= 0.5
    assert 0.0 < clocks.move <= 0.5


def test_three_causes_are_none_of_them_alike() -> None:
    hidden = Task(5, "triple").draw()
    assert len(hidden.effects) == 3
    names = [e["kind"] for e in hidden.effects]
    assert not any(alike(a, b) for a, b in itertools.combinations(names, 2))


def test_a_group_is_a_rig_and_a_kind_of_set() -> None:
    plain = record(Task(1, "single", ("sensor.delay",)), "named", True)
    odd = record(Task(2, "single", ("platform.lag",), computing="clocks"), "unknown", False)
    small = record(Task(3, "single", ("sensor.delay",), scale=0.1), "unknown", False)
    rows = groups([plain, odd, small])
    assert [(r["rig"], r["kind"], r["right"], r["sets"]) for r in rows] == [
        ("bumper", "single", 1, 1),
        ("bumper", "single, 0.1 of its size", 0, 1),
        ("clocks", "single", 0, 1),
    ]


def played(monkeypatch: pytest.MonkeyPatch, last: int) -> list[int]:
    """Has no set diagnosed: the seeds that are asked for; the last of them is interrupted."""
    asked: list[int] = []

    def one_set(task: Task) -> dict[str, Any]:
        asked.append(task.seed)
        if len(asked) == last:
            raise KeyboardInterrupt
        return record(task, "no_discrepancy", task.kind == "healthy")

    monkeypatch.setattr(bench, "one_set", one_set)
    monkeypatch.setattr(bench, "Workers", ThreadPoolExecutor)
    return asked


def test_a_benchmark_that_was_stopped_goes_on_where_it_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keep = tmp_path / "bench.sets.jsonl"
    before = played(monkeypatch, last=5)
    with pytest.raises(KeyboardInterrupt):
        diagnosis(quick=True, keep=keep, workers=1)
    with keep.open("a", encoding="utf-8") as file:
        file.write('{"seed": 40')  # cut off
    after = played(monkeypatch, last=0)
    result = diagnosis(quick=True, keep=keep, workers=1)
    assert set(before[:4]).isdisjoint(after)
    counts = {len(result.records), result.summary["planned"], result.summary["done"]}
    assert counts == {len(set(before) | set(after))}
    assert not keep.exists()


def test_records_of_another_program_are_not_taken_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keep = tmp_path / "bench.sets.jsonl"
    played(monkeypatch, last=5)
    with pytest.raises(KeyboardInterrupt):
        diagnosis(quick=True, keep=keep, workers=1)
    monkeypatch.setattr("tests.equipment.kept.made_by", lambda: "another")
    after = played(monkeypatch, last=0)
    assert len(diagnosis(quick=True, keep=keep, workers=1).records) == len(after)


def test_when_the_time_is_up_what_is_done_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    played(monkeypatch, last=0)
    result = diagnosis(quick=True, minutes=1e-6, keep=tmp_path / "bench.sets.jsonl", workers=1)
    assert (result.summary["done"], result.records, result.summary["named_rate"]) == (0, [], None)
    assert (tmp_path / "bench.sets.jsonl").exists()
