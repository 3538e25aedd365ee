"""What an effect is: a departure of one link of the loop from its nominal model.

An effect changes the parameters of its link's model (:meth:`Effect.apply`), so that the nominal and
the departing model are the same equations with different numbers. An effect's class holds
everything known about it: what :class:`~hiltestbed.effects.departure.Departure` has, search range
and starting points, and equivalent delay.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar, Self

from hiltestbed.effects.departure import Departure, Link
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.plugins import placeholder

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike


class Effect(Departure):
    """Base of every effect of the loop. A class needs a docstring and the parts named in
    :data:`PARTS`; of an effect that does not repeat, a second one in a scenario is refused.
    """

    PARTS: ClassVar[tuple[str, ...]] = (
        "docstring",
        "link",
        "equation",
        "reference",
        "apply",
        "candidates",
    )

    @classmethod
    @placeholder
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """The hypotheses of a diagnosis: free parameters, bounds and starts, scaled to the data."""
        raise NotImplementedError

    def worth(self, tick: float, frequency: float) -> float | None:
        """Equivalent delay [s] at a ``tick`` [s], in a contact of ``frequency`` [rad/s]; None:
        none.
        """
        return None

    def unfit(self, scenario: ScenarioLike) -> str | None:
        """Why it cannot act in ``scenario``, and what it would need; None if it can act."""
        return None


class LinkParameters:
    """Base of the parameters of a link's model, which the effects on the ``link`` change."""

    link: ClassVar[Link]

    def with_effects(self, effects: Iterable[Effect]) -> Self:
        """Apply those of ``effects`` that act on the link, in place; returns itself."""
        for effect in effects:
            if effect.link == self.link:
                effect.apply(self)
        return self


def repeated(effects: Sequence[Effect]) -> Iterator[tuple[int, Effect]]:
    """Index and effect of each repeated entry whose kind may appear only once in the list."""
    seen = set()
    for index, effect in enumerate(effects):
        if effect.kind in seen and not effect.repeats:
            yield index, effect
        seen.add(effect.kind)
