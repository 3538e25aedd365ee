"""What a search and a report know of whatever departs from a model: schema with units and ranges,
equation and source, and the effects that it is easily mistaken for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr

from hiltestbed.config.validation import Strictly
from hiltestbed.plugins import placeholder

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
        unit: "-" for none. meaning: a self-contained description; after a semicolon, what a special
            value stands for.
        gt, ge, lt, le: its range. search: the range [unit] that a diagnosis searches,
            logarithmically if ``ratio``, else linearly.
    """
    what, sign, note = meaning.partition(";")
    text = f"{what} [{unit}]{sign}{note}"
    extra: dict[str, Any] = {"unit": unit} | ({"search": list(search)} if search else {})
    if search or ratio:
        extra["search_by_ratio"] = ratio
    return Field(default, description=text, gt=gt, ge=ge, lt=lt, le=le, json_schema_extra=extra)


class Departure(Strictly):
    """Base of whatever may depart from a model: what a search and a report need to know of it.

    Attributes:
        kind: its id in the vocabulary, a literal. link: the link of the loop that it acts on.
        equation, reference: what it does, and the source of that.
        resembles: effects that it is easily mistaken for. repeats: whether two of its kind may act
            together. parallel: whether a search may take several with numbers of their own, side by
            side.
        leading: the parameter that sets its size, by default the first. vanishes: whether the
            effect becomes smaller as that parameter grows (a limit). jumps: the parameter on which
            the prediction depends discontinuously, or "".
        rich: whether it has so many parameters that it is tried only where effects with fewer leave
            more than noise.
    """

    kind: str
    link: ClassVar[Link] = None  # type: ignore[assignment]
    equation: ClassVar[str] = ""
    reference: ClassVar[str] = ""
    resembles: ClassVar[tuple[str, ...]] = ()
    repeats: ClassVar[bool] = False
    parallel: ClassVar[bool] = False
    leading: ClassVar[str] = ""
    vanishes: ClassVar[bool] = False
    jumps: ClassVar[str] = ""
    rich: ClassVar[bool] = False
    excludes: ClassVar[tuple[str, ...]] = ()  # kinds in place of which it acts
    same: ClassVar[tuple[str, ...]] = ()  # kinds from which no record tells it, unless searched too

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        cls.leading = cls.leading or next((n for n in cls.model_fields if n != "kind"), "")

    _variant: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @property
    def variant(self) -> Mapping[str, Any]:
        """Which interpretation of an ambiguous equation is meant; empty: that of a scenario."""
        return self._variant

    def read_as(self, variant: Mapping[str, Any]) -> Self:
        """The same effect in a variant."""
        out = self.model_copy()
        out._variant = variant
        return out

    @classmethod
    def hypothesis(cls, variant: Mapping[str, Any], **values: Any) -> Self:
        """The effect in a variant, unchecked: a search may leave the range of a scenario."""
        effect = cls.model_construct(**values)
        effect._variant = variant
        return effect

    @placeholder
    def apply(self, p: Any) -> None:
        """Change the parameters ``p`` of the model in place."""
        raise NotImplementedError

    def parameters(self) -> dict[str, Any]:
        """Its parameters, without ``kind``."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}

    @classmethod
    def meaning(cls) -> str:
        """What it is: the first paragraph of its docstring, on one line."""
        return " ".join((cls.__doc__ or "").strip().partition("\n\n")[0].split())

    @classmethod
    def unit(cls, parameter: str) -> str:
        """The unit of a parameter, "-" for none."""
        extra = cls.model_fields[parameter].json_schema_extra
        return str(extra.get("unit", "")) if isinstance(extra, dict) else ""

    @classmethod
    def searched(cls, parameter: str) -> tuple[float, float, bool]:
        """The searched range of a parameter, and whether it is searched logarithmically."""
        extra = cls.model_fields[parameter].json_schema_extra
        if not isinstance(extra, dict) or "search" not in extra:
            raise KeyError(f"{cls.__name__}.{parameter} is not searched")
        low, high = extra["search"]  # type: ignore[misc]
        return float(low), float(high), cls.by_ratio(parameter)  # type: ignore[arg-type]

    @classmethod
    def by_ratio(cls, parameter: str) -> bool:
        """Whether a parameter is searched logarithmically."""
        extra = cls.model_fields[parameter].json_schema_extra
        return isinstance(extra, dict) and bool(extra.get("search_by_ratio"))
