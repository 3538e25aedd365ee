"""Forces on a drive that depend on its position."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from hiltestbed.axis import law
from hiltestbed.axis.effects.base import DriveEffect, RecordScale
from hiltestbed.axis.effects.resistance import PHASES, PITCHES
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register


@register
class AxisGravity(DriveEffect):
    """Gravity on a joint: the weight of what it carries, about its axis."""

    kind: Literal["dynamics.gravity"] = "dynamics.gravity"
    sine: float = quantity("N m", "Moment that follows the sine of the angle", default=0.0)
    cosine: float = quantity("N m", "Moment that follows the cosine of the angle", default=0.0)
    equation = "R += sine sin x + cosine cos x"
    reference = "m g l of a rigid load"
    resembles = ("dynamics.spring",)
    axes = ("drive",)  # of an arm, gravity follows from its bodies

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.GRAVITY_SIN] += self.sine
        p.numbers[law.GRAVITY_COS] += self.cosine

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if reach.rotates:
            most = 2.0 * reach.force
            yield candidate(
                cls,
                {"sine": [0.0], "cosine": [0.0]},
                bounds={"sine": (-most, most), "cosine": (-most, most)},
            )


@register
class AxisSpring(DriveEffect):
    """A spring pulls the axis back, as a cable or a hose does."""

    kind: Literal["dynamics.spring"] = "dynamics.spring"
    stiffness: float = quantity("N/m", "Stiffness")
    rest: float = quantity("m", "Position at which it is relaxed", default=0.0)
    equation = "R += stiffness (x - rest)"
    reference = "Hooke"
    resembles = ("dynamics.gravity",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.SPRING] += self.stiffness
        p.numbers[law.REST] = self.rest

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        most = 10.0 * reach.force / reach.travel
        yield candidate(cls, {"stiffness": [0.0]}, bounds={"stiffness": (-most, most)}, rest=0.0)


@register
class AxisCogging(DriveEffect):
    """A force that repeats along the axis: of a motor's poles, or of a screw."""

    kind: Literal["dynamics.cogging"] = "dynamics.cogging"
    amplitude: float = quantity("N", "Amplitude", ge=0.0)
    pitch: float = quantity("m", "Distance after which it repeats", gt=0.0, ratio=True)
    phase: float = quantity("rad", "Phase at the origin", search=(-7.0, 7.0))
    equation = "R += amplitude sin(2 pi x/pitch + phase)"
    reference = "first harmonic of a cogging force"

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[[law.COG, law.COG_PITCH, law.COG_PHASE]] = self.amplitude, self.pitch, self.phase

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        yield candidate(
            cls,
            {
                "amplitude": [0.05 * reach.force],
                "pitch": [q * reach.travel for q in PITCHES],
                "phase": PHASES,
            },
            bounds={
                "amplitude": (0.0, reach.force),
                "pitch": (0.02 * reach.travel, reach.travel),
            },
        )
