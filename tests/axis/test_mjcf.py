"""An axis as MJCF: read back by MuJoCo and simulated, it gives the prediction of the extended model
within 1 % of the signal.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.axis.dataset import AxisDataset, nominal_of
from hiltestbed.axis.mjcf import axis_mjcf
from hiltestbed.axis.models import drive_law, model_of, started
from hiltestbed.inference.model import Hypothesis
from tests.axis import machines

WITHIN = {"drive": 1e-3, "servo": 0.01, "damper": 0.01}  # of the signal, rms


def spec(axis: str, nominal: dict, effects: list[dict], rotates: bool = False) -> AxisDataset:
    return AxisDataset.model_validate(
        {
            "axis": axis,
            "rotates": rotates,
            "nominal": nominal,
            "effects": effects,
            "runs": [{"file": "run.csv"}],
        }
    )


def predicted(of: AxisDataset, run) -> np.ndarray:
    model = model_of(of.axis, [run], nominal_of(of), of.rotates, of.effects)
    return model.predicted(Hypothesis((), np.zeros(0), np.zeros(len(model.nuisances))))[0]


def simulated(text: str, t, u, start, held: bool) -> np.ndarray:
    """Positions at the times ``t`` under the input ``u``, ``held`` or linear between them."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[0] = start[0], start[1]
    names = {model.actuator(i).name: i for i in range(model.nu)}
    if model.na:  # what a filter or a limited speed has held before the start
        data.act[0] = u[0]
    h = model.opt.timestep
    steps = int(round((t[-1] - t[0]) / h)) + 1
    at = t[0] + h * np.arange(steps)
    before = np.searchsorted(t, at + 1e-9 * h, side="right") - 1
    drive, out = u[before] if held else np.interp(at, t, u), np.zeros(steps)
    speed = np.gradient(drive, h)
    for k in range(steps):
        mujoco.mj_forward(model, data)
        out[k] = data.sensor("position").data[0]
        data.ctrl[0] = drive[k]
        if "command_speed" in names:
            data.ctrl[names["command_speed"]] = speed[k]
        mujoco.mj_step(model, data)
    return np.interp(t, at, out)


def compare(of: AxisDataset, run, start=None, offset: float = 0.0) -> list[str]:
    """What is left unsaid; ``offset``: that is to be added to the simulated position."""
    text, said, unsaid = axis_mjcf(of, ["test"])
    expected = predicted(of, run)
    start = start or (float(expected[0]) - offset, 0.0)
    found = simulated(text, run.t, run.u, start, of.axis == "drive") + offset
    off = float(np.sqrt(np.mean((found - expected) ** 2))) / float(np.std(expected))
    assert off < WITHIN[of.axis], (off, said, unsaid)
    return unsaid


FORCE = {"kind": "dynamics.force", "viscous": 130.0, "coulomb": 18.0, "offset": 4.0}
DRIVES = {
    "mass and friction": ([FORCE, {"kind": "dynamics.mass", "factor": 1.2}], 42.0 / 1.2, 0.0, False),
    "friction of two directions": (
        [FORCE | {"offset": 0.0, "coulomb": 14.0, "coulomb_back": 22.0}], 42.0, 0.0, False
    ),
    "gain": (
        [FORCE, {"kind": "dynamics.gain", "factor": 2.0}, {"kind": "dynamics.mass", "factor": 2.0}],
        21.0, 0.0, False,
    ),
    "gravity on a hinge": (
        [FORCE, {"kind": "dynamics.gravity", "sine": 60.0, "cosine": 0.0}], 42.0, 60.0, True
    ),
    "spring on a hinge": (
        [FORCE, {"kind": "dynamics.spring", "stiffness": 60.0, "rest": 0.4}], 42.0, 0.0, True
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_moves_as_predicted(name: str) -> None:
    """Over 4 s from rest: an axis that nothing holds integrates each error of its force twice."""
    effects, mass, gravity, rotates = DRIVES[name]
    run = machines.carriage(0, gravity=gravity)
    run = type(run)(run.name, run.t[:2000], run.u[:2000], run.y[:2000])
    of = spec("drive", {"mass": mass}, effects, rotates)
    law = drive_law(nominal_of(of), of.effects)
    assert not compare(of, run, started(run, 0.0, law.numbers))


LAG = {"kind": "platform.drive", "bandwidth": 6.0, "damping_ratio": 0.8}
SERVOS = {
    "delay and lag": [{"kind": "platform.delay", "delay": 0.0303}, LAG],
    "delay alone": [{"kind": "platform.delay", "delay": 0.05}],
    "poles": [{"kind": "platform.poles", "first": 0.08, "second": 0.02}],
    "one pole": [{"kind": "platform.poles", "first": 0.08}],
    "a pole before the controller": [{"kind": "platform.poles", "first": 0.05}, LAG],
    "friction and load": [LAG | {"friction": 0.01, "offset": -0.02}],
    "limited acceleration": [LAG | {"acceleration_limit": 20.0}],
    "integral action": [LAG | {"integral_time": 0.3, "friction": 0.01}],
    "integral action and a limit": [
        LAG | {"integral_time": 0.3, "friction": 0.03, "acceleration_limit": 60.0}
    ],
    "feed-forward": [{"kind": "platform.delay", "delay": 0.02}, LAG | {"feed_forward": 0.8}],
    "play": [LAG, {"kind": "platform.backlash", "width": 0.04}],
    "scale and offset": [
        LAG, {"kind": "platform.scale", "factor": 0.9}, {"kind": "platform.offset", "offset": 0.1}
    ],
    "speed limit": [LAG, {"kind": "platform.speed_limit", "speed": 0.5}],
}  # fmt: skip


@pytest.mark.parametrize("name", SERVOS)
def test_a_servo_follows_as_predicted(name: str) -> None:
    """On a slide and, every other, on a hinge."""
    rotates = list(SERVOS).index(name) % 2 == 1
    assert not compare(spec("servo", {}, SERVOS[name], rotates), _fine(machines.servo(0)))


def _fine(run):
    """The first 10 s at 1 kHz: between rows a pole takes its command as that of the next."""
    t = np.arange(10_000) / 1000.0
    return type(run)(run.name, t, np.interp(t, run.t, run.u), np.interp(t, run.t, run.y))


def test_an_offset_beside_integral_action_is_left_to_the_reader() -> None:
    effects = [
        LAG | {"integral_time": 0.5},
        {"kind": "platform.scale", "factor": -0.8},
        {"kind": "platform.offset", "offset": 0.05},
    ]
    (unsaid,) = compare(spec("servo", {}, effects), _fine(machines.servo(0)), offset=0.05)
    assert "add 0.05 to the position" in unsaid


def test_a_damper_resists_as_predicted() -> None:
    """A spring, a viscous damper, a preload and a relaxing branch under a given motion."""
    effects = [
        {"kind": "contact.relaxation", "stiffness": 4.0e4, "time_constant": 0.02},
        {"kind": "contact.preload", "force": 35.0},
    ]
    of, run = spec("damper", {"damping": 800.0, "stiffness": 2.0e4}, effects), machines.damper(0)
    text, _, unsaid = axis_mjcf(of)
    assert not unsaid
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    h = model.opt.timestep
    at = np.arange(run.t[0], run.t[-1], h)
    x = np.interp(at, run.t, run.u)
    v, force = np.gradient(x, h), np.zeros(len(at))
    for k in range(len(at)):
        data.qpos[0], data.qvel[0] = x[k], v[k]
        mujoco.mj_step(model, data)
        force[k] = -(data.qfrc_passive + data.qfrc_constraint + data.qfrc_actuator)[0]
    expected = predicted(of, run)
    off = np.interp(run.t, at, force) - expected
    off = off[50:] - np.mean(off[50:])  # each run has a zero of its own
    assert np.sqrt(np.mean(off**2)) < WITHIN["damper"] * np.std(expected)


@pytest.mark.parametrize(
    ("axis", "nominal", "effect", "words"),
    [
        ("drive", {"mass": 1.0}, {"kind": "dynamics.cogging", "amplitude": 1.0, "pitch": 0.1,
                                  "phase": 0.0}, "cogging"),
        ("drive", {"mass": 1.0}, FORCE | {"static": 30.0, "stribeck_speed": 0.01}, "Stribeck"),
        ("drive", {"mass": 1.0}, FORCE | {"viscous_asymmetry": 0.2}, "differs with the direction"),
        ("servo", {}, LAG | {"friction": 0.01, "static": 1.5}, "static above dry friction"),
        ("damper", {"damping": 9.0}, {"kind": "contact.dry_friction", "force": 9.0,
                                      "stiffness": 1e4}, "slips at once"),
    ],
)  # fmt: skip
def test_what_cannot_be_said_stands_in_the_file(axis, nominal, effect, words) -> None:
    text, _, unsaid = axis_mjcf(spec(axis, nominal, [effect]))
    assert any(words in line for line in unsaid)
    assert words in text.partition("-->")[0]
    mujoco.MjModel.from_xml_string(text)
