"""Run, RunTrace, Sweep and Comparison as Python users take them: reprs, columns by name, pandas,
xarray, plots, the verdict on energy.
"""

from __future__ import annotations

import pickle
import re
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import hiltestbed
from hiltestbed import load_scenario
from hiltestbed.analysis.assessment import NEUTRAL, assess, energy_share
from hiltestbed.errors import InputError
from hiltestbed.signals import GROUPS

pytest.importorskip("matplotlib").use("Agg")

OVERRIDES = {
    "duration": 0.6,
    "approach.gap": 0.002,
    "rig.platform.tracking": "ideal",
    "physics_rate": 4000,
}


@pytest.fixture(scope="module")
def late() -> hiltestbed.Run:
    """5 ms of delay, uncompensated: it rebounds faster than it came."""
    return hiltestbed.run(load_scenario("03-bumper-delay-uncompensated", OVERRIDES))


@pytest.fixture(scope="module")
def right() -> hiltestbed.Run:
    return hiltestbed.run(load_scenario("04-bumper-delay-compensated", OVERRIDES))


def trace_of(run: hiltestbed.Run) -> hiltestbed.RunTrace:
    assert run.trace is not None
    return run.trace


def test_reprs_are_a_line(late: hiltestbed.Run) -> None:
    for thing in (late, trace_of(late), hiltestbed.compare([late, late])):
        assert len(repr(thing)) < 300
        assert "\n" not in repr(thing)
        html = thing._repr_html_()
        assert html.count("<table>") == html.count("</table>") == 1
    assert late.summary["name"] in repr(late)
    assert "nan" not in repr(late)


def test_columns_by_name(late: hiltestbed.Run) -> None:
    trace = trace_of(late)
    for group in GROUPS.values():
        assert trace[group.name].shape == (len(trace["t"]), len(group.parts))
        for j, column in enumerate(group.columns):
            np.testing.assert_array_equal(trace[column], trace[group.name][:, j])
    assert next(iter(trace)) == "t"
    assert list(trace)[-1] == "contact"
    assert "wrench_meas" in trace
    assert "wrench_meas.fz" in trace
    with pytest.raises(KeyError, match=re.escape("did you mean 'wrench_meas'?")):
        trace["wrench_mes"]
    with pytest.raises(InputError):
        late.plot("pose")
    again = pickle.loads(pickle.dumps(trace))
    np.testing.assert_array_equal(again["pose_act"], trace["pose_act"])


def test_pandas_keeps_columns_and_units(late: hiltestbed.Run) -> None:
    pd = pytest.importorskip("pandas")
    trace = trace_of(late)
    assert list(pd.DataFrame(trace).columns) == list(trace)
    frame = late.to_pandas()
    assert frame.index.name == "t"
    assert frame.attrs["columns"]["twist_act.wz"]["unit"] == "rad/s"
    assert frame.attrs["columns"]["wrench_meas.fz"]["frame"] == "in P at P's origin"
    np.testing.assert_array_equal(frame["wrench_meas.fz"], trace["wrench_meas"][:, 2])


def test_xarray_keeps_groups_and_units(late: hiltestbed.Run) -> None:
    pytest.importorskip("xarray")
    dataset = late.to_xarray()
    assert dataset["stiffness_est"].attrs["units"] == ["N/m"] * 3 + ["N m/rad"] * 3
    assert dataset["slider_act"].attrs["units"] == "m"
    picked = dataset["wrench_true"].sel(wrench_true_part="fz")
    np.testing.assert_array_equal(picked.values, trace_of(late)["wrench_true.fz"])


def test_plot_returns_axes_with_what_was_asked(late: hiltestbed.Run) -> None:
    axes = late.plot("pose_act.pz", "pose_cmd.pz")
    assert [line.get_label() for line in axes.lines] == ["pose_act.pz", "pose_cmd.pz"]
    assert "[m]" in axes.get_ylabel()
    assert late.plot("wrench_true", axes=axes) is axes


def test_a_run_without_trace_says_so() -> None:
    (bare,) = hiltestbed.run_batch([load_scenario("02-bumper", {"duration": 0.01})])
    assert "no trace" in repr(bare)
    with pytest.raises(ValueError, match="no trace"):
        bare.to_pandas()


def test_the_verdict_on_energy_follows_the_number(
    late: hiltestbed.Run, right: hiltestbed.Run
) -> None:
    """In shares of the approach energy: e^2 = 1 - what the contact took + what the rig made; the
    first from speeds, the second by work.
    """
    wrong, good = late.assessment, right.assessment
    assert late.summary["energy_generated"] > 0.0
    assert wrong.passive is False
    assert "gained" in wrong.energy
    assert any("faster than the approach" in text for text in wrong.warnings)
    trace = trace_of(late)
    work = float(np.trapezoid(trace["wrench_true.fz"], trace["pose_act.pz"]))
    made = late.summary["cor"] ** 2 - 1.0 + work / late.summary["approach_energy"]
    assert energy_share(late.summary) == pytest.approx(made, rel=0.01)
    assert abs(energy_share(right.summary) or 0.0) <= NEUTRAL
    assert good.passive is None
    assert good.warnings == ()
    figures = {"energy_generated": -late.summary["energy_generated"], "cor_log_error": -0.6}
    lost = assess(late.summary | figures | {"cor": 0.5})
    assert lost.passive is True
    assert not any("active" in text for text in lost.warnings)


def test_every_verdict_has_advice(late: hiltestbed.Run) -> None:
    assert any("sensor.delay" in text for text in late.assessment.advice)
    stopped = assess(late.summary | {"status": "stopped", "stop_reason": "tick 3: force"})
    assert "stopped" in stopped.headline
    assert stopped.advice


def test_compare_says_which_keys_differ_and_what_they_did(
    late: hiltestbed.Run, right: hiltestbed.Run, tmp_path: Path
) -> None:
    pytest.importorskip("pandas")
    hiltestbed.write_run(late, tmp_path / "late", rerun=False)
    both = hiltestbed.compare([tmp_path / "late", right])
    assert both.differences["compensation.force.kind"] == ["none", "phase_lead"]
    assert not any(key.startswith(("spacecraft", "sensor")) for key in both.differences)
    assert both.figures["cor"] == [late.summary["cor"], right.summary["cor"]]
    net = [run.summary["stability"]["net_damping"] for run in (late, right)]
    assert both.figures["stability.net_damping"] == net
    assert net[0] < net[1]
    assert list(both.to_pandas().index) == ["late", right.summary["name"]]
    assert len(both.plot().lines) == 2
    with pytest.raises(InputError, match="two or more"):
        hiltestbed.compare([late])


def test_the_package_tells_version_and_types() -> None:
    assert hiltestbed.__version__ == version("hiltestbed")
    assert (Path(hiltestbed.__file__).parent / "py.typed").is_file()
    for name in hiltestbed.__all__:
        assert getattr(hiltestbed, name) is not None


def test_no_module_hides_a_public_name() -> None:
    """A submodule of that name would replace the function once it is imported."""
    taken = {
        path.stem
        for path in Path(hiltestbed.__file__).parent.iterdir()
        if path.suffix == ".py" or (path / "__init__.py").is_file()
    }
    assert taken.isdisjoint(hiltestbed.__all__)
