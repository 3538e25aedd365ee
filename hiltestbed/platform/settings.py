"""The rig section of a scenario: the motion platform, and the support of the passive side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from hiltestbed.config.validation import Problem, Strictly
from hiltestbed.platform.kinds import PLATFORMS, Platform
from hiltestbed.plugins import OneOf

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

AnyPlatform = Annotated[Platform, OneOf(PLATFORMS, default="pss33")]


class UpperSettings(Strictly):
    """The support of the passive side and the force sensor."""

    kind: Literal["fixed", "prs3"] = Field(
        default="fixed",
        description="Upper platform. fixed: none; prs3: heave of 2 m and two tilts, clamped while "
        "the ports are less than 0.19 m apart",
    )
    tracking: Literal["servo", "ideal"] = Field(
        default="servo",
        description="Tracking of the upper platform. servo: simulated drives; ideal: it is "
        "exactly at its planned pose",
    )

    def idle(self, scenario: ScenarioLike) -> Iterator[Problem]:
        if self.kind == "fixed":
            yield ("tracking",), "the upper platform's kind is fixed: there is none; take kind prs3"


class Rig(Strictly):
    """The physical side: the motion platform, and the support of the passive port."""

    platform: AnyPlatform = Field(
        default_factory=lambda: PLATFORMS["pss33"].model_validate({"kind": "pss33"}),
        description="The motion platform that carries the active side",
    )
    upper: UpperSettings = Field(
        default=UpperSettings(), description="Support of the passive side and the force sensor"
    )
