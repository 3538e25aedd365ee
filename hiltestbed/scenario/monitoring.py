"""The monitoring section of a scenario."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Strictly


class ContactEstimate(Strictly):
    """Axial stiffness and damping of one contact, with their standard deviations."""

    stiffness: Positive = Field(description="Stiffness as identified [N/m]")
    damping: NotNegative = Field(description="Damping as identified [N s/m]")
    stiffness_sd: Positive = Field(description="Standard deviation of the stiffness [N/m]")
    damping_sd: Positive = Field(description="Standard deviation of the damping [N s/m]")


class Monitoring(Strictly):
    """Process monitoring from the identified stiffness and damping: stages of the docking, and wear
    relative to earlier contacts.
    """

    seat_ratio: Annotated[float, Field(gt=1.0)] = Field(
        default=2.0,
        description="Ratio of the stiffness to that of the first touch above which the active "
        "side counts as seated [-]",
    )
    window: Positive = Field(default=0.02, description="Time window of the monitored stiffness [s]")
    baseline: Annotated[tuple[ContactEstimate, ...], Field(strict=False)] = Field(
        default=(),
        description="Contacts of the healthy mechanism, as the reference for wear; empty: wear is "
        "not judged",
    )
    false_alarm_rate: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=0.01, description="Probability of reporting wear for a healthy contact [-]"
    )
