"""The compensation's section of a scenario."""

from __future__ import annotations

from pydantic import Field

from hiltestbed.compensation.settings import FORCE_METHODS, MOTION_METHODS, AnyForceMethod, AnyMotionMethod
from hiltestbed.validation import Strictly


class Compensation(Strictly):
    """What is done against the delays of the loop."""

    force: AnyForceMethod = Field(
        default_factory=lambda: FORCE_METHODS["resynchronised"](kind="resynchronised"),
        description="How the delay of the measured force is compensated",
    )
    motion: AnyMotionMethod = Field(
        default_factory=lambda: MOTION_METHODS["feedforward"](kind="feedforward"), description="How the lag of the platform is compensated"
    )
