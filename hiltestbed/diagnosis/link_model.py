"""A link of the loop as a model whose departures can be sought: what it leaves of the recorded
output, in units of the noise.

The samples of a run fall into groups, one for each channel in contact and outside it. The noise of
a group is known from below only: errors that only the log has may add to it. What the groups share
is sought by :mod:`hiltestbed.inference`, as on a single axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.stats import chi2, gamma

from hiltestbed.diagnosis.links import LinkRun, ModelLink, PlatformLink, Timing, WrenchLink
from hiltestbed.diagnosis.links.base import Effects, whitening_filter
from hiltestbed.diagnosis.links.wrench import NODES, WEIGHTS
from hiltestbed.diagnosis.noise import softened
from hiltestbed.diagnosis.nuisances import Aside
from hiltestbed.diagnosis.recorded import UNUSED_END_ROWS
from hiltestbed.diagnosis.residual import Residual, finite
from hiltestbed.diagnosis.settings import BLOCK_ROWS, MODEL_ERROR, UNKNOWN
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit
from hiltestbed.inference.model import Hypothesis, Model, Nuisance
from hiltestbed.inference.residuals import RunResiduals
from hiltestbed.measured.noise import MAD_TO_SIGMA, OUTLIER_SIGMA
from hiltestbed.replay.wrench import shifted
from hiltestbed.sensor.effects import SensorDelay, SensorJitter

SLOW_SHAPES = 3  # degree of the polynomials by which a model's error varies along a contact
TIME_ERROR = 0.05  # [rows] error in time of an integration in steps
# share of the whole force by which two integrations of one contact of so many steps differ: 0.1 to
# 0.24 %
MOST_MODEL_ERROR, MODEL_STEPS = 2.4e-3, 100
# of the whole force, or torque: an engine's constraints give by a ten-thousandth
SOFTNESS = 1e-4
# standard deviation of what lies anywhere between -1 and 1: of a time-stamp offset [rows], since
# loggers stamp up to a row early or late, and of a share of which nothing is known
EVEN_SIGMA = 1.0 / math.sqrt(3.0)
# [rows] of an instant within a tick at which a facility samples or obeys
LATEST_INSTANT = 0.5
INSTANT_SIGMA = LATEST_INSTANT * EVEN_SIGMA
REACH = 3.0  # standard deviations at which a prior of stamps ends: 0.3 % lie beyond
# [rows] of a shift between two channels, each stamped on its own
SHIFT_SIGMA = math.sqrt(2.0) * EVEN_SIGMA
STAMP_STARTS = (-0.8, -0.3, 0.3, 0.8)  # [rows] of a search for an offset
MOST_OLD = 0.9  # share of the old twist in a new pose; all of it is explicit Euler, a cause
# share of what is left of a computed channel that follows its output, from which it departs
FOLLOWING = 0.1
COLOUR_ORDER = 16  # of the filter that makes noise white
OUTSIDE, INSIDE = "outside", "in"
NOTHING = Hypothesis((), np.zeros(0), np.zeros(0))
# the same of a sample in a fit, of those that exceed as many rms: one normal one in 5e8
CLIPPED = 6.0
# probability with which white noise exceeds a limit: of some 50 limits of a set one in 3000 sets
ALLOWED = 7e-6


class Whiteness(NamedTuple):
    """Whether the residual of a channel is white noise, of whatever level.

    Attributes:
        level: its rms in units of the noise, not below 1. blocks: mean square of the means of
            blocks of rows, over what white noise has there. line: the strongest line of its
            spectrum, over the mean. allowed: how much of either chance gives as rarely as
            :data:`ALLOWED`.
    """

    level: float
    blocks: float
    line: float
    allowed: tuple[float, float]

    @property
    def noise(self) -> bool:
        return self.excess <= 1.0

    @property
    def excess(self) -> float:
        """The worse of both over what is allowed."""
        return max(self.blocks / self.allowed[0], self.line / self.allowed[1])


def leftover(parts: Sequence[Array]) -> Whiteness:
    """Of one channel: residuals (M,) of each run, in units of the noise.

    Outliers are clipped. The sum of B squares of means is chi-square of B, a line of the sum of the
    spectra of R runs a gamma variable of shape R.
    """
    rows, longest = sum(map(len, parts)), max(map(len, parts))
    size = OUTLIER_SIGMA * max(MAD_TO_SIGMA * float(np.median(np.abs(np.concatenate(parts)))), 1.0)
    parts = [np.clip(x, -size, size) for x in parts]
    level = max(sum(float(x @ x) for x in parts) / rows, 1.0)
    whole = [x[: len(x) // BLOCK_ROWS * BLOCK_ROWS].reshape(-1, BLOCK_ROWS) for x in parts]
    means = np.concatenate([x.sum(axis=1) for x in whole])
    count, lines = max(len(means), 1), max(longest // 2, 1)
    squares = float(means @ means) / (BLOCK_ROWS * count * level)
    power = sum(np.abs(np.fft.rfft(x, longest))[1:] ** 2 for x in parts) / (rows * level)
    most_squares = float(chi2.isf(ALLOWED, count)) / count
    most_power = float(gamma.isf(ALLOWED / lines, len(parts))) / len(parts)
    line = float(np.max(power, initial=0.0))
    return Whiteness(math.sqrt(level), squares, line, (most_squares, most_power))


class LinkModel(Model):
    """A link on some of its runs.

    Attributes:
        link: that is replayed. members: its runs that count. groups: of the residuals, (place in
            ``members``, channel, whether in contact). rows: (M,) of each group.
    """

    noise_known = True

    def __init__(
        self,
        link: ModelLink,
        members: Sequence[int] | None = None,
        doubt: Sequence[Array | None] | None = None,
        colour: Sequence[Array] | None = None,
        timings: tuple[Nuisance, ...] | None = None,
    ) -> None:
        """doubt: (N, C) of each run of the link: further uncertainty of its prediction, in the unit
        of the output. colour: (C, P + 1) of each run, prediction-error filters that make the noise
        white; None: those of the link. timings: what is open of when the facility samples, obeys,
        stamps and steps; None: as of a link of which nothing more is known.
        """
        self.link, self.doubt = link, doubt
        self.nuisances = open_timings(link) if timings is None else timings
        self.members = tuple(range(len(link.runs)) if members is None else members)
        self.counted = tuple(_without_ends(np.isfinite(r.sigma)) for r in link.runs)
        self.weight: list[Array] = []
        for i, (r, c) in enumerate(zip(link.runs, self.counted, strict=True)):
            sigma = np.hypot(r.sigma, self._model_error(r))
            more = doubt[i] if doubt else None
            sigma = sigma if more is None else np.hypot(sigma, more)
            self.weight.append(np.where(c, 1.0 / np.where(c, sigma, 1.0), 0.0))
        filters = link.colour()
        if colour is None and filters is not None:
            colour = [np.tile(filters, (len(link.channels), 1)) for _ in link.runs]
        self._colour = colour
        self._aside: dict[int, Aside] = {}
        self.groups: list[tuple[int, int, bool]] = []
        self.rows: list[np.ndarray] = []
        names = []
        for n, i in enumerate(self.members):
            touching = link.runs[i].touching
            for c, channel in enumerate(link.channels):
                for inside in (False, True):
                    rows = np.flatnonzero(self.counted[i][:, c] & (touching == inside))
                    if len(rows):
                        self.groups.append((n, c, inside))
                        self.rows.append(rows)
                        names.append(f"run {i}, {channel}, {INSIDE if inside else OUTSIDE} contact")
        self.runs = tuple(names)
        self.floors = np.ones(len(names))
        # (M,) of each member the places of its samples among those of all channels, group by group
        own: list[list[np.ndarray]] = [[np.zeros(0, int)] for _ in self.members]
        for rows, (n, c, _) in zip(self.rows, self.groups, strict=True):
            own[n].append(rows * len(link.channels) + c)
        self._taken = [np.concatenate(rows) for rows in own]
        self._starts = np.cumsum([0, *map(len, self.rows)])[:-1]

    def _model_error(self, run: LinkRun) -> Array:
        """(N, C) error of a model of the same physics: of a computed reading, in proportion to it
        and to the whole force, or torque; 0 on other links. It is alike over a block of rows, and
        counts like noise that is larger by the root of their number.
        """
        if not isinstance(self.link, WrenchLink):
            return np.zeros_like(run.measured)
        parts = [run.measured[:, :3], run.measured[:, 3:]]
        whole = np.repeat([np.linalg.norm(x, axis=1) for x in parts], 3, axis=0).T
        error = SOFTNESS * whole + MODEL_ERROR * np.abs(run.measured)
        return np.asarray(math.sqrt(BLOCK_ROWS) * error)

    def on(self, runs: Sequence[int]) -> LinkModel:
        return self._with(members=[self.members[i] for i in runs])

    def through(self, link: ModelLink) -> LinkModel:
        """The same samples of another interpretation of the link."""
        return self._with(link=link)

    def clocked(self, rows: float, sigma: float) -> LinkModel:
        """The same of an output that is so many rows late, known to ``sigma`` rows."""
        link = self.link.with_timing(Timing.hypothesis({}, delay=rows * self.link.tick))
        return self._with(link=link, timings=open_timings(link, sigma))

    def as_timed(self) -> LinkModel:
        """The same of a facility whose timing is known."""
        return self._with(timings=())

    def timing(self, of: Hypothesis) -> Timing:
        """When the facility samples, obeys, stamps and steps under a hypothesis."""
        pairs = zip(self.nuisances, of.nuisances, strict=False)
        return Timing.hypothesis({}, **{n.name: float(v) for n, v in pairs})

    def effects(self, of: Hypothesis) -> list[Effect]:
        """The causes of a hypothesis, and the timing of the facility."""
        return [*of.each(), *([self.timing(of)] if of.nuisances.any() else [])]

    def _with(self, **changed: Any) -> LinkModel:
        given = {
            "link": self.link,
            "members": self.members,
            "doubt": self.doubt,
            "colour": self._colour,
            "timings": self.nuisances,
        }
        return LinkModel(**(given | changed))

    def under(self, effects: Sequence[Effect]) -> LinkModel:
        """The same with less weight on what the prediction under ``effects`` leaves open."""
        doubt = [
            self.link.doubt(i, effects) if i in self.members else None
            for i in range(len(self.link.runs))
        ]
        open_ = doubt if any(d is not None for d in doubt) else None
        return self if open_ is None and self.doubt is None else self._with(doubt=open_)

    def coloured(self, left: Sequence[Array]) -> LinkModel:
        """The same with noise of the colour that residuals have outside contact, or in a mechanism
        that never leaves it, channel by channel and run by run.
        """
        free = {(n, c) for n, c, inside in self.groups if not inside}
        plain = np.eye(1, COLOUR_ORDER + 1)[0]
        colour = [np.tile(plain, (len(self.link.channels), 1)) for _ in self.link.runs]
        for x, (n, c, inside) in zip(left, self.groups, strict=False):
            if (inside and (n, c) in free) or len(x) <= COLOUR_ORDER or not x.any():
                continue
            lags = np.array([float(x[k:] @ x[: len(x) - k]) for k in range(COLOUR_ORDER + 1)])
            colour[self.members[n]][c] = whitening_filter(lags)
        if self._colour is not None:  # of residuals that a filter has been applied to
            colour = [
                np.array([np.convolve(f, g) for f, g in zip(*both, strict=True)])
                for both in zip(self._colour, colour, strict=True)
            ]
        return self._with(colour=colour)

    def likelihood(self, choices: int = 1) -> Likelihood:
        return Likelihood(self, np.array([float(len(rows)) for rows in self.rows]), choices)

    def folds(self) -> list[tuple[str, Model, Model]]:
        count = len(self.members)
        if count < 2:
            return self.stretch_folds()
        rest = [[j for j in range(count) if j != i] for i in range(count)]
        return [(f"run {self.members[i]}", self.on(rest[i]), self.on([i])) for i in range(count)]

    def many(self, of: Sequence[Hypothesis]) -> list[RunResiduals]:
        each = [self.effects(h) for h in of]
        shown = iter(self.link.predict([(i, effects) for effects in each for i in self.members]))
        out = []
        for h, effects in zip(of, each, strict=True):
            z, logs, smoothing = [np.zeros(0)], 0.0, self.link.smoothing(effects)
            for n, i in enumerate(self.members):
                prediction, ratio = self._spread(i, next(shown), effects)
                noise = self._noise(i, ratio)
                own = self.in_sigma(i, prediction, smoothing, noise)
                z.append(own.ravel()[self._taken[n]])
                if ratio is not None:
                    logs += float(np.sum(np.log(ratio.ravel()[self._taken[n]])))
                    logs += noise.log_determinant - self._noise(i).log_determinant
            away = max(self._smoothed_away(h), 0.0)
            eta = h.nuisances if len(h.nuisances) else np.zeros(len(self.nuisances))
            priors = np.append(eta / self.prior_sigma(), math.sqrt(2.0 * logs + away))
            out.append(_without_outliers(RunResiduals(np.concatenate(z), self._starts, priors)))
        return out

    def residuals(self, of: Hypothesis) -> RunResiduals:
        return self.many([of])[0]

    def changes(self, each: Sequence[Sequence[Effect]]) -> list[tuple[Array, Array]]:
        """Of each run, what lists of effects change: (E, M) of its whitened residual, and (E,)
        twice the Kullback-Leibler divergence that a delay brings which varies from sample to
        sample.
        """
        lanes = [(i, effects) for i in self.members for effects in ((), *each)]
        shown, out = iter(self.link.predict(lanes)), []
        for n, i in enumerate(self.members):
            nominal, taken = next(shown), self._taken[n]
            z, scatter = np.zeros((len(each), len(taken))), np.zeros(len(each))
            for k, effects in enumerate(each):
                mean, ratio = self._spread(i, next(shown), effects)
                z[k] = finite(self._whitened(i, mean - nominal, self._noise(i))).ravel()[taken]
                if ratio is not None:
                    more = ratio.ravel()[taken] ** 2
                    scatter[k] = float(np.sum(more - 1.0 - np.log(more)))
            out.append((z, scatter))
        return out

    def sample_weights(self) -> Array:
        pairs = zip(self.members, self._taken, strict=True)
        return np.concatenate([np.zeros(0), *(self.weight[i].ravel()[at] for i, at in pairs)])

    def _smoothed_away(self, of: Hypothesis) -> float:
        """Chi-square that a hypothesis is expected to take off by smoothing the rounding errors of
        the input on record, whether it is true or not.

        Least squares with errors in the variables prefer a response that smooths (W. A. Fuller,
        Measurement Error Models, 1987).
        """
        out = 0.0
        effects = self.effects(of)
        for i in self.members if effects and self.link.rounding else ():
            believed = self.link.passed_from_input(i, ())
            found = self.link.passed_from_input(i, effects)
            if believed is not None and found is not None:
                out += float(np.sum(self.weight[i] ** 2 * (believed - found)))
        return out

    def _spread(
        self, i: int, shown: Array, effects: Sequence[Effect]
    ) -> tuple[Array, Array | None]:
        """The mean prediction, and the deviation of the output over that of its noise alone, both
        (N, C), where a delay varies from sample to sample; None: it does not.

        The error of a model is in that noise as if it scattered, which it does not: a scatter shows
        in full where it is the larger of the two.
        """
        mean, variance = self._moments(i, shown, effects)
        if variance is None:
            return mean, None
        more = np.maximum(variance - self._model_error(self.link.runs[i]) ** 2, 0.0)
        return mean, np.sqrt(1.0 + more * self.weight[i] ** 2)

    def scatter(self, n: int, effects: Sequence[Effect]) -> Array | None:
        """(N, C) variance of the output of the member n whose delay varies from sample to sample;
        None: it does not.
        """
        i = self.members[n]
        (shown,) = self.link.predict([(i, effects)])
        return self._moments(i, shown, effects)[1]

    def _moments(
        self, i: int, shown: Array, effects: Sequence[Effect]
    ) -> tuple[Array, Array | None]:
        """Mean and variance, both (N, C), of a prediction whose delay varies from sample to sample;
        None: it does not.
        """
        sigma = _jitter(effects)
        if not sigma:
            return shown, None
        rows = sigma / self.link.runs[i].scenario.tick
        nominal = float(sum(e.delay for e in effects if isinstance(e, SensorDelay)))
        nominal += self.link.runs[i].scenario.sensor.delay
        late = np.maximum(rows * NODES, -nominal / self.link.runs[i].scenario.tick)
        found = [shifted(shown, -float(n)) for n in late]
        mean = np.tensordot(WEIGHTS, np.array(found), 1)
        return mean, np.tensordot(WEIGHTS, (np.array(found) - mean) ** 2, 1)

    def _noise(self, i: int, ratio: Array | None = None) -> Aside:
        """Weights and nuisance terms of run i, those of its record and of the model's error, with
        deviations ``ratio`` (N, C) times as large.
        """
        if i not in self._aside:
            run = self.link.runs[i]
            terms = [run.terms]
            if isinstance(self.link, WrenchLink):
                (shown,) = self.link.predict([(i, ())])
                terms.append(_model_terms(run, shown))
            self._aside[i] = Aside(self.weight[i], np.concatenate(terms, axis=2))
        aside = self._aside[i]
        return aside if ratio is None else aside.under(aside.weight / ratio)

    def in_sigma(
        self, i: int, shown: Array, smoothing: float = 1.0, noise: Aside | None = None
    ) -> Array:
        """(N, C) of run i: measured less ``shown`` (N, C), whitened, in units of the noise, by
        default that of the run, that is left of that of the input, ``smoothing``.
        """
        run, noise = self.link.runs[i], noise or self._noise(i)
        left = run.measured - shown
        left = np.sign(left) * np.maximum(np.abs(left) - 0.5 * run.steps, 0.0)
        return finite(self._whitened(i, left, noise, smoothing, run.heavy))

    def _whitened(
        self, i: int, left: Array, noise: Aside, smoothing: float = 1.0, heavy: bool = False
    ) -> Array:
        if (white := self.link.whitened(i, np.nan_to_num(left, nan=UNKNOWN))) is not None:
            return white
        z = softened((left - noise.of(left)) * (noise.weight / smoothing), heavy)
        if self._colour is None:
            return z
        pairs = zip(self._colour[i], z.T, strict=True)
        white = np.column_stack([lfilter(f, 1.0, x) for f, x in pairs])
        return np.where(noise.weight > 0.0, white, 0.0)

    def departure(self, of: Hypothesis) -> list[Array]:
        """In units of the noise alone, without what the model may err by."""
        residual = Residual(self.link, self.members)
        return [residual.compared(i, self.effects(of)) for i in self.members]

    def leftovers(self, left: Sequence[Array]) -> dict[tuple[int, bool], Whiteness]:
        """What is left of each channel, in contact and outside it."""
        out = {}
        for key in dict.fromkeys((c, inside) for _, c, inside in self.groups):
            mine = [x for x, (_, *g) in zip(left, self.groups, strict=False) if tuple(g) == key]
            out[key] = leftover(mine)
        return out

    def leaves_noise(self, left: Sequence[Array]) -> bool:
        return self.excess(left) <= 1.0

    def excess(self, left: Sequence[Array]) -> float:
        """What is left of the worst channel, over what noise leaves."""
        if self.link.computed:
            return self.follows_input(left)
        return max((x.excess for x in self.leftovers(left).values()), default=0.0)

    def follows_input(self, left: Sequence[Array]) -> float:
        """The largest share of what is left of a computed channel in contact that follows the
        output itself, over :data:`FOLLOWING`; 0 below the noise.

        A computed output departs as a function of its input, whatever the log adds does not. That
        function is one of the output, its rates and its size, fitted to the other runs.
        """
        worst = 0.0
        for c in range(len(self.link.channels)):
            parts, bases = [], []
            for x, rows, (n, d, inside) in zip(left, self.rows, self.groups, strict=False):
                if d == c and inside:
                    y = uniform_filter1d(self.link.runs[self.members[n]].measured[:, c], BLOCK_ROWS)
                    rate = np.gradient(y)
                    terms = (y, rate, np.gradient(rate), y * np.abs(y), np.abs(rate))
                    basis = np.column_stack(terms)
                    bases.append(basis[rows] / (np.std(basis, axis=0) + np.finfo(float).tiny))
                    parts.append(np.clip(x, -UNKNOWN, UNKNOWN))
            if len(parts) < 2 or sum(float(x @ x) for x in parts) <= sum(map(len, parts)):
                continue
            usual = MAD_TO_SIGMA * float(np.median(np.abs(np.concatenate(parts))))
            size = OUTLIER_SIGMA * max(usual, 1.0)
            parts = [np.clip(x, -size, size) for x in parts]
            before, after = sum(float(x @ x) for x in parts), 0.0
            for n, (x, basis) in enumerate(zip(parts, bases, strict=True)):
                others = [m for m in range(len(parts)) if m != n]
                a, y = (np.concatenate([p[m] for m in others]) for p in (bases, parts))
                law = np.linalg.lstsq(a, y, rcond=1e-9)[0]
                after += float(np.sum((x - basis @ law) ** 2))
            if before:
                worst = max(worst, (1.0 - after / before) / FOLLOWING)
        return worst

    def contradicts(self, of: Hypothesis, left: RunResiduals) -> bool:
        """A scatter is white: one that leaves more than that stands in for what is smooth."""
        return _jitter(of.each()) > 0.0 and not self.leaves_noise(left)

    def negligible(self, of: Hypothesis, index: int) -> bool:
        """In contact by the share of the whole force, and of the whole torque, by which it changes
        each; outside, and where it scatters, by the noise.
        """
        effects = self.effects(of)
        fewer = [e for n, e in enumerate(effects) if n != index]
        return bool(self.over_negligible([effects], fewer)[0] <= 1.0)

    def over_negligible(self, each: Sequence[Effects], fewer: Effects = ()) -> Array:
        """(E,) of lists of effects, what they change beyond ``fewer``, over what is negligible."""
        out = np.full(len(each), np.inf)
        if not isinstance(self.link, WrenchLink):
            return out
        lanes = [(i, effects) for effects in (fewer, *each) for i in self.members]
        shown, count = self.link.predict(lanes), len(self.members)
        least = self._moments_of(fewer, shown[:count])
        for k, effects in enumerate(each):
            own = self._moments_of(effects, shown[(k + 1) * count : (k + 2) * count])
            changed, whole, outside = np.zeros(2), np.zeros(2), 0.0
            for i, (a, more), (b, less) in zip(self.members, own, least, strict=True):
                inside, weight = self.link.runs[i].touching, self.weight[i]
                for part, columns in enumerate((slice(0, 3), slice(3, 6))):
                    changed[part] += float(np.sum((a - b)[inside, columns] ** 2))
                    whole[part] += float(np.sum(a[inside, columns] ** 2))
                outside += float(np.sum(((a - b) * weight)[~inside] ** 2))
                outside += float(np.sum(np.abs(more - less) * weight**2))
            allowed = self._model_differs() ** 2 * whole
            some = np.stack([changed, allowed])[:, changed > 0.0]
            shares = np.divide(*some, out=np.full(some.shape[1], np.inf), where=some[1] > 0.0)
            out[k] = math.sqrt(max(*shares, outside / float(chi2.isf(ALLOWED, 1)), 0.0))
        return out

    def _moments_of(self, effects: Effects, shown: Sequence[Array]) -> list[tuple[Array, Any]]:
        """Of each member the mean prediction under effects, and its variance (N, C), or 0."""
        found = [self._moments(i, x, effects) for i, x in zip(self.members, shown, strict=True)]
        return [(mean, 0.0 if spread is None else spread) for mean, spread in found]

    def common_errors(self, of: Hypothesis) -> list[list[Array]]:
        """What a facility's integration makes of every run alike: a part of a row in time, and a
        share of a force. What the facility has computed itself is known to its steps, but for the
        delay of the filter through which readings went to the record.
        """
        logged, computed = self.link.logged, not isinstance(self.link, (WrenchLink, PlatformLink))
        if computed and logged is None:
            return []
        shown = self.link.predict([(i, self.effects(of)) for i in self.members])
        late = math.hypot(0.0 if computed else TIME_ERROR, logged.delay_error if logged else 0.0)
        errors_of = [[late * np.gradient(s, axis=0) for s in shown]]
        if isinstance(self.link, WrenchLink):
            errors_of.append([0.5 * self._model_differs() * s for s in shown])
        out = []
        for errors in errors_of:
            pairs = zip(self.members, errors, strict=True)
            z = [self._whitened(i, e, self._noise(i)) for i, e in pairs]
            rows = zip(self.groups, self.rows, strict=True)
            out.append([z[n][at, c] for (n, c, _), at in rows])
        return out

    def _model_differs(self) -> float:
        """Share of the whole force by which a facility's integration of the shortest contact may
        differ from this one: of first order in the step, which may be a whole row.
        """
        edges = [np.flatnonzero(np.diff(np.r_[0, r.touching, 0])) for r in self.link.runs]
        lengths = np.concatenate([e[1::2] - e[::2] for e in edges])
        return MOST_MODEL_ERROR * max(1.0, MODEL_STEPS / max(1, lengths.min(initial=MODEL_STEPS)))

    def log_evidence(self, found: PosteriorFit) -> float:
        """Log of the evidence of a fit, with the deviations of the noise and the price of its
        numbers, so that models with different noise can be compared.
        """
        total = 0.0
        for i, taken in zip(self.members, self._taken, strict=True):
            w = self.link.weights(i)
            total += float(np.sum(np.log((self.weight[i] if w is None else w).ravel()[taken])))
        own, known = self._colour, self.link.colour()  # of which the latter is no estimate
        each = len(self.link.channels) * (0 if known is None else len(known) - 1)
        filters = 0 if own is None else sum(np.size(f[:, 1:]) - each for f in own)
        numbers = filters + self.link.noise_numbers
        price = 0.5 * numbers * math.log(max(sum(map(len, self.rows)), 1))
        return found.evidence + total - price

    def measured(self) -> list[Array]:
        return [
            self.link.runs[self.members[n]].measured[rows, c]
            for (n, c, _), rows in zip(self.groups, self.rows, strict=True)
        ]


def _jitter(effects: Sequence[Effect]) -> float:
    """[s] standard deviation of the delay under ``effects``."""
    return math.sqrt(sum(e.sigma**2 for e in effects if isinstance(e, SensorJitter)))


def _without_outliers(left: RunResiduals) -> RunResiduals:
    """Residuals clipped at :data:`CLIPPED` robust standard deviations of their group."""
    if not len(left.starts):
        return left
    sizes = np.abs(left.samples)
    worst = np.maximum.reduceat(sizes, left.starts)
    for g in np.flatnonzero(worst > CLIPPED * np.sqrt(left.squares())):
        own = slice(left.starts[g], left.starts[g] + left.rows[g])
        size = CLIPPED * max(MAD_TO_SIGMA * float(np.median(sizes[own])), 1.0)
        np.clip(left.samples[own], -size, size, out=left.samples[own])
    return left


def _without_ends(counted: np.ndarray) -> np.ndarray:
    """Without the first and last rows, for which a channel that is stamped off has no data."""
    out = counted.copy()
    out[:UNUSED_END_ROWS] = out[len(out) - UNUSED_END_ROWS :] = False
    return out


def _model_terms(run: LinkRun, shown: Array) -> Array:
    """(N, C, D) how a model of the same physics may err along a contact: in proportion to the
    reading ``shown`` (N, C) without its noise, by a share that varies slowly, and in time.
    """
    at = np.flatnonzero(run.touching)
    if not len(at):
        return np.zeros((*run.measured.shape, 0))
    places = np.clip(2.0 * (np.arange(run.rows) - at[0]) / max(at[-1] - at[0], 1) - 1.0, -1.0, 1.0)
    slow = MODEL_ERROR * legendre.legvander(places, SLOW_SHAPES)
    terms = shown[:, :, None] * slow[:, None, :]
    late = TIME_ERROR * np.gradient(shown, axis=0)
    return np.concatenate([terms, late[:, :, None]], axis=2)


def open_timings(link: ModelLink, sigma: float = SHIFT_SIGMA) -> tuple[Nuisance, ...]:
    """When the facility of a link samples, obeys, stamps and steps, as nuisances; ``sigma`` [rows]
    of the shift between its output and its input.
    """
    tick = link.tick

    def rows(
        name: str, sigma: float, ends: tuple[float, float], starts: Sequence[float]
    ) -> Nuisance:
        least, most = (x * tick for x in ends)
        return Nuisance(name, "s", sigma * tick, most, least, tuple(x * tick for x in starts))

    # through the others noise passes, so that it matters whether the output or the input is late
    names = ("delay",) if link.name in ("wrench", "platform") else ("delay", "before")
    if sigma <= TIME_ERROR:  # clocks as exact as an integration in steps
        names = ()
    each = sigma / math.sqrt(max(len(names), 1))
    out = [rows(name, each, (-REACH * each, REACH * each), STAMP_STARTS) for name in names]
    if link.name == "platform":
        out.append(rows("obeyed", INSTANT_SIGMA, (0.0, LATEST_INSTANT), (0.25,)))
    if link.name == "dynamics":
        out.append(Nuisance("old", "-", EVEN_SIGMA, MOST_OLD, 0.0, (0.25, 0.75)))
    return tuple(out)
