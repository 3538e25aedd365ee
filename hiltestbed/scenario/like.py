"""A scenario as its sections see it: what they may read of each other without importing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from hiltestbed.scenario.spacecraft import Approach, Spacecraft
    from hiltestbed.sensor.settings import Sensor

HIGHEST = 4e6  # [Hz] physics rate that a scenario may have


class ScenarioLike(Protocol):
    """The fields of :class:`hiltestbed.scenario.Scenario` that blocks and sections read.

    Sections whose classes start blocks are not typed: their modules would import each other.
    """

    @property
    def rate(self) -> float: ...
    @property
    def physics_rate(self) -> float: ...
    @property
    def tick(self) -> float: ...
    @property
    def substeps(self) -> int: ...
    @property
    def impact(self) -> Any: ...
    @property
    def spacecraft(self) -> Spacecraft: ...
    @property
    def numerical_model(self) -> Any: ...
    @property
    def approach(self) -> Approach: ...
    @property
    def mechanism(self) -> Any: ...
    @property
    def rig(self) -> Any: ...
    @property
    def sensor(self) -> Sensor: ...
    @property
    def compensation(self) -> Any: ...
    @property
    def identification(self) -> Any: ...
    @property
    def safety(self) -> Any: ...
    @property
    def effects(self) -> Sequence[Any]: ...
