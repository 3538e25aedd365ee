"""The explanation of one link: the causes with the most evidence, as far as they carry over to runs
that were not fitted, and whether they leave only noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.link_model import LinkModel, Whiteness
from hiltestbed.diagnosis.links import ModelLink, Timing, WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import Confirmed, SearchConclusion, conclude
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit
from hiltestbed.inference.model import Hypothesis, places
from hiltestbed.inference.search import MOST_CAUSES, Progress, Searched, extended, search
from hiltestbed.sensor.effects import SensorHum

ROUNDS = 2 * MOST_CAUSES  # of an explanation: each adds a cause, or changes what may explain
FEW = 2  # causes of one link that are often right together
# with which a link is explained, where they leave noise alone; more, with more than noise left, are
# what something without a name looks like
MOST_NAMED = 3
# half of chi-square by which another interpretation of a facility has to be better: odds of 1000
READ_OTHERWISE = math.log(1000.0)


# power of a line over that of the noise, from which it is tried as a hum: 1e-13 of exponential
# noise a frequency
MIN_LINE_POWER = 30.0
MIN_SPECTRUM_ROWS = 1 << 15  # length of the transform: lines are told apart to 0.06 Hz at 2 kHz
MIN_FREQUENCY = 0.7  # [Hz] of a line; slower ones are drifts over a run of some seconds


@dataclass(frozen=True, eq=False)
class Explanation:
    """The explanation of a link.

    Attributes:
        model: as it was judged. candidates: the hypotheses. conclusion: the causes, with nuisances.
        adequate: whether the causes leave noise alone. excess: what is left over what noise leaves,
            1 or less where it is adequate.
    """

    model: LinkModel
    candidates: tuple[Candidate, ...]
    conclusion: SearchConclusion
    adequate: bool
    excess: float

    @property
    def link(self) -> ModelLink:
        """The link, as the facility computes it."""
        return self.model.link

    @property
    def fit(self) -> PosteriorFit:
        return self.conclusion.fit

    @property
    def causes(self) -> tuple[Confirmed, ...]:
        """The causes, those that explain most first."""
        return self.conclusion.causes

    @property
    def departs(self) -> bool:
        """Whether the nominal link does not explain the record."""
        return bool(self.causes) or not self.adequate

    def effects(self) -> list[Effect]:
        return effects_of(self.fit)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(e.kind for e in self.effects())

    def timing(self) -> Timing:
        return self.link.timing_with([self.model.timing(self.fit.of)])

    def stamp_error(self) -> float:
        """[rows] standard deviation of the shift between output and input, of the posterior."""
        likelihood, fit = self.likelihood, self.fit
        names = [n.name for n in likelihood.model.nuisances]
        if not names:
            return 0.0
        shifts = np.array([0.0] * len(fit.of.theta) + [float(n != "old") for n in names])
        return float(np.linalg.norm(shifts @ self._deviations())) / self.link.tick

    def _deviations(self) -> Array:
        """(P, P) of the numbers of the fit, by columns: independent changes of one standard
        deviation of the posterior each.
        """
        likelihood, fit = self.likelihood, self.fit
        x = np.concatenate([fit.of.theta, fit.of.nuisances])
        normal, _ = likelihood.normal(fit.left, likelihood.slopes(fit.causes, x, fit.left))
        variance, ways = np.linalg.eigh(np.linalg.pinv(normal, hermitian=True))
        scale = likelihood.scale_of(fit.causes, x)
        return np.asarray(scale[:, None] * ways * np.sqrt(np.maximum(variance, 0.0)))

    def alternatives(self) -> list[list[Effect]]:
        """The effects and the timing of the fit, changed by one standard deviation of the posterior
        in each independent way.
        """
        of, count = self.fit.of, len(self.fit.of.theta)
        x = np.concatenate([of.theta, of.nuisances])
        low, high, _ = self.likelihood.bounds(of.causes)
        points = np.clip(x + self._deviations().T, low, high)
        each = [Hypothesis(of.causes, point[:count], point[count:]) for point in points]
        return [[*other.each(), self.model.timing(other)] for other in each]

    def residual(self) -> Residual:
        """The residual of the link in units of the noise alone, with its timing as found; as
        believed where nothing explains it, since a shift then stands in for what has no name.
        """
        timing = self.timing() if self.adequate or self.causes else self.link.timing
        return Residual(self.link.with_timing(timing), self.model.members)

    def timed(self) -> LinkModel:
        """The model with its timing as found."""
        return self.model.through(self.link.with_timing(self.timing()))

    def leftovers(self) -> dict[str, Whiteness]:
        """Channel to what the causes leave of it, in contact or outside it, whichever is worse."""
        out: dict[str, Whiteness] = {}
        for (c, _), left in self.model.leftovers(self.fit.left).items():
            name = self.link.channels[c]
            if name not in out or left.excess > out[name].excess:
                out[name] = left
        return out

    def ranked(self) -> list[PosteriorFit]:
        """The fits with causes that were compared, that of this explanation first and then those of
        the most evidence, each set of effects once.
        """
        out: dict[tuple[str, ...], PosteriorFit] = {}
        fits = sorted(self.conclusion.visited, key=lambda f: -f.evidence)
        for f in [self.fit, *(f for f in fits if np.isfinite(f.evidence))]:
            if kinds := tuple(sorted(e.kind for e in effects_of(f))):
                out.setdefault(kinds, f)
        return list(out.values())

    def singles(self) -> list[PosteriorFit]:
        """The fits of one cause, those of the most evidence first, each effect once."""
        out: dict[str, PosteriorFit] = {}
        for f in self.conclusion.visited:
            if len(effects := effects_of(f)) == 1 and math.isfinite(f.evidence):
                out.setdefault(effects[0].kind, f)
        return list(out.values())

    @property
    def likelihood(self) -> Likelihood:
        """By which the hypothesis was chosen."""
        return self.conclusion.likelihood

    def alone(self, n: int, found: PosteriorFit) -> tuple[LinkModel, PosteriorFit]:
        """The model of the member n alone, and the causes of ``found`` fitted to it."""
        model = self.model.on([n])
        fitted = model.likelihood().fit(found.causes, [found.of.theta], found.of.nuisances)
        return model, fitted


@dataclass(frozen=True, eq=False)
class OpenPair:
    """Two hypotheses of a link between which its record does not decide."""

    explanation: Explanation
    fits: tuple[PosteriorFit, PosteriorFit]

    @property
    def kinds(self) -> tuple[str, ...]:
        """The effects that only one of the two has, or has on this place."""
        return tuple(c.kind for own in self._alone() for c in own)

    @property
    def names(self) -> tuple[str, str]:
        """What the first has in place of the second, and the reverse, in words: the same effect on
        another body or axis with that.
        """
        first, second = self._alone()
        both = {c.kind for c in first} & {c.kind for c in second}

        def word(c: Candidate) -> str:
            return f"{c.kind} [{', '.join(c.place)}]" if c.kind in both else c.kind

        a, b = (" and ".join(map(word, own)) or "nothing" for own in (first, second))
        return a, b

    def _alone(self) -> tuple[list[Candidate], list[Candidate]]:
        a, b = ({(c.kind, c.place): c for c in f.causes} for f in self.fits)
        return [c for k, c in a.items() if k not in b], [c for k, c in b.items() if k not in a]


def effects_of(fit: PosteriorFit) -> list[Effect]:
    """The causes of a fit as effects."""
    return fit.of.each()


def explain(
    model: LinkModel,
    candidates: Sequence[Candidate],
    progress: Progress | None = None,
    beside: Explanation | None = None,
) -> Explanation:
    """The explanation of a link.

    Causes are added one at a time, each under the interpretation of the facility that suits the
    others. Where that ends, other ways are tried in turn, and after each that leads on it goes on.
    beside: the explanation of another link, whose causes are tried first where they are hypotheses
    of this one, too.
    """
    so_far = _SoFar(model, candidates, progress)
    if beside is not None:
        so_far.causes_of(beside)
    ways = (
        so_far.noise_instead,
        so_far.another_cause,
        so_far.another_interpretation,
        so_far.another_noise,
        so_far.other_candidates,
        so_far.one_cause_alone,
        so_far.several_causes,
    )
    for _ in range(ROUNDS):
        if not any(way() for way in ways):
            break
    model, found = so_far.model, so_far.found
    concluded = conclude(found, model.folds(), so_far.candidates, progress)
    left = concluded.fit.left
    return Explanation(
        model, so_far.candidates, concluded, model.leaves_noise(left), model.excess(left)
    )


class _SoFar:
    """The explanation of a link as far as it has come, and the ways to go on, each of which tells
    whether it has led anywhere.

    Attributes:
        model: as the link is judged. candidates: the hypotheses. found: the last search.
    """

    def __init__(
        self, model: LinkModel, candidates: Sequence[Candidate], progress: Progress | None
    ) -> None:
        self.model, self._progress = model.under(()), progress
        self.candidates = tuple(c for c in candidates if not c.effect.rich)
        self._kept = tuple(c for c in candidates if c.effect.rich)  # for want of simpler ones
        self._likelihood = self.model.likelihood()
        nothing = self._likelihood.start().left
        if not self.model.leaves_noise(nothing):
            self.candidates = (*self.candidates, *hums(self.model, nothing))
        self._alone_asked = self._several_asked = False
        self._new = True  # whether what may explain has changed since causes were too many
        self.found = self._searched(self._likelihood.start(), (), 0)

    @property
    def _noise(self) -> bool:
        return self.model.leaves_noise(self.found.best.left)

    @property
    def _count(self) -> int:
        return len(effects_of(self.found.best))

    def _searched(
        self, start: PosteriorFit, before: Sequence[PosteriorFit], more: int | None
    ) -> Searched:
        return search(self._likelihood, self.candidates, self._progress, start, before, more)

    def _through(self, model: LinkModel, likelihood: Likelihood, start: PosteriorFit) -> bool:
        """Go on with another model, from a fit by its ``likelihood``."""
        self.model, self._likelihood, self._new = model, likelihood, True
        self.found = self._searched(start, (), 0)
        return True

    def _grown(self, found: Searched) -> bool:
        """Whether a search has led to another hypothesis: then it is taken, with the interpretation
        that suits it, unless what it leaves open of the prediction makes the record less likely.
        """
        if found.best.keys == self.found.best.keys:
            self.found = found
            return False
        there = interpreted(self.model.under(self.model.effects(found.best.of)), found.best)
        if there is self.model:
            self.found = found
            return True
        same = there.link is self.model.link
        known = self._likelihood.through(there) if same else there.likelihood()
        known = known.choosing(found.likelihood.choices)
        fit = known.fit(found.best.causes, [found.best.of.theta], found.best.of.nuisances)
        if there.log_evidence(fit) <= self.model.log_evidence(self.found.best):
            return False
        self._through(there, known, fit)
        self._new = False
        return True

    def causes_of(self, other: Explanation) -> None:
        """Go on from the causes that another link shares with this one, if they explain more than
        nothing.
        """
        keys = {c.key for c in self.candidates}
        pairs = zip(other.fit.causes, places(other.fit.causes), strict=True)
        shared = [(c, other.fit.of.theta[own]) for c, own in pairs if c.key in keys]
        if shared:
            causes, values = zip(*shared, strict=True)
            base = self._likelihood.fit(causes, [np.concatenate(values)])
            if base.evidence > self.found.best.evidence:
                self._grown(self._searched(base, self.found.visited, 0))

    def another_cause(self) -> bool:
        """One more, unless many leave more than noise already."""
        if self._count > MOST_NAMED and not self._noise and not self._new:
            return False
        self._new = False
        return self._grown(self._searched(self.found.best, self.found.visited, 1))

    def another_interpretation(self) -> bool:
        """Where no cause helps."""
        if self.found.best.causes or self._noise:
            return False
        there = interpreted(self.model, self.found.best)
        if there is self.model:
            return False
        likelihood = there.likelihood()
        return self._through(there, likelihood, likelihood.start())

    def noise_instead(self) -> bool:
        """Noise of the log in place of causes that smooth it."""
        return bool(self.found.best.causes) and self.another_noise()

    def another_noise(self) -> bool:
        """Noise of the log."""
        there, fit = with_other_noise(self.model, self.found)
        return there is not self.model and self._through(there, there.likelihood(), fit)

    def other_candidates(self) -> bool:
        """Those with many numbers, and tones in what is left."""
        if self._noise:
            return False
        have = {c.key for c in self.candidates}
        lines = hums(self.model, self.found.best.left)
        more, self._kept = [c for c in (*lines, *self._kept) if c.key not in have], ()
        self.candidates, self._new = (*self.candidates, *more), bool(more)
        return bool(more)

    def one_cause_alone(self) -> bool:
        """One cause under any interpretation: with a wrong one, causes add up to what one is with
        the right one.
        """
        if self._alone_asked or (self._noise and self._count <= FEW):
            return False
        self._alone_asked = True
        there, alone = with_one_cause(self.found, self.candidates)
        same = there is self.model
        if same and alone.evidence <= self.found.best.evidence:
            return False
        return self._through(there, self._likelihood if same else there.likelihood(), alone)

    def several_causes(self) -> bool:
        """Several at once, or others in their place, where few leave more than noise."""
        if self._several_asked or self._noise or self._count > MOST_NAMED:
            return False
        self._several_asked = True
        return self._grown(self._searched(self.found.best, self.found.visited, None))


def with_one_cause(
    found: Searched, candidates: Sequence[Candidate]
) -> tuple[LinkModel, PosteriorFit]:
    """The cause that has most evidence alone, under any interpretation of the facility, and the
    model with that interpretation; under the present one where others are hardly better.
    """
    here = found.likelihood
    assert isinstance(here.model, LinkModel)
    model, best, least = here.model, found.null, -math.inf
    link = model.link
    groups = link.interpretations() if isinstance(link, WrenchLink) else []
    for other in (link, *(x for group in groups for x in group)):
        likelihood = here
        if other is not link:
            likelihood = here.model.through(other).likelihood(here.choices)
        for fit in extended(likelihood, likelihood.start(), candidates)[:1]:
            if fit.evidence > least:
                assert isinstance(likelihood.model, LinkModel)
                model, best = likelihood.model, fit
                least = fit.evidence + (READ_OTHERWISE if other is link else 0.0)
    return model, best


def with_other_noise(model: LinkModel, found: Searched) -> tuple[LinkModel, PosteriorFit]:
    """The model with noise of the log, and the hypothesis to go on from: of what leaves noise
    alone, that with the most evidence, the noise of the log being what the best hypothesis leaves,
    or what nothing does; both themselves where none does.
    """
    best = found.best
    ways = [(model, best)] if model.leaves_noise(best.left) else []
    for base in (found.null, best) if best.causes else (best,):
        for noisy in with_noise_of_the_log(model, base):
            likelihood = noisy.likelihood(found.likelihood.choices)
            ways.append((noisy, likelihood.fit(base.causes, [base.of.theta])))
    return max(ways, key=lambda way: way[0].log_evidence(way[1]), default=(model, best))


def with_noise_of_the_log(model: LinkModel, base: PosteriorFit) -> list[LinkModel]:
    """The models with the noise that a hypothesis leaves, of the output and of the input; none
    where what is left is no noise.
    """
    if isinstance(model.link, WrenchLink):  # free flight has shown the noise of the force
        return []
    shown = model.link.predict([(i, model.effects(base.of)) for i in model.members])
    left = [(i, model.link.runs[i].measured - p) for i, p in zip(model.members, shown, strict=True)]
    noisier, out = model.link.noisier(left), [model.coloured(base.left)]
    if noisier is not model.link:
        out.append(model.through(noisier))
    return [m for m in out if m.leaves_noise(m.residuals(base.of))]


def interpreted(model: LinkModel, found: PosteriorFit) -> LinkModel:
    """The model with the interpretation of the facility that suits a hypothesis best."""
    if not isinstance(model.link, WrenchLink):
        return model
    for others in model.link.interpretations(found.of.each()):
        models = [model, *(model.through(link) for link in others)]
        fits = [
            m.likelihood().fit(found.causes, [found.of.theta], found.of.nuisances) for m in models
        ]
        costs = [f.cost for f in fits]
        best = int(np.argmin(costs))
        if costs[best] < costs[0] - 2.0 * READ_OTHERWISE:
            model, found = models[best], fits[best]
    return model


def hums(model: LinkModel, left: Sequence[Array]) -> tuple[Candidate, ...]:
    """Tones of one phase in all runs in what is left of the forces: the strongest line of each axis
    that exceeds white noise.
    """
    if not isinstance(model.link, WrenchLink):
        return ()
    runs, rows = model.link.runs, max(r.rows for r in model.link.runs)
    size = max(MIN_SPECTRUM_ROWS, 1 << (rows - 1).bit_length())
    total, count, level = np.zeros((3, size // 2 + 1), complex), np.zeros(3), np.zeros(3)
    for (n, c, inside), at, z in zip(model.groups, model.rows, left, strict=False):
        run = runs[model.members[n]]
        if c > 2 or (inside and not run.touching.all()):
            continue
        sigma = run.sigma[at, c]
        x = np.zeros(size)
        x[at] = z * sigma - np.mean(z * sigma)
        total[c] += np.fft.rfft(x)
        count[c] += len(at)
        level[c] = max(level[c], float(np.median(sigma)))
    frequencies = np.fft.rfftfreq(size, model.link.tick)
    total[:, frequencies < MIN_FREQUENCY] = 0.0
    out = []
    for axis, spectrum, rows, sigma in zip("xyz", total, count, level, strict=True):
        at = int(np.argmax(np.abs(spectrum)))
        line = spectrum[at]
        if rows and abs(line) ** 2 > MIN_LINE_POWER * rows * sigma**2:
            phase = float(np.angle(line) + math.pi / 2.0)
            amplitude = 2.0 * abs(line) / rows
            out.append(SensorHum.near(axis, float(frequencies[at]), amplitude, phase))
    return tuple(out)
