"""Stage "decide": from the explanations of the links to one `Verdict` and its causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.in_part import holding
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.timing import delays_not_causes
from hiltestbed.effects.base import Effect
from hiltestbed.effects.table import EFFECTS
from hiltestbed.inference.conclude import Confirmed
from hiltestbed.inference.likelihood import PosteriorFit

MAX_RIVALS = 2  # that are listed for a cause; a set of more than three identifies nothing
# of the variance of the noise: mean square of a residual outside contact, from which a departure
# shows there; that of 400 rows of noise exceeds 1.2 once in 500 runs
MIN_FREE_VARIANCE = 1.5


@dataclass(frozen=True)
class Named:
    """One named cause, and the link whose explanation it is a part of."""

    link: str
    cause: Confirmed

    @property
    def effect(self) -> str:
        """The id of the effect."""
        return self.cause.cause.kind

    @property
    def fitted(self) -> Effect:
        """The effect with its estimates."""
        return self.cause.effect

    @property
    def rivals(self) -> tuple[tuple[str, PosteriorFit], ...]:
        """The effects that explain the data as well, each with the whole explanation."""
        return tuple(zip(self.cause.rivals, self.cause.others, strict=True))[:MAX_RIVALS]

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """The effects that explain the data as well."""
        return tuple(kind for kind, _ in self.rivals)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a dataset.

    Attributes:
        verdict: no_discrepancy, named, ambiguous, named_in_part, unknown or inconclusive. link:
            that departs, or None.
        causes: strongest first. not_judged: link to the reason.
    """

    verdict: str
    link: str | None
    causes: tuple[Named, ...]
    not_judged: dict[str, str]


def decide(findings: Findings) -> Verdict:
    """The verdict on all links: named where causes explain each one that departs, in part where
    they do so on the one that departs most and leave more than noise.
    """
    explanations, missing = findings.explanations, findings.missing
    timing = delays_not_causes(explanations)
    causes: list[Named] = []
    unexplained: list[tuple[float, str]] = []
    for name in LINK_NAMES:
        e = explanations.get(name)
        if e is None or not e.departs:
            continue
        found = e.causes if e.adequate else holding(e)
        causes += [Named(name, c) for c in found if c.cause.kind not in timing.get(name, ())]
        if not e.adequate:
            unexplained.append((e.excess, name))
    causes = sorted(_once(causes), key=lambda c: -c.cause.gain)
    if unexplained:
        name = max(unexplained)[1]
        e = explanations[name]
        link = _record_alone(explanations.get("wrench"), explanations.get("compensation")) or (
            _contact_or_sensor(e) if name == "wrench" else name
        )
        in_part = any(c.link == name for c in causes)
        return Verdict("named_in_part" if in_part else "unknown", link, tuple(causes), missing)
    if not causes:
        return Verdict("inconclusive" if missing else "no_discrepancy", None, (), missing)
    ambiguous = any(c.rivals for c in causes)
    link = EFFECTS[causes[0].effect].link
    return Verdict("ambiguous" if ambiguous else "named", link, tuple(causes), missing)


def _record_alone(*both: Explanation | None) -> str | None:
    """`log` where both links of the measured force depart, one of them by a stamp delay."""
    stamped = any(e is not None and "log.skew" in e.kinds for e in both)
    return "log" if stamped and all(e is not None and e.departs for e in both) else None


def _once(causes: Sequence[Named]) -> list[Named]:
    """Each effect once: contact and sensor, which come first, determine a stamp delay better."""
    return [c for i, c in enumerate(causes) if c.effect not in {o.effect for o in causes[:i]}]


def _contact_or_sensor(e: Explanation) -> str:
    """`sensor` where only its effects were chosen and show outside contact too; else `contact`."""
    links = {effect.link for effect in e.effects()}
    return "sensor" if links == {"sensor"} and _shows_free(e) else "contact"


def _shows_free(e: Explanation) -> bool:
    parts = zip(e.model.groups, e.conclusion.null.left, strict=False)
    free = np.concatenate([np.zeros(0), *(x for (_, _, inside), x in parts if not inside)])
    return bool(len(free)) and float(np.mean(free**2)) > MIN_FREE_VARIANCE
