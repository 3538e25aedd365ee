"""A mass that a force drives: mass, friction and offset from records that an independent program
has integrated exactly.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import hiltestbed
from hiltestbed.diagnosis.diagnose import diagnose
from hiltestbed.diagnosis.driven import axis_link
from hiltestbed.diagnosis.intervals import MIN_RELATIVE_WIDTH
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.report.diagnosis import Diagnosis
from hiltestbed.effects import EFFECTS
from hiltestbed.measured import load_dataset
from tests.slow import SLOW, slow

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "driven_axis"
SECONDS = 10.0
SCENARIO = (
    (EXAMPLE / "nominal.yaml").read_text("utf-8").replace("duration: 24.8", f"duration: {SECONDS}")
)


def _generator() -> Any:
    spec = importlib.util.spec_from_file_location("driven_axis_generate", EXAMPLE / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["driven_axis_generate"] = module  # a dataclass looks for its module there
    spec.loader.exec_module(module)
    return module


generate = _generator()
TRUE = generate.Axis()


@pytest.fixture(scope="module")
def records() -> dict[str, dict[str, np.ndarray]]:
    return {name: cut(columns) for name, columns in generate.records(TRUE).items()}


def cut(columns: dict[str, np.ndarray], every: int = 1) -> dict[str, np.ndarray]:
    return {
        name: values[: round(SECONDS * generate.RATE)][::every] for name, values in columns.items()
    }


def dataset(
    folder: Path, records: dict[str, dict[str, np.ndarray]], mass: float = 100.0, gap: float = 0.25
) -> Path:
    for name, columns in records.items():
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
    (folder / "nominal.yaml").write_text(
        SCENARIO.replace("mass: 100.0", f"mass: {mass}").replace("gap: 0.25", f"gap: {gap}"),
        "utf-8",
    )
    runs = "".join(f"  - {{file: {name}.parquet}}\n" for name in records)
    channels = (
        f"  wrench_comp.fz: {{column: force, scale: -1.0}}\n  pose_cmd.pz: {{column: "
        f"position, offset: {-gap}}}\n"
    )
    (folder / "dataset.yaml").write_text(
        f"scenario: nominal.yaml\nruns:\n{runs}channels:\n{channels}", "utf-8"
    )
    return folder / "dataset.yaml"


def estimates(found: Diagnosis) -> dict[str, Any]:
    """Parameter to its estimate and 95 % interval."""
    causes = found.finding.causes or found.finding.partial
    parameters = {
        f"{c.effect} {name}": p
        for c in causes
        for name, p in c.parameters.items()
        if isinstance(p.estimate, float)
    }
    return {name: (p.estimate, p.ci95) for name, p in parameters.items()}


def left_on(path: Path, found: Diagnosis, run: int) -> float:
    """[m] rms between a record and the motion that the named causes predict of it from its start
    alone.
    """
    link = axis_link(load_dataset(path).runs)
    effects = [
        EFFECTS[c.effect](**{k: v for k, v in c.entry().items() if k != "kind"})
        for c in found.finding.causes
    ]
    counted = np.isfinite(link.runs[run].sigma)
    return float(
        np.sqrt(np.mean((link.runs[run].measured - link.shown(run, effects))[counted] ** 2))
    )


@pytest.mark.parametrize("believed", [slow(1.0), 100.0])
def test_mass_friction_and_offset_are_found_whatever_mass_is_believed(
    tmp_path: Path, records: dict[str, dict[str, np.ndarray]], believed: float
) -> None:
    found = diagnose(dataset(tmp_path, records, believed))
    assert found.finding.verdict == "named"
    assert {c.effect for c in found.finding.causes} == {"dynamics.mass", "dynamics.force"}
    true = {"dynamics.mass factor": TRUE.mass / believed, "dynamics.force viscous": TRUE.viscous}
    true |= {"dynamics.force coulomb": TRUE.coulomb, "dynamics.force offset": TRUE.offset}
    got = estimates(found)
    for name, value in true.items():
        estimate, (low, high) = got[name]
        assert low < value < high, name
        assert got["dynamics.force viscous_asymmetry"][0] == 0.0
        assert high - low < 0.05 * abs(value), (
            "an interval that holds because it is wide says nothing"
        )
        # neither the loop's step nor a rest that creeps is in it
        assert estimate == pytest.approx(value, rel=1e-4), name


@SLOW
def test_one_record_predicts_the_other(
    tmp_path: Path, records: dict[str, dict[str, np.ndarray]]
) -> None:
    (tmp_path / "one").mkdir()
    found = diagnose(dataset(tmp_path / "one", {"trapezoids": records["trapezoids"]}))
    both = dataset(tmp_path, records)
    assert left_on(both, found, 1) < 1e-3


def test_a_mass_that_is_right_is_not_named(
    tmp_path: Path, records: dict[str, dict[str, np.ndarray]]
) -> None:
    found = diagnose(dataset(tmp_path, records, TRUE.mass))
    assert [c.effect for c in found.finding.causes] == ["dynamics.force"]


def test_what_the_law_does_not_hold_widens_the_intervals_and_takes_nothing_from_the_estimates(
    tmp_path: Path,
) -> None:
    """1 N of ripple over the place, of 20 N of dry friction: estimates within 1 %, intervals thrice
    those of clean records, and right.
    """
    found = diagnose(
        dataset(
            tmp_path, {n: cut(c) for n, c in generate.records(generate.Axis(ripple=1.0)).items()}
        )
    )
    got = estimates(found)
    for name, value in (("viscous", TRUE.viscous), ("coulomb", TRUE.coulomb)):
        estimate, (low, high) = got[f"dynamics.force {name}"]
        assert estimate == pytest.approx(value, rel=0.01), name
        assert low < value < high, name
        assert high - low > 3.0 * 2.0 * MIN_RELATIVE_WIDTH * value, name


def test_friction_that_differs_by_direction_is_told_from_friction_that_does_not(
    tmp_path: Path,
) -> None:
    axis = generate.Axis(asymmetry=0.2)
    found = diagnose(dataset(tmp_path, {n: cut(c) for n, c in generate.records(axis).items()}))
    got = estimates(found)
    assert got["dynamics.force viscous_asymmetry"][0] == pytest.approx(axis.asymmetry, rel=0.05)
    assert got["dynamics.force viscous"][0] == pytest.approx(axis.viscous, rel=0.02)
    assert got["dynamics.mass factor"][0] == pytest.approx(axis.mass / 100.0, rel=0.01)


def test_a_log_at_another_rate_than_the_loop(tmp_path: Path) -> None:
    found = diagnose(dataset(tmp_path, {n: cut(c, 2) for n, c in generate.records(TRUE).items()}))
    got = estimates(found)
    for name, value in (
        ("viscous", TRUE.viscous),
        ("coulomb", TRUE.coulomb),
        ("offset", TRUE.offset),
    ):
        assert got[f"dynamics.force {name}"][0] == pytest.approx(value, rel=0.03)


@SLOW
def test_a_record_starts_where_it_stood_and_in_motion(
    tmp_path: Path, records: dict[str, dict[str, np.ndarray]]
) -> None:
    """From the middle of a motion, 40 mm from where the scenario starts: no fault, and the start is
    read from the record.
    """
    later = {
        n: {k: v[1333:] - (c["t"][1333] if k == "t" else 0.0) for k, v in c.items()}
        for n, c in records.items()
    }
    path = dataset(tmp_path, later, gap=0.01)
    link = axis_link(load_dataset(path).runs)
    speed = [(c["position"][3] - c["position"][0]) / 3e-3 for c in later.values()]
    np.testing.assert_allclose(link.speed, speed, atol=2e-3)
    assert diagnose(path).finding.verdict == "named"


def test_a_spacecraft_that_approaches_is_no_driven_axis(tmp_path: Path) -> None:
    """Force and pose alone of a docking: free flight at the start, so that the numerical model is
    judged as computed.
    """
    scenario = hiltestbed.load_scenario("02-bumper", {"duration": 1.0})
    hiltestbed.run(scenario).to_pandas()[["pose_cmd.pz", "wrench_comp.fz"]].to_csv(
        tmp_path / "run.csv"
    )
    (tmp_path / "nominal.yaml").write_text(hiltestbed.dump_scenario(scenario), "utf-8")
    (tmp_path / "dataset.yaml").write_text(
        "scenario: nominal.yaml\nruns: [{file: run.csv}]\n", "utf-8"
    )
    assert lay_out(load_dataset(tmp_path / "dataset.yaml")).scales.driven is None
