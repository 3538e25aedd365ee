"""The compensation section of a scenario: methods against the delays in the loop, one class per
method.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import Drive, ForceBlock, ForcePath, PoseBlock
from hiltestbed.config.validation import Problem, Strictly
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.plugins import OneOf, Registry, all_of, placeholder

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario.like import ScenarioLike


# What a method may read at t_k: the measured wrench; the pose and twist that the rig reached; the
# stiffness and damping identified so far; whether the mechanism is captured; the pose and twist of
# the numerical model that it drives.
Input = Literal["wrench", "pose", "twist", "identified", "captured", "model"]
INPUTS: frozenset[str] = frozenset(get_args(Input))


class ForceMethod(Strictly):
    """Base of every force compensation. A class needs a docstring and the parts named in
    :data:`PARTS`.

    Attributes:
        reads: its inputs at t_k. corrects_platform: whether it corrects the force for the
            platform's tracking error.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "reads", "start")
    CHOICES: ClassVar[Mapping[str, frozenset[str]]] = {"reads": INPUTS}

    kind: str
    reads: ClassVar[frozenset[Input]] = None  # type: ignore[assignment]
    # whether it adds a force that is not derived from the measured one
    adds_force: ClassVar[bool] = False
    corrects_platform: ClassVar[bool] = False
    removes_delay: ClassVar[bool] = False  # whether it removes the sensor's delay, no more, no less

    @classmethod
    @placeholder
    def start(cls, scenarios: Sequence[ScenarioLike], model: NumericalModel) -> ForceBlock | Drive:
        """For ``n`` runs: a block that corrects the wrench, or a drive that steps ``model``."""
        raise NotImplementedError

    def removes(self, scenario: ScenarioLike) -> Mapping[str, float]:
        """Name to the delay [s] that it removes from the loop at low frequency."""
        from hiltestbed.contact.directions import acting_along_z

        removed = self.removed(scenario.sensor.delay, acting_along_z(scenario.impact)[0])
        return {} if removed is None else {self.kind: removed}

    def removed(self, delay: float, stiffness: float) -> float | None:
        """What it removes [s] of a ``delay`` [s] in a contact of ``stiffness`` [N/m]; None:
        nothing.
        """
        return delay if self.removes_delay else None

    def memory(self) -> float:
        """The time constant [s] with which its output decays after a force has ended."""
        return 0.0

    @classmethod
    def contest(cls, stiffness: float, damping: float, delay: float) -> Mapping[str, Any]:
        """Keys of its scenario section for a contact of `bench cor`, given the true stiffness [N/m]
        and damping [N s/m] and the nominal delay [s].

        A method that needs no knowledge of the contact does not override this, and is benchmarked
        with its defaults.
        """
        return {}


class MotionMethod(Strictly):
    """Base of every motion compensation. A class needs a docstring and the parts named in
    :data:`PARTS`.

    Attributes:
        reads: its inputs at t_k. feeds: whether the servo receives velocity and acceleration
            feed-forward.
        tells_model_pose: whether the command is the numerical model's pose itself.
        corrects_force: whether it corrects the force for the platform's tracking error, instead of
            the command.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "reads")
    CHOICES: ClassVar[Mapping[str, frozenset[str]]] = {"reads": INPUTS}

    kind: str
    reads: ClassVar[frozenset[Input]] = None  # type: ignore[assignment]
    feeds: ClassVar[bool] = False
    tells_model_pose: ClassVar[bool] = False
    corrects_force: ClassVar[bool] = False

    @property
    def open_loop(self) -> bool:
        """Whether it changes the command without measurements: a part of the rig's response."""
        return not (self.reads or self.tells_model_pose or self.feeds)

    def of_the_rig(self) -> dict[str, Any]:
        """The section for the rig alone: what acts without measurements."""
        return (
            self.model_dump(mode="json")
            if self.open_loop
            else {"kind": "feedforward" if self.feeds else "none"}
        )

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike]) -> PoseBlock | None:
        """The method for ``n`` runs; None if the pose is commanded unchanged."""
        motions = all_of(cls, [s.compensation.motion for s in scenarios])
        return cls.block(motions, scenarios[0].rate)

    @classmethod
    def block(cls, own: Sequence[Self], rate: float) -> PoseBlock | None:
        """The same from settings alone; ``rate`` of the loop [Hz]."""
        return None


FORCE_METHODS: Registry[ForceMethod] = Registry(
    "force compensation",
    ForceMethod,
    ("hiltestbed.compensation.force_methods", "hiltestbed.compensation.resynchronised.settings"),
)
MOTION_METHODS: Registry[MotionMethod] = Registry(
    "motion compensation", MotionMethod, ("hiltestbed.compensation.motion_methods",)
)
AnyForceMethod = Annotated[ForceMethod, OneOf(FORCE_METHODS)]
AnyMotionMethod = Annotated[MotionMethod, OneOf(MOTION_METHODS)]


Force = TypeVar("Force", bound=ForceMethod)


def force_of(scenarios: Sequence[ScenarioLike], method: type[Force]) -> list[Force]:
    """``compensation.force`` of each, all of class ``method``. Raises TypeError for another."""
    return all_of(method, [s.compensation.force for s in scenarios])


class BlockMethod(ForceMethod):
    """Base of the methods that correct the wrench and need no more than a :class:`ForcePath`."""

    reads: ClassVar[frozenset[Input]] = frozenset({"wrench"})

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike], model: NumericalModel) -> ForceBlock:
        delay = np.array([s.sensor.delay for s in scenarios])
        mass = np.array([effective_mass(s.spacecraft) for s in scenarios])
        captures = scenarios[0].mechanism.captures
        path = ForcePath(scenarios[0].rate, delay, mass, captures, model)
        return cls.block(force_of(scenarios, cls), path)

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        """The method for ``n`` runs with the settings ``own``."""
        raise NotImplementedError


# Its schema lists the methods, whose modules import this one: it is built when it is first used.
class Compensation(Strictly, defer_build=True):
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
