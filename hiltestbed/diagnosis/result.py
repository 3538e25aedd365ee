"""The result of a diagnosis: the contents of diagnosis.json, as plain records.

`Finding` is what the stage "decide" gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.diagnosis.plain import finite, plain
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.diagnosis.certainty import Certainty
    from hiltestbed.diagnosis.explain import OpenPair
    from hiltestbed.diagnosis.timing import ClockOffset

VERDICTS = ("no_discrepancy", "named", "ambiguous", "named_in_part", "unknown", "inconclusive")
LINKS = ("platform", "contact", "sensor", "compensation", "dynamics", "log")
Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class Parameter:
    """An estimate with its 95 % interval, in `unit`; a vector has an interval for each item, a
    choice (an axis, a body) has none.
    """

    estimate: float | str | tuple[float, ...]
    ci95: Interval | tuple[Interval, ...] | None
    unit: str = ""

    def text(self) -> str:
        """The estimate with its interval, where it is one number."""
        interval = self.ci95
        if (
            not isinstance(self.estimate, float)
            or not interval
            or isinstance(interval[0], tuple)
            or isinstance(interval[1], tuple)
        ):
            return str(self.estimate)
        ends = ", ".join("open" if end is None else f"{end:.4g}" for end in interval)
        return f"{self.estimate:.4g} ({ends})"


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
        """As it stands under `effects:` in a scenario."""
        return {"kind": self.effect} | {
            name: plain(p.estimate) for name, p in self.parameters.items()
        }

    def to_json(self) -> dict[str, Any]:
        """As it stands in diagnosis.json."""
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

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero gain, and the gain exceeds the placebo's."""
        return self.ci95[0] > 0.0 and self.reduction > self.placebo_reduction

    def to_json(self) -> dict[str, Any]:
        """Its figures, and those of each run in a list."""
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
        """As it stands under `effects:` in a scenario."""
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
        cor: rebound speed / approach speed. peak_force [N]: largest reading along z. stiffness
            [N/m], damping [N s/m]: least squares of the reading on pose and rate in contact.
    """

    cor: float | None = None
    peak_force: float | None = None
    stiffness: float | None = None
    damping: float | None = None


@dataclass(frozen=True)
class ClosedLoop:
    """Figures of each run: measured, of the nominal and of the extended simulation."""

    runs: tuple[int, ...]
    measured: tuple[Figures, ...]
    nominal: tuple[Figures, ...]
    extended: tuple[Figures, ...]

    def to_json(self) -> dict[str, Any]:
        """`cor_measured` and so on, each a list over the runs."""
        out: dict[str, Any] = {"runs": list(self.runs)}
        for name in ("cor", "peak_force", "stiffness", "damping"):
            for source in ("measured", "nominal", "extended"):
                label = name if name in ("cor", "peak_force") else f"identified_{name}"
                out[f"{label}_{source}"] = [getattr(f, name) for f in getattr(self, source)]
        return out


@dataclass(frozen=True)
class Experiment:
    """A run that would settle what is open: the effects it separates, and the keys of each run."""

    text: str
    separates: tuple[str, ...] = ()
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
    likeness: float = 0.0


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
        """Whether a learned law extends the model."""
        return self.learned is not None and self.learned.carries_over

    @property
    def extends(self) -> bool:
        """Whether the model is extended."""
        return self.names or self.learns

    @property
    def extension(self) -> tuple[Cause | Learned, ...]:
        """The causes and the learned law that extend the model."""
        if self.learned is not None and self.learns:
            return (*self.causes, self.learned)
        return self.causes if self.names else ()
