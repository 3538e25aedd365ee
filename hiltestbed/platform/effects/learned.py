"""The platform's response as learned from data, where no named effect explains it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from hiltestbed.config.piecewise import Curve, Pairs, packed
from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.platform.parameters import mean_lateness
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters


def _after_the_step(pairs: Pairs) -> Pairs:
    if pairs[0][0] < 0.0:
        raise PydanticCustomError(
            "cause",
            "a platform cannot respond before the step (got {time} s)",
            {"time": pairs[0][0]},
        )
    return pairs


Step = Annotated[Curve, Field(min_length=2), AfterValidator(_after_the_step)]


@register
class LearnedResponse(Effect):
    """A linear response of the platform, common to all three axes, given as its response to a step
    of the command.
    """

    kind: Literal["platform.response"] = "platform.response"
    step: Step = quantity(
        "s, -",
        "Knots of the step response: time since the step, fraction reached; zero before the first "
        "knot, constant after the last",
    )
    link = "platform"
    equation = "x(t) = integral of s(t - t') x_cmd'(t') dt', s piecewise linear"
    reference = "step response, superposition"
    resembles = ("platform.lag", "platform.delay", "platform.mode")

    def apply(self, p: PlatformParameters) -> None:
        p.step = packed(self.step)

    def worth(self, tick: float, frequency: float) -> float:
        return mean_lateness(packed(self.step))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned, see :mod:`hiltestbed.diagnosis.learned`."""
        return iter(())
