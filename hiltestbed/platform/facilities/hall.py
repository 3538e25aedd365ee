"""The facility of a scenario, with its spacecraft."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltestbed.numerical_model.bodies import inertia_matrix, port_pose
from hiltestbed.platform.facilities.facility import Facility

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike
    from hiltestbed.scenario.spacecraft import Body


def facility_of(scenario: ScenarioLike) -> Facility:
    """The facility that a scenario names, including its spacecraft if the bodies move freely.
    Raises InputError.
    """
    facility = scenario.rig.platform.facility()
    if facility.physical:
        from hiltestbed.platform.facilities.bodies import Article, PhysicalFacility

        assert isinstance(facility, PhysicalFacility)

        def article(body: Body) -> Article:
            return Article(body.mass, inertia_matrix(body.inertia), port_pose(body))

        facility.stand(article(scenario.spacecraft.chaser), article(scenario.spacecraft.target))
    return facility
