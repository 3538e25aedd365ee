"""The result of a diagnosis, as plain records: what the stage "decide" finds (`Finding`), and what
the report derives from it (`Conclusion`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.diagnosis.plain import finite, plain
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.diagnosis.certainty import Certainty
    from hiltestbed.diagnosis.explain import OpenPair
    from hiltestbed.diagnosis.timing import ClockOffset
    from hiltestbed.measured import MeasuredDataset
    from hiltestbed.scenario import Scenario
    from hiltestbed.signals import RunTrace

RESAMPLES = 2000  # draws of the bootstrap over runs: its ends are known to a percent of its width
Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class Parameter:
    """An estimate with its 95 % interval, in `unit`; a vector has an interval for each item, a
    choice (an axis, a body) has none.
    """

    estimate: float | str | tuple[float, ...]
    ci95: Interval | tuple[Interval, ...] | None
    unit: str = ""

    def in_words(self) -> str:
        """`0.003300 (0.003294 to 0.003307) s`: with as many digits as the interval supports."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        if isinstance(self.estimate, str):
            return self.estimate
        if isinstance(self.estimate, tuple):
            ends = self.ci95 or (None,) * len(self.estimate)
            each = (_with_interval(v, e) for v, e in zip(self.estimate, ends, strict=True))
            return f"[{', '.join(each)}]{unit}"
        return _with_interval(self.estimate, self.ci95) + unit


def _with_interval(value: float, ends: Any) -> str:
    if ends is None or None in ends or ends[0] == ends[1]:
        return f"{value:.4g}"
    size, width = max(abs(value), abs(ends[0]), abs(ends[1])), ends[1] - ends[0]
    digits = 4
    if size > 0 and width > 0:
        digits = min(8, max(2, 2 + math.floor(math.log10(size)) - math.floor(math.log10(width))))
    return f"{value:.{digits}g} ({ends[0]:.{digits}g} to {ends[1]:.{digits}g})"


@dataclass(frozen=True)
class Cause:
    """A named effect.

    Attributes:
        effect: id in the vocabulary. parameters: all of them, so that the effect can go into a
            scenario.
        probability: that it is this effect and not one of `indistinguishable_from`.
        alternatives: for each of these the whole explanation with it in place of this effect, as
            under `effects:` in a scenario; the parameters of the other causes may differ in it.
    """

    effect: str
    parameters: Mapping[str, Parameter]
    probability: float
    indistinguishable_from: tuple[str, ...] = ()
    alternatives: tuple[tuple[Mapping[str, Any], ...], ...] = ()

    def entry(self) -> dict[str, Any]:
        return {"kind": self.effect} | {
            name: plain(p.estimate) for name, p in self.parameters.items()
        }

    def to_json(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "parameters": {name: vars(p) for name, p in self.parameters.items()},
            "probability": self.probability,
            "indistinguishable_from": list(self.indistinguishable_from),
            "alternatives": finite(self.alternatives),
        }


@dataclass(frozen=True)
class ChannelResidual:
    """The residual of a replayed link on one channel, in the channel's unit.

    Attributes:
        rms, rms_free, rms_contact, rms_after: of measured less nominal: overall, before the first
            touch, in contact, after it.
        noise_floor: rms of the noise alone. white: whether the residual of the nominal model passes
            for white noise at the floor.
        rms_extended, white_extended: the same with the named effects; None where nothing was named.
    """

    channel: str
    rms: float
    noise_floor: float
    rms_free: float | None
    rms_contact: float | None
    rms_after: float | None
    white: bool
    unit: str = ""
    rms_extended: float | None = None
    white_extended: bool | None = None


@dataclass(frozen=True)
class Heldout:
    """The gain on left-out runs.

    Attributes:
        runs: their numbers. rms_before, rms_after: residual of the departing link in units of its
            noise floor (which is 1).
        reduction: 1 - rms_after/rms_before. ci95: of the reduction, over runs.
        placebo_reduction: of a wrong effect with as many parameters, fitted and left out in the
            same way.
        per_run: run to (before, after).
    """

    runs: tuple[int, ...]
    rms_before: float
    rms_after: float
    reduction: float
    ci95: tuple[float, float]
    placebo_reduction: float
    per_run: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        runs: Sequence[int],
        before: Mapping[int, float],
        after: Mapping[int, float],
        wrong: Mapping[int, float],
    ) -> Heldout:
        """From the mean squares of each run, nominal, with the causes and with the placebo; the
        interval by bootstrap over runs.
        """
        a, b, w = (np.array([x[i] for i in runs]) for x in (before, after, wrong))
        draws = np.random.default_rng(0).integers(0, len(runs), (RESAMPLES, len(runs)))
        gains = 1.0 - np.sqrt(b[draws].sum(axis=1) / a[draws].sum(axis=1))
        low, high = (float(x) for x in np.percentile(gains, [2.5, 97.5]))
        rms_a, rms_b, rms_w = (float(np.sqrt(np.mean(x))) for x in (a, b, w))
        per_run = {i: (float(np.sqrt(before[i])), float(np.sqrt(after[i]))) for i in runs}
        gain, placebo = 1.0 - rms_b / rms_a, 1.0 - rms_w / rms_a
        return cls(tuple(runs), rms_a, rms_b, gain, (low, high), placebo, per_run)

    def in_words(self) -> str:
        """`12.0 % (95 % interval 8.0 to 14.0 %), from 3.1 to 2.7 times the noise`."""
        gain, low, high = (100.0 * v for v in (self.reduction, *self.ci95))
        return (
            f"{gain:.1f} % (95 % interval {low:.1f} to {high:.1f} %), from {self.rms_before:.3g} "
            f"to {self.rms_after:.3g} times the noise"
        )

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero gain, and the gain exceeds the placebo's."""
        return self.ci95[0] > 0.0 and self.reduction > self.placebo_reduction

    def to_json(self) -> dict[str, Any]:
        rows = [{"run": run, "before": a, "after": b} for run, (a, b) in self.per_run.items()]
        return vars(self) | {"per_run": rows, "significant": self.significant}


@dataclass(frozen=True)
class LearnedCurve:
    """One curve of a learned law, and the data for it with all other terms subtracted.

    Attributes:
        over: its abscissa, a parameter of the effect. knots: (K, 2). data: (M, 2) samples, thinned.
            units: of both axes.
    """

    over: str
    knots: Array
    data: Array
    units: tuple[str, str]


@dataclass(frozen=True)
class Learned:
    """A law that was learned on a link which no named effects explain.

    Attributes:
        effect: id. parameters: as in a scenario. link: that it acts on. numbers: how many were
            fitted.
        heldout: its gain on left-out runs, beside the named causes. explained: share of the
            departure there.
        carries_over: whether the same law holds in all runs, so that the model is extended with it.
        equation: a short one, or None where none fits. resembles: named effects that remove much
            the same from the residual.
    """

    effect: str
    parameters: Mapping[str, Any]
    link: str
    numbers: int
    heldout: Heldout
    explained: float
    carries_over: bool
    equation: str | None
    resembles: tuple[str, ...]
    curves: tuple[LearnedCurve, ...] = ()

    def entry(self) -> dict[str, Any]:
        return {"kind": self.effect, **self.parameters}

    def to_json(self) -> dict[str, Any]:
        """As it stands in diagnosis.json; `gain` is the relative reduction of the residual on
        left-out runs.
        """
        return {
            "effect": self.effect,
            "gain": self.heldout.reduction,
            "resembles": list(self.resembles),
            "equation": self.equation,
            "parameters": dict(self.parameters),
            "numbers": self.numbers,
            "explained": self.explained,
            "carries_over": self.carries_over,
            "heldout": self.heldout.to_json(),
        }


@dataclass(frozen=True)
class Figures:
    """Figures of a run along z, by the same rule for measured and simulated runs; None where one
    cannot be estimated.

    Attributes:
        cor: rebound speed / approach speed. peak_force [N]: largest reading along z.
    """

    cor: float | None = None
    peak_force: float | None = None


@dataclass(frozen=True)
class ClosedLoop:
    """Figures of each run: measured, of the nominal and of the extended simulation."""

    runs: tuple[int, ...]
    measured: tuple[Figures, ...]
    nominal: tuple[Figures, ...]
    extended: tuple[Figures, ...]

    def to_json(self) -> dict[str, Any]:
        sources = ("measured", "nominal", "extended")
        return {"runs": list(self.runs)} | {
            f"{name}_{source}": [getattr(f, name) for f in getattr(self, source)]
            for name in ("cor", "peak_force")
            for source in sources
        }


@dataclass(frozen=True)
class Experiment:
    """A run that would settle what is open, in words, and the keys of each run."""

    text: str
    runs: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class Ranked:
    """A hypothesis that was compared: effects, their parameters in words, score (chi-square and
    penalty; smaller is better), link.

    heldout: rms on left-out runs in units of the noise floor, or None. adequate: whether it leaves
        only noise.
    """

    effects: tuple[str, ...]
    score: float
    link: str = ""
    parameters: str = ""
    heldout: float | None = None
    adequate: bool | None = None


@dataclass(frozen=True)
class Isolable:
    """What these data can show of an effect: the smallest size that would be detected, and its
    look-alikes at that size.

    smallest: of `parameter` in `unit`; None where the data do not show it at all.
    """

    effect: str
    parameter: str
    unit: str
    smallest: float | None
    confused_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Series:
    """One channel of one run: measured, and predicted by the nominal and by the extended link from
    measured inputs; all (N,).

    sigma: noise, infinite where not counted. touching: in contact, or the sensor still shows it.
    """

    channel: str
    run: int
    t: Array
    measured: Array
    nominal: Array
    extended: Array
    sigma: Array
    touching: np.ndarray
    unit: str = ""


@dataclass
class Finding:
    """The result of the stage "decide".

    Attributes:
        link: that departs most, or None. causes: strongest first.
        isolability: of the effects on links whose explanation leaves noise alone. unsized: of every
            other link the reason why it has none.
        series: every channel of every link and run. noise: channel to its floor.
        left: residual of the best extension in a sentence (verdict `unknown`): link, phase and
            shape. contrary: how its runs contradict each other, in a sentence, if they do.
        not_judged: link to the reason why it could not be judged.
        partial: the effects of the vocabulary that come nearest where none leaves only noise;
            partial_gain: their gain on left-out runs.
        certainty: the uncertainty of the estimates of each fit that gave a cause.
        learned: the law learned on a link where the vocabulary leaves more than noise.
        timing: what was attributed to the timing of the facility.
        open: pairs of hypotheses that the data do not tell apart.
        assumed: assumptions on the noise, in sentences. explained: verdict `named_in_part`: share
            of the departure on left-out runs.
    """

    verdict: str
    link: str | None
    causes: tuple[Cause, ...] = ()
    series: list[Series] = field(default_factory=list)
    noise: Mapping[str, float] = field(default_factory=dict)
    heldout: Heldout | None = None
    ranking: tuple[Ranked, ...] = ()
    isolability: tuple[Isolable, ...] = ()
    unsized: Mapping[str, str] = field(default_factory=dict)
    left: str = ""
    contrary: str = ""
    not_judged: Mapping[str, str] = field(default_factory=dict)
    partial: tuple[Cause, ...] = ()
    partial_gain: Heldout | None = None
    assumed: tuple[str, ...] = ()
    explained: float | None = None
    learned: Learned | None = None
    certainty: tuple[Certainty, ...] = ()
    timing: tuple[ClockOffset, ...] = ()
    open: tuple[OpenPair, ...] = ()

    @property
    def names(self) -> bool:
        """Whether causes extend the model: their gain on left-out runs is significant."""
        named = self.verdict in ("named", "ambiguous", "named_in_part") and bool(self.causes)
        return named and (self.heldout is None or self.heldout.significant)

    @property
    def learns(self) -> bool:
        return self.learned is not None and self.learned.carries_over

    @property
    def extends(self) -> bool:
        return self.names or self.learns

    @property
    def extension(self) -> tuple[Cause | Learned, ...]:
        """The causes and the learned law that extend the model."""
        if self.learned is not None and self.learns:
            return (*self.causes, self.learned)
        return self.causes if self.names else ()


@dataclass(frozen=True)
class SimulatedRun:
    """One run, simulated: the nominal and the extended trace, None where it could not be run."""

    run: int
    nominal: RunTrace | None
    extended: RunTrace | None


@dataclass
class Conclusion:
    """A finding and what follows from it.

    Attributes:
        dataset, extended: the data, and the scenario with the named effects (the nominal one where
            nothing was named). simulated: the simulations of each run.
    """

    name: str
    finding: Finding
    residuals: tuple[ChannelResidual, ...]
    closed_loop: ClosedLoop
    experiment: Experiment | None
    extended: Scenario
    dataset: MeasuredDataset
    simulated: tuple[SimulatedRun, ...]
    remarks: tuple[str, ...] = ()
    overridden: tuple[str, ...] = ()  # a sentence on each check that the dataset overrides
    seconds: float | None = None

    @property
    def verdict(self) -> str:
        return self.finding.verdict

    @property
    def link(self) -> str | None:
        return self.finding.link

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.finding.causes

    @property
    def heldout(self) -> Heldout | None:
        return self.finding.heldout

    @property
    def compared(self) -> str:
        """Name of the `extended` prediction of the series: the extended model, the best explanation
        that is not adequate, or none.
        """
        if self.finding.extends:
            return "extended"
        return "best explanation" if self.finding.partial else ""

    @property
    def next_experiment(self) -> str | None:
        return self.experiment.text if self.experiment else None
