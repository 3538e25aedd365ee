"""The compensation section of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import Field

from hiltestbed.compensation.settings import (
    FORCE_METHODS,
    MOTION_METHODS,
    AnyForceMethod,
    AnyMotionMethod,
)
from hiltestbed.config.validation import Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike


class Compensation(Strictly):
    """Compensation of the delays in the loop."""

    force: AnyForceMethod = Field(
        default_factory=lambda: FORCE_METHODS["resynchronised"](kind="resynchronised"),
        description="How the delay of the measured force is compensated",
    )
    motion: AnyMotionMethod = Field(
        default_factory=lambda: MOTION_METHODS["feedforward"](kind="feedforward"),
        description="How the lag of the platform is compensated",
    )

    def idle(self, scenario: ScenarioLike) -> Iterator[Problem]:
        platform = scenario.rig.platform
        if platform.physical:
            why = (
                f"on a platform of kind {platform.kind} the bodies move freely: there is "
                f"no loop, and nothing to compensate"
            )
            yield from (
                ((name,), why) for name in ("force", "motion") if getattr(self, name).kind != "none"
            )
        elif self.motion.feeds and platform.prescribed and platform.tracking != "ideal":
            yield (
                ("motion",),
                f"{self.motion.kind} feeds velocity and acceleration to the drives, and with "
                f"tracking {platform.tracking} there are none; take tracking servo, or a method "
                "that changes the command (inverse_model, adaptive_time_series)",
            )
