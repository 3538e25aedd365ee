"""What an effect is: a departure of one link of the loop from what is believed of it.

An effect changes the parameters of its link's model (:meth:`Effect.apply`), so that nominal and departing are the same equations with
other numbers. Everything that is known of an effect stands in its class: schema with units and ranges, equation and source, where a
search for it starts and ends, the delay that it is worth, what it is easily taken for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr

from hiltestbed.plugins import placeholder
from hiltestbed.validation import Strictly

if TYPE_CHECKING:
    from hiltestbed.effects.search import Candidate, Scales
    from hiltestbed.scenario import Scenario

Link = Literal["platform", "contact", "sensor", "compensation", "dynamics", "log"]
LINKS: tuple[Link, ...] = ("platform", "contact", "sensor", "compensation", "dynamics", "log")


def quantity(
    unit: str,
    meaning: str,
    *,
    default: Any = ...,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    search: tuple[float, float] | None = None,
    ratio: bool = False,
) -> Any:
    """A field of an effect.

    Args:
        unit: "-" for none. meaning: what it is, in words that need no others; after a semicolon what a special value stands for.
        gt, ge, lt, le: its range. search: the range [unit] that a diagnosis searches, by ``ratio`` or by difference.
    """
    what, sign, note = meaning.partition(";")
    text = f"{what} [{unit}]{sign}{note}"
    extra = {"unit": unit} | ({"search": list(search), "search_by_ratio": ratio} if search else {})
    return Field(default, description=text, gt=gt, ge=ge, lt=lt, le=le, json_schema_extra=extra)


class Effect(Strictly):
    """Base of every effect. A class needs a docstring and the parts named in :data:`PARTS`.

    Attributes:
        kind: its id in the vocabulary, a literal. link: the link of the loop that it acts on.
        equation: what it does, in the discrete form where that matters. reference: where the equation comes from.
        resembles: effects that it is easily taken for. repeats: whether two of its kind act together; else a second one is refused.
        leading: the parameter that says how large it is. vanishes: whether a smaller effect has a larger parameter (a limit).
        jumps: a parameter in which a prediction is not smooth, or "".
        rich: whether it has so many numbers that it is sought only where effects with fewer leave more than noise.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "link", "equation", "reference", "apply", "candidates")

    kind: str
    link: ClassVar[Link] = None  # type: ignore[assignment]
    equation: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    resembles: ClassVar[tuple[str, ...]] = ()
    repeats: ClassVar[bool] = False
    leading: ClassVar[str] = ""
    vanishes: ClassVar[bool] = False
    jumps: ClassVar[str] = ""
    rich: ClassVar[bool] = False

    _variant: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @property
    def variant(self) -> Mapping[str, Any]:
        """Which reading of the equation is meant, where its words leave more than one; empty for the one that a scenario runs."""
        return self._variant

    @classmethod
    def hypothesis(cls, variant: Mapping[str, Any], **values: Any) -> Self:
        """The effect with parameters that are not checked, in a variant: a search may leave what a scenario allows."""
        effect = cls.model_construct(**values)
        effect._variant = variant
        return effect

    @placeholder
    def apply(self, p: Any) -> None:
        """Change the parameters ``p`` of one run's link, an object of the link's ``Parameters`` class, in place."""
        raise NotImplementedError

    @classmethod
    @placeholder
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """The hypotheses with which a diagnosis searches for it: free parameters, bounds and starts, scaled by what the data hold."""
        raise NotImplementedError

    def worth(self, scenario: Scenario, frequency: float) -> float | None:
        """The delay [s] that it is worth in a contact of ``frequency`` [rad/s]; None: it is no delay."""
        return None

    def unfit(self, scenario: Scenario) -> str | None:
        """Why it cannot act in ``scenario``, in words that say what it takes; None where it can."""
        return None

    def parameters(self) -> dict[str, Any]:
        """Its parameters without the kind."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}

    @classmethod
    def meaning(cls) -> str:
        """What it is, in a sentence: the first of its docstring."""
        return (cls.__doc__ or "").strip().partition("\n")[0]

    @classmethod
    def unit(cls, parameter: str) -> str:
        """The unit of a parameter, "-" for none."""
        extra = cls.model_fields[parameter].json_schema_extra
        return str(extra.get("unit", "")) if isinstance(extra, dict) else ""

    @classmethod
    def searched(cls, parameter: str) -> tuple[float, float, bool]:
        """The range of a parameter that a diagnosis searches, and whether by ratio."""
        extra = cls.model_fields[parameter].json_schema_extra
        if not isinstance(extra, dict) or "search" not in extra:
            raise KeyError(f"{cls.__name__}.{parameter} is not searched")
        low, high = extra["search"]  # type: ignore[misc]
        return float(low), float(high), bool(extra["search_by_ratio"])  # type: ignore[arg-type]


def repeated(effects: Sequence[Effect]) -> Iterator[tuple[int, Effect]]:
    """The place of each effect that stands in a list a second time although its kind does not act together with itself."""
    seen = set()
    for index, effect in enumerate(effects):
        if effect.kind in seen and not effect.repeats:
            yield index, effect
        seen.add(effect.kind)
