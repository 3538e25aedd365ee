"""Bad data, each with a clear error or a stated loss; good data, however the rig departs from its
model, with neither.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed.errors import InputError
from hiltestbed.measured import MeasuredDataset, examine, load_dataset
from hiltestbed.measured.noise import step_of
from hiltestbed.measured.remark import Remark
from tests.equipment.independent_rig import draw_set, write_set
from tests.robustness.distortions import lost, rows, swapped_axes, w_first, without

from . import bounce
from .bounce import Table, changed


def _examine(folder: Path, table: Table, channels: str = "") -> MeasuredDataset:
    return examine(bounce.write_dataset(folder, table, channels=channels))


def _errors(dataset: MeasuredDataset) -> list[Remark]:
    return [remark for remark in dataset.remarks if remark.severity == "error"]


def _moved(name: str, by: float, faster: float = 0.0) -> Callable[[Table], None]:
    """A channel counted from elsewhere [m], of a run that was so much faster [m/s]."""

    def change(table: Table) -> None:
        table[name] = table[name] + by + faster * table["t"]

    return change


def _without_lever(table: Table) -> None:
    table["wrench_meas.tx"] = 1e6 * (table["wrench_meas.tx"] + 1e-2 * table["wrench_meas.fz"])


PLACE, TURN = "px py pz", "qx qy qz qw"
MISTAKES = {  # a change of the data; of the error: its channel, words, and what its fix says
    "force of the other sign": (changed("wrench", -1.0), "wrench_meas.fz", "pulls while", "-1"),
    "compensation turned": (changed("wrench_comp", -1.0), "wrench_comp.fz", "pulls while", "-1"),
    "force in kN": (changed("wrench", 1e-3), "wrench_meas.fz", "another unit", "1000"),
    "pose in mm": (changed("pose", 1e3, PLACE), "pose_act.pz", "another unit", "0.001"),
    "reached pose in mm": (changed("pose_act", 1e3, PLACE), "pose_act.px", "another unit", "0.001"),
    "pz that falls on the way in": (changed("pose", -1.0, "pz"), "pose_act.pz", "reversed", "-1"),
    "quaternion w first": (w_first, "pose_act.q*", "order is w, x, y, z", "exchange the columns"),
    "quaternion in %": (
        changed("pose_act", 1e2, TURN),
        "pose_act.q*",
        "no unit quat",
        "check scale",
    ),
    "force on another axis": (swapped_axes, "wrench_meas.fz", "swapped", "exchange the columns"),
    "torque without lever": (_without_lever, "wrench_meas.tx", "lever arm", "0.001"),
    "time in ms": (changed("t", 1e3), "t", "lasts 599 s", "0.001"),
    "another speed": (
        _moved("pose_cmd.pz", 0.0, 0.005),
        "pose_cmd.pz",
        "begins at 0.035 m/s",
        "{approach.velocity.2: 0.035}",
    ),
    "another start": (
        _moved("pose_cmd.pz", -0.002),
        "pose_cmd.pz",
        "by its approach the scenario is at",
        "set: {approach.gap: 0.00",
    ),
    "a reached pose from elsewhere": (
        _moved("pose_act.pz", 0.25),
        "pose_act.pz",
        "by its approach",
        "{pose_act.pz: {offset: -0.25}}",
    ),
    "a command from elsewhere": (
        _moved("pose_cmd.pz", 0.002),
        "pose_cmd.pz",
        "by its approach",
        "{pose_cmd.pz: {offset: -0.002}}",
    ),
}


def test_a_spike_at_the_start_is_no_other_approach(tmp_path: Path) -> None:
    table = bounce.columns()
    table["pose_cmd.pz"][7] += 1e-3
    assert not _errors(examine(bounce.write_dataset(tmp_path, table)))


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_contradicts_the_physics_is_an_error_with_its_fix(
    tmp_path: Path, mistake: str
) -> None:
    """A number is a scale, which the fix states for the channel. The entries of the channel map
    that the errors spell out, written down, leave no error, and the data are what they were.
    """
    change, channel, text, fix = MISTAKES[mistake]
    table = bounce.columns()
    change(table)
    path = bounce.write_dataset(tmp_path, table)
    dataset = examine(path)
    errors = {r.channel: r for r in _errors(dataset)}
    assert text in errors[channel].text
    scale = re.fullmatch(r"[-\d.]+", fix)
    assert (f"{{{channel}: {{scale: {fix}}}}}" if scale else fix) in errors[channel].fix
    with pytest.raises(InputError, match=r"run_0\.parquet") as raised:
        load_dataset(path)
    named = [channel for fault in raised.value.faults for channel in fault.key.split(", ")]
    assert sorted(named) == sorted(errors)
    if not scale or "torque" in mistake or "compensation" in mistake:
        return
    entries: dict[str, str] = {}
    channels = ""
    for _ in range(3):
        for remark in _errors(dataset):
            entries |= dict(re.findall(r"\{([\w.]+): \{scale: ([-\w.+]+)\}\}", remark.fix))
        lines = [f"  {name}: {{scale: {scale}}}\n" for name, scale in entries.items()]
        channels = f"channels:\n{''.join(lines)}"
        dataset = _examine(tmp_path, table, channels)
    assert not _errors(dataset)
    good, record = bounce.columns(), dataset.runs[0].record
    for name in ("wrench_meas.fz", "pose_act.pz", "pose_cmd.px"):
        np.testing.assert_allclose(record.column(name), good[name], rtol=1e-12)


DRIVEN = {  # a change of the data; of the errors: channels and check
    "nothing": (changed("wrench", 1.0), [], ""),
    "the force of a stiffer contact": (changed("wrench", 5.0), [], ""),
    "force of the other sign": (changed("wrench_meas", -1.0), ["wrench_meas.fz"], "sign"),
    "compensation turned": (changed("wrench_comp", -1.0), ["wrench_comp.fz"], "sign"),
    "force in kN": (changed("wrench", 1e-3), ["wrench_meas.fz", "wrench_comp.fz"], "unit"),
    "force on another axis": (swapped_axes, ["wrench_meas.fz", "wrench_comp.fz"], "axes"),
}


@pytest.mark.parametrize("mistake", DRIVEN)
def test_of_a_driven_machine_the_force_is_that_of_the_believed_contact_along_the_pose(
    tmp_path: Path, mistake: str
) -> None:
    """By its sign, its axis and its order of magnitude: no momentum tells more."""
    change, channels, check = DRIVEN[mistake]
    table = {n: v for n, v in bounce.columns().items() if not n.startswith("pose_cmd")}
    change(table)
    path = bounce.write_dataset(tmp_path, table)
    at_rest = bounce.SCENARIO.replace(
        f"velocity: [{bounce.SIDE}, 0.0, {bounce.SPEED}]", "velocity: [0.0, 0.0, 0.0]"
    )
    (tmp_path / "nominal.yaml").write_text(at_rest)
    errors = _errors(examine(path))
    assert [r.channel for r in errors] == channels
    assert {r.check for r in errors} <= {check}
    assert all(r.fix for r in errors)


def test_two_numbers_that_are_alike_on_coarse_steps_are_no_copy(tmp_path: Path) -> None:
    """Two axes at rest at the edge of a step show its two numbers; four in the same order are a
    copy.
    """
    table = bounce.columns()
    rows, random = np.arange(len(table["t"])), np.random.default_rng(2)
    table["pose_act.px"] = np.where(rows < 250, -2e-5, 0.0)
    table["pose_act.py"] = np.where(rows < 2, -2e-5, 0.0)
    assert not [r for r in _examine(tmp_path, table).remarks if "a copy" in r.text]
    table["pose_act.px"] = table["pose_act.py"] = 2e-5 * random.integers(0, 5, len(rows))
    assert [r for r in _examine(tmp_path, table).remarks if "a copy" in r.text]


def _clip(table: Table) -> None:
    table["wrench_meas.fz"] = np.minimum(table["wrench_meas.fz"], 0.7 * bounce.PEAK)


nan_stretch = lost("wrench_meas.fz", 100 / 600, 40)
MISSING = "missing (NaN) in 40 of 600 samples, at most 40 in a row from 0.1 s"
LOSSES = {
    "missing samples": (nan_stretch, "wrench_meas.fz", MISSING),
    "mostly missing": (lost("pose_act.pz", 0.0, 400), "pose_act.pz", "left out of this run"),
    "clipped": (_clip, "wrench_meas.fz", "clipped"),
    "no compensated wrench": (without("wrench_comp"), "wrench_comp", "compensation and dynamics"),
    "no contact": (rows(lambda n: np.arange(90)), "", "has no contact"),
}


@pytest.mark.parametrize("case", LOSSES)
def test_a_loss_is_stated_and_does_not_stop(tmp_path: Path, case: str) -> None:
    change, channel, text = LOSSES[case]
    table = bounce.columns()
    change(table)
    dataset = load_dataset(bounce.write_dataset(tmp_path, table))
    losses = [r for r in dataset.remarks if r.severity == "loss" and r.channel == channel]
    assert any(text in r.text for r in losses)


def test_masks_mark_what_was_lost(tmp_path: Path) -> None:
    table = bounce.columns()
    nan_stretch(table)
    record = load_dataset(bounce.write_dataset(tmp_path, table)).runs[0].record
    assert np.flatnonzero(~record.measured("wrench_meas.fz")).tolist() == list(range(100, 140))
    assert np.isfinite(record.filled("wrench_meas")).all()


def test_one_axis_is_a_record(tmp_path: Path) -> None:
    """Displacement and force alone: the other axes are stated as absent, and are zero where a model
    must be driven.
    """
    table = bounce.columns()
    few = {"s": table["t"], "displacement_mm": 1e3 * table["pose_act.pz"]}
    few["load_kN"] = -1e-3 * table["wrench_meas.fz"]
    channels = (
        "channels:\n  t: {column: s}\n  pose_act.pz: {column: displacement_mm, unit: mm}\n"
        "  wrench_meas.fz: {column: load_kN, unit: kN, scale: -1.0}\n"
    )
    dataset = _examine(tmp_path, few, channels)
    record = dataset.runs[0].record
    assert record.columns() == ("pose_act.pz", "wrench_meas.fz")
    lost = {r.channel for r in dataset.remarks if r.severity == "loss"}
    assert lost == {"pose_cmd", "wrench_comp", "pose_act", "wrench_meas"}
    np.testing.assert_allclose(record.column("wrench_meas.fz"), table["wrench_meas.fz"], rtol=1e-12)
    assert (record.filled("pose_act")[:, 3:] == [0.0, 0.0, 0.0, 1.0]).all()


def test_a_file_without_what_is_needed_of_it_is_an_error(tmp_path: Path) -> None:
    """A column that is mapped, with the nearest name; the time; any channel."""
    table = bounce.columns()
    with pytest.raises(InputError, match=r"no column of the file \(got 'Fz'\); nearest: Fz_N"):
        _examine(
            tmp_path,
            {"t": table["t"], "Fz_N": table["wrench_meas.fz"]},
            "channels: {wrench_meas.fz: {column: Fz}}\n",
        )
    with pytest.raises(InputError, match=r"no time column 't'; .*time"):
        _examine(tmp_path, {"time": table["t"], "pose_act.pz": table["pose_act.pz"]})
    with pytest.raises(InputError, match=r"holds none of the channels pose_cmd\.\*"):
        _examine(tmp_path, {"t": table["t"], "temperature": table["t"]})


def test_all_files_are_heard_before_the_error(tmp_path: Path) -> None:
    good, bad = bounce.columns(), bounce.columns()
    path = bounce.write_dataset(tmp_path, bad, good, bad)
    for name in ("run_0", "run_2"):
        (tmp_path / f"{name}.parquet").write_bytes(b"PAR1 but nothing more")
    with pytest.raises(InputError) as raised:
        load_dataset(path)
    names = [Path(fault.file).name for fault in raised.value.faults]
    assert names == ["run_0.parquet", "run_2.parquet"]


def test_noise_and_contact_are_read_as_they_were_made(tmp_path: Path) -> None:
    """White noise of 0.1 N and 1 um; one contact from gap/v over pi/w, peak v sqrt(k mu)."""
    survey = _examine(tmp_path, bounce.columns()).runs[0].survey
    free = round(bounce.TOUCH * bounce.RATE)
    assert free - 10 <= survey.free <= free
    # 98 samples: 1 sigma is 7 %
    assert survey.noise["wrench_meas.fz"].rms == pytest.approx(0.1, rel=0.25)
    assert survey.noise["wrench_meas.fz"].white == pytest.approx(0.1, rel=0.5)
    assert survey.noise["pose_act.pz"].rms == pytest.approx(1e-6, rel=0.25)
    (contact,) = survey.contacts
    lasts = (contact.end - contact.start) / bounce.RATE
    assert contact.start / bounce.RATE == pytest.approx(bounce.TOUCH, abs=2e-3)
    assert lasts == pytest.approx(np.pi / bounce.OMEGA, abs=3e-3)
    assert contact.peak_force == pytest.approx(bounce.PEAK, rel=0.01)
    assert contact.speed == pytest.approx(bounce.SPEED, rel=0.01)
    assert "pose_act.px" in survey.excited
    assert "pose_act.py" not in survey.excited


def test_hum_counts_in_rms_and_not_in_white(tmp_path: Path) -> None:
    table = bounce.columns()
    table["wrench_meas.fz"] = table["wrench_meas.fz"] + 5.0 * np.sin(2 * np.pi * 10.0 * table["t"])
    noise = _examine(tmp_path, table).runs[0].survey.noise["wrench_meas.fz"]
    assert noise.rms > 2.0
    assert noise.white < 0.3


EFFECTS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "bias": lambda t, f: f - 40.0,
    "drift": lambda t, f: f + 20.0 * t,
    "hum": lambda t, f: f + 20.0 * np.sin(2 * np.pi * 50.0 * t),
    "gain": lambda t, f: 0.6 * f,
    "dead zone": lambda t, f: np.where(np.abs(f) < 60.0, 0.0, f),
    "delay": lambda t, f: np.r_[np.zeros(30), f[:-30]],
    "charge leak": lambda t, f: f - np.convolve(f, 0.05 * np.exp(-np.arange(600) / 20.0))[: len(f)],
    "adhesion": lambda t, f: np.where(
        (t > bounce.PARTING - 0.01) & (t < bounce.PARTING), f - 150.0, f
    ),
    "coarse steps": lambda t, f: 5.0 * np.round(f / 5.0),
    "fine steps": lambda t, f: 0.05 * np.round(f / 0.05),
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_what_a_diagnosis_looks_for_is_no_fault_of_the_data(tmp_path: Path, effect: str) -> None:
    """Departures of the rig, far beyond a moderate size, raise no error and lose no channel."""
    table = bounce.columns()
    # the model moves by what it is given
    late = ("wrench_meas.fz",) if effect == "delay" else ("wrench_meas.fz", "wrench_comp.fz")
    for name in late:
        table[name] = EFFECTS[effect](table["t"], table[name])
    assert [r for r in _examine(tmp_path, table).remarks if r.severity != "note"] == []


@pytest.mark.parametrize("top", [3.0, 7.3, 50.0])
def test_the_rounded_top_of_a_stepped_signal_is_not_clipped(tmp_path: Path, top: float) -> None:
    """However wide its last step is; the same signal cut at 80 % is."""
    table = bounce.columns(force_noise=0.0)
    smooth = top * table["wrench_meas.fz"] / bounce.PEAK
    for cut, clipped in ((1.0, False), (0.8, True)):
        table["wrench_meas.fz"] = np.round(np.minimum(smooth, cut * top), 1)
        remarks = _examine(tmp_path, table).remarks
        assert any("clipped" in r.text for r in remarks) == clipped


def test_the_step_of_a_channel_is_found() -> None:
    values = 0.25 * np.round(np.random.default_rng(4).standard_normal(2000) / 0.25)
    assert step_of(values) == pytest.approx(0.25)
    assert step_of(np.random.default_rng(4).standard_normal(2000)) is None


def test_the_axis_of_insertion_alone_is_balanced_where_nothing_else_moves(tmp_path: Path) -> None:
    """fz and pz of a centred approach: the other axes are zero by symmetry, so that pounds are told
    from newtons; off it they are not.
    """
    table = {n: v for n, v in bounce.columns().items() if n == "t" or n.endswith((".pz", ".fz"))}
    table["wrench_meas.fz"] = table["wrench_meas.fz"] / 4.4482216152605
    path = bounce.write_dataset(tmp_path, table)
    assert not _errors(examine(path))
    centred = bounce.SCENARIO.replace(f"velocity: [{bounce.SIDE},", "velocity: [0.0,")
    (tmp_path / "nominal.yaml").write_text(centred)
    (error,) = _errors(examine(path))
    assert (error.channel, error.check) == ("wrench_meas.fz", "unit")
    assert "lbf" in error.text


def test_an_axis_that_a_port_beside_its_place_moves_is_not_called_turned(tmp_path: Path) -> None:
    """Along y a hum pushes hardly, and a lever of the port that nobody believes in moves it the
    other way, several times as far.
    """
    names = ("platform.speed_limit", "sensor.hum", "dynamics.port_offset")
    write_set(tmp_path, draw_set(np.random.default_rng(910_001), "pair", names))
    assert _errors(examine(tmp_path / "dataset.yaml")) == []


def test_a_run_is_called_by_its_file(tmp_path: Path) -> None:
    """Whatever number its file has: remarks, and what a whole dataset lacks, name the file; two of
    one name by their folders.
    """
    (tmp_path / "logs").mkdir()
    whole, cut = bounce.columns(), bounce.columns()
    whole["wrench_meas.fz"][100] = float("nan")
    cut = {name: column for name, column in cut.items() if not name.startswith("wrench_meas")}
    pq.write_table(pa.table(cut), tmp_path / "logs" / "run_0.parquet")
    alone = [str(remark) for remark in examine(bounce.write_dataset(tmp_path, whole)).remarks]
    assert any(": run_0.parquet: " in text and "missing (NaN)" in text for text in alone), alone
    found = examine(bounce.write_dataset(tmp_path, whole, files=("logs/run_0.parquet",)))
    assert found.names == ["logs/run_0.parquet", f"{tmp_path.name}/run_0.parquet"]
    assert any("not in logs/run_0.parquet" in str(remark) for remark in found.remarks)


def _beside_the_axis(x: float, y: float, **torques: tuple[str, float]) -> Table:
    """A bounce at (x, y) [m] with its torques; ``torques``: what stands in a column instead:
    another torque, times a factor.
    """
    table = bounce.columns()
    for group in ("pose_cmd", "pose_act"):
        table[f"{group}.px"] = table[f"{group}.px"] * 0.0 + x
        table[f"{group}.py"] = table[f"{group}.py"] + y
    for group in ("wrench_meas", "wrench_comp"):
        force = table[f"{group}.fz"]
        true = {"tx": y * force + table[f"{group}.tx"], "ty": -x * force + table[f"{group}.ty"]}
        stated = {name: factor * true[other] for name, (other, factor) in torques.items()}
        shown = true | (stated if group == "wrench_meas" else {})
        table |= {f"{group}.{name}": values for name, values in shown.items()}
    return table


@pytest.mark.parametrize(
    ("torques", "expected"),
    [
        ({}, []),
        ({"tx": ("tx", -1.0), "ty": ("ty", -1.0)}, [("sign", "tx"), ("sign", "ty")]),
        ({"tx": ("ty", 1.0), "ty": ("tx", 1.0)}, [("axes", "tx")]),
        ({"tx": ("tx", -1.0)}, []),  # of one alone a leak from the force may do so
        ({"tx": ("tx", 1.5), "ty": ("ty", 1.5)}, []),
    ],
)
def test_torques_follow_the_force_beside_the_axis(torques, expected, tmp_path: Path) -> None:
    """tx = y fz, ty = -x fz: about P's origin, of a plane."""
    table = _beside_the_axis(0.08, -0.06, **torques)
    path = bounce.write_dataset(tmp_path, table)
    beside = bounce.SCENARIO.replace("approach: {", "approach: {offset: [0.08, -0.06], ")
    beside = beside.replace(f"[{bounce.SIDE}, 0.0,", "[0.0, 0.0,")
    (tmp_path / "nominal.yaml").write_text(beside)
    torque = "wrench_meas.t"
    found = [r for r in _errors(examine(path)) if r.channel.startswith(torque)]
    assert [(r.check, r.channel[-2:]) for r in found] == expected


def test_where_the_place_beside_the_axis_was_not_logged_no_torque_is_held_against_it(
    tmp_path: Path,
) -> None:
    table = _beside_the_axis(0.08, -0.06)
    unplaced = {name: values for name, values in table.items() if name[-2:] not in ("px", "py")}
    assert not _errors(_examine(tmp_path, unplaced))
