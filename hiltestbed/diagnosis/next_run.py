"""The run that would settle what a diagnosis leaves open, computed.

Two hypotheses a and b explain the record of a link equally well. Further runs are simulated as if a
acted, and every link that they record is replayed under both. The numbers of b may follow, but
the runs on record hold them. With S the change of the new residuals per number of b, H the
information of the old runs on these numbers, and d the difference of the new residuals under both,
in units of the noise, the chi-square by which b is then worse is, to first order,

    min over x of x H x + |d + S x|^2 = |d|^2 - d S' (H + S S')^-1 S d.

Its root is the separation in standard deviations, and half of it the log of the odds that are
expected. The two may change places: the smaller of both counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.diagnosis.closed_loop import with_entries
from hiltestbed.diagnosis.explain import OpenPair, effects_of
from hiltestbed.diagnosis.further import (
    Further,
    as_measured,
    chosen,
    noise_on_record,
    possible,
    with_noise,
)
from hiltestbed.diagnosis.investigate import links_of
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.plain import LINK_NAMES, entry
from hiltestbed.diagnosis.result import Experiment, Finding
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import TOLD_APART
from hiltestbed.inference.likelihood import PosteriorFit
from hiltestbed.inference.model import Hypothesis
from hiltestbed.measured import MeasuredDataset
from hiltestbed.signals import GROUPS

LOGGED = ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp")
# what each link takes in, which can be given to it by itself
INPUT = {
    "platform": "a motion in air",
    "sensor": "a known force without contact",
    "compensation": "a computed force",
    "dynamics": "a computed force",
    "contact": "a known motion",
    "log": "a motion and a force at known instants",
}

Change = tuple[float, Array, Array]  # |d|^2, S d and S S'


class Trial(NamedTuple):
    """A further run: in words, as settings, and of each pair the changes in either direction."""

    words: str
    set: Mapping[str, Any]
    changes: Sequence[Sequence[Change]]


def next_experiment(finding: Finding, dataset: MeasuredDataset) -> Experiment | None:
    """The run that would settle what is open; None where nothing is, or where no run would."""
    lacking = [g for g in LOGGED if not all(r.record.has(g) for r in dataset.runs)]
    own = dict(dataset.spec.runs[0].set)
    if finding.contrary:
        text = "Repeat a run with nothing changed: the runs on record contradict each other."
        return Experiment(text, (own, own))
    if finding.open:
        with np.errstate(all="ignore"):
            return _separating(finding, dataset, lacking)
    if finding.verdict != "inconclusive" or not lacking:
        return None
    links = " and ".join(finding.not_judged)
    text = f"Record {' and '.join(lacking)} in the same runs: without, {links} cannot be judged."
    return Experiment(text, (own,))


def _separating(finding: Finding, dataset: MeasuredDataset, lacking: Sequence[str]) -> Experiment:
    pairs = list({frozenset(pair.names): pair for pair in finding.open}.values())
    known = [[_known(pair, k) for k in (0, 1)] for pair in pairs]
    needed = [_needed(pair) for pair in pairs]
    own = dict(dataset.spec.runs[_base(dataset)].set)
    left, texts, runs, most = set(range(len(pairs))), [], [], np.zeros(len(pairs))
    for trials in _trials(finding, dataset, lacking, dict(zip(pairs, known, strict=True))):
        changes = [trial.changes for trial in trials]
        for k, apart in chosen(len(trials), left, partial(_settled, known, needed, changes)):
            told = " and ".join(
                f"{' from '.join(pairs[i].names)} ({sigma:.2g} standard deviations at least)"
                for i, sigma in apart.items()
            )
            texts.append(f"One more run, {trials[k].words}, would tell {told}.")
            runs.append(own | dict(trials[k].set))
            left = left - set(apart)
        if not left:
            break
        for each in changes:
            most = np.maximum(
                most, [_separation(*x) for x in zip(known, [[c] for c in each], strict=True)]
            )
    for i in sorted(left):
        texts.append(_beyond(pairs[i], most[i]))
    return Experiment(" ".join(texts), tuple(runs))


def _settled(
    known: Sequence[Sequence[Array]],
    needed: Sequence[float],
    changes: Sequence[Sequence[Sequence[Change]]],
    ks: Sequence[int],
) -> dict[int, float]:
    """The pairs that further runs ``ks`` settle together, with their separation."""
    apart = {i: _separation(own, [changes[k][i] for k in ks]) for i, own in enumerate(known)}
    return {i: sigma for i, sigma in apart.items() if sigma > needed[i]}


def _needed(pair: OpenPair) -> float:
    """[sigma] that settles a pair: the log of the odds on record may be for the wrong one, at most
    by as much as leaves it open, and is then expected to count for the right one.
    """
    first, second = (pair.explanation.likelihood.again(fit).evidence for fit in pair.fits)
    return math.sqrt(2.0 * (TOLD_APART + min(abs(first - second), TOLD_APART)))


def _beyond(pair: OpenPair, most: float) -> str:
    """What would tell a pair apart that no run does."""
    links = {EFFECTS[kind].link for kind in pair.kinds if kind in EFFECTS}
    first = next((link for link in INPUT if link in links), "contact")
    name = LINK_NAMES.get(first, first)
    return (
        f"No other speed, spring, mass or attitude and no further channel of the loop tells "
        f"{' from '.join(pair.names)} ({most:.2g} standard deviations at most): record the "
        f"{name} by itself under {INPUT[first]}."
    )


def _trials(
    finding: Finding,
    dataset: MeasuredDataset,
    lacking: Sequence[str],
    pairs: Mapping[OpenPair, Sequence[Array]],
) -> Iterator[list[Trial]]:
    """The runs at other settings; and, where channels lack, the same run with one of them."""
    noise = noise_on_record(dataset)
    columns = {c for run in dataset.runs for c in run.record.columns()}
    base, count = with_noise(dataset.runs[_base(dataset)].scenario, noise, 0), len(dataset.runs)
    acting = _acting(finding)

    def simulated(further: Sequence[Further], columns: Set[str]) -> list[Trial]:
        truth = [with_entries(f.scenario, acting) for f in further]
        data, trouble = as_measured([f.scenario for f in further], truth, noise, columns)
        there = [f for f, why in zip(further, trouble, strict=True) if not why]
        if data is None:
            return []
        models = [LinkModel(link) for link in links_of(lay_out(data))]
        return [
            Trial(
                f.words, f.set, [_changes([m.on([i]) for m in models], *p) for p in pairs.items()]
            )
            for i, f in enumerate(there)
        ]

    yield simulated(list(possible(base, count)), columns)
    for group in lacking:
        same = Further(f"the same with {group} on record", {}, base)
        yield simulated([same], columns | set(GROUPS[group].columns))


def _base(dataset: MeasuredDataset) -> int:
    """The run that others are derived from: the fastest, in which effects show most."""
    speeds = [abs(run.scenario.approach.velocity[2]) for run in dataset.runs]
    return int(np.argmax(speeds))


def _acting(finding: Finding) -> list[Mapping[str, Any]]:
    """The effects of the runs to come: the causes, and where none is named the nearest effect."""
    out: list[Mapping[str, Any]] = [cause.entry() for cause in finding.causes]
    kinds = {e["kind"] for e in out}
    nearest = [e for pair in finding.open[:1] for e in effects_of(pair.fits[0])]
    return out + [entry(e) for e in nearest if e.kind not in kinds]


def _known(pair: OpenPair, k: int) -> Array:
    """H of the numbers of a fit, with the priors of its nuisances."""
    likelihood, of = pair.explanation.likelihood, pair.fits[k].of
    (left,) = likelihood.lefts(of.causes, [_numbers(of)])
    return likelihood.normal(left, likelihood.slopes(of.causes, _numbers(of), left))[0]


def _numbers(of: Hypothesis) -> Array:
    """(P + E,) of the causes of a hypothesis, and of its nuisances."""
    return np.concatenate([of.theta, of.nuisances])


def _changes(models: Sequence[LinkModel], pair: OpenPair, known: Sequence[Array]) -> list[Change]:
    """Of either hypothesis in place of the other, over the links of a run; nuisances are those of
    the link that is explained. Its numbers first follow by a step, about whose end it is linear.
    """
    out = []
    judged = [_as_judged(m, pair) for m in models]
    for k, (own, other) in enumerate((pair.fits, pair.fits[::-1])):
        x = _numbers(own.of)
        _, along, products = _about(judged, pair, own, other, x)
        scale = pair.explanation.likelihood.scale_of(own.causes, x)
        step = -np.linalg.lstsq(known[k] + products, along, rcond=1e-10)[0]
        low, high, _ = pair.explanation.likelihood.bounds(own.causes)
        out.append(_about(judged, pair, own, other, np.clip(x + step * scale, low, high)))
    return out


def _about(
    models: Sequence[LinkModel], pair: OpenPair, own: PosteriorFit, other: PosteriorFit, x: Array
) -> Change:
    """What a run changes that the hypothesis ``own`` predicts, linear about its numbers ``x``, per
    unit of them in their scales at the fit, as if the ``other`` acted.
    """
    size, along, products = 0.0, np.zeros(len(x)), np.zeros((len(x), len(x)))
    for model in models:
        here = model.link.name == pair.explanation.link.name
        likelihood = (model if here else model.as_timed()).likelihood()
        at, there = (slice(None if here else len(f.of.theta)) for f in (own, other))
        (left,) = likelihood.lefts(own.causes, [x[at]])
        (true,) = likelihood.lefts(other.causes, [_numbers(other.of)[there]])
        scale = likelihood.scale_of(own.causes, _numbers(own.of)[at])
        slopes = likelihood.slopes(own.causes, x[at], left).samples
        slopes *= (scale / likelihood.scale_of(own.causes, x[at]))[:, None]
        d = left.samples - true.samples - ((x - _numbers(own.of))[at] / scale) @ slopes
        size += float(d @ d)
        along[at] += slopes @ d
        products[at, at] += slopes @ slopes.T
    return size, along, products


def _as_judged(model: LinkModel, pair: OpenPair) -> LinkModel:
    """A model of a run to come with what the explained link says of the facility, and less weight
    on what a prediction leaves open.
    """
    link, judged = model.link, pair.explanation.link
    if isinstance(link, WrenchLink) and isinstance(judged, WrenchLink):
        model = model.through(link.as_interpreted(judged))
    return model.under(effects_of(pair.fits[0]))


def _separation(known: Sequence[Array], runs: Sequence[Sequence[Change]]) -> float:
    """[sigma] of a pair by further runs, the smaller of both directions."""
    out = []
    for k, normal in enumerate(known):
        size = sum(run[k][0] for run in runs)
        along = sum((run[k][1] for run in runs), np.zeros(len(normal)))
        total = sum((run[k][2] for run in runs), normal)
        followed = along @ np.linalg.lstsq(total, along, rcond=1e-10)[0]
        out.append(math.sqrt(max(size - float(followed), 0.0)))
    return min(out)
