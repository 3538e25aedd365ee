"""The closed loop against records of a rig that shares no code with it, healthy and with 3.3 ms of
extra sensor delay.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from hiltestbed import load_scenario
from hiltestbed.simulation import simulate
from tests.measured_data import measured_data

EFFECTS = {"set_1": [], "set_8": [], "set_2": [{"kind": "sensor.delay", "delay": 0.0033}]}


@pytest.mark.parametrize(("name", "number"), list(product(EFFECTS, (0, 5))))
def test_the_loop_runs_as_the_independent_rig(name: str, number: int) -> None:
    folder = measured_data("rig_practice") / name
    entry = YAML(typ="safe").load(folder / "dataset.yaml")["runs"][number]
    scenario = load_scenario(folder / "nominal.yaml", set=entry["set"] | {"effects": EFFECTS[name]})
    trace = simulate([scenario], trace=True).trace
    assert trace is not None
    table = pq.read_table(folder / entry["file"])
    force = trace["wrench_meas"][:, 0, 2] - table["wrench_meas.fz"].to_numpy()
    free = ~trace.contact[:, 0]
    # Both records carry noise of their own: the difference has sqrt(2) sigma while nothing touches.
    assert np.std(force[free]) == pytest.approx(np.sqrt(2.0) * scenario.sensor.noise, rel=0.1)
    # The lead makes white noise of sigma (T1/h)/(1 + T2/h) out of sigma; integrated twice it
    # spreads as sigma h^2 n^1.5/(sqrt(3) mu).
    lead = (scenario.sensor.delay + 0.0005) * scenario.rate
    bodies = scenario.spacecraft
    mu = 1.0 / (1.0 / bodies.chaser.mass + 1.0 / bodies.target.mass)
    spread = (
        np.sqrt(2.0 / 3.0) * scenario.sensor.noise * scenario.tick**2 * scenario.ticks**1.5 / mu
        + lead * scenario.tick**2
    )
    pose = trace["pose_cmd"][:, 0, 2] - table["pose_cmd.pz"].to_numpy()
    assert np.abs(pose).max() < 4.0 * spread
    # In contact the force differs by that noise and by the stiffness times the difference of the
    # poses.
    allowed = (
        np.sqrt(2.0) * scenario.sensor.noise
        + scenario.mechanism.contact.stiffness * np.abs(pose).max()
    )
    assert np.median(np.abs(force[~free])) < allowed
