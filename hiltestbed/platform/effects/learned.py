"""The platform's response as it was learned from data, where no effect with a name does it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.piecewise import Curve, Pairs, packed
from hiltestbed.platform.step_response import mean_lateness
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.platform.parameters import PlatformParameters
    from hiltestbed.scenario import Scenario


def _after_the_step(pairs: Pairs) -> Pairs:
    if pairs[0][0] < 0.0:
        raise PydanticCustomError("cause", "a platform answers to no step that is still to come (got {time} s)", {"time": pairs[0][0]})
    return pairs


Step = Annotated[Curve, Field(min_length=2), AfterValidator(_after_the_step)]


@register
class LearnedResponse(Effect):
    """A linear response of the platform, one for all three axes, as the answer to a step of its command."""

    kind: Literal["platform.response"] = "platform.response"
    step: Step = quantity(
        "s, -", "Knots of the part of a step that is reached over the time since it; none before the first, constant past the last"
    )
    link = "platform"
    equation = "x(t) = integral of s(t - t') x_cmd'(t') dt', s piecewise linear"
    reference = "step response, superposition"
    resembles = ("platform.lag", "platform.delay", "platform.mode")
    leading = "step"

    def apply(self, p: PlatformParameters) -> None:
        p.step = packed(self.step)

    def worth(self, scenario: Scenario, frequency: float) -> float:
        return mean_lateness(packed(self.step))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned where the effects with a name leave more than noise, see :mod:`hiltestbed.diagnosis.learned`."""
        return iter(())
