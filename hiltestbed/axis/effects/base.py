"""What an effect on a single axis is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from hiltestbed.axis.law import ArmNumbers
from hiltestbed.effects.departure import Departure
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import Registry, placeholder

AxisKind = Literal["drive", "servo", "damper", "arm"]


@dataclass(frozen=True)
class RecordScale:
    """Orders of magnitude of a record, from which a search takes its starts and bounds.

    Attributes:
        travel: range of the position. speed, acceleration: largest. force: largest, of what is
            measured or drives.
        tick: [s] between rows. duration: [s] of the longest run. rotates: whether positions are
            angles [rad]. stiffness, damping: of the nominal model, 0 where it has none.
    """

    travel: float
    speed: float
    acceleration: float
    force: float
    tick: float
    duration: float
    rotates: bool = False
    stiffness: float = 0.0
    damping: float = 0.0
    resists: bool = False  # whether something resists the motion of the nominal drive


class Sought(NamedTuple):
    """Where a diagnosis seeks a parameter: starting points and bounds, in multiples of what ``of``
    gives for the record; without bounds in the search range of the parameter.
    """

    starts: tuple[float, ...]
    ends: tuple[float, float] | None = None
    of: Callable[[RecordScale], float] = lambda reach: 1.0


class AxisEffect(Departure):
    """Base of every effect on a single axis. A class needs a docstring, and the parts named in
    :data:`PARTS`.

    Attributes:
        axes: the kinds of axis on which it acts. adds, multiplies: parameter to the places in the
            numbers of the axis that change by it. sought: the parameters that are sought together.
            needs: parameters, as "kind:name", without which these mean nothing.
    """

    PARTS: ClassVar[tuple[str, ...]] = (
        "docstring",
        "link",
        "axes",
        "equation",
        "reference",
        "apply|adds|multiplies",
        "parts|sought",
    )
    axes: ClassVar[tuple[AxisKind, ...]] = ()
    adds: ClassVar[Mapping[str, int]] = {}
    multiplies: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    sought: ClassVar[Mapping[str, Sought]] = {}
    needs: ClassVar[tuple[str, ...]] = ()

    @placeholder
    def apply(self, p: Any) -> None:
        """Change the numbers of an axis, those of a law or of a servo, in place."""
        numbers = getattr(p, "numbers", p)
        for name, place in self.adds.items():
            numbers[place] += getattr(self, name)
        for name, places in self.multiplies.items():
            numbers[list(places)] *= getattr(self, name)

    @classmethod
    @placeholder
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        """The parts of the effect that a diagnosis searches: free parameters, bounds and starting
        points, scaled to the data.
        """
        sizes = {name: (sought, sought.of(reach)) for name, sought in cls.sought.items()}
        grids = {name: [q * size for q in s.starts] for name, (s, size) in sizes.items()}
        bounds = {n: (s.ends[0] * x, s.ends[1] * x) for n, (s, x) in sizes.items() if s.ends}
        yield candidate(cls, grids, bounds=bounds, needs=cls.needs)


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
        "hiltestbed.axis.effects.resistance",
        "hiltestbed.axis.effects.damper",
        "hiltestbed.axis.effects.servo",
    ),
)


def applied(effects: Any, p: Any) -> Any:
    """``p`` with the ``effects`` on it."""
    for effect in effects:
        effect.apply(p)
    return p
