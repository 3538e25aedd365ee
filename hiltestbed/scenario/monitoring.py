"""What a scenario asks of process monitoring."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hiltestbed.validation import NotNegative, Positive, Strictly


class ContactEstimate(Strictly):
    """Axial stiffness and damping of one contact, with their standard deviations."""

    stiffness: Positive = Field(description="Stiffness as identified [N/m]")
    damping: NotNegative = Field(description="Damping as identified [N s/m]")
    stiffness_sd: Positive = Field(description="Standard deviation of the stiffness [N/m]")
    damping_sd: Positive = Field(description="Standard deviation of the damping [N s/m]")


class Monitoring(Strictly):
    """What the identified stiffness and damping say of the docking while it happens, and against the contacts before it."""

    seat_ratio: Annotated[float, Field(gt=1.0)] = Field(
        default=2.0, description="Stiffness over that of the first touch from which the active side counts as seated [-]"
    )
    window: Positive = Field(default=0.02, description="Memory of the stiffness that is watched [s]")
    baseline: Annotated[tuple[ContactEstimate, ...], Field(strict=False)] = Field(
        default=(), description="Contacts of the healthy mechanism, with which this one is compared; none: wear is not judged"
    )
    false_alarm_rate: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=0.01, description="Probability with which a healthy contact is called worn [-]"
    )
