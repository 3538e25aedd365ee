"""Stage "decide": from the explanations of the links (`Findings`) to a `Finding`: the verdict, the
causes with their intervals, the gain on left-out runs, the ranking of hypotheses, and which effects
the data can tell apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import gmean

from hiltestbed.diagnosis.certainty import certainty
from hiltestbed.diagnosis.explain import Explanation, OpenPair, effects_of
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.isolability import isolability
from hiltestbed.diagnosis.learned.finding import learned_on
from hiltestbed.diagnosis.learned.selection import MIN_HELDOUT_GAIN
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
from hiltestbed.diagnosis.timing import clock_offsets
from hiltestbed.diagnosis.unexplained import contradiction, describe
from hiltestbed.diagnosis.verdict import Named, Verdict, decide, explained
from hiltestbed.effects.base import Effect
from hiltestbed.inference.conclude import Confirmed, Estimate
from hiltestbed.inference.likelihood import PosteriorFit
from hiltestbed.inference.search import Progress
from hiltestbed.process.progress import labelled

CLOSING_STEPS = 4  # after the links: intervals, smallest sizes, closed loop, report
MAX_RANKED = 6  # hypotheses of a link that are listed
MAX_RANKED_HELDOUT = 3  # of them, scored on left-out runs
# links whose output is measured: their residual is compared with its noise
MEASURED_LINKS = ("platform", "wrench")
LEAST_LEFT_OUT = 0.005  # share of the rows in contact, from which it is said that they do not count


@dataclass(frozen=True)
class Judged:
    """The verdict on a dataset, before series are added.

    Attributes:
        findings: the explanations. verdict: with its causes. nearest: the effect that comes nearest
            where the worst link departs and nothing is named. share: of the departure, explained by
            the causes that are named in part. learned: the law learned beside the causes, if any.
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
    nearest = _nearest(findings, verdict)
    in_part = [c for c in verdict.causes if not findings.explanations[c.link].adequate]
    share = explained(findings.explanations[in_part[0].link]) if in_part else None
    verdict, share, learned, law = _learned(findings, verdict, share, progress)
    return Judged(findings, verdict, nearest, share, learned, law)


def find(findings: Findings, progress: Progress | None = None) -> Finding:
    """The finding on a dataset: verdict, causes with intervals, evidence."""
    judged = judge(findings, progress)
    findings, verdict, nearest, law = judged.findings, judged.verdict, judged.nearest, judged.law
    if progress:
        progress(f"closing step 1 of {CLOSING_STEPS}: intervals and left-out runs")
    explanations = findings.explanations
    offsets = clock_offsets(explanations)
    causes = tuple(cause_of(c, verdict.causes) for c in verdict.causes)
    # a stamp delay shows on two links
    once = {c.effect: c for c in [*([] if law else nearest), *verdict.causes]}
    effects = [*(c.fitted for c in once.values()), *law]
    series = [s for link in findings.whole.values() for s in link_series(link, effects)]
    departed = {name: e for name, e in explanations.items() if e.departs}
    open_ = {name: e for name, e in departed.items() if not e.adequate}
    contrary = {name: contradiction(e) for name, e in open_.items()}
    left = [part for n, e in open_.items() for part in (describe(e, LINK_NAMES[n]), contrary[n])]
    return Finding(
        verdict=verdict.verdict,
        link=verdict.link,
        causes=causes,
        series=series,
        noise=findings.noise,
        heldout=gain_of(findings, verdict.causes),
        ranking=tuple(r for n, e in departed.items() for r in _ranking(n, e)),
        isolability=_isolability(findings, progress),
        unsized=_unsized(findings),
        left="; ".join(filter(None, left)),
        contrary="; ".join(filter(None, contrary.values())),
        not_judged={LINK_NAMES[name]: why for name, why in verdict.not_judged.items()},
        partial=tuple(cause_of(c) for c in nearest),
        partial_gain=gain_of(findings, nearest),
        explained=judged.share,
        learned=judged.learned,
        assumed=(
            *findings.layout.assumed(),
            *(offset.sentence() for offset in offsets),
            *findings.weighed,
            *_left_out(findings),
        ),
        certainty=tuple(certainty(n, e) for n, e in departed.items() if e.causes),
        timing=offsets,
        open=_open(findings, verdict),
    )


def _left_out(findings: Findings) -> list[str]:
    """Sentences on the share of the contact that was not compared; none where all of it was."""
    link, layout = findings.whole.get("wrench"), findings.layout
    if not isinstance(link, WrenchLink):
        return []
    untold = [np.isinf(run.sigma).all(axis=1) & link.simulated for run in link.runs]
    beside = [link.beside_jumps(i) for i in range(len(link.runs))]
    whys = (
        (untold, "there the smallest difference decides how the mechanism moves"),
        (beside, "there the platform jumps, and which reading shows a jump is not known"),
    )
    touching = [r.touching(run.rows) for r, run in zip(layout.runs, link.runs, strict=True)]
    inside = np.concatenate(touching)
    shares = [(float(np.sum(np.concatenate(out) & inside)), why) for out, why in whys]
    rows = max(float(inside.sum()), 1.0)
    return [
        f"{count / rows:.0%} of the rows in contact were left out: {why}"
        for count, why in shares
        if count / rows >= LEAST_LEFT_OUT
    ]


def _nearest(findings: Findings, verdict: Verdict) -> tuple[Named, ...]:
    """The effect that comes nearest where the worst link departs and nothing is named on it."""
    if verdict.verdict != "unknown":
        return ()
    open_ = {n: e for n, e in findings.explanations.items() if not e.adequate}
    name = max(open_, key=lambda n: open_[n].excess)
    e = open_[name]
    best = next((f for f in e.singles() if f.evidence > e.conclusion.null.evidence), None)
    if best is None:
        return ()
    (cause,) = best.causes
    values = zip(cause.names, best.of.theta, strict=True)
    estimates = tuple(Estimate(n, float(v), float(v), float(v)) for n, v in values)
    return (Named(name, Confirmed(cause, estimates, 0.0, 1.0, ())),)


def _learned(
    findings: Findings, verdict: Verdict, share: float | None, progress: Progress | None
) -> tuple[Verdict, float | None, Learned | None, tuple[Effect, ...]]:
    """The law learned on a link that departs beyond its causes, and the effect that extends the
    model.

    A cause named in part is dropped if curves alone do as well as curves beside it, with fewer
    numbers: it was a part of them.
    """
    links = findings.explanations
    open_ = {n: links[n] for n in MEASURED_LINKS if n in links and not links[n].adequate}
    if verdict.verdict not in ("unknown", "named_in_part") or not open_:
        return verdict, share, None, ()
    name = max(open_, key=lambda n: (n == verdict.link, n == "wrench"))
    found = open_[name]
    if progress:
        progress(f"{LINK_NAMES[name]}: learning a law")
    causes = [c for c in verdict.causes if c.link == name]
    known = [c.fitted for c in causes]
    result = learned_on(found, known)
    alone = learned_on(found, ()) if known and result is not None else None
    if (
        result is not None
        and alone is not None
        and needless(result[0], alone[0], sum(len(c.cause.estimates) for c in causes))
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


def cause_of(c: Named, beside: tuple[Named, ...] = ()) -> Cause:
    """A cause with the 95 % intervals of its parameters.

    beside: all named causes, for the complete explanations that have a rival in place of this one.
    """
    effect = c.fitted
    ends: dict[str, Interval] = {e.name: (e.low, e.high) for e in c.cause.estimates}
    found: dict[str, Parameter] = {}
    for name, value in effect.parameters().items():
        unit = effect.unit(name)
        if value is None:  # omitted: it follows from another
            continue
        if isinstance(value, str):
            found[name] = Parameter(value, None, "")
        elif isinstance(value, tuple):
            ci = tuple(ends.get(f"{name}.{j}", (float(v), float(v))) for j, v in enumerate(value))
            found[name] = Parameter(tuple(float(v) for v in value), ci, unit)
        else:
            found[name] = Parameter(value, ends.get(name, (float(value), float(value))), unit)
    elsewhere = [o.fitted for o in beside if o.link != c.link]
    alternatives = tuple(
        tuple(entry(e) for e in (*effects_of(rival), *elsewhere)) for _, rival in c.rivals
    )
    probability, alike = c.cause.probability, c.indistinguishable_from
    return Cause(c.effect, found, probability, alike, alternatives)


def gain_of(findings: Findings, causes: tuple[Named, ...]) -> Heldout | None:
    """The gain on left-out runs, on the link of the strongest cause; None without a cause."""
    if not causes:
        return None
    e = findings.explanations[causes[0].link]
    if e.causes:
        return heldout(e, e.fit)
    return heldout(e, next(f for f in e.singles() if effects_of(f)[0].kind == causes[0].effect))


def heldout(e: Explanation, found: PosteriorFit) -> Heldout | None:
    """The gain of ``found``, fitted to all runs but one, on that one, beside that of a placebo: a
    wrong effect with about as many parameters, the worst fitted, not the next best. None with one
    run, or without a cause.
    """
    runs = e.model.members
    if len(runs) < 2 or not found.causes:
        return None
    own, count, null = {c.kind for c in found.causes}, len(found.of.theta), e.conclusion.null
    wrong = [f for f in e.singles() if not own & {c.kind for c in f.causes}]
    far = min(wrong, key=lambda f: (abs(len(f.of.theta) - count), f.evidence), default=null)
    held = e.conclusion.judge
    squares = [
        dict(zip(runs, (held.rms(f) ** 2).tolist(), strict=True)) for f in (null, found, far)
    ]
    return Heldout.of(runs, *squares)


def _ranking(name: str, e: Explanation) -> list[Ranked]:
    out = []
    for n, f in enumerate(e.ranked()[:MAX_RANKED]):
        effects = effects_of(f)
        gain = heldout(e, f) if n < MAX_RANKED_HELDOUT else None
        words = "; ".join(listed(effect.parameters()) for effect in effects)
        after, adequate = gain.rms_after if gain else None, e.adequate if f is e.fit else None
        worse = 2.0 * (e.likelihood.again(e.fit).evidence - e.likelihood.again(f).evidence)
        kinds = tuple(x.kind for x in effects)
        out.append(Ranked(kinds, worse, name, words, after, adequate))
    return out


def _open(findings: Findings, verdict: Verdict) -> tuple[OpenPair, ...]:
    """The pairs that another run has to tell apart: each cause and its rivals; on a link that more
    than noise is left of, the two explanations that come nearest.
    """
    rivals = [
        OpenPair(e, (e.fit, fit))
        for c in verdict.causes
        for e in [findings.explanations[c.link]]
        for _, fit in c.rivals
    ]
    open_ = (e for e in findings.explanations.values() if not e.adequate)
    return (*rivals, *(pair for e in open_ for pair in _nearest_pair(e)))


def _nearest_pair(e: Explanation) -> list[OpenPair]:
    """The explanation that comes nearest and the next one that is no part of it, nor it of that."""
    best, *others = e.ranked() or [e.fit]
    kinds = [{x.kind for x in effects_of(f)} for f in (best, *others)]
    pairs = zip(others, kinds[1:], strict=True)
    apart = [f for f, own in pairs if not (own <= kinds[0] or own >= kinds[0])]
    return [OpenPair(e, (best, f)) for f in apart[:1]]


def _isolability(findings: Findings, progress: Progress | None) -> tuple[Isolable, ...]:
    out: list[Isolable] = []
    for name, e in findings.explanations.items():
        if e.adequate:
            words = f"closing step 2 of {CLOSING_STEPS}: sizes, {LINK_NAMES[name]}"
            out += isolability(e, labelled(progress, words))
    return tuple(out)


def _unsized(findings: Findings) -> dict[str, str]:
    """Link to the reason why no sizes can be stated for its effects."""
    why = "what was found there leaves more than noise, in which smaller effects hide"
    return {LINK_NAMES[n]: why for n, e in findings.explanations.items() if not e.adequate} | {
        LINK_NAMES[name]: f"it was not judged: {reason}"
        for name, reason in findings.missing.items()
    }
