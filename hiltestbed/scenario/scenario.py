"""The scenario, which defines a run, and its files. Its sections are defined in the packages of the
loop's links.

`load_scenario` reads a file (and `--set` overrides), `dump_scenario` writes the resolved form, with
every default written out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ConfigDict, Field, model_validator

from hiltestbed import plugins
from hiltestbed.compensation.settings import Compensation
from hiltestbed.config.gallery import find_scenario
from hiltestbed.config.mjcf import packed
from hiltestbed.config.validation import (
    Positive,
    Problem,
    Strictly,
    UserFile,
    refuse,
    user_files,
    validate,
)
from hiltestbed.config.yaml_source import KeyPath, Source, dump_yaml, read_source
from hiltestbed.contact.settings import AnyMechanism
from hiltestbed.devices.section import Devices
from hiltestbed.effects.base import repeated
from hiltestbed.effects.table import AnyEffect, by_link
from hiltestbed.identification.settings import IDENTIFIERS, AnyIdentifier
from hiltestbed.numerical_model.settings import MODELS, AnyModel
from hiltestbed.platform.settings import Rig
from hiltestbed.scenario.like import HIGHEST
from hiltestbed.scenario.limits import DockingLimits
from hiltestbed.scenario.monitoring import Monitoring
from hiltestbed.scenario.safety import SafetyLimits
from hiltestbed.scenario.spacecraft import Approach, Spacecraft
from hiltestbed.sensor.settings import Sensor

if TYPE_CHECKING:
    from hiltestbed.contact.touch import Impact

TICK_LIMIT = 20_000_000  # a trace of this many rows fills 16 GB


class Scenario(Strictly):
    """One run: two vehicles, their approach, the rig that reproduces it, and the compensation of
    the rig's delays.
    """

    model_config = ConfigDict(serialize_by_alias=True)  # one key has another name in a file

    name: Annotated[str, Field(min_length=1, max_length=200)] = Field(
        description="Name of the scenario, also of its run folder"
    )
    description: str = Field(
        default="", description="What the scenario shows, in a sentence or two"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        default=0, description="Seed of the random numbers; same seed, same trace"
    )
    duration: Positive = Field(default=3.0, description="Simulated time [s]")
    rate: Annotated[float, Field(gt=0, le=1e6)] = Field(
        default=2000.0,
        description="Rate of the loop [Hz]: one reading, one step of the numerical model and one "
        "command per tick",
    )
    stated_physics_rate: Annotated[float, Field(gt=0, le=HIGHEST)] | None = Field(
        default=None,
        alias="physics_rate",
        description="Rate of the physics steps [Hz], a whole multiple of rate; null or omitted: "
        "twice rate, or as many times as give the first contact, and the parts that it moves, 100 "
        "steps in half a period",
    )
    spacecraft: Spacecraft = Field(description="Both vehicles, as nominal in the numerical model")
    numerical_model: AnyModel = Field(
        default_factory=lambda: MODELS["free_flyers"](kind="free_flyers"),
        description="Dynamics of both vehicles under the compensated wrench",
    )
    approach: Approach = Field(
        description="Initial pose and velocity of the active port relative to the passive port"
    )
    mechanism: AnyMechanism = Field(
        description="The docking mechanism: its surfaces and their contact stiffness"
    )
    rig: Rig = Field(
        default=Rig(), description="The motion platform, and the carrier of the passive side"
    )
    sensor: Sensor = Field(
        default=Sensor(), description="The force-torque sensor below the passive port"
    )
    compensation: Compensation = Field(
        default=Compensation(), description="Compensation of the delays in the loop"
    )
    identification: AnyIdentifier = Field(
        default_factory=lambda: IDENTIFIERS["rls"](kind="rls"),
        description="Identification of stiffness and damping during the contact",
    )
    monitoring: Monitoring | None = Field(
        default=None,
        description="Process monitoring: touch, seating, capture and wear from the "
        "identification; null: off",
    )
    safety: SafetyLimits = Field(
        default=SafetyLimits(),
        description="Safety limits: a run that exceeds one is stopped; null: no limit",
    )
    limits: DockingLimits | None = Field(
        default=None,
        description="Limits of the approach and of the loads on the interface, for a verdict on "
        "the run, which they do not stop; null: none",
    )
    devices: Devices = Field(
        default=Devices(),
        description="Real devices in place of the simulated rig, for live, emulate and commission",
    )
    effects: Annotated[tuple[AnyEffect, ...], Field(strict=False)] = Field(
        default=(),
        description="Departures of the rig from its nominal model: a list of {kind: ID, "
        "parameter: value}",
    )

    @property
    def tick(self) -> float:
        """Time between two passes of the loop [s]."""
        return 1.0 / self.rate

    @property
    def ticks(self) -> int:
        """Number of passes of the loop in the run."""
        return round(self.duration * self.rate)

    @property
    def physics_rate(self) -> float:
        """Rate of the physics steps [Hz]: the stated one, or what the contact needs."""
        if self.stated_physics_rate is not None:
            return self.stated_physics_rate
        from hiltestbed.contact.resolution import sufficient_rate

        return sufficient_rate(self.impact, self.rate)

    @property
    def impact(self) -> Impact:
        """Both vehicles and their mechanism, for what their first contact will be."""
        from hiltestbed.contact.touch import Impact

        acting = tuple(by_link(self.effects, "contact"))
        return Impact(self.mechanism, acting, self.spacecraft, self.approach)

    @property
    def substeps(self) -> int:
        """Steps of the physics in one tick."""
        return round(self.physics_rate / self.rate)

    @model_validator(mode="after")
    def _is_possible(self) -> Scenario:
        refuse(_problems(self))
        return self


def _problems(scenario: Scenario) -> Iterator[Problem]:
    """Every fault of several keys together that needs no model."""
    yield from _time_problems(scenario)
    platform, upper = scenario.rig.platform, scenario.rig.upper
    if upper.kind != "fixed" and not platform.carries_upper:
        message = (
            f"belongs to the 3-3 PSS platform (got {upper.kind!r} with platform kind "
            f"{platform.kind!r}); allowed is fixed"
        )
        yield ("rig", "upper", "kind"), message
    else:
        yield from platform.problems(scenario)
    for index, effect in repeated(scenario.effects):
        message = (
            f"appears twice, and two effects {effect.kind!r} do not act together; allowed is one: "
            f"take one of them out"
        )
        yield ("effects", index), message
    for index, effect in enumerate(scenario.effects):
        if reason := effect.unfit(scenario):
            yield ("effects", index), reason


def _time_problems(scenario: Scenario) -> Iterator[Problem]:
    rate, duration = scenario.rate, scenario.duration
    physics_rate = scenario.stated_physics_rate or rate
    ratio, ticks, delay = physics_rate / rate, duration * rate, scenario.sensor.delay
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        near = max(1, round(ratio)) * rate
        message = (
            f"does not divide by rate (got {physics_rate:g} Hz over {rate:g} Hz = {ratio:g}); "
            f"allowed is a whole multiple of rate, such as {near:g}"
        )
        yield ("physics_rate",), message
    if not 1 <= ticks <= TICK_LIMIT:
        message = (
            f"is out of range (got {duration:g} s at {rate:g} Hz = {ticks:g} ticks); "
            f"allowed are 1 to {TICK_LIMIT} ticks"
        )
        yield ("duration",), message
    if delay > duration:
        message = (
            f"cannot be held (got {delay:g} s in a run of {duration:g} s); allowed is 0 to the "
            f"run's duration"
        )
        yield ("sensor", "delay"), message


@plugins.depends
def _rebuild() -> None:
    """Include the classes of a plugin in the schema."""
    for model in (Compensation, Rig, Scenario):
        model.model_rebuild(force=True)


def load_scenario(path: str | Path, set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in a YAML file, or the one shipped under a name, with dotted keys overridden.
    Raises InputError.

    >>> load_scenario("02-bumper", {"approach.velocity.2": 0.05}).approach.velocity
    (0.0, 0.0, 0.05)
    """
    return scenario_from(read_source(find_scenario(path)).with_set(set))


def scenario_from(
    source: Source | Mapping[str, Any],
    set: Mapping[str, Any] | None = None,
    further: Callable[[Scenario], Iterable[Problem]] = lambda _: (),
) -> Scenario:
    """The scenario from a `Source`, or a dict with the content of a file. Raises InputError, also
    with the ``further`` problems that are found in it.
    """
    plugins.load()
    if not isinstance(source, Source):
        source = Source("scenario", dict(source))
    return validate(Scenario, source.with_set(set), _SPECIMEN, further)


_BODY = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0]}
_SPECIMEN = {  # valid values that replace refused ones, so that the other keys can still be checked
    "name": "specimen",
    "duration": 1.0,
    "spacecraft": {"chaser": _BODY, "target": _BODY},
    "approach": {"velocity": [0.0, 0.0, 0.0]},
    "mechanism": {"kind": "bumper", "contact": {"stiffness": 1.0}},
}


def resolved(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain data with every default written out, from which it is restored."""
    return scenario.model_dump(mode="json") | {"physics_rate": scenario.physics_rate}


def dump_scenario(scenario: Scenario) -> str:
    """The resolved scenario as YAML text."""
    return dump_yaml(resolved(scenario))


def identity(scenario: Scenario) -> dict[str, Any]:
    """The resolved form with the SHA-256 of its content in place of each of the user's files."""
    data = resolved(scenario)
    for path, (file, kind) in user_files(scenario).items():
        put(data, path, file_sha256(file, kind))
    return data


def file_sha256(file: Path, kind: UserFile) -> str:
    """SHA-256 of a user's file, of an MJCF file with every file that it names."""
    return packed(file).sha256 if kind.mjcf else hashlib.sha256(file.read_bytes()).hexdigest()


def put(data: Any, path: KeyPath, value: Any) -> None:
    """Set ``path`` of plain ``data`` to ``value``."""
    for part in path[:-1]:
        data = data[part]
    data[path[-1]] = value


def scenario_sha256(scenario: Scenario) -> str:
    """SHA-256 of the resolved form, with user's files by their content."""
    same = identity(scenario)
    canonical = json.dumps(same, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
