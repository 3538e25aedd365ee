"""Recursive least squares, on time-aligned samples, on raw samples, and on the force after a phase
lead; and no identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field

from hiltestbed.compensation.force_methods.phase_lead import PhaseLeadBlock
from hiltestbed.config.validation import Positive
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.identification.samples import ContactSamples, SampleParameters
from hiltestbed.identification.settings import ContactIdentifier
from hiltestbed.plugins import register


class Recursive(ContactIdentifier):
    """What the recursions share."""

    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(
        default=1.0, description="Forgetting factor per tick [-]; 1: no forgetting"
    )


@register
class Rls(Recursive):
    """Recursive least squares of k and c on each axis, during contact only, with the pose at the
    time the force acted.
    """

    kind: Literal["rls"] = "rls"
    delay: Literal["known", "estimate"] = Field(
        default="known",
        description="Delay of the force. known: sensor.delay is taken as exact; estimate: it is "
        "estimated from the instant of touch",
    )

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> RecursiveLeastSquares:
        samples = ContactSamples(given, estimate=own[0].delay == "estimate")
        return RecursiveLeastSquares(samples, [o.forgetting for o in own])


@register
class RlsRaw(Recursive):
    """Recursive least squares of k and c on the raw force, with the pose of the same tick: the
    delay biases c.
    """

    kind: Literal["rls_raw"] = "rls_raw"

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> RecursiveLeastSquares:
        samples = ContactSamples(given, aligned=False)
        return RecursiveLeastSquares(samples, [o.forgetting for o in own])


@register
class RlsLead(Recursive):
    """Recursive least squares of k and c on the force after a first-order phase lead, with the pose
    of the same tick.
    """

    kind: Literal["rls_lead"] = "rls_lead"
    lag: Positive = Field(
        default=0.0005,
        description="Time constant T2 of the phase lead's pole [s]; its T1 is sensor.delay + T2",
    )

    @property
    def settles(self) -> float:
        return self.lag

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> RecursiveLeastSquares:
        pairs = zip(given.sensors, own, strict=True)
        lead = PhaseLeadBlock(given.rate, [(s.delay + o.lag, o.lag) for s, o in pairs])
        samples = ContactSamples(given, aligned=False, lead=[o.lag for o in own])
        return RecursiveLeastSquares(samples, [o.forgetting for o in own], lead)


@register
class NoIdentification(ContactIdentifier):
    """Stiffness and damping are not estimated."""

    kind: Literal["none"] = "none"

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> None:
        return None
