"""The compensation's section of a scenario: what is done against the delays of the loop, one class a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar, get_args

from hiltestbed.plugins import OneOf, Registry, placeholder
from hiltestbed.validation import Strictly

if TYPE_CHECKING:
    from hiltestbed.compensation.blocks import Drive, ForceBlock, PoseBlock
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario

# What a method may read at t_k: the measured wrench; the pose and twist that the rig reached; stiffness and damping as identified so far;
# whether the latches hold; the pose and twist of the numerical model that it drives.
Input = Literal["wrench", "pose", "twist", "identified", "captured", "model"]
INPUTS: frozenset[str] = frozenset(get_args(Input))


class ForceMethod(Strictly):
    """Base of every compensation of the force. A class needs a docstring and the parts named in :data:`PARTS`.

    Attributes:
        reads: what it needs to know at t_k. corrects_platform: whether it corrects the force for where the platform is not.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "reads", "start")
    CHOICES: ClassVar[Mapping[str, frozenset[str]]] = {"reads": INPUTS}

    kind: str
    reads: ClassVar[frozenset[Input]] = None  # type: ignore[assignment]
    adds_force: ClassVar[bool] = False  # a force of its own, beside what it makes of the measured one
    corrects_platform: ClassVar[bool] = False

    @classmethod
    @placeholder
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> ForceBlock | Drive:
        """The method for ``n`` runs: what corrects the wrench, or a drive of its own that steps ``model`` itself."""
        raise NotImplementedError

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        """Name to the delay [s] that it takes out of the loop at low frequency, once it knows the contact that it needs to know."""
        return {}

    def memory(self) -> float:
        """The time constant [s] with which it forgets a force that has ended."""
        return 0.0

    @classmethod
    def contest(cls, stiffness: float, damping: float, delay: float) -> Mapping[str, Any]:
        """Keys of its section of the scenario for a contact of `bench cor`, with the true stiffness [N/m] and damping [N s/m] and the
        believed delay [s].

        A method that needs no knowledge of the contact leaves it as it is here, and takes part with its defaults.
        """
        return {}


class MotionMethod(Strictly):
    """Base of every way to tell the platform where to go. A class needs a docstring and the parts named in :data:`PARTS`.

    Attributes:
        reads: what it needs to know at t_k. feeds: whether the servo is told velocity and acceleration, too.
        tells_model_pose: whether the platform is told the numerical model's pose itself.
        corrects_force: whether it corrects the force for where the platform is not, in place of the motion.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "reads")
    CHOICES: ClassVar[Mapping[str, frozenset[str]]] = {"reads": INPUTS}

    kind: str
    reads: ClassVar[frozenset[Input]] = None  # type: ignore[assignment]
    feeds: ClassVar[bool] = False
    tells_model_pose: ClassVar[bool] = False
    corrects_force: ClassVar[bool] = False

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> PoseBlock | None:
        """The method for ``n`` runs; None where the pose is commanded as it is."""
        return None


FORCE_METHODS: Registry[ForceMethod] = Registry(
    "force compensation", ForceMethod, ("hiltestbed.compensation.force_methods", "hiltestbed.compensation.resynchronised.settings")
)
MOTION_METHODS: Registry[MotionMethod] = Registry("motion compensation", MotionMethod, ("hiltestbed.compensation.motion_methods",))
AnyForceMethod = Annotated[ForceMethod, OneOf(FORCE_METHODS)]
AnyMotionMethod = Annotated[MotionMethod, OneOf(MOTION_METHODS)]


Force = TypeVar("Force", bound=ForceMethod)
Motion = TypeVar("Motion", bound=MotionMethod)


def force_of(scenarios: Sequence[Scenario], method: type[Force]) -> list[Force]:
    """``compensation.force`` of each scenario, all of one class. Raises TypeError for another."""
    return _all_of(method, [s.compensation.force for s in scenarios])


def motion_of(scenarios: Sequence[Scenario], method: type[Motion]) -> list[Motion]:
    """``compensation.motion`` of each scenario, all of one class. Raises TypeError for another."""
    return _all_of(method, [s.compensation.motion for s in scenarios])


def _all_of(method: type, sections: list[Any]) -> list[Any]:
    other = next((s for s in sections if not isinstance(s, method)), None)
    if other is not None:
        raise TypeError(f"settings of {method.__name__} expected (got {type(other).__name__})")
    return sections
