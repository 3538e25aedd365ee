"""Stage "decide": the rebound as evidence between explanations.

A link is replayed alone, on measured inputs, so that what the closed loop made of a departure does
not enter. Explanations that leave the same residual may differ in just that: a sensor that is late
makes the vehicles part faster, a record that is stamped late does not. The scenario extended by
each is simulated up to the rebound, and its coefficient of restitution is one more residual beside
those of the link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.diagnosis.closed_loop import (
    bounce_of,
    measured_motion,
    restitution,
    trace_motion,
    traces_of,
    with_entries,
)
from hiltestbed.diagnosis.explain import Explanation, effects_of
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.plain import entry
from hiltestbed.diagnosis.recorded import DatasetLayout
from hiltestbed.diagnosis.settings import MODEL_ERROR
from hiltestbed.effects.base import Effect
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import TOLD_APART, Confirmed, conclude
from hiltestbed.inference.likelihood import PosteriorFit
from hiltestbed.inference.search import Searched
from hiltestbed.measured import MeasuredRun
from hiltestbed.numerical_model.bodies import mobility
from hiltestbed.scenario import Scenario

# of the approach speed, beyond which the motion on record is not that of the scenario's loop
MAX_APPROACH_ERROR = 0.05
MAX_TRIED = 8  # explanations that are simulated in place of one that the rebound contradicts
LONGER = 0.25  # of a bounce, by which it may last longer in a simulation than on record
# of chi-square, beyond which a rebound contradicts: odds of 1 : 400
CONTRADICTED = 2.0 * math.log(400.0)


@dataclass(frozen=True)
class Rebound:
    """First bounce on record: coefficient of restitution, standard error, rows to simulate."""

    cor: float
    error: float
    rows: int


def with_rebounds(findings: Findings) -> Findings:
    """The findings with the rebound in the evidence of the explanations of each link."""
    layout, explanations = findings.layout, dict(findings.explanations)
    departing = {n: e for n, e in explanations.items() if e.departs}
    if not all(e.adequate for e in departing.values()):
        return findings  # what is not explained spoils the comparison
    open_ = [n for n, e in departing.items() if n == "wrench" or any(c.others for c in e.causes)]
    rebounds = [_rebound(layout, i) for i in range(len(layout.runs))] if open_ else []
    words: list[str] = []
    for name in open_ if any(rebounds) else ():
        judge = _Loop(layout, rebounds, _others(explanations, name), explanations[name].model)
        explanations[name], told = _weighed(explanations[name], judge)
        words += told
    return replace(findings, explanations=explanations, weighed=tuple(words))


@dataclass(frozen=True)
class _Loop:
    """The rebounds on record, and the causes on the other links beside which a link, of ``model``,
    is judged.
    """

    layout: DatasetLayout
    rebounds: Sequence[Rebound | None]
    beside: Sequence[Effect]
    model: LinkModel

    def chi2(self, fits: Sequence[PosteriorFit]) -> Array:
        """(fits,) of the rebounds on record against the loop with each explanation."""
        shown = _simulated(fits, self.beside, self.layout.runs, self.rebounds)
        pairs = zip(shown, fits, strict=True)
        return np.array([_apart(x, self.layout, self.rebounds, self._walks(f)) for x, f in pairs])

    def _walks(self, fit: PosteriorFit) -> Array:
        """(runs,) by which coefficients of restitution differ from one time to the next by what
        scatters in an explanation: on record and in the simulation, whose draws differ.
        """
        out = np.zeros(len(self.layout.runs))
        for n, i in enumerate(self.model.members):
            variance = self.model.scatter(n, self.model.effects(fit.of))
            scenario = self.layout.runs[i].scenario
            if isinstance(self.model.link, WrenchLink) and variance is not None:
                force = math.sqrt(2.0 * float(np.sum(variance[:, 2])))
                out[i] = speed_noise(scenario, force, 1.0) / scenario.approach.velocity[2]
        return out


def _weighed(e: Explanation, loop: _Loop) -> tuple[Explanation, list[str]]:
    """The explanation with the most evidence of link and rebound together, its rivals, and in
    sentences what the rebound decided.

    It contradicts an explanation if it departs from the loop without it and with it, and is not
    nearer to the latter. Where it contradicts the chosen one, others that leave only noise are
    tried; where there is none, the link is not explained.
    """
    rivals = {f.keys: f for c in e.causes for f in c.others}
    fits = [e.fit, *rivals.values()]
    without, *apart = loop.chi2([e.conclusion.null, *fits])
    limit = max(CONTRADICTED, without - CONTRADICTED)
    words = []
    if without > CONTRADICTED and min(apart) > limit:
        words = [
            f"the rebound contradicts {' + '.join(e.kinds)}: with it the loop parts no nearer to "
            "the coefficient of restitution on record than without it"
        ]
        tried = {f.keys for f in fits}
        more = [f for f in e.conclusion.visited if f.causes and f.keys not in tried]
        more = [f for f in more if e.model.leaves_noise(f.left)][:MAX_TRIED]
        pairs = zip([*fits, *more], [*apart, *loop.chi2(more)], strict=True)
        kept = [(f, x) for f, x in pairs if x <= limit]
        if not kept:
            return replace(e, adequate=False), words
        fits, apart = [f for f, _ in kept], [x for _, x in kept]
    elif not rivals:
        return e, []
    least = min(apart)
    # something else in the loop spoils the comparison
    scale = max(1.0, least / max(1, sum(r is not None for r in loop.rebounds)))
    pairs = zip(fits, apart, strict=True)
    total = {f.keys: f.evidence - 0.5 * (x - least) / scale for f, x in pairs}
    best = max(fits, key=lambda f: total[f.keys])
    if best.keys != e.fit.keys:
        found = Searched(e.likelihood, best, e.conclusion.visited, e.conclusion.null)
        e = replace(e, conclusion=conclude(found, e.model.folds(), e.candidates))
    causes = tuple(_told_apart(c, total, total[best.keys]) for c in e.causes)
    decided = sum(len(c.others) for c in causes) < len(rivals) or best.keys != fits[0].keys
    if decided and not words:
        kinds = [" + ".join(x.kind for x in effects_of(f)) for f in fits]
        each = ", ".join(f"{k} {x:.3g}" for k, x in zip(kinds, apart, strict=True))
        words = [f"the rebound decides: chi-square of the coefficients of restitution {each}"]
    return replace(e, conclusion=replace(e.conclusion, causes=causes)), words


def _told_apart(c: Confirmed, total: Mapping[tuple[str, ...], float], own: float) -> Confirmed:
    """A cause without the rivals that link and rebound together refute."""
    gaps = [total.get(f.keys, -math.inf) - own for f in c.others]
    kept = [n for n, gap in enumerate(gaps) if gap > -TOLD_APART]
    return replace(
        c,
        rivals=tuple(c.rivals[n] for n in kept),
        others=tuple(c.others[n] for n in kept),
        probability=1.0 / (1.0 + sum(math.exp(min(gaps[n], 0.0)) for n in kept)),
    )


def _apart(
    shown: Array, layout: DatasetLayout, rebounds: Sequence[Rebound | None], walks: Array
) -> float:
    """Chi-square of the rebounds on record against the ``shown`` (runs,) ones, which scatter by
    ``walks`` (runs,); infinite without.

    When in a tick h a facility reads and obeys is not known: a delay of the loop of standard
    deviation h/sqrt(12), which all runs have in common, with ``ln e = (pi/2) w tau``.
    """
    known = [(i, r) for i, r in enumerate(rebounds) if r is not None and np.isfinite(shown[i])]
    if not known:
        return math.inf
    errors = np.array([math.hypot(r.error, walks[i]) / r.cor for i, r in known])
    off = np.array([math.log(shown[i] / r.cor) for i, r in known]) / errors
    scenario = layout.runs[known[0][0]].scenario
    common = 0.5 * math.pi * contact_frequency(scenario) * scenario.tick / math.sqrt(12.0) / errors
    return float(off @ off - (off @ common) ** 2 / (1.0 + common @ common))


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
    return force * float(mobility(scenario.spacecraft)[2, 2]) * scenario.tick * math.sqrt(rows)


def _others(explanations: Mapping[str, Explanation], name: str) -> list[Effect]:
    known = set(explanations[name].kinds)
    return [
        effect
        for n, e in explanations.items()
        if n != name and e.departs and e.adequate
        for effect in e.effects()
        if effect.kind not in known
    ]


def _simulated(
    fits: Sequence[PosteriorFit],
    beside: Sequence[Effect],
    runs: Sequence[MeasuredRun],
    rebounds: Sequence[Rebound | None],
) -> Array:
    """(fits, runs) coefficients of restitution in closed loop; NaN where there is none."""
    out, lanes = np.full((len(fits), len(runs)), np.nan), []
    for n, f in enumerate(fits):
        for i, (run, rebound) in enumerate(zip(runs, rebounds, strict=True)):
            effects = [*effects_of(f), *beside]
            scenario = _extended(run.scenario, effects, rebound.rows) if rebound else None
            if scenario is not None:
                lanes.append((n, i, scenario))
    for (n, i, scenario), trace in zip(lanes, traces_of([s for _, _, s in lanes]), strict=True):
        motion = trace_motion(trace)
        cor = restitution(motion, scenario) if motion is not None else None
        out[n, i] = math.nan if cor is None else cor
    return out


def _extended(scenario: Scenario, effects: Sequence[Effect], rows: int) -> Scenario | None:
    """The scenario with more effects, each read as it was fitted, for so many rows; None where it
    may not have these.
    """
    try:
        out = with_entries(scenario, [entry(e) for e in effects], rows)
    except InputError:
        return None
    fitted = [*scenario.effects, *effects]
    stated = zip(out.effects, fitted, strict=True)
    return out.model_copy(update={"effects": tuple(e.read_as(f.variant) for e, f in stated)})
