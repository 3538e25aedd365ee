"""Facilities in the loop: the plant, which knows none of them by name, plays one scenario on
each.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hiltestbed
from hiltestbed import load_scenario, read_run
from hiltestbed.analysis.limits import drives_in_contact
from hiltestbed.build import runnable
from hiltestbed.campaign.sweep import sweep
from hiltestbed.config.check import look_at
from hiltestbed.errors import InputError
from hiltestbed.loop import Loop
from hiltestbed.platform.build import demand_of
from hiltestbed.run_folder.store import write_run
from hiltestbed.scenario import Scenario, dump_scenario
from hiltestbed.signals import Trace
from hiltestbed.simulation import run_batch, simulate
from hiltestbed.supervision.snapshot import Snapshots, restore
from tests.platform.halls import TABLE
from tests.platform.rigs import fitted
from tests.running import run, shipped

K, C = 5.0e4, 200.0
HIL = ("stewart", "serial_arm", "two_arms", "mjcf")
PHYSICAL = ("air_bearing", "suspension")


def bounce(kind: str, changes: Any = None, **platform: Any) -> Scenario:
    """A bumper between two free bodies, at once in reach of every rig; no delay, no
    compensation.
    """
    about: dict[str, Any] = {"kind": kind} | platform
    if kind == "mjcf":
        about["model"] = TABLE
    quiet = {"sensor": {}, "compensation.force.kind": "none", "duration": 0.8}
    return shipped("18-stewart", {"rig.platform": about} | quiet | (changes or {}))


def test_an_ideal_drive_gives_the_same_restitution_on_every_facility() -> None:
    cors = {kind: run(bounce(kind, tracking="ideal")).summary["cor"] for kind in ("pss33", *HIL)}
    zeta = C / (2.0 * math.sqrt(K * 400.0))
    root = math.sqrt(1.0 - zeta * zeta)
    # until the force is zero again
    closed = math.exp(-zeta / root * math.atan2(2.0 * zeta * root, 2.0 * zeta * zeta - 1.0))
    assert closed == pytest.approx(cors["pss33"], rel=2e-3)
    for kind in HIL:
        assert cors[kind] == pytest.approx(cors["pss33"], rel=1e-3), kind


def test_a_sensor_that_moves_reads_the_contact_and_nothing_else() -> None:
    """Weight and inertia of a passive side that moves, too, are not in the reading: it is k x + c v
    of where the ports are.
    """
    done = run(bounce("two_arms"))
    z, v, f = done.trace["pose_act"][:, 2], done.trace["twist_act"][:, 2], done.trace["wrench_true"]
    k, c = fitted(z, v, f[:, 2])
    assert k == pytest.approx(K, rel=2e-3)
    assert c == pytest.approx(C, rel=2e-2)
    # identification without noise tells a contact from exact zeros
    assert not f[~done.trace.contact].any()
    assert done.summary["identification"]["z"]["stiffness"] == pytest.approx(K, rel=5e-3)


@pytest.mark.parametrize("rig", [*HIL, *PHYSICAL, "dual drive", "nine axes"])
def test_a_run_alone_is_the_run_in_a_batch_bit_for_bit(rig) -> None:
    """Of nine axes some runs are far away, whose upper platform is stepped, and one is near; of the
    drives with friction one is without.
    """

    def scenario(speed: float, gap: float) -> Scenario:
        keys = {"duration": 0.1, "approach.velocity.2": speed, "approach.gap": 1e-3}
        if rig == "nine axes":
            return shipped("14-rendezvous", keys | {"approach.gap": gap})
        if rig == "dual drive":
            kind = {"rig.platform.actuator.kind": "ideal" if speed == 0.02 else "dual"}
            return shipped("08-dual-drive", keys | kind)
        return bounce(rig, keys)

    runs = [scenario(0.03, 0.22), scenario(0.05, 0.5), scenario(0.02, 0.15)]
    for both in zip(run_batch(runs, trace=True)[1:], map(run, runs[1:]), strict=True):
        together, alone = (done.trace for done in both)
        for name, column in alone.columns().items():
            np.testing.assert_array_equal(column, together.columns()[name], err_msg=name)


def test_a_campaign_runs_on_a_hall(tmp_path) -> None:
    """Its cases are the runs alone."""
    base = bounce("air_bearing", changes={"approach.gap": 1e-3, "duration": 0.2})
    (tmp_path / "base.yaml").write_text(dump_scenario(base))
    (tmp_path / "campaign.yaml").write_text(
        "scenario: base.yaml\nvary:\n  approach.velocity.2: {values: [0.02, 0.04]}\ndesign: "
        "{kind: grid}\n"
    )
    found = sweep(tmp_path / "campaign.yaml", tmp_path / "out").to_pandas()["peak_force"].tolist()
    speeds = ({"approach.velocity.2": v} for v in (0.02, 0.04))
    alone = simulate([load_scenario(tmp_path / "base.yaml", set=v) for v in speeds]).figures
    assert found == [f.peak_force for f in alone] == sorted(found)


@pytest.mark.parametrize("kind", ["stewart", "two_arms", "suspension"])
def test_a_snapshot_goes_on_as_the_run_did(kind) -> None:
    scenario = bounce(kind, changes={"approach.gap": 1e-3})
    loop, again = Loop([scenario]), Loop([scenario])
    kept = Snapshots(loop)
    for _ in range(600):
        kept.keep()
        loop.step()
    loop.trouble[0] = (loop.k, "stopped", "for the test")
    assert restore(again, kept.failures()[0])
    rows = [Trace(1200, 1, scenario.rate, loop.plant.units) for _ in range(2)]
    for _ in range(100):
        loop.step(rows[0])
    while again.k < loop.k:
        again.step(rows[1])
    for name, column in rows[0].data.items():
        np.testing.assert_array_equal(column[600:700], rows[1].data[name][600:700], err_msg=name)


@pytest.mark.parametrize(
    ("kind", "units"), [("two_arms", ("rad",) * 12 + ("m",)), ("air_bearing", ())]
)
def test_the_run_folder_has_the_joints_that_there_are(kind, units, tmp_path) -> None:
    """Thirteen joints have thirteen columns, each with its unit; where nothing is driven there are
    none. The recording is drawn.
    """
    write_run(run(bounce(kind, changes={"duration": 0.1})), tmp_path / "run")
    again = read_run(tmp_path / "run").trace
    assert again.joints == units
    columns = [name for name in again.columns() if name.startswith("slider_act.")]
    assert columns == [f"slider_act.{j}" for j in range(len(units))]
    assert (tmp_path / "run" / "recording.rrd").stat().st_size > 1e5


def test_bodies_that_move_by_themselves_have_neither_command_nor_ledger() -> None:
    done = run(bounce("air_bearing", changes={"sensor.delay": 0.005}))
    assert np.array_equal(done.trace["pose_cmd"], done.trace["pose_act"])
    assert np.array_equal(done.trace["wrench_comp"], done.trace["wrench_true"])
    assert [entry["source"] for entry in done.summary["delay_ledger"]] == ["total"]
    assert done.summary["status"] == "completed"


def test_a_level_floor_without_film_is_free_flight() -> None:
    """Two floats of 500 and 2000 kg with nothing that holds them bounce as the free bodies do."""
    names = ("float_mass", "film_damping", "friction", "hose_stiffness", "hose_damping")
    done = run(bounce("air_bearing", **dict.fromkeys(names, 0.0), tilt=[0.0, 0.0])).summary
    assert done["cor"] == pytest.approx(done["cor_reference"], rel=1e-3)


def test_a_rig_of_the_users_own_docks() -> None:
    """A table with a lift and a gimbal captures the probe in the cone."""
    keys = {
        "rig.platform": {"kind": "mjcf", "model": TABLE},
        "duration": 4.0,
        "approach.gap": 0.12,
        "approach.offset": [0.02, 0.01],
        "approach.attitude_deg": [1, 0, 2],
    }
    done = run(shipped("09-docking", keys)).summary
    assert done["outcome"] == "captured"
    assert done["tracking_error"] < 2e-3


def test_a_drive_moves_the_masses_above_it_and_carries_the_contact() -> None:
    drives = demand_of(bounce("mjcf"))
    above = np.array([645.0, 385.0, 205.0]) + 200.0  # [kg] moved by x, y and z; the bumper's
    weight = np.array([0.0, 0.0, 405.0 * 9.81])  # [N]
    np.testing.assert_allclose(drives.weight[:3], weight, atol=1e-6)
    np.testing.assert_allclose(drives.inertia[:3, :3], np.diag(above), atol=1e-6)
    np.testing.assert_allclose(drives.load[:3, :3], -np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.diag(drives.shares)[:3], above / (3.0e4 - weight), rtol=1e-6)
    assert demand_of(bounce("mjcf", tracking="ideal")) is None


@pytest.mark.parametrize("kind", ["pss33", "serial_arm", "two_arms"])
def test_the_forces_of_drives_in_a_contact_are_foreseen(kind: str) -> None:
    """Against the drives' forces in MuJoCo at the peak of a bounce, to 2 % of the largest."""
    soft = {"mechanism.contact": {"stiffness": 2.0e4, "damping": 100.0}}
    scenario = bounce(kind, soft | {"approach.velocity": [0.0, 0.0, 0.2]})
    drives, loop = demand_of(scenario), Loop([scenario])
    assert drives is not None
    plant: Any = loop.plant
    tracking = plant._tracking
    columns = [tracking.model.joint(axis.joint).dofadr[0] for axis in drives.axes]
    peak, found = 0.0, np.zeros(len(columns))
    for _ in range(int(scenario.duration * scenario.rate)):
        loop.step()
        if loop.plant.wrench_sub[0, -1, 2] > peak:
            peak, found = loop.plant.wrench_sub[0, -1, 2], tracking._forces[0, columns]
    foreseen = drives.weight + drives_in_contact(scenario, drives, peak)
    np.testing.assert_allclose(found, foreseen, atol=0.02 * np.abs(found).max())
    assert np.abs(found - drives.weight).max() > 0.04 * np.abs(found).max()


def test_a_check_says_which_contact_a_drive_cannot_exert(tmp_path: Path) -> None:
    """The speed that it advises is the one from which it complains."""
    hard = {"mechanism.contact.stiffness": 3.0e6, "approach.velocity": [0.0, 0.0, 2.0]}
    file = tmp_path / "hard.yaml"
    file.write_text(dump_scenario(bounce("serial_arm", hard)))
    (said,) = (text for text in look_at(file).remarks if "of the drive of joint" in text)
    found = re.search(r"joint a.*its limit is .* N m; approach at less than (\S+) m/s", said)
    for share, count in ((0.99, 0), (1.01, 1)):
        speed = {"approach.velocity.2": share * float(found[1])}
        remarks = look_at(file, speed).remarks
        assert sum("of the drive of joint" in text for text in remarks) == count


def test_a_correction_asks_no_more_of_an_arm_than_its_drives_can_give() -> None:
    """Force and arm are 17 ms late together; within the 2 ms of `blending` the correction would
    take 30 m/s^2 of 27.
    """
    late = {
        "duration": 0.4,
        "approach.velocity": [0.0, 0.0, 0.1],
        "mechanism.contact": {"stiffness": 1.0e6, "damping": 1300.0},
        "rig.platform": {"kind": "serial_arm"},
        "compensation.force": {"kind": "resynchronised"},
        "identification": {"kind": "none"},
    }
    summary = run(hiltestbed.load_scenario("reference-bumper", late)).summary
    assert summary["status"] == "completed"
    assert abs(summary["cor_log_error"]) < 0.01


def test_a_joint_past_its_limit_stops_the_run() -> None:
    """The facility's own limits are watched: a hydraulic leg asked for more than its valve lets
    through.
    """
    fast = {"approach.velocity.2": 0.1, "approach.gap": 0.1}
    done = run(bounce("stewart", changes=fast, drive={"kind": "hydraulic", "speed": 0.06})).summary
    assert done["status"] == "stopped"
    assert "joint leg_" in done["stop_reason"]
    assert "its limit is 0.06 m/s" in done["stop_reason"]


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        ("stewart", {"approach.gap": 0.9}, "approach: starts at a pose that the platform cannot"),
        (
            "serial_arm",
            {"rate": 900.0, "physics_rate": 1800.0},
            r"rig.platform.command.controller_rate: does not divide the loop's rate \(got 250 Hz in "
            r"a loop of 900 Hz .* such as 225",
        ),
        (
            "two_arms",
            {"mechanism.mount": {"stiffness": [1e6] * 6, "damping": [1e3] * 6}},
            r"mechanism.mount: cannot be combined",
        ),
        ("serial_arm", {"rig.upper.kind": "prs3"}, r"rig.upper.kind: belongs to the 3-3 PSS"),
        ("mjcf", {"rig.platform.model": "absent.xml"}, r"rig.platform.model: .*no such file"),
        ("air_bearing", {"approach.offset": [0.0, 0.02]}, r"approach: .*do not go along y"),
    ],
)
def test_what_a_facility_cannot_play_is_said_before_the_run(kind, change, said) -> None:
    with pytest.raises(InputError, match=said):
        runnable(bounce(kind, change))


def test_a_response_in_place_of_drives_is_the_second_order_with_its_delay() -> None:
    """A property of the platform: the same bounce as the two effects that make a perfect platform
    lag and come late.
    """
    keys = {
        "rate": 2000.0,
        "physics_rate": 4000.0,
        "mechanism.contact.stiffness": 1e4,
        "duration": 2.0,
    }
    answer = {"bandwidth": 10.0, "damping_ratio": 0.7, "delay": 0.006}
    effects = [
        {"kind": "platform.delay", "delay": 0.006},
        {"kind": "platform.lag", "bandwidth": 10.0},
    ]
    platform = {"rig.platform.tracking": "response", "rig.platform.response": answer}
    first = hiltestbed.run(shipped("02-bumper", keys | platform)).summary
    second = hiltestbed.run(shipped("02-bumper", keys | {"effects": effects})).summary
    assert first["cor"] == pytest.approx(second["cor"], rel=1e-9)
    net = [summary["stability"]["net_damping"] for summary in (first, second)]
    assert net[0] == pytest.approx(net[1], rel=1e-6)
    late = 0.006 + 1.4 / (2.0 * math.pi * 10.0)
    entry = first["delay_ledger"][-2]
    assert entry["source"] == "platform.response"
    assert entry["delay"] == pytest.approx(late, rel=0.02)
