"""The identification section of a scenario: estimators of stiffness and damping during the contact,
one class per method.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Protocol, Self

from hiltestbed.config.validation import Strictly
from hiltestbed.frames import Array
from hiltestbed.plugins import OneOf, Registry, all_of, placeholder

if TYPE_CHECKING:
    from hiltestbed.identification.samples import ContactSamples, SampleParameters
    from hiltestbed.scenario.like import ScenarioLike


class Identification(Protocol):
    """An estimator of ``F = k x + c v`` on six axes, for ``n`` runs.

    Attributes:
        stiffness, damping: ``(n, 6)`` running estimates, NaN before the first.
        samples: ``(n, 6)`` number of contact samples used.
        source: of its contact samples.
    """

    stiffness: Array
    damping: Array
    samples: Array

    @property
    def source(self) -> ContactSamples: ...

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Process the measurements at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        ...


class Identifier(Strictly):
    """Base of every estimator's settings. A class needs a docstring and the parts named in
    :data:`PARTS`.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "start")

    kind: str

    @property
    def settles(self) -> float:
        """[s] of the method's own filter, over whose memory samples are buffered; 0: none."""
        return 0.0

    @classmethod
    @placeholder
    def start(cls, scenarios: Sequence[ScenarioLike]) -> Identification | None:
        """The estimator for ``n`` runs; None if nothing is estimated."""
        raise NotImplementedError


IDENTIFIERS: Registry[Identifier] = Registry(
    "identifier", Identifier, ("hiltestbed.identification.methods",)
)
AnyIdentifier = Annotated[Identifier, OneOf(IDENTIFIERS)]


class ContactIdentifier(Identifier):
    """Base of the estimators that are made of their settings and of contact samples alone."""

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike]) -> Identification | None:
        from hiltestbed.identification.samples import SampleParameters

        own = all_of(cls, [s.identification for s in scenarios])
        return cls.estimator(own, SampleParameters.of(scenarios))

    @classmethod
    def estimator(cls, own: Sequence[Self], given: SampleParameters) -> Identification | None:
        """The estimator for ``n`` runs with the settings ``own``; None if nothing is estimated."""
        raise NotImplementedError
