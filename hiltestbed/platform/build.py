"""The facility that a scenario's settings describe, and what is asked of it before a run: the only
module that knows both.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from hiltestbed.config.validation import Problem
from hiltestbed.contact.composition import Structure, structure_of
from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects.table import by_link
from hiltestbed.errors import InputError
from hiltestbed.numerical_model.bodies import approach_state, inertia_matrix, port_pose
from hiltestbed.platform.facilities.air_bearing import AirBearing
from hiltestbed.platform.facilities.arms import SerialArm, TwoArms
from hiltestbed.platform.facilities.bodies import Article, PhysicalFacility
from hiltestbed.platform.facilities.composed import TOOL, facility_model
from hiltestbed.platform.facilities.demand import Demand, demand
from hiltestbed.platform.facilities.facility import Facility
from hiltestbed.platform.facilities.mjcf import MjcfFacility
from hiltestbed.platform.facilities.pss33 import Pss33Facility
from hiltestbed.platform.facilities.settings import Driven
from hiltestbed.platform.facilities.stewart import Stewart
from hiltestbed.platform.facilities.suspension import Suspension
from hiltestbed.platform.kinds import Platform
from hiltestbed.platform.shipped.arms import SerialArmSettings, TwoArmsSettings
from hiltestbed.platform.shipped.halls import AirBearingSettings, SuspensionSettings
from hiltestbed.platform.shipped.mjcf import MjcfSettings
from hiltestbed.platform.shipped.pss33 import Pss33
from hiltestbed.platform.shipped.stewart import StewartSettings

if TYPE_CHECKING:
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


def structure(scenario: Scenario) -> Structure:
    """The structure of a scenario's rig."""
    mechanism, effects = scenario.mechanism, by_link(scenario.effects, "contact")
    rubs = any(
        ContactParameters.believed(c).with_effects(effects).friction > 0.0
        for c in mechanism.contacts()
    )
    return structure_of(mechanism, bool(effects), rubs)


def demand_of(scenario: Scenario) -> Demand | None:
    """What accelerations and contact take of the drives, both sides mounted; None without simulated
    drives.
    """
    platform = scenario.rig.platform
    if platform.prescribed or platform.physical:
        return None
    return _demand(built(platform), structure(scenario), scenario.tick / scenario.substeps)


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
    for complaint in facility.complaints(approach_state(scenario)[:7]):
        yield (
            ("approach",),
            f"starts at a pose that the platform cannot reach ({complaint}); allowed is a start "
            "within its workspace",
        )
