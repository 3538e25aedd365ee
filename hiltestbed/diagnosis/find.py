"""Stage "decide": from the explanations of the links (`Findings`) to a `Finding`.

A `Finding` holds the verdict, the causes with their intervals, the gain on left-out runs, the
ranking of hypotheses, and which effects the data can tell apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import gmean

from hiltestbed.diagnosis import timing
from hiltestbed.diagnosis.adequacy import contact_leftovers, noise_alone
from hiltestbed.diagnosis.certainty import Certainties, spans_its_range
from hiltestbed.diagnosis.fit import Fit
from hiltestbed.diagnosis.grow import far_off, grow
from hiltestbed.diagnosis.heldout import heldout, placebo_of
from hiltestbed.diagnosis.in_part import confirmed, explained, holding
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.isolability import isolability
from hiltestbed.diagnosis.learned.finding import learned_on
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.plain import LINK_NAMES, entry, listed
from hiltestbed.diagnosis.rebound import with_rebounds
from hiltestbed.diagnosis.report.evidence import link_series
from hiltestbed.diagnosis.result import (
    Cause,
    Finding,
    Heldout,
    Interval,
    Isolable,
    Learned,
    Parameter,
    Ranked,
)
from hiltestbed.diagnosis.search import Explanation, Progress, Search, labelled
from hiltestbed.diagnosis.settings import MIN_HELDOUT_GAIN
from hiltestbed.diagnosis.unexplained import describe
from hiltestbed.diagnosis.verdict import Named, Verdict, decide
from hiltestbed.effects.base import Effect

CLOSING_STEPS = 4  # after the links: intervals, smallest sizes, closed loop, report
MAX_RANKED = 6  # hypotheses of a link that are listed
MAX_RANKED_HELDOUT = 3  # of them, scored on left-out runs
# links whose output is measured: their residual is compared with its noise
MEASURED_LINKS = ("platform", "wrench")


@dataclass(frozen=True)
class Judged:
    """The verdict on a dataset, before intervals and series are added.

    Attributes:
        findings: the explanations, with the one to which causes were added, if any. verdict: with
            its causes.
        nearest: the effects that come nearest where the worst link departs and nothing is named.
        share: of the departure, explained by the causes that are named in part. learned: the law
            learned beside the causes, if any.
        law: the effect by which that law extends the model.
    """

    findings: Findings
    verdict: Verdict
    nearest: tuple[Named, ...]
    share: float | None
    learned: Learned | None
    law: tuple[Effect, ...]


def judge(findings: Findings, progress: Progress | None = None) -> Judged:
    """The verdict; where few effects do not explain a link, with what holds, or a learned law."""
    findings = with_rebounds(findings)
    verdict = decide(findings)
    findings, nearest = _nearest(findings, verdict, progress)
    # more causes than were searched together explain it
    if verdict.verdict == "unknown" and not nearest:
        verdict = decide(findings)
    verdict, share = _in_part(findings, verdict, nearest)
    verdict, share, learned, law = _learned(findings, verdict, share, progress)
    return Judged(findings, verdict, nearest, share, learned, law)


def find(findings: Findings, progress: Progress | None = None) -> Finding:
    """The finding on a dataset: verdict, causes with intervals, evidence."""
    judged = judge(findings, progress)
    findings, verdict, nearest, law = judged.findings, judged.verdict, judged.nearest, judged.law
    if progress:
        progress(f"closing step 1 of {CLOSING_STEPS}: intervals and left-out runs")
    offsets = timing.clock_offsets(findings.explanations)
    certain = Certainties(findings.explanations)
    verdict = _determined(verdict, certain)
    causes = tuple(cause_of(findings, c, certain, verdict.causes) for c in verdict.causes)
    once = {c.effect: c for c in [*nearest, *verdict.causes]}  # a stamp delay shows on two links
    once = {c.effect: c for c in verdict.causes} if law else once
    # as the links take them, with their variants
    effects = [*(c.fit.effects()[c.index] for c in once.values()), *law]
    series = [s for link in findings.whole.values() for s in link_series(link, effects)]
    departed = {name: e for name, e in findings.explanations.items() if e.departs}
    left = "; ".join(describe(e, LINK_NAMES[n]) for n, e in departed.items() if not e.adequate)
    return Finding(
        verdict=verdict.verdict,
        link=verdict.link,
        causes=causes,
        series=series,
        noise=findings.noise,
        heldout=gain_of(
            findings, nearest if verdict.verdict == "named_in_part" else verdict.causes
        ),
        ranking=tuple(r for n, e in departed.items() for r in _ranking(n, e)),
        isolability=_isolability(findings, progress),
        unsized=_unsized(findings),
        left=left,
        not_judged={LINK_NAMES[name]: why for name, why in verdict.not_judged.items()},
        partial=tuple(cause_of(findings, c, certain) for c in nearest),
        partial_gain=gain_of(findings, nearest),
        explained=judged.share,
        learned=judged.learned,
        assumed=(
            *findings.layout.assumed(),
            *(offset.sentence() for offset in offsets),
            *findings.weighed,
            *_left_out(findings),
        ),
        certainty=tuple(certain),
        timing=offsets,
    )


def _determined(verdict: Verdict, certain: Certainties) -> Verdict:
    """The verdict without causes whose size the data do not determine."""
    kept = tuple(
        c
        for c in verdict.causes
        if not spans_its_range(c.fit, c.index, certain.of(c.link, c.fit).ends)
    )
    if len(kept) == len(verdict.causes):
        return verdict
    return replace(verdict, verdict="unknown", causes=kept)


def _left_out(findings: Findings) -> tuple[str, ...]:
    """Sentences on the share of the contact that was not compared; none where all of it was."""
    link, layout = findings.whole.get("wrench"), findings.layout
    if not isinstance(link, WrenchLink):
        return ()
    touching = [r.touching(run.rows) for r, run in zip(layout.runs, link.runs, strict=True)]
    untold = [
        np.asarray(np.isinf(run.sigma).all(axis=1))
        if link.simulated
        else np.zeros(run.rows, dtype=bool)
        for run in link.runs
    ]
    beside = [link.beside_jumps(i) for i in range(len(link.runs))]
    whys = (
        (untold, "there the smallest difference decides how the mechanism moves"),
        (beside, "there the platform jumps, and which reading shows a jump is not known"),
    )
    rows = max(sum(int(t.sum()) for t in touching), 1)
    left = [
        (sum(int((o & t).sum()) for o, t in zip(out, touching, strict=True)) / rows, why)
        for out, why in whys
    ]
    return tuple(
        f"{share:.0%} of the rows in contact were left out: {why}"
        for share, why in left
        if share >= 0.005
    )


def _nearest(
    findings: Findings, verdict: Verdict, progress: Progress | None
) -> tuple[Findings, tuple[Named, ...]]:
    """Where a link departs and nothing is named: the effects that come nearest on the worst link,
    as many as lower its misfit enough.

    No effects are returned if these leave only noise and each is confirmed; the findings then hold
    them as the explanation of that link.
    """
    if verdict.verdict != "unknown":
        return findings, ()
    open_ = {
        n: e
        for n, e in findings.explanations.items()
        if e.departs and not e.adequate and e.chosen.causes
    }
    if not open_:
        return findings, ()
    name = max(open_, key=lambda n: open_[n].worst)
    if name in MEASURED_LINKS and far_off(open_[name]):
        grown = _grown(open_[name], progress)
        whole = confirmed(replace(grown, adequate=noise_alone(grown.leftovers)))
        findings = replace(findings, explanations={**findings.explanations, name: whole or grown})
        if whole:
            return findings, ()
    fit = findings.explanations[name].chosen
    return findings, tuple(Named(kind, name, fit, index) for index, kind in enumerate(fit.kinds))


def _learned(
    findings: Findings, verdict: Verdict, share: float | None, progress: Progress | None
) -> tuple[Verdict, float | None, Learned | None, tuple[Effect, ...]]:
    """The law learned on a link that departs beyond its confirmed causes, and the effect that
    extends the model.

    A cause named in part is dropped if curves alone do as well as curves beside it, with fewer
    numbers: it was a part of them.
    """
    open_ = {
        n: e
        for n, e in findings.explanations.items()
        if n in MEASURED_LINKS and e.departs and not e.adequate
    }
    if verdict.verdict not in ("unknown", "named_in_part") or not open_:
        return verdict, share, None, ()
    name = max(open_, key=lambda n: (n == verdict.link, n == "wrench"))
    found = open_[name]
    if progress:
        progress(f"{LINK_NAMES[name]}: learning a law")
    causes = [c for c in verdict.causes if c.link == name]
    known = [c.fit.effects()[c.index] for c in causes]
    result = learned_on(found, known)
    alone = learned_on(found, ()) if known and result is not None else None
    if (
        result is not None
        and alone is not None
        and needless(result[0], alone[0], sum(len(c.fit.part(c.index)) for c in causes))
    ):
        others = tuple(c for c in verdict.causes if c.link != name)
        verdict = Verdict("unknown", verdict.link, others, verdict.not_judged)
        share = None
        result = alone
    if result is None:
        return verdict, share, None, ()
    learned, effect = result
    return verdict, share, learned, (effect,) if learned.carries_over else ()


def needless(beside: Learned, alone: Learned, named: int) -> bool:
    """Whether curves alone do as well as curves beside ``named`` parameters of causes, with fewer
    numbers.

    Each left-out run counts alike: a pooled rms is that of the run that departs most, and a cause
    that acts in the others would be dropped.
    """
    as_good = _left(alone) < _left(beside) / (1.0 - MIN_HELDOUT_GAIN)
    return alone.carries_over and as_good and alone.numbers < beside.numbers + named


def _left(law: Learned) -> float:
    """Geometric mean of the rms that a law leaves of left-out runs."""
    return float(gmean([after for _, after in law.heldout.per_run.values()]))


def _in_part(
    findings: Findings, verdict: Verdict, nearest: tuple[Named, ...]
) -> tuple[Verdict, float | None]:
    """The verdict with those of the nearest causes that hold, and the share that they explain."""
    if not nearest:
        return verdict, None
    e = findings.explanations[nearest[0].link]
    parts_of_ticks = timing.delays_not_causes(findings.explanations).get(nearest[0].link, {})
    kept = [i for i in holding(e) if nearest[i].effect not in parts_of_ticks]
    if not kept:
        return verdict, None
    causes = tuple(replace(nearest[i], probability=1.0) for i in kept)
    others = tuple(c for c in verdict.causes if c.effect not in {n.effect for n in causes})
    return Verdict(
        "named_in_part", verdict.link, (*causes, *others), verdict.not_judged
    ), explained(e)


def _grown(e: Explanation, progress: Progress | None) -> Explanation:
    """The explanation of a link with the best fit of several effects."""
    best = grow(e, Search(e.candidates, progress=labelled(progress, "further causes")))
    return replace(e, chosen=best, leftovers=contact_leftovers(e.residual, best.effects()))


def cause_of(
    findings: Findings, c: Named, certain: Certainties | None = None, beside: tuple[Named, ...] = ()
) -> Cause:
    """A cause with the 95 % intervals of its parameters; `certain` caches the intervals of each
    fit.

    beside: all named causes, for the complete explanations that have a rival in place of this one.
    """
    ends = (certain or Certainties(findings.explanations)).of(c.link, c.fit).ends
    start = c.fit.place(c.index).start
    names = c.fit.causes[c.index].names
    effect = c.fit.effects()[c.index]
    found: dict[str, Parameter] = {}
    for name, value in effect.parameters().items():
        unit = effect.unit(name)
        if value is None:  # omitted: it follows from another
            continue
        if isinstance(value, str):
            found[name] = Parameter(value, None, "")
        elif isinstance(value, tuple):
            ci = tuple(_interval(ends, names, start, f"{name}.{j}", v) for j, v in enumerate(value))
            found[name] = Parameter(tuple(float(v) for v in value), ci, unit)
        else:
            found[name] = Parameter(value, _interval(ends, names, start, name, value), unit)
    elsewhere = [o.fit.effects()[o.index] for o in beside if o.link != c.link]
    alternatives = tuple(
        tuple(entry(e) for e in (*rival.effects(), *elsewhere)) for rival in c.rivals
    )
    return Cause(c.effect, found, c.probability, tuple(c.indistinguishable_from), alternatives)


def _interval(ends: Any, names: tuple[str, ...], start: int, name: str, value: float) -> Interval:
    if name not in names:
        return (float(value), float(value))
    low, high = ends[start + names.index(name)]
    return (float(low), float(high))


def gain_of(findings: Findings, causes: tuple[Named, ...]) -> Heldout | None:
    """The gain on left-out runs, on the link of the strongest cause; None without a cause."""
    if not causes:
        return None
    strongest = causes[0]
    e = findings.explanations[strongest.link]
    return heldout(e.residual, strongest.fit, placebo_of(e.singles, strongest.fit))


def _ranking(name: str, e: Explanation) -> list[Ranked]:
    pool: list[Fit] = sorted([*e.singles, *e.more], key=lambda f: f.score)
    seen, out = set(), []
    for f in [e.chosen, *pool]:
        key = tuple(sorted(f.kinds))
        if not key or key in seen or len(out) >= MAX_RANKED:
            continue
        seen.add(key)
        gain = heldout(e.residual, f, None) if len(out) < MAX_RANKED_HELDOUT else None
        words = "; ".join(listed(effect.parameters()) for effect in f.effects())
        after, adequate = gain.rms_after if gain else None, e.adequate if f is e.chosen else None
        out.append(Ranked(f.kinds, f.score - e.chosen.score, name, words, after, adequate))
    return out


def _isolability(findings: Findings, progress: Progress | None) -> tuple[Isolable, ...]:
    out: list[Isolable] = []
    for name, e in findings.explanations.items():
        if e.adequate:
            out += isolability(
                e.residual,
                e.candidates,
                labelled(progress, f"closing step 2 of {CLOSING_STEPS}: sizes, {LINK_NAMES[name]}"),
            )
    return tuple(out)


def _unsized(findings: Findings) -> dict[str, str]:
    """Link to the reason why no sizes can be stated for its effects."""
    why = "what was found there leaves more than noise, in which smaller effects hide"
    return {LINK_NAMES[n]: why for n, e in findings.explanations.items() if not e.adequate} | {
        LINK_NAMES[name]: f"it was not judged: {reason}"
        for name, reason in findings.missing.items()
    }
