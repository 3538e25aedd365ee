"""The file of an axis: what it takes, what it refuses, and that what was found can be read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from hiltestbed.axis.dataset import load_axis
from hiltestbed.axis.diagnose import diagnose_axis
from hiltestbed.axis.records import Signal, at_times
from hiltestbed.axis.scaling import scaling_of
from hiltestbed.config.check import look_at
from hiltestbed.errors import InputError
from tests.axis import machines


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs of a damper in millimetres, and their file."""
    out = tmp_path_factory.mktemp("axis")
    for s in (0, 1):
        r = machines.damper(s)
        table = pd.DataFrame({"t": r.t, "x [mm]": 1e3 * r.u, "F": r.y})
        table.to_csv(out / f"run_{s}.csv", index=False)
    return out


def spec(**more):
    data = {
        "axis": "damper",
        "nominal": {"damping": 500.0},
        "runs": [{"file": "run_0.csv"}, {"file": "run_1.csv"}],
        "channels": {"input": {"column": "x [mm]"}, "output": {"column": "F", "unit": "N"}},
    }
    return data | more


def written(folder, data):
    path = folder / "axis.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_units_are_those_of_the_file_and_of_the_map(folder):
    loaded = load_axis(written(folder, spec()))
    assert np.ptp(loaded.records[0].u) == pytest.approx(0.02, rel=0.01)
    found = look_at(folder / "axis.yaml")
    assert found.kind == "axis"
    assert not found.faults


def test_rows_without_contact_are_said(folder):
    t = np.arange(300) * 1e-3
    x = 0.05 * t - 0.001
    force = np.maximum(2e4 * x, 0.0)  # 1 N a row, above the noise from the first in contact
    force += 0.1 * np.random.default_rng(0).standard_normal(300)
    pd.DataFrame({"t": t, "x [mm]": 1e3 * x, "F": force}).to_csv(folder / "drop.csv", index=False)
    data = spec(runs=[{"file": "drop.csv"}, {"file": "run_0.csv"}])
    (remark,) = load_axis(written(folder, data)).remarks
    assert remark.startswith("drop.csv: the displacement changes over 21 rows without a force")


@pytest.mark.parametrize(
    ("column", "unit", "factor"), [("x [mm]", "m", 1e-3), ("F", "kN", 1e3), ("F", "N", None)]
)
def test_a_unit_that_contradicts_what_is_believed_is_said(folder, column, unit, factor):
    """A damper's displacement in mm taken for m, or its force in N for kN, and a factor of two."""
    given = {"input": {"column": "x [mm]"}, "output": {"column": "F", "unit": "N"}}
    given["input" if column.startswith("x") else "output"]["unit"] = unit
    path = written(folder, spec(nominal={"damping": 400.0}, channels=given))
    loaded = load_axis(path)
    found = scaling_of(loaded.model())
    if factor is None:
        assert not found
        assert not look_at(path).remarks
        return
    assert [name for name, _ in found] == ["run_0.csv", "run_1.csv"]
    # 120 N of dry friction are as 4 F/(pi v) = 1900 N s/m at 0.08 m/s, beside 800 N s/m
    assert all(2.0 < scale / factor < 12.0 for _, scale in found)
    assert "check the units of the channels" in " ".join(look_at(path).remarks)


def test_what_was_found_is_read_back_and_leaves_nothing_to_find(folder):
    diagnosis = diagnose_axis(written(folder, spec()))
    out = diagnosis.write(folder / "out")
    result = json.loads((out / "diagnosis.json").read_text())
    assert result["verdict"] == diagnosis.verdict
    assert result["heldout"]["reduction"] > 0.9
    again = load_axis(out / "extended.yaml")
    left = again.model().residuals(diagnosis.conclusion.null.of)
    shown = diagnosis.conclusion.fit.left
    # up to the time-stamp offset, which is of the log and not of the axis
    for a, b in zip(left[:-1], shown[:-1], strict=True):
        assert np.sqrt(np.mean(a**2)) < 2.0 * np.sqrt(np.mean(b**2))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"nominal": {"mass": 3.0}}, "is no number of a damper"),
        ({"axis": "drive", "nominal": {}}, "lacks mass"),
        ({"axis": "lever"}, "axis"),
        ({"effects": [{"kind": "dynamics.mass", "factor": 2.0}]}, "does not act on a damper"),
        (
            {"effects": [{"kind": "dynamics.fade", "rate": 0.1, "joint": "elbow"}]},
            "is of an arm alone",
        ),
        ({"effects": [{"kind": "contact.nothing"}]}, "contact.nothing"),
        ({"runs": [{"file": "absent.csv"}]}, "names no file"),
        ({"channels": {"input": {"column": "y"}}}, "names no column"),
        (
            {"channels": {"input": {"column": "x [mm]", "unit": "kN"}, "output": {"column": "F"}}},
            "is no unit of it",
        ),
        ({"nominal": {"damping": -1.0}}, "damping"),
    ],
)
def test_bad_input_is_said(folder, changes, words):
    path = written(folder, spec(**changes))
    with pytest.raises(InputError, match=words):
        load_axis(path)
    assert look_at(path).faults


def test_a_log_without_a_clock_asks_for_its_rate(tmp_path):
    r = machines.damper(0)
    pd.DataFrame({"x": r.u, "F": r.y}).to_csv(tmp_path / "run_0.csv", index=False)
    data = spec(runs=[{"file": "run_0.csv"}])
    data["channels"] = {"input": {"column": "x"}, "output": {"column": "F"}}
    with pytest.raises(InputError, match="sample rate"):
        load_axis(written(tmp_path, data))
    loaded = load_axis(written(tmp_path, data | {"rate": 500.0}))
    assert loaded.records[0].t[1] == pytest.approx(0.002)
    assert look_at(tmp_path / "axis.yaml").kind == "axis"


@pytest.mark.parametrize(
    ("held", "expected"),
    [(True, [np.nan, 1.0, 1.0, 3.0, 3.0]), (False, [np.nan, 1.0, 2.0, 3.0, np.nan])],
)
def test_an_input_with_a_clock_of_its_own_is_taken_at_the_times_of_the_output(held, expected):
    u, own, t = np.array([1.0, 3.0]), np.array([1.0, 3.0]), np.arange(5.0)
    signal = Signal("input", "N", held)
    assert np.array_equal(at_times(Path("log"), signal, own, t, u), expected, equal_nan=True)
    with pytest.raises(InputError, match="run backwards"):
        at_times(Path("log"), signal, own[::-1], t, u)
