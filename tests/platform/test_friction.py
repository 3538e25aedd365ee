"""Friction of the drives: what holds, what slides, what a differential pair leaves of it, and that
it only takes energy.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.pss33 import PRESLIDING
from hiltestbed.platform.friction import BRISTLE, DriveFriction
from hiltestbed.platform.shipped.pss33 import Pss33
from hiltestbed.scenario import Scenario, scenario_from
from tests.platform.rigs import scenario
from tests.running import run

COULOMB, STICTION, STRIBECK, VISCOUS, BIAS = 200.0, 300.0, 0.005, 400.0, 0.3
DT, MASS = 2.5e-4, 85.0  # a step of the physics; carriage and armature


def with_actuator(base: Scenario, kind: str, **numbers: float) -> Scenario:
    data: dict[str, Any] = base.model_dump(mode="json")
    data["rig"]["platform"]["actuator"] |= {"kind": kind} | numbers
    return scenario_from(data)


class Sled:
    """Six masses on drives of one kind, each pushed by its own force."""

    def __init__(self, kind: str) -> None:
        platform = with_actuator(scenario(), kind).rig.platform
        assert isinstance(platform, Pss33)
        law = np.tile(platform.actuator.law(), (1, 6, 1))
        self.friction = DriveFriction(law, PRESLIDING, MASS, np.arange(6), np.arange(6), DT)
        self.x, self.v, self.applied = np.zeros(6), np.zeros((1, 6)), np.zeros((1, 6))

    def drag(self, speed: float, steps: int = 4000) -> float:
        """Friction [N] after some time at a steady speed."""
        self.v[:] = speed
        for _ in range(steps):
            self.rub()
        return -float(self.applied[0, 0])

    def rub(self) -> None:
        self.applied[:] = 0.0
        self.friction.act(self.v, self.applied)

    def push(self, force: Array | float) -> None:
        self.rub()
        self.v += DT / MASS * (force + self.applied)
        self.x += DT * self.v[0]


def test_a_slider_breaks_away_at_the_stiction() -> None:
    """Pushed by what grows by 100 N/s. Before it goes the speed is that of the bristle, far below
    the Stribeck speed.
    """
    sled = Sled("single")
    for k in range(20_000):
        force = 100.0 * k * DT
        sled.push(force)
        if abs(sled.x[0]) > 6.5e-6:  # the bristle reaches 300 N at 6 um
            break
    assert force == pytest.approx(STICTION, rel=5e-3)


def test_below_break_away_it_holds_and_does_not_creep() -> None:
    """Shaken at two thirds of the break-away for 5 s: it stays on its bristle, 200 N/5e7 N/m = 4 um."""
    sled = Sled("single")
    for k in range(20_000):
        sled.push(200.0 * math.sin(2.0 * math.pi * 30.0 * k * DT))
    assert abs(sled.x[0]) < 5e-6
    for _ in range(4000):
        sled.push(0.0)
    assert abs(sled.x[0]) < 1e-9


def test_sliding_friction_is_the_stribeck_curve() -> None:
    for v in (1e-3, 5e-3, 2e-2, -2e-2, 0.3):
        curve = COULOMB + (STICTION - COULOMB) * math.exp(-((v / STRIBECK) ** 2))
        expected = math.copysign(curve, v) + VISCOUS * v
        assert Sled("single").drag(v) == pytest.approx(expected, rel=1e-9)


def test_a_pair_has_no_friction_at_standstill_and_half_the_viscous_part_until_a_motor_reverses() -> (
    None
):
    """(f(v/2 + b) + f(v/2 - b))/2: the Coulomb terms cancel, and (f_v (v/2 + b) + f_v (v/2 - b))/2
    = f_v v/2; past twice the bias they add.
    """
    for speed in (-0.2, -1e-6, 0.0, 1e-3, 0.2):
        assert Sled("dual").drag(speed) == pytest.approx(0.5 * VISCOUS * speed, abs=1e-9)
    assert Sled("dual").drag(2.0 * BIAS + 0.1) > COULOMB


@pytest.mark.parametrize("kind", ["single", "dual"])
def test_friction_only_takes_energy(kind: str) -> None:
    """Six sliders thrown and left alone: kinetic energy and that of the bristles never grows beyond
    what the step makes, (v dt)^2.
    """
    sled = Sled(kind)
    sled.v[0] = [0.2, -0.1, 0.01, 1e-3, -1e-4, 0.05]
    if kind == "dual":
        sled.friction.settle(sled.v)
    stiffness = sled.friction.numbers[0, 0, BRISTLE]
    bristles = 1 if kind == "single" else 0  # those of the pair slide at the bias throughout

    def energy() -> Array:
        spring = 0.5 * stiffness * sled.friction.bristles[0, :, 0] ** 2 * bristles
        return np.asarray(0.5 * MASS * sled.v[0] ** 2 + spring)

    before = start = energy()
    for _ in range(8000):
        sled.push(0.0)
        now = energy()
        assert (now <= before + 0.02 * start + 1e-9).all()
        before = now
    assert (before < 0.01 * start + 1e-9).all() if kind == "single" else (before < start).all()


def test_a_single_drive_makes_energy_at_the_reversal_and_a_pair_does_not() -> None:
    """Head on at 10 mm/s, k = 1e5 N/m, mu = 400 kg. Each slider lags by f_c/kp against its motion,
    so that the contact is short of
    k d going in and long of it coming out: 2 k d x a bounce of depth x = v sqrt(mu/k) on k x^2/2,
        ln e = 2 d/x.
    """
    base = scenario(damping=0.0)
    data = base.model_dump(mode="json")
    data["approach"] |= {"velocity": [0.0, 0.0, 0.01], "gap": 0.002}
    data["duration"] = 0.6
    data["compensation"]["force"] = {"kind": "none"}
    base = scenario_from(data)
    errors = {kind: run(with_actuator(base, kind)).summary for kind in ("ideal", "single", "dual")}
    ideal, single, dual = (errors[kind]["cor_log_error"] for kind in ("ideal", "single", "dual"))
    kp = 214.0 * (2.0 * math.pi * 40.0) ** 2
    expected = 2.0 * (COULOMB / kp) / (0.01 * math.sqrt(400.0 / 1e5))
    assert single - ideal == pytest.approx(expected, rel=0.5)
    assert abs(dual - ideal) < 0.1 * expected
