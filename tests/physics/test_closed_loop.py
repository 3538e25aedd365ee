"""Laws that the whole loop obeys."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed.loop import Loop
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.signals import AXES
from hiltestbed.simulation import run_batch, simulate
from tests.physics.closed_forms import cor_at_zero_force, cor_pure_delay

K, MU = 1.0e5, 400.0  # 500 kg against 2000 kg
W = math.sqrt(K / MU)


def head_on(**changes: object) -> Scenario:
    return load_scenario(
        "02-bumper", set={key.replace("__", "."): value for key, value in changes.items()}
    )


@pytest.mark.parametrize("damping", [0.0, 400.0, 2500.0])
def test_a_rebound_without_delay_is_the_closed_form(damping: float) -> None:
    figures = simulate([head_on(mechanism__contact__damping=damping)]).figures[0]
    assert figures.cor is not None
    assert abs(math.log(figures.cor / cor_at_zero_force(K, damping, MU))) < 2e-3
    # sd of the momentum: impulse = mu (v_approach + v_rebound), to round-off
    assert figures.impulse == pytest.approx(MU * 0.03 * (1.0 + figures.cor), rel=1e-9)


@pytest.mark.parametrize("w_tau", [0.063, 0.251, 1.005])
def test_a_pure_delay_makes_the_energy_of_the_exact_series(w_tau: float) -> None:
    scenario = head_on(mechanism__contact__damping=0.0, sensor__delay=w_tau / W)
    figures = simulate([scenario]).figures[0]
    assert figures.cor == pytest.approx(cor_pure_delay(W, w_tau / W), rel=5e-3)
    # what the rebound has more than the approach
    made = 0.5 * MU * 0.03**2 * (figures.cor**2 - 1.0)
    assert figures.energy_generated == pytest.approx(made, rel=1e-3)


@pytest.mark.parametrize("rate", [1000, 4000])
def test_the_coupling_adds_no_delay(rate: int) -> None:
    """A hold would add half a tick, ln e = (pi/2) w h/2; less than a twentieth is there."""
    figures = simulate([head_on(rate=rate, physics_rate=2 * rate)]).figures[0]
    assert (
        abs(math.log(figures.cor / cor_at_zero_force(K, 400.0, MU)))
        < 0.5 * math.pi * W * 0.05 / rate
    )


def test_free_flight_makes_neither_force_nor_energy() -> None:
    ideal = {"rig.platform.tracking": "ideal"}
    batch = simulate([load_scenario("01-free-flight", set=ideal)], trace=True)
    assert not batch.trace.contact.any()
    assert not batch.trace["wrench_true"].any()
    assert batch.figures[0].energy_generated == 0.0
    assert batch.figures[0].cor is None


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_stiffness_and_damping_are_identified_through_the_delay(tracking: str) -> None:
    """5 ms late, noise 0.2 % of the peak, one contact. c within 3 %: sd(c)/c = sqrt(2/N) 0.002/(2
    zeta) = 0.2 % with N = 390.
    """
    name = "04-bumper-delay-compensated"
    scenarios = [
        load_scenario(name, set={"rig.platform.tracking": tracking, "seed": seed})
        for seed in range(8)
    ]
    batch = simulate(scenarios)
    for identified in batch.identification:
        assert identified["z"]["stiffness"] == pytest.approx(K, rel=5e-3)
        assert identified["z"]["damping"] == pytest.approx(400.0, rel=3e-2)


@pytest.mark.parametrize(
    ("force", "identification"),
    [("resynchronised", "rls")]
    + [("none", kind) for kind in ("rls_lead", "kalman", "hunt_crossley", "instrumental")],
)
def test_the_same_seed_gives_the_same_bytes_alone_and_in_a_batch(
    force: str, identification: str
) -> None:
    """Across the limit of 16 runs that one Pinocchio model holds."""
    kinds = {"compensation.force": {"kind": force}, "identification": {"kind": identification}}
    base, *others = (
        load_scenario(
            "05-off-centre",
            set=kinds | {"duration": 0.5, "seed": 50 + i, "sensor.delay": 1e-3 + 1e-4 * i},
        )
        for i in range(20)
    )
    alone, again = (simulate([base], trace=True) for _ in range(2))
    among = simulate([*others[:17], base, *others[17:]], trace=True, nthread=2)
    for name, array in alone.trace.data.items():
        assert array[:, 0].tobytes() == again.trace[name][:, 0].tobytes(), name
        assert array[:, 0].tobytes() == among.trace[name][:, 17].tobytes(), name
    assert repr(alone.identification[0]) == repr(among.identification[17])


def test_the_reference_is_the_closed_form() -> None:
    runs = run_batch(
        [head_on(sensor__delay=0.01, mechanism__contact__damping=c) for c in (0.0, 400.0)]
    )
    for run, damping in zip(runs, (0.0, 400.0), strict=True):
        assert (
            abs(math.log(run.summary["cor_reference"] / cor_at_zero_force(K, damping, MU))) < 2e-3
        )
        assert run.summary["cor_log_error"] > 0.2


SCENARIO = "13-ring-down"
DELAY_TICKS = 10  # 5 ms at 2 kHz


def test_each_axis_is_found_through_the_delay_and_does_not_show_on_another() -> None:
    """Six runs, one an axis; with the ports at the centres no lever arm turns a push. The force
    across, as a stiffness over the geometric mean of both axes' own.
    """
    scenarios = []
    for axis in range(6):
        speed = np.zeros(6)
        speed[axis] = 0.006 if axis < 3 else 1.0  # m/s, deg/s
        changes = {
            "approach.velocity": speed[:3].tolist(),
            "approach.rate_deg": speed[3:].tolist(),
            "seed": axis,
            "spacecraft.chaser.port.position": [0, 0, 0],
            "spacecraft.target.port.position": [0, 0, 0],
            "rig.platform.tracking": "ideal",
            "compensation.force": {"kind": "phase_lead"},
        }
        scenarios.append(load_scenario(SCENARIO, set=changes))
    batch = simulate(scenarios, trace=True)
    assert not batch.trouble
    late, now = slice(DELAY_TICKS, None), slice(None, -DELAY_TICKS)
    for i, (axis, identified) in enumerate(zip(AXES, batch.identification, strict=True)):
        found = identified[axis]
        assert found["stiffness"] == pytest.approx(found["stiffness_true"], rel=1e-2), axis
        assert found["damping"] == pytest.approx(found["damping_true"], rel=5e-2), axis
        true = np.array([identified[name]["stiffness_true"] for name in AXES])
        motion = (1.0 if i < 3 else 2.0) * batch.trace["pose_act"][now, i, i]
        rate = batch.trace["twist_act"][now, i, i]
        columns = np.column_stack([motion, rate, np.ones(len(motion))])
        stiffness = np.linalg.lstsq(columns, batch.trace["wrench_meas"][late, i], rcond=None)[0][0]
        assert np.abs(np.delete(stiffness / np.sqrt(true * true[i]), i)).max() < 1e-2, axis


def kinetic(loop: Loop) -> float:
    """[J] of both vehicles of the only run."""
    craft, total = loop.model, 0.0
    for b in range(2):
        v = craft.v[0, b]
        total += 0.5 * craft.mass[0, b] * float(v[:3] @ v[:3]) + 0.5 * float(
            v[3:] @ craft.inertia[0, b] @ v[3:]
        )
    return total


@pytest.mark.parametrize(("offset", "gap"), [((0.06, -0.02), 0.07), ((0.15, 0.0), 0.16)])
def test_a_contact_that_takes_nothing_leaves_the_vehicles_what_the_rig_made(offset, gap) -> None:
    """A spring without damper and friction gives all back: the energy of the rig is the change of
    both vehicles' kinetic energy.
    """
    keys = {
        "approach": {
            "gap": gap,
            "offset": list(offset),
            "velocity": [0.0, 0.0, 0.08],
            "attitude_deg": [1.0, 0.0, 0.0],
        },
        "mechanism": {"kind": "probe_cone", "contact": {"stiffness": 5.0e4}},
        "sensor": {"delay": 0.006},
        "duration": 1.2,
        "compensation.force.kind": "none",
        "identification.kind": "none",
    }
    s = load_scenario("09-docking", keys)
    loop = Loop([s])
    before, apart = kinetic(loop), 0
    while loop.k < s.ticks and apart < 40:
        loop.step(None)
        apart = apart + 1 if loop.tally.contacts[0] and not loop.plant.contact[0] else 0
    gained = kinetic(loop) - before
    assert apart == 40
    assert gained > 0.1
    assert loop.tally.energy[0] == pytest.approx(gained, rel=1e-3)
    assert np.isfinite(loop.tally.figures(0).cor_normal or np.nan)
