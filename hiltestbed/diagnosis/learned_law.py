"""A learned law as plain records, for the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.diagnosis.result import Heldout


@dataclass(frozen=True)
class LearnedCurve:
    """One curve of a learned law, and the data for it with all other terms subtracted.

    Attributes:
        over: its abscissa, a parameter of the effect. knots: (K, 2). data: (M, 2) samples, thinned.
            units: of both axes.
    """

    over: str
    knots: Array
    data: Array
    units: tuple[str, str]


@dataclass(frozen=True)
class Learned:
    """A law that was learned on a link which no named effects explain.

    Attributes:
        effect: id. parameters: as in a scenario. link: that it acts on. numbers: how many were
            fitted.
        heldout: its gain on left-out runs, beside the named causes. explained: share of the
            departure there.
        carries_over: whether the same law holds in all runs, so that the model is extended with it.
        equation: a short one, or None where none fits. resembles: named effects that remove much
            the same from the residual.
    """

    effect: str
    parameters: Mapping[str, Any]
    link: str
    numbers: int
    heldout: Heldout
    explained: float
    carries_over: bool
    equation: str | None
    resembles: tuple[str, ...]
    curves: tuple[LearnedCurve, ...] = ()

    def entry(self) -> dict[str, Any]:
        """As it stands under `effects:` in a scenario."""
        return {"kind": self.effect, **self.parameters}

    def to_json(self) -> dict[str, Any]:
        """As it stands in diagnosis.json; `gain` is the relative reduction of the residual on
        left-out runs.
        """
        return {
            "effect": self.effect,
            "gain": self.heldout.reduction,
            "resembles": list(self.resembles),
            "equation": self.equation,
            "parameters": dict(self.parameters),
            "numbers": self.numbers,
            "explained": self.explained,
            "carries_over": self.carries_over,
            "heldout": self.heldout.to_json(),
        }
