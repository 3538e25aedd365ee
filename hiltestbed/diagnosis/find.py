"""From a measured dataset to a `Finding`: verdict, causes with intervals, gain on left-out runs, ranking, what could be told apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hiltestbed.diagnosis.fit import Fit
from hiltestbed.diagnosis.grow import far_off, grow
from hiltestbed.diagnosis.heldout import heldout, placebo_of
from hiltestbed.diagnosis.intervals import intervals
from hiltestbed.diagnosis.investigate import Findings, Progress, full_links, investigate
from hiltestbed.diagnosis.isolability import isolability
from hiltestbed.diagnosis.output.evidence import link_series
from hiltestbed.diagnosis.output.result import Cause, Finding, Heldout, Interval, Isolable, Parameter, Ranked
from hiltestbed.diagnosis.search import Explanation, contact_leftovers
from hiltestbed.diagnosis.shape import describe
from hiltestbed.diagnosis.verdict import Cause as Named
from hiltestbed.diagnosis.verdict import Verdict, judge
from hiltestbed.effects.vocabulary import EFFECTS
from hiltestbed.measured import MeasuredDataset

RANKED = 6  # hypotheses of a link that are listed
CHECKED = 3  # of them, scored on left-out runs
MEASURED = ("platform", "wrench")  # links whose output is measured: what they leave is judged by its noise
LINK_NAMES = {"platform": "platform", "wrench": "contact and sensor", "compensation": "compensation", "dynamics": "numerical model"}


def find(dataset: MeasuredDataset, progress: Progress | None = None) -> Finding:
    """What is wrong with the simulation of these data."""
    findings = investigate(dataset, progress)
    verdict = judge(findings)
    if progress:
        progress("intervals and left-out runs")
    causes = tuple(cause_of(findings, c) for c in verdict.causes)
    nearest = _nearest(findings, verdict, progress)
    once = {c.effect: c for c in [*nearest, *verdict.causes]}  # a record stamped late shows on two links
    effects = [c.fit.effects()[c.index] for c in once.values()]  # as the links take them, forms included
    series = [s for link in full_links(findings).values() for s in link_series(link, effects)]
    alarmed = {name: e for name, e in findings.explanations.items() if e.alarm}
    left = "; ".join(describe(findings.residuals[n], e, LINK_NAMES[n]) for n, e in alarmed.items() if not e.adequate)
    return Finding(
        verdict.verdict, verdict.link, causes, series, dict(findings.study.noise), gain_of(findings, verdict.causes),
        tuple(r for n, e in alarmed.items() for r in _ranking(findings, n, e)), _isolability(findings, progress), left,
        tuple(f"{LINK_NAMES[name]} was not judged: {why}" for name, why in findings.missing.items()),
        tuple(cause_of(findings, c) for c in nearest), gain_of(findings, nearest),
    )  # fmt: skip


def _nearest(findings: Findings, verdict: Verdict, progress: Progress | None) -> list[Named]:
    """Where a link departs without a name: the effects that come nearest on the link that is worst, as many as pay."""
    if verdict.verdict != "unknown":
        return []
    open_ = {n: e for n, e in findings.explanations.items() if e.alarm and not e.adequate and e.chosen.causes}
    if not open_:
        return []
    name = max(open_, key=lambda n: max(left.excess for left in open_[n].leftovers.values()))
    if name in MEASURED and far_off(open_[name]):
        findings.explanations[name] = _grown(findings, name, progress)
    fit, out = findings.explanations[name].chosen, []
    for index, c in enumerate(fit.causes):
        out.append(Named(c.effect, name, fit, index, c.public(fit.part(index)), 0.0, 0.0))
    return out


def _grown(findings: Findings, name: str, progress: Progress | None) -> Explanation:
    """The explanation of a link with the best that several effects do."""
    residual, e = findings.residuals[name], findings.explanations[name]
    best = grow(residual, e, findings.weighed[name], progress)
    return replace(e, chosen=best, leftovers=contact_leftovers(residual, best.effects()))


def cause_of(findings: Findings, c: Named) -> Cause:
    """A cause with the 95 % intervals of its parameters."""
    ends = intervals(findings.residuals[c.link], c.fit)
    start = sum(len(x.names) for x in c.fit.causes[: c.index])
    names = c.fit.causes[c.index].names
    found: dict[str, Parameter] = {}
    for name, value in c.parameters.items():
        spec = EFFECTS[c.effect].parameters.get(name)
        if spec is None:
            continue
        if isinstance(value, str):
            found[name] = Parameter(value, None, "")
        elif isinstance(value, list):
            ci = tuple(_interval(ends, names, start, f"{name}.{j}", v) for j, v in enumerate(value))
            found[name] = Parameter(tuple(float(v) for v in value), ci, spec.unit)
        else:
            found[name] = Parameter(value, _interval(ends, names, start, name, value), spec.unit)
    return Cause(c.effect, found, c.probability, tuple(c.indistinguishable_from))


def _interval(ends: Any, names: tuple[str, ...], start: int, name: str, value: float) -> Interval:
    if name not in names:
        return (float(value), float(value))
    low, high = ends[start + names.index(name)]
    return (float(low), float(high))


def gain_of(findings: Findings, causes: list[Named]) -> Heldout | None:
    """The gain of the strongest cause's link on left-out runs; None without a cause."""
    if not causes:
        return None
    strongest = causes[0]
    e = findings.explanations[strongest.link]
    return heldout(findings.residuals[strongest.link], strongest.fit, placebo_of(e.singles, strongest.fit))


def _ranking(findings: Findings, name: str, e: Explanation) -> list[Ranked]:
    pool: list[Fit] = sorted([*e.singles, *e.pairs], key=lambda f: f.score)
    seen, out = set(), []
    for f in [e.chosen, *pool]:
        key = tuple(sorted(c.effect for c in f.causes))
        if not key or key in seen or len(out) >= RANKED:
            continue
        seen.add(key)
        gain = heldout(findings.residuals[name], f, None) if len(out) < CHECKED else None
        words = "; ".join(_words(kind, p) for kind, p in f.effects())
        adequate = e.adequate if f is e.chosen else None
        out.append(
            Ranked(tuple(c.effect for c in f.causes), f.score - e.chosen.score, name, words, gain.rms_after if gain else None, adequate)
        )
    return out


def _words(kind: str, parameters: dict[str, Any]) -> str:
    def text(v: Any) -> str:
        return f"{v:.4g}" if isinstance(v, float) else "[" + ", ".join(f"{x:.3g}" for x in v) + "]" if isinstance(v, list) else str(v)

    return ", ".join(f"{name} {text(v)}" for name, v in parameters.items() if name in EFFECTS[kind].parameters)


def _isolability(findings: Findings, progress: Progress | None) -> tuple[Isolable, ...]:
    if progress:
        progress("what these data can tell apart")
    out: list[Isolable] = []
    for name, residual in findings.residuals.items():
        if findings.explanations[name].adequate:
            out += isolability(residual, findings.weighed[name])
    return tuple(out)
