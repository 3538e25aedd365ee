"""Stage "decide": the rebound as evidence between rivals.

A link is replayed alone, on measured inputs, so that what the closed loop made of a departure does
not enter. Rivals that leave the same residual may differ in just that: a sensor that is late makes
the vehicles part faster, a record that is stamped late does not. The scenario extended by each
rival is simulated up to the rebound, and its coefficient of restitution compared with that on
record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.diagnosis.adequacy import Leftover, contact_leftovers, noise_alone
from hiltestbed.diagnosis.closed_loop import (
    bounce_of,
    measured_motion,
    restitution,
    trace_motion,
    traces_of,
    with_entries,
)
from hiltestbed.diagnosis.fit import Fit, fit, inflation
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.jitter_and_hum import hum_beside, jitter_beside
from hiltestbed.diagnosis.layout import DatasetLayout
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.diagnosis.plain import entry
from hiltestbed.diagnosis.readings import reinterpreted
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import AMBIGUITY, MODEL_ERROR
from hiltestbed.diagnosis.timing import delays_not_causes
from hiltestbed.effects.base import Effect
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.momentum import mobility
from hiltestbed.scenario import Scenario

# chosen: of the approach speed, beyond which the motion on record is not that of the scenario's
# loop
MAX_APPROACH_ERROR = 0.05
# chosen: fits that are simulated in place of one that the rebound contradicts
MAX_TRIED = 8
LONGER = 0.25  # chosen: of a bounce, by which it may last longer in a simulation than on record


@dataclass(frozen=True)
class Rebound:
    """First bounce on record: coefficient of restitution, standard error, rows to simulate."""

    cor: float
    error: float
    rows: int


def with_rebounds(findings: Findings) -> Findings:
    """The findings with rivals weighed by the rebound, and without what it contradicts."""
    return _uncontradicted(_with_rivals_weighed(findings))


def _with_rivals_weighed(findings: Findings) -> Findings:
    """The findings without rivals that the rebound refutes, and with one that it prefers chosen."""
    layout, explanations = findings.layout, dict(findings.explanations)
    # what is attributed to the timing of the facility needs no decision
    shifts = delays_not_causes(explanations)
    rivals = {n: e for n, e in explanations.items() if e.departs and e.adequate and any(e.rivals)}
    open_ = [n for n, e in rivals.items() if not set(e.chosen.kinds) & {*shifts.get(n, ())}]
    rebounds = [_rebound(layout, i) for i in range(len(layout.runs))] if open_ else []
    if not any(rebounds):
        return findings
    words = []
    for name in open_:
        weighed, told = _weighed(explanations[name], _others(explanations, name), layout, rebounds)
        explanations[name], words = weighed, [*words, *told]
    return replace(findings, explanations=explanations, weighed=tuple(words))


def _uncontradicted(findings: Findings) -> Findings:
    """The findings with an explanation of contact and sensor that the rebound does not contradict,
    and in a sentence what it contradicts.

    It contradicts causes if it departs by more than :data:`AMBIGUITY` in chi-square from the loop
    without them and with them, and is not nearer to the latter by as much. Stamps that are off do
    not act in the loop: where the link has such, it is explained again as stamped. Else the best of
    the fits that leave only noise and that the rebound does not contradict is chosen; where there
    is none, the link is not explained.
    """
    layout, explanations = findings.layout, dict(findings.explanations)
    found = explanations.get("wrench")
    if found is None or not (found.departs and found.adequate and found.chosen.causes):
        return findings
    if any(e.departs and not e.adequate for e in explanations.values()):
        return findings  # what is not explained spoils the comparison
    rebounds = [_rebound(layout, i) for i in range(len(layout.runs))]
    if not any(rebounds):
        return findings
    beside = _others(explanations, "wrench")

    def distance(fits: Sequence[Fit]) -> list[float]:
        """Chi-square of the rebounds on record against the loop with each fit."""
        shown = _simulated(fits, beside, layout.runs, rebounds)
        return [_apart(row, layout, rebounds) for row in shown]

    without, chosen = distance((found.null, found.chosen))
    limit = max(AMBIGUITY, without - AMBIGUITY)
    if without <= AMBIGUITY or chosen <= limit:
        return findings
    words = (
        f"the rebound contradicts {' + '.join(found.chosen.kinds)}: with it the loop parts no "
        "nearer to the coefficient of restitution on record than without it"
    )
    again = _as_stamped(found)
    if again is not None and again.adequate and distance((again.chosen,))[0] <= limit:
        explanations["wrench"] = again
        return replace(findings, explanations=explanations, weighed=(*findings.weighed, words))
    known = {id(found.chosen), *(id(f) for rivals in found.rivals for f in rivals)}
    others = sorted((*found.more, *found.singles), key=lambda f: f.score)
    others = [f for f in others if id(f) not in known and noise_alone(_left(found, f))]
    better = next((f for f in others[:MAX_TRIED] if distance((f,))[0] <= limit), None)
    explanations["wrench"] = (
        replace(found, adequate=False)
        if better is None
        else replace(found, chosen=better, leftovers=_left(found, better), rivals=())
    )
    return replace(findings, explanations=explanations, weighed=(*findings.weighed, words))


def _apart(shown: Array, layout: DatasetLayout, rebounds: Sequence[Rebound | None]) -> float:
    """Chi-square of the rebounds on record against the ``shown`` (runs,) ones; infinite without.

    When in a tick h a facility reads and obeys is not known: a delay of the loop of standard
    deviation h/sqrt(12), which all runs have in common, with ``ln e = (pi/2) w tau``.
    """
    known = [(i, r) for i, r in enumerate(rebounds) if r is not None and np.isfinite(shown[i])]
    if not known:
        return math.inf
    errors = np.array([r.error / r.cor for _, r in known])
    off = np.array([math.log(shown[i] / r.cor) for i, r in known]) / errors
    scenario = layout.runs[known[0][0]].scenario
    common = 0.5 * math.pi * contact_frequency(scenario) * scenario.tick / math.sqrt(12.0) / errors
    return float(off @ off - (off @ common) ** 2 / (1.0 + common @ common))


def _as_stamped(found: Explanation) -> Explanation | None:
    """The link explained again with the stamps as believed; None where it has no others."""
    link = found.residual.link
    if link.timing == NO_SHIFT:
        return None
    search = Search(found.candidates, special=(jitter_beside, hum_beside), reread=reinterpreted)
    return search.explain(Residual(link.with_timing(NO_SHIFT)))


def _left(found: Explanation, other: Fit) -> dict[str, Leftover]:
    """What another fit leaves of the link."""
    return contact_leftovers(found.residual, other.effects())


def _rebound(layout: DatasetLayout, i: int) -> Rebound | None:
    """The bounce of a run; None where the record has none, or where its approach is not the
    scenario's: no loop was closed then.

    The error is that of the speeds by the noise of the pose, and by the noise of the force, whose
    impulse is a random walk between them. The simulation has noise of its own, and the two differ
    by :data:`MODEL_ERROR`.
    """
    run = layout.runs[i]
    scenario, motion = run.scenario, measured_motion(run)
    rows, speed = bounce_of(motion, scenario), scenario.approach.velocity[2]
    if rows is None or scenario.mechanism.captured or speed <= 0.0:
        return None
    cor, approach = restitution(motion, scenario), rows.approach_speed
    if cor is None or approach is None or abs(approach - speed) > MAX_APPROACH_ERROR * speed:
        return None
    place = layout.noise.get("pose_cmd.pz" if motion.command is not None else "pose_act.pz", 0.0)
    before, after = (
        place * math.sqrt(12.0 / (b - a) ** 3) / scenario.tick for a, b in (rows.before, rows.after)
    )
    force = math.hypot(
        layout.noise.get("wrench_meas.fz", 0.0) * layout.force.colour, scenario.sensor.noise
    )
    walk = speed_noise(scenario, force, 0.5 * (sum(rows.after) - sum(rows.before)))
    error = math.hypot(math.hypot(after, cor * before, walk) / approach, MODEL_ERROR * cor)
    return Rebound(cor, error, rows.after[1] + round(LONGER * (rows.after[1] - rows.before[1])))


def speed_noise(scenario: Scenario, force: float, rows: float) -> float:
    """[m/s] standard deviation of the relative speed along z after so many rows of white noise of
    the ``force`` [N] on free bodies.
    """
    return force * abs(float(mobility(scenario)[2, 2])) * scenario.tick * math.sqrt(rows)


def _others(explanations: Mapping[str, Explanation], name: str) -> list[Effect]:
    """The causes on the other links."""
    known, shifts = set(explanations[name].chosen.kinds), delays_not_causes(explanations)
    others = [(n, e) for n, e in explanations.items() if n != name and e.departs and e.adequate]
    return [
        c
        for n, e in others
        for c in e.chosen.effects()
        if c.kind not in known and c.kind not in shifts.get(n, ())
    ]


def _weighed(
    found: Explanation,
    beside: Sequence[Effect],
    layout: DatasetLayout,
    rebounds: Sequence[Rebound | None],
) -> tuple[Explanation, list[str]]:
    """The explanation with the rebound in its scores, and in a sentence what that decided."""
    fits = [found.chosen, *(f for rivals in found.rivals for f in rivals)]
    shown = _simulated(fits, beside, layout.runs, rebounds)
    there = [i for i in range(len(rebounds)) if np.isfinite(shown[:, i]).all()]
    pairs = [(i, r.cor, r.error) for i in there if (r := rebounds[i]) is not None]
    if not pairs:
        return found, []
    known, cor, error = (np.array(x) for x in zip(*pairs, strict=True))
    chi2 = np.sum(((shown[:, known] - cor) / error) ** 2, axis=1)
    # something else in the loop spoils the comparison
    scale = max(1.0, float(chi2.min()) / len(known)) / inflation(found.chosen)
    told = {
        id(f): replace(f, elsewhere=f.elsewhere + float(c - chi2.min()) / scale)
        for f, c in zip(fits, chi2, strict=True)
    }
    weighed = _rechosen(
        found, told[id(found.chosen)], [[told[id(f)] for f in rivals] for rivals in found.rivals]
    )
    if (
        sum(map(len, weighed.rivals)) == sum(map(len, found.rivals))
        and weighed.chosen.kinds == found.chosen.kinds
    ):
        return weighed, []
    each = ", ".join(
        f"{' + '.join(f.kinds)} {np.mean(s[known]):.4f}" for f, s in zip(fits, shown, strict=True)
    )
    words = (
        f"the rebound decides: coefficient of restitution {np.mean(cor):.4f} on record, "
        f"standard error of a run {np.mean(error):.2g}"
    )
    return weighed, [f"{words}; simulated with {each}"]


def _rechosen(found: Explanation, chosen: Fit, rivals: Sequence[Sequence[Fit]]) -> Explanation:
    """The explanation with the best of the fits as the chosen one, and the rivals that remain."""
    i, best = min(
        ((i, f) for i, others in enumerate(rivals) for f in (chosen, *others)),
        key=lambda item: item[1].score,
    )
    losers: list[list[Fit]] = [list(others) for others in rivals]
    if best is not chosen:
        own = next(c for c in best.causes if c.key not in {c.key for c in chosen.causes})
        winner = best
        best = best.ordered([own if j == i else c for j, c in enumerate(chosen.causes)])
        losers = [
            [chosen, *(f for f in others if f is not winner)]
            if j == i
            else [_exchanged(found, best, f, chosen, j) for f in others]
            for j, others in enumerate(losers)
        ]
    most = AMBIGUITY * inflation(best)
    kept = tuple(tuple(f for f in others if f.score - best.score < most) for others in losers)
    fits = (chosen, best, *(f for others in rivals for f in others))
    known = {f.keys: f.elsewhere for f in fits}
    singles, more = (
        tuple(replace(f, elsewhere=known.get(f.keys, f.elsewhere)) for f in fits)
        for fits in (found.singles, found.more)
    )
    return replace(found, chosen=best, rivals=kept, singles=singles, more=more)


def _exchanged(found: Explanation, best: Fit, rival: Fit, chosen: Fit, j: int) -> Fit:
    """``best`` with the cause of ``rival`` in place of cause j, fitted."""
    keys = {c.key for c in chosen.causes}
    index, own = next((n, c) for n, c in enumerate(rival.causes) if c.key not in keys)
    causes = (*best.causes[:j], own, *best.causes[j + 1 :])
    start = np.concatenate(
        [rival.part(index) if n == j else best.part(n) for n in range(len(causes))]
    )
    return replace(fit(found.residual, causes, [start], tries=1), elsewhere=rival.elsewhere)


def _simulated(
    fits: Sequence[Fit],
    beside: Sequence[Effect],
    runs: Sequence[MeasuredRun],
    rebounds: Sequence[Rebound | None],
) -> Array:
    """(fits, runs) coefficients of restitution in closed loop; NaN where there is none."""
    out, lanes = np.full((len(fits), len(runs)), np.nan), []
    for n, f in enumerate(fits):
        entries = [entry(e) for e in (*f.effects(), *beside)]
        for i, (run, rebound) in enumerate(zip(runs, rebounds, strict=True)):
            scenario = _extended(run.scenario, entries, rebound.rows) if rebound else None
            if scenario is not None:
                lanes.append((n, i, scenario))
    for (n, i, scenario), trace in zip(lanes, traces_of([s for _, _, s in lanes]), strict=True):
        motion = trace_motion(trace)
        cor = restitution(motion, scenario) if motion is not None else None
        out[n, i] = math.nan if cor is None else cor
    return out


def _extended(
    scenario: Scenario, entries: Sequence[Mapping[str, Any]], rows: int
) -> Scenario | None:
    """The scenario with more effects for so many rows; None where it may not have these."""
    try:
        return with_entries(scenario, entries, rows)
    except InputError:
        return None
