"""What an effect on a single axis is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.axis.law import ArmNumbers
from hiltestbed.effects.departure import Departure
from hiltestbed.effects.search import Candidate
from hiltestbed.plugins import Registry, placeholder

AxisKind = Literal["drive", "servo", "damper", "arm"]


@dataclass(frozen=True)
class RecordScale:
    """Orders of magnitude of a record, from which a search takes its starts and bounds.

    Attributes:
        travel: range of the position. speed: largest, slow: the median of those in motion.
            acceleration: largest. force: largest, of what is measured or drives.
        tick: [s] between rows. duration: [s] of the longest run. rotates: whether positions are
            angles [rad]. stiffness, damping: of the nominal model, 0 where it has none.
    """

    travel: float
    speed: float
    slow: float
    acceleration: float
    force: float
    tick: float
    duration: float
    rotates: bool = False
    stiffness: float = 0.0
    damping: float = 0.0
    resists: bool = False  # whether something resists the motion of the nominal drive


class AxisEffect(Departure):
    """Base of every effect on a single axis. A class needs a docstring and the parts named in
    :data:`PARTS`.

    Attributes:
        axes: the kinds of axis on which it acts.
    """

    PARTS: ClassVar[tuple[str, ...]] = (
        "docstring",
        "link",
        "axes",
        "equation",
        "reference",
        "apply",
        "parts",
    )
    axes: ClassVar[tuple[AxisKind, ...]] = ()

    @classmethod
    @placeholder
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        """The parts of the effect that a diagnosis searches: free parameters, bounds and starting
        points, scaled to the data. A part of which another one makes sense only with it names that
        in ``needs``.
        """
        raise NotImplementedError


class DriveEffect(AxisEffect):
    """Base of the effects on a drive, alone or in a joint of an arm."""

    joint: str | None = Field(default=None, description="of an arm: the joint on which it acts")
    link = "dynamics"
    axes = ("drive", "arm")

    def apply_to_arm(self, p: ArmNumbers) -> None:
        """Change the numbers of an arm in place: those of the joint."""
        self.apply(p.laws[self.joint or ""])


class BodyEffect(AxisEffect):
    """Base of the effects on what an arm moves; of a single drive, there is one body."""

    body: str | None = Field(default=None, description="of an arm: the body on which it acts")
    link = "dynamics"
    axes = ("arm",)

    def apply_to_arm(self, p: ArmNumbers) -> None:
        """Change the numbers of an arm in place: those of the body."""
        self.apply(p)


class ServoEffect(AxisEffect):
    """Base of the effects on a servo alone."""

    link = "platform"
    axes = ("servo",)


class DamperEffect(AxisEffect):
    """Base of the effects on a damper alone."""

    link = "contact"
    axes = ("damper",)


AXIS_EFFECTS: Registry[AxisEffect] = Registry(
    "effect on an axis",
    AxisEffect,
    (
        "hiltestbed.axis.effects.inertia",
        "hiltestbed.axis.effects.arm",
        "hiltestbed.axis.effects.resistance",
        "hiltestbed.axis.effects.position",
        "hiltestbed.axis.effects.damper",
        "hiltestbed.axis.effects.servo",
    ),
)


def applied(effects: Any, p: Any) -> Any:
    """``p`` with the ``effects`` on it."""
    for effect in effects:
        effect.apply(p)
    return p
