"""What a run is: the scenario as a whole, files in and out. Its sections belong to the links of the loop.

`load_scenario` reads a file (and `--set` overrides), `dump_scenario` writes the resolved form, in which every default stands.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from hiltestbed import plugins
from hiltestbed.compensation.section import Compensation
from hiltestbed.contact.settings import AnyMechanism
from hiltestbed.devices.section import Devices
from hiltestbed.effects.table import AnyEffect
from hiltestbed.gallery import find_scenario
from hiltestbed.identification.settings import IDENTIFIERS, AnyIdentifier
from hiltestbed.numerical_model.settings import MODELS, AnyModel
from hiltestbed.platform.settings import Rig
from hiltestbed.scenario.checks import problems
from hiltestbed.scenario.monitoring import Monitoring
from hiltestbed.scenario.safety import Safety
from hiltestbed.scenario.spacecraft import Approach, Spacecraft
from hiltestbed.sensor.settings import Sensor
from hiltestbed.validation import Positive, Strictly, refuse, validate
from hiltestbed.yaml_source import Source, dump_yaml, read_source


class Scenario(Strictly):
    """One run: two vehicles, how they meet, the rig that plays it, and what is done about the rig's faults."""

    name: Annotated[str, Field(min_length=1, max_length=200)] = Field(description="Name of the scenario, of which a run folder's is made")
    description: str = Field(default="", description="What the scenario shows, in a sentence or two")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(default=0, description="Seed of the random numbers; the same seed, the same trace")
    duration: Positive = Field(default=3.0, description="Simulated time [s]")
    rate: Annotated[float, Field(gt=0, le=1e6)] = Field(
        default=2000.0, description="Rate of the loop [Hz]: one reading, one step of the numerical model, one command a tick"
    )
    physics_rate: Annotated[float, Field(gt=0, le=4e6)] = Field(
        default_factory=lambda given: 2.0 * given["rate"],  # type: ignore[arg-type]
        description="Rate of the steps of the physics [Hz], a whole multiple of rate; left out: twice rate",
    )
    spacecraft: Spacecraft = Field(description="Both vehicles as the numerical model has them")
    numerical_model: AnyModel = Field(
        default_factory=lambda: MODELS["free_flyers"](kind="free_flyers"),
        description="What moves both vehicles under the compensated wrench",
    )
    approach: Approach = Field(description="Where the active port starts and how it moves, relative to the passive one")
    mechanism: AnyMechanism = Field(description="The docking mechanism: which surfaces meet, and how stiff they are")
    rig: Rig = Field(default=Rig(), description="The motion platform, and what carries the passive side")
    sensor: Sensor = Field(default=Sensor(), description="The force and torque sensor below the passive port, in the order of its chain")
    compensation: Compensation = Field(default=Compensation(), description="What is done against the delays of the loop")
    identification: AnyIdentifier = Field(
        default_factory=lambda: IDENTIFIERS["rls"](kind="rls"),
        description="How stiffness and damping are estimated while the contact lasts",
    )
    monitoring: Monitoring | None = Field(
        default=None, description="Touch, seat, capture and wear as the identification tells them; null: not watched"
    )
    safety: Safety = Field(default=Safety(), description="Limits past which the run stops; null: not watched")
    devices: Devices = Field(default=Devices(), description="Real devices in the place of the simulated rig, for live, emulate, commission")
    effects: Annotated[tuple[AnyEffect, ...], Field(strict=False)] = Field(
        default=(), description="Departures of the rig from what is believed of it: a list of {kind: ID, parameter: value}"
    )

    @property
    def tick(self) -> float:
        """Time between two passes of the loop [s]."""
        return 1.0 / self.rate

    @property
    def ticks(self) -> int:
        """Passes of the loop in the whole run."""
        return round(self.duration * self.rate)

    @property
    def substeps(self) -> int:
        """Steps of the physics in one tick."""
        return round(self.physics_rate / self.rate)

    @model_validator(mode="after")
    def _is_possible(self) -> Scenario:
        refuse(problems(self))
        return self


@plugins.depends
def _rebuild() -> None:
    """List the classes of a plugin in the schema, too."""
    for model in (Compensation, Rig, Scenario):
        model.model_rebuild(force=True)


def load_scenario(path: str | Path, set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in a YAML file, or the one shipped under a name, with dotted keys overridden. Raises InputError.

    >>> load_scenario("02-bumper", {"approach.velocity.2": 0.05}).approach.velocity
    (0.0, 0.0, 0.05)
    """
    return scenario_from(read_source(find_scenario(path)).with_set(set))


def scenario_from(source: Source | Mapping[str, Any], set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in data that is read already: a `Source`, or a plain dict as it would stand in a file. Raises InputError."""
    plugins.load()
    if not isinstance(source, Source):
        source = Source("scenario", dict(source))
    return validate(Scenario, source.with_set(set), _SPECIMEN)


_BODY = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0]}
_SPECIMEN = {  # holds whatever the other keys are: stands in for what is refused while the rest is checked
    "name": "specimen",
    "duration": 1.0,
    "spacecraft": {"chaser": _BODY, "target": _BODY},
    "approach": {"velocity": [0.0, 0.0, 0.0]},
    "mechanism": {"kind": "bumper", "contact": {"stiffness": 1.0}},
}


def resolved(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain data with every default written out; `scenario_from` gives the same scenario back."""
    return scenario.model_dump(mode="json")


def dump_scenario(scenario: Scenario) -> str:
    """The resolved scenario as YAML text."""
    return dump_yaml(resolved(scenario))


def scenario_sha256(scenario: Scenario) -> str:
    """SHA-256 of the resolved form, the same however the file was written; models of the user's count by their content."""
    data = resolved(scenario)
    data["mechanism"] |= scenario.mechanism.fingerprint()
    canonical = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
