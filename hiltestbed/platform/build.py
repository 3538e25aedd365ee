"""The facility that a scenario's settings describe, and what is asked of it before a run: the only
module that knows both.

What an acceleration of the platform and a load on it take of its drives: joint accelerations a that
move the tools and keep the loops closed satisfy J a = (tools, 0). The drives' forces f, the loads r
in locked joints and l in the loops then satisfy M a + weight = S' f + L' r + C' l + T' w (R.
Featherstone, Rigid Body Dynamics Algorithms, 2008, equation 8.6), S, L, C and T the rows of the
Jacobian of driven joints, locked joints, loops and tools, w the wrenches on the tools.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.validation import Problem
from hiltestbed.contact.composition import Structure, structure_of
from hiltestbed.contact.parameters import mechanism_parameters
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects.table import by_link
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import (
    approach_state,
    approach_states,
    inertia_matrix,
    port_pose,
)
from hiltestbed.platform.facilities.arms import SerialArm, TwoArms
from hiltestbed.platform.facilities.bodies import Article, PhysicalFacility
from hiltestbed.platform.facilities.composed import TOOL, facility_model
from hiltestbed.platform.facilities.facility import Facility, Runs
from hiltestbed.platform.facilities.halls import AirBearing, Suspension
from hiltestbed.platform.facilities.kinematics import MECHANISMS, Axis, Kinematics
from hiltestbed.platform.facilities.mjcf import MjcfFacility
from hiltestbed.platform.facilities.pss33 import Pss33Facility
from hiltestbed.platform.facilities.stewart import Stewart
from hiltestbed.platform.kinds import Driven, Platform
from hiltestbed.platform.parameters import PlatformParameters, RigParameters
from hiltestbed.platform.shipped.arms import SerialArmSettings, TwoArmsSettings
from hiltestbed.platform.shipped.halls import AirBearingSettings, SuspensionSettings
from hiltestbed.platform.shipped.mjcf import MjcfSettings
from hiltestbed.platform.shipped.pss33 import Pss33
from hiltestbed.platform.shipped.stewart import StewartSettings

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import AppliedForce
    from hiltestbed.platform.plant import Plant
    from hiltestbed.scenario.like import ScenarioLike as Scenario
    from hiltestbed.scenario.spacecraft import Body

FACILITIES: dict[type[Platform], Callable[[Any], Facility]] = {
    Pss33: Pss33Facility,
    StewartSettings: Stewart,
    SerialArmSettings: SerialArm,
    TwoArmsSettings: TwoArms,
    MjcfSettings: MjcfFacility,
    AirBearingSettings: AirBearing,
    SuspensionSettings: Suspension,
}


def built(platform: Platform) -> Facility:
    """The facility of a platform's settings, by the settings' own ``facility`` if they have one.

    Raises:
        InputError: an unsuitable model of the user, or a kind without a facility.
    """
    own = getattr(platform, "facility", None)
    if own is not None:
        return own()
    for kind in type(platform).__mro__:
        if kind in FACILITIES:
            facility = FACILITIES[kind]
            if isinstance(platform, Driven):
                # settings are frozen, and so hashable
                return _kept(facility, platform, platform.stamp())  # type: ignore[arg-type]
            return facility(platform)
    raise InputError(
        f"rig.platform.kind {platform.kind}: describes no facility; give the class a method "
        "`facility`"
    )


@lru_cache(maxsize=32)
def _kept(facility: Callable[[Any], Facility], platform: Driven, stamp: Hashable) -> Facility:
    return facility(platform)


def facility_of(scenario: Scenario) -> Facility:
    """The facility of a scenario, with its spacecraft if bodies move freely. Raises InputError."""
    facility = built(scenario.rig.platform)
    if isinstance(facility, PhysicalFacility):
        craft = scenario.spacecraft
        facility.stand(_article(craft.chaser), _article(craft.target))
    return facility


def _article(body: Body) -> Article:
    return Article(body.mass, inertia_matrix(body.inertia), port_pose(body))


def alike(scenario: Scenario) -> Hashable:
    """What the platform's model depends on, which must be equal in the runs of one batch."""
    facility = built(scenario.rig.platform)
    if isinstance(facility, PhysicalFacility):
        return facility.alike(), scenario.spacecraft.model_dump_json()
    return facility.alike()


def lockstep_key(scenario: Scenario) -> Hashable:
    """Everything that must be equal in the scenarios of one plant."""
    platform, upper = scenario.rig.platform, scenario.rig.upper
    above = (upper.kind, upper.tracking if upper.kind != "fixed" else None)
    structure = structure_of(scenario.mechanism, scenario.effects)
    rates = scenario.rate, scenario.physics_rate
    return *rates, structure, alike(scenario), platform.tracking, above


def runs_of(scenarios: Sequence[Scenario]) -> Runs:
    """What the drives of a batch are made for."""
    first, feeds = scenarios[0], [s.compensation.motion.feeds for s in scenarios]
    settings = [s.rig.platform for s in scenarios]
    return Runs(first.tick, first.substeps, settings, np.array(feeds, dtype=bool))


def rig_parameters(scenarios: Sequence[Scenario]) -> RigParameters:
    """The parameters of the rigs of scenarios with one :func:`lockstep_key`."""
    first, effects = scenarios[0], [s.effects for s in scenarios]
    structure = structure_of(first.mechanism, first.effects)
    mechanisms = [s.mechanism for s in scenarios]
    watched = None
    if not first.rig.platform.physical and first.rig.platform.states_limits:
        # a run's safety section may switch off three of them
        limits = [(s.safety.stroke, s.safety.speed, s.safety.acceleration) for s in scenarios]
        watched = np.array([[*(limit is not None for limit in row), True, True] for row in limits])
    return RigParameters(
        facility_of(first),
        structure,
        runs_of(scenarios),
        mechanism_parameters(mechanisms, effects, structure.sides.rules),
        [PlatformParameters(s.tick).with_effects(s.effects) for s in scenarios],
        any(by_link(acting, "platform") for acting in effects),
        approach_states(s.approach for s in scenarios),
        watched,
        first.rig.upper.tracking if first.rig.upper.kind == "prs3" else None,
    )


def plant_of(
    scenarios: Sequence[Scenario],
    nthread: int = 1,
    late: NDArray[np.bool_] | None = None,
    force: AppliedForce | None = None,
    held: bool = False,
) -> Plant:
    """The rigs of scenarios, see :class:`hiltestbed.platform.plant.Plant`. Raises InputError for
    scenarios that cannot go in lockstep.
    """
    from hiltestbed.platform.plant import Plant  # the loop's kernels, which a check does not need

    if len({lockstep_key(s) for s in scenarios}) != 1:
        raise InputError(
            "one Plant takes runs of one structure: the same rate, physics_rate, "
            "rig.platform, rig.upper and mechanism.kind; "
            "mechanism.mount, contact.friction > 0 and effects of the contact in all or in none"
        )
    return Plant(rig_parameters(scenarios), nthread, late, force, held)


def demand_of(scenario: Scenario) -> Demand | None:
    """What accelerations and contact take of the drives, both sides mounted; None without simulated
    drives.
    """
    platform = scenario.rig.platform
    if platform.prescribed or platform.physical:
        return None
    structure = structure_of(scenario.mechanism, scenario.effects)
    return _demand(built(platform), structure, scenario.tick / scenario.substeps)


@lru_cache(maxsize=32)
def _demand(facility: Facility, made_of: Structure, timestep: float) -> Demand:
    still = replace(made_of, constant=True, latched=False, touches=False, held=True)
    model = facility_model(facility, still, timestep)
    return demand(model, facility.kinematics(model, TOOL))


def nearest_bandwidth(scenario: Scenario) -> float:
    """[Hz] of the second-order system closest to the platform's tracking along the insertion."""
    platform = scenario.rig.platform
    if getattr(platform, "tracking", "free") == "response":
        given = platform.response.bandwidth
        return given if isinstance(given, float) else given[2]
    return built(platform).bandwidth()


def problems(scenario: Scenario) -> Iterator[Problem]:
    """Requirements of a scenario that the model of its facility cannot meet: a start out of reach,
    sides that its sensor could not weigh.
    """
    where, kind = ("rig", "platform"), scenario.rig.platform.kind
    try:
        facility = facility_of(scenario)
    except InputError as error:
        has_model = "model" in type(scenario.rig.platform).model_fields
        yield (*where, "model") if has_model else where, str(error)
        return
    if facility.moves_passive and scenario.mechanism.mount is not None:
        yield (
            ("mechanism", "mount"),
            f"cannot be combined with a passive side that moves (got a mount on platform kind "
            f"{kind!r}, whose sensor could not separate the mount's load from the mechanism's "
            "weight); allowed is null",
        )
    if facility.moves_passive and sides_of(scenario.mechanism).moving:
        yield (
            ("mechanism", "kind"),
            f"has moving parts (got {scenario.mechanism.kind!r} on platform kind {kind!r}, whose "
            "passive side moves: the load of its sensor must be rigid); allowed is a mechanism "
            "without moving parts",
        )
    for complaint in facility.complaints(approach_state(scenario.approach)[:7]):
        yield (
            ("approach",),
            f"starts at a pose that the platform cannot reach ({complaint}); allowed is a start "
            "within its workspace",
        )


class Demand(NamedTuple):
    """The force of J drives at home [N, N m], linear in what nt tools do, in W.

    Attributes:
        axes: the drives, with their limits. weight: (J,) at rest. inertia: (J, 6 nt) for a unit
            acceleration of each tool [m/s^2, rad/s^2]. load: (J, 6 nt) against a unit wrench on
            each, at its origin [N, N m].
    """

    axes: tuple[Axis, ...]
    weight: Array
    inertia: Array
    load: Array

    @property
    def most(self) -> Array:
        """``(J,)`` the drives' limits [N, N m]."""
        return np.array([axis.force for axis in self.axes])

    @property
    def shares(self) -> Array:
        """``(J, 6)`` share of each drive's force, beyond its weight, that a unit acceleration of
        the first tool takes [s^2/m, s^2/rad]; 1 is all that the drive has left.
        """
        # a drive that cannot hold the weight has nothing left
        left = np.maximum(self.most - np.abs(self.weight), np.finfo(float).eps * self.most)
        return self.inertia[:, :6] / left[:, None]


def demand(model: mujoco.MjModel, kinematics: Kinematics) -> Demand:
    """Of the drives of a composed model.

    Springs (the deflection of gears), prescribed joints (a rail) and the joints of the mechanisms
    are locked.
    """
    data = mujoco.MjData(model)
    data.qpos = kinematics.home
    jacobian = model.opt.jacobian
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(model, data)
    model.opt.jacobian = jacobian
    tools = np.zeros((len(kinematics.tools), 6, model.nv))
    for tool, name in zip(tools, kinematics.tools, strict=True):
        mujoco.mj_jacSite(model, data, tool[:3], tool[3:], model.site(name).id)
    tools = tools.reshape(-1, model.nv)
    closed = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    loops = data.efc_J.reshape(-1, model.nv)[closed]
    names = [model.joint(j).name for j in model.dof_jntid]
    held = [name in kinematics.prescribed or name.startswith(MECHANISMS) for name in names]
    locked = np.array(held) | (model.jnt_stiffness[model.dof_jntid] != 0.0)
    rows = np.eye(model.nv)
    fixed = np.vstack([rows[locked], loops])
    rates = np.linalg.pinv(np.vstack([tools, fixed]))[:, : len(tools)]
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    driven = [j for j, v in enumerate(kinematics.v) if not locked[v]]
    forces = np.linalg.pinv(np.vstack([rows[kinematics.v[driven]], fixed]).T)[: len(driven)]
    return Demand(
        axes=tuple(kinematics.axes[j] for j in driven),
        weight=forces @ (data.qfrc_bias - data.qfrc_gravcomp),
        inertia=forces @ mass @ rates,
        load=-forces @ tools.T,
    )
