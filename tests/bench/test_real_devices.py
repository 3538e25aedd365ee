"""Real machines: what the manifest must hold without the data; experts on simulated machines."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hiltestbed.bench.real import DEVICES, experts
from hiltestbed.bench.real.device import AxisRecord, Device, split
from hiltestbed.bench.real.peer import sysid_of

UNITS = {
    "drive": ({"N", "N m", "A", "V"}, {"m", "rad"}),
    "servo": ({"m", "rad"}, {"m", "rad"}),
    "damper": ({"m", "rad"}, {"N", "N m"}),
}
NOMINAL = {
    "drive": {"mass", "gain"},
    "servo": set(),
    "damper": {"stiffness", "damping"},
}


@pytest.mark.parametrize("device", DEVICES, ids=lambda d: d.name)
def test_the_manifest_of_a_device_is_whole(device: Device) -> None:
    assert device.files
    for path, sha256 in device.files.items():
        assert not Path(path).is_absolute()
        assert re.fullmatch(r"[0-9a-f]{64}", sha256)
    assert device.fit
    assert device.left_out
    assert not set(device.fit) & set(device.left_out)
    assert device.units[0] in UNITS[device.kind][0]
    assert device.units[1] in UNITS[device.kind][1]
    assert set(device.nominal) == NOMINAL[device.kind]
    assert re.match(r"github:[\w-]+/[\w.-]+, ", device.source)
    assert device.licence


def test_names_are_unique() -> None:
    assert len({d.name for d in DEVICES}) == len(DEVICES)


def test_a_file_that_is_not_the_described_one_is_absent(tmp_path: Path) -> None:
    device = DEVICES[0]
    path = next(iter(device.files))
    (tmp_path / path).parent.mkdir()
    (tmp_path / path).write_text("something else")
    assert device.absent(tmp_path) == list(device.files)


def test_parts_of_a_record_are_the_record() -> None:
    t = np.asarray([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6], dtype=np.float64)
    parts = split(AxisRecord("whole", t, np.sin(t), np.cos(t)), "a", "b")
    assert [p.name for p in parts] == ["a", "b"]
    assert all(p.t[0] == 0 for p in parts)
    np.testing.assert_array_equal(np.concatenate([p.y for p in parts]), np.cos(t))


def _moved(mass: float, viscous: float, forwards: float, backwards: float) -> AxisRecord:
    """A carriage pushed by a force of two frequencies: integrated by SciPy, with a steep sign."""
    t = np.asarray(np.arange(8000) * 1e-3, dtype=np.float64)

    def force(time: float) -> float:
        return 60 * np.sin(2 * np.pi * 0.5 * time) + 40 * np.sin(2 * np.pi * 1.7 * time)

    def motion(time: float, state: np.ndarray) -> list[float]:
        v = state[1]
        dry = (forwards if v > 0 else backwards) * np.tanh(v / 1e-3)
        return [v, (force(time) - viscous * v - dry) / mass]

    y = solve_ivp(motion, (0, t[-1]), [0, 0], t_eval=t, method="LSODA", rtol=1e-7).y[0]
    return AxisRecord("moved", t, np.array([force(x) for x in t]), y)


def test_the_drive_expert_finds_mass_and_friction_each_way() -> None:
    record = _moved(20.0, 30.0, 8.0, 12.0)
    start = experts.drive_regression([record], window=0.02, slow=0.02)
    p = experts.fitted(lambda p, r: experts.drive(p, r, window=0.0), [record], start)
    np.testing.assert_allclose(
        [1 / p[0], p[1] / p[0], p[2] / p[0], p[3] / p[0]], [20, 30, 8, 12], rtol=0.03
    )


def test_a_slider_behind_a_play_loses_its_loop_in_each_cycle() -> None:
    """Work of a cycle of amplitude A: 4 limit (A - limit / k - play / 2), without rest."""
    k, limit, play, amplitude = 5e3, 20.0, 2e-3, 0.02
    x = amplitude * np.sin(np.linspace(0, 4 * np.pi, 20001))
    force = experts.slider(np.array([k, limit, limit, play]), x)
    second = slice(10000, None)
    work = float(np.sum(0.5 * (force[second][1:] + force[second][:-1]) * np.diff(x[second])))
    assert work == pytest.approx(4 * limit * (amplitude - limit / k - play / 2), rel=1e-3)


def test_the_servo_law_without_play_and_limit_is_the_second_order_step() -> None:
    omega, damping = 20.0, 0.5
    t = np.arange(0, 1, 0.01)
    y = experts.servo(
        np.array([omega, damping, 0.05, 0.0, 1e3, 0.0, 1.0]),
        AxisRecord("step", t, np.where(t > 0, 1.0, 0.0), 0 * t),
        steps=100,
    )
    after = np.maximum(t - 0.06, 0)
    free = omega * np.sqrt(1 - damping**2)
    decay = np.exp(-damping * omega * after)
    step = 1 - decay * (np.cos(free * after) + damping * omega / free * np.sin(free * after))
    np.testing.assert_allclose(y, step, atol=0.01)


def test_bouc_wen_at_constant_speed_is_its_dashpots_and_its_force() -> None:
    """Past its reach z = 1, and the speed behind the dashpot follows from the balance of forces."""
    alpha, damping, dashpot, stiffness, offset = 100.0, 50.0, 2e3, 30.0, 4.0
    t = np.linspace(0, 1, 1001)
    x = 0.1 * t
    p = np.array([alpha, 1e-3, 2.0, damping, dashpot, stiffness, offset])
    force = experts.bouc_wen(p, AxisRecord("ramp", t, x, 0 * t))
    behind = (dashpot * 0.1 - alpha) / (damping + dashpot)
    assert force[-1] == pytest.approx(alpha + damping * behind + stiffness * 0.1 + offset, rel=1e-3)


def test_the_peer_finds_the_carriage_or_is_absent() -> None:
    """Of a machine that is no drive, and without the extras of `mujoco[sysid]`, there is none."""
    sysid = pytest.importorskip("mujoco.sysid")
    drive = next(d for d in DEVICES if d.name == "emps")
    record = _moved(80.0, 30.0, 8.0, 8.0)
    found = sysid_of(drive, [record])
    if not hasattr(sysid, "optimize"):
        assert found is None
        return
    assert found is not None
    assert np.std(found(record) - record.y) < 0.02 * np.std(record.y)
    assert sysid_of(next(d for d in DEVICES if d.kind == "damper"), [record]) is None
