"""The numerical-model section of a scenario: the dynamics of the two vehicles, one class per
kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar

from hiltestbed.config.validation import Strictly
from hiltestbed.plugins import OneOf, Registry, placeholder

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario.like import ScenarioLike


class ModelKind(Strictly):
    """Base of every numerical model's settings. A class needs a docstring and the parts named in
    :data:`PARTS`.

    Attributes:
        ticks_late: delay that the coupling to the model adds to the loop, in ticks.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "start")

    kind: str
    ticks_late: ClassVar[float] = 0.0

    @classmethod
    @placeholder
    def start(cls, scenarios: Sequence[ScenarioLike]) -> NumericalModel:
        """The model for ``n`` runs, at the start of the approach. Raises InputError."""
        raise NotImplementedError


MODELS: Registry[ModelKind] = Registry(
    "numerical model", ModelKind, ("hiltestbed.numerical_model.kinds",)
)
AnyModel = Annotated[ModelKind, OneOf(MODELS, default="free_flyers")]
