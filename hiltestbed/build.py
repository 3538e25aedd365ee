"""From a scenario, which is numbers and names, to what runs.

The faults that need a model are found, and the rate of the physics steps is determined. The blocks
of the loop are made, in the order of the signal flow, each from the parameters that it takes of
the scenarios; those whose method is chosen in the scenario are made by the method itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.analysis.metrics import Tally
from hiltestbed.analysis.outcome import Outcomes
from hiltestbed.compensation.blocks import ForceDrive
from hiltestbed.compensation.input import InputDeadZone, InputParameters
from hiltestbed.compensation.interfaces import Drive
from hiltestbed.compensation.motion import MotionCommand
from hiltestbed.compensation.motion_methods.contact_correction import Gate
from hiltestbed.compensation.settings import FORCE_METHODS, MOTION_METHODS
from hiltestbed.config.validation import Problem
from hiltestbed.config.yaml_source import Source, dotted
from hiltestbed.contact.findings import faults
from hiltestbed.errors import InputError
from hiltestbed.identification.samples import SampleParameters
from hiltestbed.identification.settings import IDENTIFIERS, Identification
from hiltestbed.platform.build import problems as facility_problems
from hiltestbed.plugins import calling
from hiltestbed.scenario import Scenario, scenario_from
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.sensor.sensor import Sensors
from hiltestbed.supervision.monitoring import ProcessMonitor
from hiltestbed.supervision.safety import Safety

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel


def runnable_from(
    source: Source | Mapping[str, Any], set: Mapping[str, Any] | None = None
) -> Scenario:
    """As ``scenario_from``, of one that is to run. Raises InputError with its models' faults."""
    return _timed(scenario_from(source, set, _problems))


def runnable(scenario: Scenario) -> Scenario:
    """``scenario``, with its physics rate stated. Raises InputError if its models cannot run."""
    found = [f"{dotted(path)}: {message}" for path, message in _problems(scenario)]
    if found:
        raise InputError(f"scenario {scenario.name}: " + "; ".join(found))
    return _timed(scenario)


def _timed(scenario: Scenario) -> Scenario:
    return scenario.model_copy(update={"stated_physics_rate": scenario.physics_rate})


def _problems(scenario: Scenario) -> Iterator[Problem]:
    """Faults that need a model: of a mechanism's files, a start out of reach."""
    platform = scenario.rig.platform
    yield from platform.start_problems(scenario)
    if platform.start_needs_model:
        yield from facility_problems(scenario)
    yield from ((("mechanism",), message) for message in faults(scenario))


def sensors(scenarios: Sequence[Scenario]) -> Sensors:
    """The sensors of runs of the same rates."""
    parameters = [SensorParameters.believed(s.sensor).with_effects(s.effects) for s in scenarios]
    generators = [np.random.default_rng(s.seed) for s in scenarios]
    return Sensors(parameters, scenarios[0].tick, scenarios[0].substeps, generators)


def monitor(scenarios: Sequence[Scenario]) -> ProcessMonitor:
    """The process monitor of runs of the same mechanism and platform."""
    return ProcessMonitor(SampleParameters.of(scenarios), [s.monitoring for s in scenarios])


def dead_zone(scenarios: Sequence[Scenario]) -> InputDeadZone:
    """What the compensation does not see of the readings."""
    return InputDeadZone([InputParameters().with_effects(s.effects) for s in scenarios])


def identification(scenarios: Sequence[Scenario]) -> Identification | None:
    """The estimator of runs of the same method; None if nothing is estimated."""
    return IDENTIFIERS[scenarios[0].identification.kind].start(scenarios)


def drive(scenarios: Sequence[Scenario], model: NumericalModel) -> Drive:
    """What drives the ``model`` of runs of the same compensation."""
    compensation = scenarios[0].compensation
    own = FORCE_METHODS[compensation.force.kind]
    with calling(own, f"compensation.force: {own.__name__}.start"):
        method = own.start(scenarios, model)
    if isinstance(method, Drive):
        return method
    corrects = MOTION_METHODS[compensation.motion.kind].corrects_force
    gate = Gate([s.sensor.noise for s in scenarios]) if corrects else None
    return ForceDrive(model, method, gate)


def motion_command(scenarios: Sequence[Scenario]) -> MotionCommand:
    """The command of the platform in runs of the same motion compensation."""
    first, motions = scenarios[0], [s.compensation.motion for s in scenarios]
    method = MOTION_METHODS[motions[0].kind].start(scenarios)
    return MotionCommand(first.rate, np.array([float(m.feeds) for m in motions]), method)


def safety(scenarios: Sequence[Scenario]) -> Safety:
    """The safety limits of runs on the same platform."""
    first, limits = scenarios[0], [s.safety for s in scenarios]
    return Safety(limits, first.tick, first.rig.platform.states_limits)


def tally(scenarios: Sequence[Scenario]) -> Tally:
    """The running figures of each run."""
    forces = [s.compensation.force for s in scenarios]
    return Tally(scenarios[0].rate, [s.sensor for s in scenarios], forces)


def outcomes(scenarios: Sequence[Scenario]) -> Outcomes:
    """The contacts of each run."""
    return Outcomes(scenarios[0].tick, [s.mechanism for s in scenarios])
