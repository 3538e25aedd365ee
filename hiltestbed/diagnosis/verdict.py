"""From the explanations of the links to one verdict and its causes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hiltestbed.diagnosis.fit import Fit
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.search import Explanation, inflation
from hiltestbed.effects.vocabulary import EFFECTS

MOST_RIVALS = 2
ORDER = ("platform", "wrench", "compensation", "dynamics")


@dataclass
class Cause:
    """One cause: which effect, on which link's fit, and what cannot be told from it."""

    effect: str
    link: str
    fit: Fit
    index: int
    parameters: dict
    probability: float
    weight: float
    rivals: list[Fit] = field(default_factory=list)

    @property
    def indistinguishable_from(self) -> list[str]:
        """Effects that explain as much."""
        own = {c.effect for c in self.fit.causes}
        return [next(c.effect for c in f.causes if c.effect not in own) for f in self.rivals]


@dataclass
class Verdict:
    """no_discrepancy, named, ambiguous or unknown; the link that departs; the causes, strongest first."""

    verdict: str
    link: str | None
    causes: list[Cause]
    sentence: str = ""


def judge(findings: Findings) -> Verdict:
    """The verdict on all links."""
    causes: list[Cause] = []
    unexplained: list[tuple[float, str]] = []
    for name in ORDER:
        e = findings.explanations.get(name)
        if e is None or not e.alarm:
            continue
        if not e.adequate:
            worst = max(left.excess for left in e.leftovers.values())
            unexplained.append((worst, _part(findings, e) if name == "wrench" else name))
            continue
        causes += _causes(findings, name, e)
    causes = _merged(causes)
    causes.sort(key=lambda c: -c.weight)
    if unexplained:
        return Verdict("unknown", _record_alone(findings) or max(unexplained)[1], causes)
    if not causes:
        return Verdict("no_discrepancy", None, [])
    ambiguous = any(c.rivals for c in causes)
    return Verdict("ambiguous" if ambiguous else "named", EFFECTS[causes[0].effect].link, causes)


def _record_alone(findings: Findings) -> str | None:
    """`log` where the force departs from what it came from and from what became of it alike: the record, and not the loop."""
    both = [findings.explanations.get(name) for name in ("wrench", "compensation")]
    stamped = any(e is not None and any(c.effect == "log.skew" for c in e.chosen.causes) for e in both)
    return "log" if stamped and all(e is not None and e.alarm for e in both) else None


def _causes(findings: Findings, name: str, e: Explanation) -> list[Cause]:
    out = []
    for index, cause in enumerate(e.chosen.causes):
        rivals = (e.rivals[index] if e.rivals else [])[:MOST_RIVALS]
        share = inflation(e.chosen)
        odds = [math.exp(-0.5 * max(-50.0, (f.score - e.chosen.score) / share)) for f in rivals]
        rest = _without(e, index)
        parameters = cause.public(e.chosen.part(index))
        out.append(Cause(cause.effect, name, e.chosen, index, parameters, 1.0 / (1.0 + sum(odds)), rest / share, rivals))
    return out


def _without(e: Explanation, index: int) -> float:
    """What the cause takes off chi-square, beside the others."""
    if len(e.chosen.causes) == 1:
        return e.null.chi2 - e.chosen.chi2
    others = {c.key for i, c in enumerate(e.chosen.causes) if i != index}
    single = next((f for f in e.singles if {c.key for c in f.causes} == others), e.null)
    return single.chi2 - e.chosen.chi2


def _merged(causes: list[Cause]) -> list[Cause]:
    """Each effect once: log.skew shows on two links, of which the force against the pose, which comes first, is the sharper one."""
    return [c for i, c in enumerate(causes) if c.effect not in {o.effect for o in causes[:i]}]


def _part(findings: Findings, e: Explanation) -> str:
    """Contact or sensor: what only shows while the mechanisms touch is the contact's."""
    effects = {EFFECTS[c.effect].link for c in e.chosen.causes}
    return "sensor" if effects == {"sensor"} and _shows_free(findings, e) else "contact"


def _shows_free(findings: Findings, e: Explanation) -> bool:
    import numpy as np

    residual = findings.residuals["wrench"]
    free = [residual.of_run(i, e.chosen.effects())[~residual.link.runs[i].touching] for i in residual.runs]
    return bool(float(np.mean(np.concatenate(free) ** 2)) > 1.5)
