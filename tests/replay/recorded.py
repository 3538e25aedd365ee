"""Runs of the loop whose own records are replayed: without noise, so that nothing but the models is
between record and replay.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.contact.parameters import mechanism_parameters
from hiltestbed.contact.settings import Mechanism
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects import Effect
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array, pose_step
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.platform.build import lockstep_key, runs_of
from hiltestbed.platform.facilities.facility import Runs
from hiltestbed.replay import Felt, replay_wrench
from hiltestbed.replay.wrench import Lane
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.simulation import simulate

SCENARIOS = Path(__file__).parents[2] / "scenarios"
QUIET = {"sensor.noise": 0.0, "sensor.torque_noise": 0.0}

# A hit beside the axis at once, tilted, sliding and turning: everything that the contact can do is
# in a third of a second.
HIT = {"approach.gap": 0.001, "duration": 0.35, "compensation.force": {"kind": "phase_lead"}}
# Probe and cone from just before the touch: down the cone, into the socket, latched at 0.5 s.
DOCKING = {
    "approach.gap": 0.055,
    "approach.offset": [0.05, -0.02],
    "approach.velocity": [0.0, 0.0, 0.1],
    "duration": 1.6,
    "mechanism.latch": {"depth": 0.006, "angle_deg": 5.0, "speed": 0.2},
}
# Held from the start, at a rate at which no drive has to follow anything.
HELD = {"duration": 0.4, "compensation.force": {"kind": "phase_lead"}}
MOUNT = {
    "stiffness": [2e5, 2e5, 3e5, 2e4, 2e4, 1e4],
    "damping": [1500.0, 1500.0, 2000.0, 12.0, 12.0, 8.0],
}

RIGS: dict[str, tuple[str, dict[str, Any]]] = {
    "bumper": ("02-bumper", {"approach.gap": 0.001, "duration": 0.25}),
    "bumper with friction": ("05-off-centre", HIT),
    "bumper on a mount": ("05-off-centre", HIT | {"mechanism.mount": MOUNT}),
    "probe and cone": ("09-docking", DOCKING | {"mechanism.latch": None}),
    "probe and cone with latch": ("09-docking", DOCKING),
    "probe and cone with latch on a mount": ("09-docking", DOCKING | {"mechanism.mount": MOUNT}),
    "latched": (
        "13-ring-down",
        HELD
        | {
            "mechanism.mount": None,
            "mechanism.contact.stiffness": 2e5,
            "mechanism.contact.damping": 2e3,
        },
    ),
    "latched on a mount": ("13-ring-down", HELD),
}


def scenario(
    rig: str, tracking: str = "ideal", changes: Mapping[str, Any] | None = None
) -> Scenario:
    """The scenario of one of the :data:`RIGS`, without noise."""
    name, own = RIGS[rig]
    return load_scenario(
        SCENARIOS / f"{name}.yaml",
        set=QUIET | own | {"rig.platform.tracking": tracking} | dict(changes or {}),
    )


@dataclass
class Recorded:
    """The records of runs of one structure: scenarios and groups (R, N, ...)."""

    scenarios: list[Scenario]
    data: dict[str, Array]

    def __getitem__(self, group: str) -> Array:
        return self.data[group]

    @property
    def lanes(self) -> np.ndarray:
        """(R,) one lane a run."""
        return np.arange(len(self.scenarios))


def record(scenarios: Sequence[Scenario]) -> Recorded:
    """Run the loop; every run has to come to its end."""
    data: dict[str, list[Array]] = {}
    groups: dict[Hashable, list[int]] = {}
    for i, s in enumerate(scenarios):
        groups.setdefault(lockstep_key(s), []).append(i)
    for numbers in groups.values():
        batch = simulate([scenarios[i] for i in numbers], trace=True)
        assert not batch.trouble, batch.trouble
        for name, array in batch.trace.data.items():
            rows = data.setdefault(name, [np.empty(0)] * len(scenarios))
            for k, i in enumerate(numbers):
                rows[i] = array[:, k]
    return Recorded(list(scenarios), {name: np.stack(rows) for name, rows in data.items()})


def carried(scenarios: Sequence[Scenario]) -> tuple[list[Mechanism], Array, Runs]:
    """What the sides of scenarios are carried with, along whatever path."""
    start = approach_states(s.approach for s in scenarios)
    return [s.mechanism for s in scenarios], start, runs_of(scenarios)


def felt(recorded: Recorded) -> Felt:
    """What the lanes of :func:`readings` share; under a servo with the twist of the rig."""
    first = recorded.scenarios[0]
    before = np.empty((len(recorded.scenarios), 7))
    for i in range(len(before)):
        pose_step(recorded["pose_act"][i, 0], recorded["twist_act"][i, 0], -first.tick, before[i])
    driven = first.rig.platform.tracking == "servo"
    rates = recorded["twist_act"] if driven else None
    along = Felt.along(*carried(recorded.scenarios), recorded["pose_act"], rates)
    return replace(along, before=before)


def laws(s: Scenario, effects: Sequence[Effect]) -> Array:
    """(C + 1, PARAMETERS) of the candidates and the latch of a scenario's mechanism."""
    rules = sides_of(s.mechanism).rules
    return mechanism_parameters([s.mechanism], [effects], rules).laws[0]


def lane(s: Scenario, run: int, effects: Sequence[Effect] | None = None) -> Lane:
    """Contact, sensor and record of a scenario, with its own effects or with others."""
    effects = s.effects if effects is None else effects
    return Lane(
        run,
        laws(s, effects),
        SensorParameters.believed(s.sensor).with_effects(effects),
        LogParameters().with_effects(effects),
    )


def readings(
    recorded: Recorded, effects: Sequence[Effect] | None = None, shared: Felt | None = None
) -> Array:
    """(R, N, 6) what contact and sensor make of the recorded poses, with any effects."""
    lanes = [lane(s, i, effects) for i, s in enumerate(recorded.scenarios)]
    grid = recorded.scenarios[0].substeps
    return replay_wrench(felt(recorded) if shared is None else shared, lanes, grid=grid)
