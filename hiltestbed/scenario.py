"""What a run is: the scenario as a whole, the checks that join its keys, files in and out. Its parts: `scenario_parts`, `scenario_methods`.

`load_scenario` reads a file (and `--set` overrides), `dump_scenario` writes the resolved form, in which every default stands.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from hiltestbed.effects.vocabulary import EFFECTS
from hiltestbed.scenario_methods import Compensation, Identification, Rls
from hiltestbed.scenario_parts import Approach, Mechanism, Rig, Safety, Sensor, Spacecraft
from hiltestbed.validation import Positive, Problem, Strictly, nearest, refuse, validate
from hiltestbed.yaml_source import Source, describe, dump_yaml, read_source

WORKSPACE_TRANSLATION = 0.25  # [m] the platform's reach from home, any axis; home is at the nominal first touch
WORKSPACE_ROTATION_DEG = 10.0
UPPER_SPEED = 0.3  # [m/s] up to which the upper platform is clamped before the touch
TICK_LIMIT = 20_000_000  # a trace of this many rows fills 16 GB


class Scenario(Strictly):
    """One run: two vehicles, how they meet, the rig that plays it, and what is done about the rig's faults."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    duration: Positive = Field(default=3.0, description="[s]")
    rate: Annotated[float, Field(gt=0, le=1e6)] = Field(default=2000.0, description="passes of the loop [Hz]")
    physics_rate: Annotated[float, Field(gt=0, le=4e6)] = Field(
        default_factory=lambda given: 2.0 * given["rate"],  # type: ignore[arg-type]
        description="steps of the physics [Hz], a whole multiple of rate; left out: twice rate",
    )
    spacecraft: Spacecraft
    approach: Approach
    mechanism: Mechanism
    rig: Rig = Rig()
    sensor: Sensor = Sensor()
    compensation: Compensation = Compensation()
    identification: Identification = Rls()
    safety: Safety = Safety()
    effects: Annotated[tuple[dict[str, Any], ...], Field(strict=False)] = Field(
        default=(), description="departures from the nominal rig: {kind: ID, parameter: value}"
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

    @model_validator(mode="before")
    @classmethod
    def _complete_effects(cls, data: Any) -> Any:
        """Each effect with its defaults written out; a faulty one stays as it is, `_is_possible` says why."""
        if not isinstance(data, dict) or not isinstance(data.get("effects"), (list, tuple)):
            return data
        return data | {"effects": [_complete(entry) for entry in data["effects"]]}

    @model_validator(mode="after")
    def _is_possible(self) -> Scenario:
        refuse([*_rate_problems(self), *_delay_problems(self), *_start_problems(self), *_effect_problems(self.effects)])
        return self


def _complete(entry: Any) -> Any:
    spec = EFFECTS.get(str(entry.get("kind"))) if isinstance(entry, dict) else None
    given = {name: value for name, value in entry.items() if name != "kind"} if spec else {}
    if spec is None or spec.faults(given):
        return entry
    resolved = {name: list(value) if isinstance(value, tuple) else value for name, value in spec.complete(given).items()}
    return {"kind": spec.id} | {name: _number(spec.parameters[name].kind, value) for name, value in resolved.items()}


def _number(kind: str, value: Any) -> Any:
    """One way to write a number, so that 1 and 1.0 give the same hash."""
    if kind == "vector":
        return [float(item) for item in value]
    if kind == "number":
        return float(value)
    return int(value) if kind == "integer" else value


def _rate_problems(scenario: Scenario) -> Iterator[Problem]:
    ratio = scenario.physics_rate / scenario.rate
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        near = max(1, round(ratio)) * scenario.rate
        yield (
            ("physics_rate",),
            (
                f"does not divide by rate (got {scenario.physics_rate:g} Hz over {scenario.rate:g} Hz = {ratio:g}); "
                f"allowed is a whole multiple of rate, such as {near:g}"
            ),
        )
    if not 1 <= scenario.duration * scenario.rate <= TICK_LIMIT:
        yield (
            ("duration",),
            (
                f"is out of range (got {scenario.duration:g} s at {scenario.rate:g} Hz = {scenario.duration * scenario.rate:g} ticks); "
                f"allowed are 1 to {TICK_LIMIT} ticks"
            ),
        )


def _delay_problems(scenario: Scenario) -> Iterator[Problem]:
    if scenario.sensor.delay > scenario.duration:
        yield (
            ("sensor", "delay"),
            (f"cannot be held (got {scenario.sensor.delay:g} s in a run of {scenario.duration:g} s); allowed is 0 to the run's duration"),
        )


def _start_problems(scenario: Scenario) -> Iterator[Problem]:
    """The platform reaches WORKSPACE_TRANSLATION and WORKSPACE_ROTATION_DEG around the nominal first touch, and no further."""
    approach, reach, turn = scenario.approach, WORKSPACE_TRANSLATION, WORKSPACE_ROTATION_DEG
    if scenario.rig.upper.kind == "prs3":
        yield from _nine_axis_problems(scenario)
        return
    lowest = -reach if scenario.mechanism.kind == "latched" else 0.0
    limits = [(("approach", "gap"), approach.gap, lowest, reach, "m")]
    limits += [(("approach", "offset", axis), value, -reach, reach, "m") for axis, value in enumerate(approach.offset)]
    limits += [(("approach", "attitude_deg", axis), value, -turn, turn, "deg") for axis, value in enumerate(approach.attitude_deg)]
    for path, value, low, high, unit in limits:
        if not low <= value <= high:
            yield path, f"starts outside the workspace (got {value:g} {unit}); allowed is {low:g} to {high:g} {unit}"


def _nine_axis_problems(scenario: Scenario) -> Iterator[Problem]:
    """With the upper platform the gap may be as long as its heave; the lower platform's part of the start must be in its workspace."""
    import numpy as np

    from hiltestbed.frames import quat_from_attitude_deg, rotation_vectors
    from hiltestbed.rig.allocation import LONGEST, lower_pose

    approach = scenario.approach
    lowest = -WORKSPACE_TRANSLATION if scenario.mechanism.kind == "latched" else 0.0
    if not lowest <= approach.gap <= LONGEST:
        yield ("approach", "gap"), f"starts outside the workspace (got {approach.gap:g} m); allowed is {lowest:g} to {LONGEST:g} m"
        return
    if not abs(approach.velocity[2]) <= UPPER_SPEED:
        yield (
            ("approach", "velocity", 2),
            f"is faster than the upper platform comes to rest before the touch (got {approach.velocity[2]:g} m/s); "
            f"allowed is -{UPPER_SPEED:g} to {UPPER_SPEED:g} m/s",
        )
    pose = np.array([[*approach.offset, -approach.gap, *quat_from_attitude_deg(approach.attitude_deg)]])
    lower = lower_pose(pose)
    place, turn = np.abs(lower[0, :3]), np.degrees(np.abs(rotation_vectors(lower[:, 3:])[0]))
    if not (place.max() <= WORKSPACE_TRANSLATION and turn.max() <= WORKSPACE_ROTATION_DEG):
        where = ", ".join(f"{value:.3g}" for value in lower[0, :3])
        yield (
            ("approach",),
            f"starts outside the workspace (the lower platform would stand at {where} m, turned by up to {turn.max():.3g} deg); allowed "
            f"are {WORKSPACE_TRANSLATION:g} m and {WORKSPACE_ROTATION_DEG:g} deg on each axis: take a smaller offset or attitude_deg",
        )


def _effect_problems(effects: tuple[dict[str, Any], ...]) -> Iterator[Problem]:
    for index, entry in enumerate(effects):
        where = ("effects", index)
        kind = entry.get("kind")
        if kind is None:
            yield (*where, "kind"), "is missing; an effect is {kind: ID, parameter: value}"
        elif not isinstance(kind, str) or kind not in EFFECTS:
            yield (*where, "kind"), f"unknown effect{nearest(str(kind), EFFECTS)} (got {describe(kind)}); allowed: {', '.join(EFFECTS)}"
        else:
            given = {name: value for name, value in entry.items() if name != "kind"}
            yield from (((*where, name), message) for name, message in EFFECTS[kind].faults(given))


def load_scenario(path: str | Path, set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in a YAML file, with dotted keys overridden (`{"approach.velocity.2": 0.05}`). Raises InputError."""
    return scenario_from(read_source(path).with_set(set))


def scenario_from(source: Source | Mapping[str, Any], set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in data that is read already: a `Source`, or a plain dict as it would stand in a file. Raises InputError."""
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
    """SHA-256 of the resolved form, the same however the file was written."""
    canonical = json.dumps(resolved(scenario), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
