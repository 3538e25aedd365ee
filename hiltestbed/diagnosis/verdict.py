"""From the explanations of the links to one verdict and its causes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.fit import Fit, inflation
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import MOST_RIVALS
from hiltestbed.diagnosis.timing import no_causes
from hiltestbed.effects.table import EFFECTS

ORDER = ("platform", "wrench", "compensation", "dynamics")
SHOWS = 1.5  # of the noise's variance, from which a departure shows outside contact


@dataclass(frozen=True)
class Named:
    """One cause: which of a fit's, on which link, and what cannot be told from it.

    Attributes:
        effect: id. link: whose fit it is in. index: its place in the fit. probability: that it is this one and not a rival.
        weight: what it takes off chi-square beside the others. rivals: fits that differ in this cause alone.
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
        """Effects that explain as much."""
        return [next(kind for kind in f.kinds if kind not in self.fit.kinds) for f in self.rivals]


@dataclass(frozen=True)
class Verdict:
    """What is said of a dataset.

    Attributes:
        verdict: no_discrepancy, named, ambiguous, unknown or inconclusive. link: that departs, or None. causes: strongest first.
        not_judged: link to why.
    """

    verdict: str
    link: str | None
    causes: tuple[Named, ...]
    not_judged: dict[str, str]


def decide(findings: Findings) -> Verdict:
    """The verdict on all links."""
    causes: list[Named] = []
    unexplained: list[tuple[float, str]] = []
    timing = no_causes(findings.explanations)
    for name in ORDER:
        e = findings.explanations.get(name)
        if e is None or not e.departs:
            continue
        if not e.adequate:
            unexplained.append((e.worst, _part(e) if name == "wrench" else name))
            continue
        causes += [c for c in _causes(name, e) if c.effect not in timing.get(name, ())]
    causes = sorted(_once(causes), key=lambda c: -c.weight)
    missing = findings.missing
    if unexplained:
        return Verdict("unknown", _record_alone(findings) or max(unexplained)[1], tuple(causes), missing)
    if not causes:
        return Verdict("inconclusive" if missing else "no_discrepancy", None, (), missing)
    ambiguous = any(c.rivals for c in causes)
    return Verdict("ambiguous" if ambiguous else "named", EFFECTS[causes[0].effect].link, tuple(causes), missing)


def _record_alone(findings: Findings) -> str | None:
    """`log` where the force departs from what it came from and from what became of it alike: the record, and not the loop."""
    both = [findings.explanations.get(name) for name in ("wrench", "compensation")]
    stamped = any(e is not None and "log.skew" in e.chosen.kinds for e in both)
    return "log" if stamped and all(e is not None and e.departs for e in both) else None


def _causes(name: str, e: Explanation) -> list[Named]:
    out = []
    share = inflation(e.chosen)
    for index, kind in enumerate(e.chosen.kinds):
        rivals = (e.rivals[index] if e.rivals else ())[:MOST_RIVALS]
        odds = [math.exp(-0.5 * max(-50.0, (f.score - e.chosen.score) / share)) for f in rivals]
        out.append(Named(kind, name, e.chosen, index, 1.0 / (1.0 + sum(odds)), _weight(e, index) / share, tuple(rivals)))
    return out


def _weight(e: Explanation, index: int) -> float:
    """What a cause takes off chi-square, beside the others."""
    if len(e.chosen.causes) == 1:
        return e.null.chi2 - e.chosen.chi2
    others = {c.key for i, c in enumerate(e.chosen.causes) if i != index}
    rest = next((f for f in (*e.singles, *e.more) if {c.key for c in f.causes} == others), e.null)
    return rest.chi2 - e.chosen.chi2


def _once(causes: list[Named]) -> list[Named]:
    """Each effect once: a record stamped late shows on two links, of which contact and sensor, which come first, tell it more exactly."""
    return [c for i, c in enumerate(causes) if c.effect not in {o.effect for o in causes[:i]}]


def _part(e: Explanation) -> str:
    """Contact or sensor: what only shows while the mechanisms touch is the contact's."""
    links = {c.effect.link for c in e.chosen.causes}
    return "sensor" if links == {"sensor"} and _shows_free(e) else "contact"


def _shows_free(e: Explanation) -> bool:
    residual = e.residual
    left = residual.by_run([e.chosen.effects()])[0]
    free = np.concatenate([r[~residual.link.runs[i].touching] for i, r in zip(residual.runs, left, strict=True)])
    return bool(len(free)) and float(np.mean(free**2)) > SHOWS
