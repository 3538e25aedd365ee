"""Facilities in the loop: the plant, which knows none of them by name, plays one scenario on
each.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hiltestbed
from hiltestbed import load_scenario, read_run
from hiltestbed.campaign.sweep import sweep
from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.errors import InputError
from hiltestbed.loop import Loop
from hiltestbed.measured import load_dataset
from hiltestbed.run_folder.store import write_run, write_trace
from hiltestbed.scenario import Scenario, dump_scenario
from hiltestbed.signals import Trace
from hiltestbed.simulation import run_batch, simulate
from hiltestbed.supervision.snapshot import Snapshots, restore
from tests.platform.halls import GANTRY
from tests.running import run
from tests.slow import slow

SCENARIOS = Path(__file__).parents[2] / "scenarios"
K, C = 5.0e4, 200.0
HIL = ("stewart", "serial_arm", "two_arms", "mjcf")
PHYSICAL = ("air_bearing", "suspension")
DIRECT = {"controller_rate": None, "delay_cycles": 0}


@pytest.fixture(scope="module")
def gantry(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("rig") / "gantry.xml"
    path.write_text(GANTRY)
    return str(path)


def bounce(
    kind: str,
    gantry: str = "",
    tracking: str | None = "servo",
    set: dict[str, Any] | None = None,
    **platform: Any,
) -> Scenario:
    """A bumper between two free bodies, at once in reach of every rig; no delay, no
    compensation.
    """
    about: dict[str, Any] = {"kind": kind} | platform
    if tracking is not None:
        about["tracking"] = tracking
    if kind == "mjcf":
        about["model"] = gantry
    quiet = {"sensor": {}, "compensation.force.kind": "none", "duration": 0.8}
    return load_scenario(
        SCENARIOS / "18-stewart.yaml", set={"rig.platform": about} | quiet | (set or {})
    )


def test_an_ideal_drive_gives_the_same_restitution_on_every_facility(gantry) -> None:
    cors = {kind: run(bounce(kind, gantry, "ideal")).summary["cor"] for kind in ("pss33", *HIL)}
    zeta = C / (2.0 * math.sqrt(K * 400.0))
    root = math.sqrt(1.0 - zeta * zeta)
    # until the force is zero again
    closed = math.exp(-zeta / root * math.atan2(2.0 * zeta * root, 2.0 * zeta * zeta - 1.0))
    assert closed == pytest.approx(cors["pss33"], rel=2e-3)
    for kind in HIL:
        assert cors[kind] == pytest.approx(cors["pss33"], rel=1e-3), kind


@pytest.mark.parametrize("kind", [slow("stewart"), slow("serial_arm"), "two_arms", slow("mjcf")])
def test_the_sensor_feels_the_contact_and_nothing_else(kind, gantry) -> None:
    """Weight and inertia of a passive side that moves, too, are not in the reading: it is k x + c v
    of where the ports are.
    """
    done = run(bounce(kind, gantry))
    assert done.trace is not None
    z, v, f = done.trace["pose_act"][:, 2], done.trace["twist_act"][:, 2], done.trace["wrench_true"]
    touching = (z > 0.0) & (f[:, 2] > 0.0)
    (k, c), *_ = np.linalg.lstsq(np.column_stack([z, v])[touching], f[touching, 2], rcond=None)
    assert k == pytest.approx(K, rel=2e-3)
    assert c == pytest.approx(C, rel=2e-2)
    # identification without noise tells a contact from exact zeros
    assert not f[~done.trace.contact].any()
    assert done.summary["identification"]["z"]["stiffness"] == pytest.approx(K, rel=5e-3)


@pytest.mark.parametrize("kind", [*HIL, *PHYSICAL])
def test_a_run_alone_is_the_run_in_a_batch_bit_for_bit(kind, gantry) -> None:
    tracking = None if kind in PHYSICAL else "servo"
    runs = [
        bounce(
            kind,
            gantry,
            tracking,
            {"approach.velocity.2": v, "duration": 0.1, "approach.gap": 1e-3},
        )
        for v in (0.03, 0.05, 0.02)
    ]
    together = run_batch(runs, trace=True)[1].trace
    alone = run_batch(runs[1:2], trace=True)[0].trace
    assert together is not None
    assert alone is not None
    for name, column in alone.columns().items():
        assert np.array_equal(
            column, together.columns()[name], equal_nan=column.dtype.kind == "f"
        ), name


@pytest.mark.parametrize(
    "kind", ["stewart", "air_bearing", *map(slow, ("serial_arm", "two_arms", "mjcf", "suspension"))]
)
def test_a_campaign_runs_on_it(kind, gantry, tmp_path) -> None:
    """Its cases are the runs alone."""
    base = bounce(
        kind, gantry, None if kind in PHYSICAL else "servo", {"approach.gap": 1e-3, "duration": 0.2}
    )
    (tmp_path / "base.yaml").write_text(dump_scenario(base))
    (tmp_path / "campaign.yaml").write_text(
        "scenario: base.yaml\nvary:\n  approach.velocity.2: {values: [0.02, 0.04]}\ndesign: "
        "{kind: grid}\n"
    )
    found = sweep(tmp_path / "campaign.yaml", tmp_path / "out").to_pandas()
    alone = simulate(
        [
            load_scenario(tmp_path / "base.yaml", set={"approach.velocity.2": v})
            for v in (0.02, 0.04)
        ]
    ).figures
    assert found["peak_force"].tolist() == [f.peak_force for f in alone]
    assert found["peak_force"].is_monotonic_increasing


@pytest.mark.parametrize("kind", ["stewart", "two_arms", "suspension"])
def test_a_snapshot_goes_on_as_the_run_did(kind, gantry) -> None:
    scenario = bounce(kind, gantry, None if kind in PHYSICAL else "servo", {"approach.gap": 1e-3})
    loop = Loop([scenario])
    kept = Snapshots(loop)
    for _ in range(600):
        kept.keep()
        loop.step()
    loop.trouble[0] = (loop.k, "stopped", "for the test")
    state = kept.failures()[0]
    again = Loop([scenario])
    assert restore(again, state)
    rows = [Trace(1200, 1, scenario.rate, loop.plant.units) for _ in range(2)]
    for _ in range(100):
        loop.step(rows[0])
    while again.k < loop.k:
        again.step(rows[1])
    for name, column in rows[0].data.items():
        assert np.array_equal(column[600:700], rows[1].data[name][600:700], equal_nan=True), name


@pytest.mark.parametrize("kind", ["two_arms", "air_bearing"])
def test_the_run_folder_has_the_joints_that_there_are(kind, gantry, tmp_path) -> None:
    """Thirteen joints have thirteen columns, each with its unit; where nothing is driven there are
    none. The recording is drawn.
    """
    done = run(bounce(kind, gantry, None if kind in PHYSICAL else "servo", {"duration": 0.1}))
    write_run(done, tmp_path / "run")
    again = read_run(tmp_path / "run").trace
    assert again is not None
    expected = {"two_arms": ("rad",) * 12 + ("m",), "air_bearing": ()}[kind]
    assert again.joints == expected
    assert [name for name in again.columns() if name.startswith("slider_act.")] == [
        f"slider_act.{j}" for j in range(len(expected))
    ]
    assert (tmp_path / "run" / "recording.rrd").stat().st_size > 1e5


def test_bodies_that_move_by_themselves_have_neither_command_nor_ledger() -> None:
    done = run(bounce("air_bearing", tracking=None, set={"sensor.delay": 0.005}))
    assert done.trace is not None
    assert np.array_equal(done.trace["pose_cmd"], done.trace["pose_act"])
    assert np.array_equal(done.trace["wrench_comp"], done.trace["wrench_true"])
    assert [entry["source"] for entry in done.summary["delay_ledger"]] == ["total"]
    assert done.summary["status"] == "completed"


def test_a_level_floor_without_film_is_free_flight() -> None:
    """Two floats of 500 and 2000 kg with nothing that holds them bounce as the free bodies do."""
    nothing = {
        "float_mass": 0.0,
        "tilt": [0.0, 0.0],
        "film_damping": 0.0,
        "friction": 0.0,
        "hose_stiffness": 0.0,
        "hose_damping": 0.0,
    }
    done = run(bounce("air_bearing", tracking=None, **nothing)).summary
    assert done["cor"] == pytest.approx(done["cor_reference"], rel=1e-3)


def test_a_rig_of_the_users_own_docks(gantry) -> None:
    """A bridge crane with a wrist, hung over its work, captures the probe in the cone."""
    about = {"kind": "mjcf", "model": gantry}
    start = {
        "approach.gap": 0.12,
        "approach.offset": [0.02, 0.01],
        "approach.attitude_deg": [1, 0, 2],
    }
    scenario = load_scenario(
        SCENARIOS / "09-docking.yaml", set={"rig.platform": about, "duration": 4.0} | start
    )
    done = run(scenario).summary
    assert done["outcome"] == "captured"
    assert done["tracking_error"] < 2e-3


def test_a_joint_past_its_limit_stops_the_run() -> None:
    """The facility's own limits are watched: a hydraulic leg asked for more than its valve lets
    through.
    """
    drive = {"kind": "hydraulic", "speed": 0.06}
    done = run(
        bounce("stewart", set={"approach.velocity.2": 0.1, "approach.gap": 0.1}, drive=drive)
    ).summary
    assert done["status"] == "stopped"
    assert "joint leg_" in done["stop_reason"]
    assert "its limit is 0.06 m/s" in done["stop_reason"]


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        (
            "stewart",
            {"approach.gap": 0.9},
            r"approach: starts at a pose that the platform cannot reach",
        ),
        (
            "serial_arm",
            {"rate": 900.0, "physics_rate": 1800.0},
            r"controller_rate: does not divide the loop's rate",
        ),
        (
            "two_arms",
            {"mechanism.mount": {"stiffness": [1e6] * 6, "damping": [1e3] * 6}},
            r"mechanism.mount: cannot be combined",
        ),
        (
            "serial_arm",
            {"rig.upper.kind": "prs3"},
            r"rig.upper.kind: belongs to the 3-3 PSS platform",
        ),
        ("mjcf", {"rig.platform.model": "absent.xml"}, r"rig.platform.model: .*no such file"),
        ("air_bearing", {"approach.offset": [0.0, 0.02]}, r"approach: .*do not go along y"),
    ],
)
def test_what_a_facility_cannot_play_is_said_before_the_run(kind, change, said, gantry) -> None:
    with pytest.raises(InputError, match=said):
        bounce(kind, gantry, None if kind in PHYSICAL else "servo", change)


def test_a_fault_in_a_rig_of_the_users_own_is_named(gantry, tmp_path) -> None:
    """Two bounces on the crane with a contact that is a sixth stiffer than believed: named, with
    its factor.
    """
    keys = {
        "rig.platform": {"kind": "mjcf", "model": gantry},
        "duration": 0.5,
        "approach.gap": 0.005,
    }
    nominal = load_scenario(SCENARIOS / "18-stewart.yaml", set=keys)
    (tmp_path / "nominal.yaml").write_text(dump_scenario(nominal))
    lines = ["scenario: nominal.yaml", "runs:"]
    for i, speed in enumerate((0.02, 0.05)):
        hidden = {
            "effects": [{"kind": "contact.stiffness", "factor": 1.15}],
            "approach.velocity.2": speed,
            "seed": i,
        }
        done = run(load_scenario(SCENARIOS / "18-stewart.yaml", set=keys | hidden))
        assert done.trace is not None
        write_trace(done.trace, tmp_path / f"run{i}.parquet")
        lines.append(f"  - {{file: run{i}.parquet, set: {{approach.velocity.2: {speed}}}}}")
    (tmp_path / "dataset.yaml").write_text("\n".join(lines) + "\n")
    found = judge(investigate(load_dataset(tmp_path / "dataset.yaml"))).verdict
    assert found.verdict == "named"
    (cause,) = found.causes
    assert cause.effect == "contact.stiffness"
    assert cause.fitted.parameters()["factor"] == pytest.approx(1.15, abs=0.01)


@pytest.mark.parametrize("kind", ["pss33", slow("stewart")])
def test_a_response_in_place_of_drives_is_the_second_order_with_its_delay(kind) -> None:
    """A property of the platform: the same bounce as the two effects that make a perfect platform
    lag and come late.
    """
    keys = {
        "rate": 2000.0,
        "physics_rate": 4000.0,
        "mechanism.contact.stiffness": 1e4,
        "duration": 2.0,
        "rig.platform.kind": kind,
    }
    answer = {"bandwidth": 10.0, "damping_ratio": 0.7, "delay": 0.006}
    own = load_scenario(
        SCENARIOS / "02-bumper.yaml",
        set=keys | {"rig.platform.tracking": "response", "rig.platform.response": answer},
    )
    effects = [
        {"kind": "platform.delay", "delay": 0.006},
        {"kind": "platform.lag", "bandwidth": 10.0},
    ]
    other = load_scenario(SCENARIOS / "02-bumper.yaml", set=keys | {"effects": effects})
    first, second = hiltestbed.run(own).summary, hiltestbed.run(other).summary
    assert first["cor"] == pytest.approx(second["cor"], rel=1e-9)
    assert first["stability"]["net_damping"] == pytest.approx(
        second["stability"]["net_damping"], rel=1e-6
    )
    assert first["delay_ledger"][-2]["source"] == "platform.response"
    assert first["delay_ledger"][-2]["delay"] == pytest.approx(
        0.006 + 1.4 / (2.0 * math.pi * 10.0), rel=0.02
    )
