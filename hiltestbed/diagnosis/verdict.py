"""Stage "decide": from the explanations of the links to one `Verdict` and its causes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.fit import Fit, inflation
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.timing import delays_not_causes
from hiltestbed.effects.table import EFFECTS

MAX_RIVALS = 2  # chosen: that are listed for a cause; a larger set identifies nothing

# chosen: of the noise variance: mean square of a residual outside contact, from which a departure
# shows there
MIN_FREE_VARIANCE = 1.5


@dataclass(frozen=True)
class Named:
    """One named cause: its place in a fit, the link, and what it cannot be told from.

    Attributes:
        effect: id. link: whose fit it is in. index: its place in the fit. probability: that it is
            this effect and not a rival.
        weight: reduction of chi-square by it, beside the other causes. rivals: fits that differ in
            this cause only.
    """

    effect: str
    link: str
    fit: Fit
    index: int
    probability: float = 0.0
    weight: float = 0.0
    rivals: tuple[Fit, ...] = ()

    @property
    def indistinguishable_from(self) -> list[str]:
        """Effects that explain the data as well; itself where on another axis or body."""
        return [
            next((kind for kind in f.kinds if kind not in self.fit.kinds), self.effect)
            for f in self.rivals
        ]


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
    """The verdict on all links."""
    causes: list[Named] = []
    unexplained: list[tuple[float, str]] = []
    timing = delays_not_causes(findings.explanations)
    for name in LINK_NAMES:
        e = findings.explanations.get(name)
        if e is None or not e.departs:
            continue
        if not e.adequate:
            unexplained.append((e.worst, _contact_or_sensor(e) if name == "wrench" else name))
            continue
        causes += [c for c in _causes(name, e) if c.effect not in timing.get(name, ())]
    causes = sorted(_without_repeats(causes), key=lambda c: -c.weight)
    missing = findings.missing
    if unexplained:
        return Verdict(
            "unknown", _record_alone(findings) or max(unexplained)[1], tuple(causes), missing
        )
    if not causes:
        return Verdict("inconclusive" if missing else "no_discrepancy", None, (), missing)
    ambiguous = any(c.rivals for c in causes)
    link = EFFECTS[causes[0].effect].link
    return Verdict("ambiguous" if ambiguous else "named", link, tuple(causes), missing)


def _record_alone(findings: Findings) -> str | None:
    """`log` where both links of the measured force depart, one of them by a stamp delay."""
    both = [findings.explanations.get(name) for name in ("wrench", "compensation")]
    stamped = any(e is not None and "log.skew" in e.chosen.kinds for e in both)
    return "log" if stamped and all(e is not None and e.departs for e in both) else None


def _causes(name: str, e: Explanation) -> list[Named]:
    out = []
    share = inflation(e.chosen)
    for index, kind in enumerate(e.chosen.kinds):
        rivals = (e.rivals[index] if e.rivals else ())[:MAX_RIVALS]
        odds = [math.exp(-0.5 * max(-50.0, (f.score - e.chosen.score) / share)) for f in rivals]
        probability, weight = 1.0 / (1.0 + sum(odds)), _weight(e, index) / share
        out.append(Named(kind, name, e.chosen, index, probability, weight, tuple(rivals)))
    return out


def _weight(e: Explanation, index: int) -> float:
    """Reduction of chi-square by a cause, beside the others."""
    if len(e.chosen.causes) == 1:
        return e.null.chi2 - e.chosen.chi2
    others = {c.key for i, c in enumerate(e.chosen.causes) if i != index}
    rest = next((f for f in (*e.singles, *e.more) if {c.key for c in f.causes} == others), e.null)
    return rest.chi2 - e.chosen.chi2


def _without_repeats(causes: list[Named]) -> list[Named]:
    """Each effect once: contact and sensor, which come first, determine a stamp delay better."""
    return [c for i, c in enumerate(causes) if c.effect not in {o.effect for o in causes[:i]}]


def _contact_or_sensor(e: Explanation) -> str:
    """`sensor` where only its effects were chosen and show outside contact too; else `contact`."""
    links = {c.effect.link for c in e.chosen.causes}
    return "sensor" if links == {"sensor"} and _shows_free(e) else "contact"


def _shows_free(e: Explanation) -> bool:
    residual = e.residual
    left = residual.by_run([e.chosen.effects()])[0]
    free = np.concatenate(
        [r[~residual.link.runs[i].touching] for i, r in zip(residual.runs, left, strict=True)]
    )
    return bool(len(free)) and float(np.mean(free**2)) > MIN_FREE_VARIANCE
