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
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit, independent
from hiltestbed.inference.model import Hypothesis
from hiltestbed.inference.search import MOST_CAUSES, Progress, Searched, extended, search
from hiltestbed.sensor.effects import SensorHum

ROUNDS = 2 * MOST_CAUSES  # of a search: a cause is added, or the interpretation changes
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
        """The hypothesis."""
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
        """The causes as effects."""
        return effects_of(self.fit)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(e.kind for e in self.effects())

    def timing(self) -> Timing:
        """The timing of the facility."""
        return self.link.timing_with(self.fit.of.each())

    def residual(self) -> Residual:
        """The residual of the link with its timing as found, in units of the noise alone."""
        return Residual(self.link.with_timing(self.timing()), self.model.members)

    def leftovers(self) -> dict[str, Whiteness]:
        """Channel to what the causes leave of it, in contact or outside it, whichever is worse."""
        out: dict[str, Whiteness] = {}
        for (c, _), left in self.model.leftovers(self.fit.left).items():
            name = self.link.channels[c]
            if name not in out or left.excess > out[name].excess:
                out[name] = left
        return out

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


def effects_of(fit: PosteriorFit) -> list[Effect]:
    """The causes of a fit as effects, without its nuisances."""
    return [e for e in fit.of.each() if not isinstance(e, Timing)]


def explain(
    model: LinkModel, candidates: Sequence[Candidate], progress: Progress | None = None
) -> Explanation:
    """The explanation of a link.

    Causes are added one at a time, each under the interpretation of the facility that suits the
    others; several at once, or others in their place, where that ends with more than noise.
    """
    nothing = Hypothesis((), np.zeros(0), np.zeros(0))
    model = model.under(())
    rich = tuple(c for c in candidates if c.effect.rich)
    candidates = tuple(c for c in candidates if not c.effect.rich)
    counts = independent(model.residuals(nothing), noise_known=True)
    likelihood = Likelihood(model, counts)
    base, visited = likelihood.start(), ()
    if isinstance(model.link, WrenchLink) and not model.leaves_noise(base.left):
        candidates = (*candidates, *hums(model, base.left))
    one, thorough, asked = True, False, False
    for _ in range(ROUNDS):
        everything = (*candidates, *model.timings())
        found = search(likelihood, everything, progress, base, visited, one)
        best, noise = found.best, model.leaves_noise(found.best.left)
        there, more, grown, noisier = model, (), best.keys != base.keys, False
        if grown or not best.causes:
            there = interpreted(model.under(best.of.each()), best)
        base, visited = best, found.visited
        enough = len(effects_of(best)) > MOST_NAMED and not noise
        if (not grown and there.link is model.link) or enough:
            there, base = with_other_noise(model, found, counts)
            noisier = there is not model
            if not noise:
                more = hums(model, best.left) if isinstance(model.link, WrenchLink) else ()
                more, rich = (*more, *rich), ()
                more = tuple(c for c in more if c.key not in {o.key for o in candidates})
            if there is model and not more:
                if not asked and (not noise or len(effects_of(best)) > FEW):
                    # with a wrong interpretation causes add up to what one is with the right one
                    asked, there = True, interpreted_with_one_cause(found, everything)
                    base = base if there is model else found.null
                if there is model:
                    if noise or thorough or enough:
                        break
                    one, thorough = False, True
                    continue
        one, candidates = True, (*candidates, *more)
        if there is not model:
            model, visited = there, ()
            likelihood = Likelihood(model, counts) if noisier else likelihood.through(model)
            base = likelihood.fit(base.causes, [base.of.theta])
    assert isinstance(found.likelihood.model, LinkModel)
    model = found.likelihood.model
    concluded = conclude(found, model.folds(), everything, progress)
    left = concluded.fit.left
    return Explanation(
        model, tuple(candidates), concluded, model.leaves_noise(left), model.excess(left)
    )


def interpreted_with_one_cause(found: Searched, candidates: Sequence[Candidate]) -> LinkModel:
    """The model with the interpretation of the facility under which one cause has most evidence."""
    here = found.likelihood
    model = here.model
    assert isinstance(model, LinkModel)
    if not isinstance(model.link, WrenchLink):
        return model
    best, reached = model, -math.inf
    others = (link for group in model.link.interpretations() for link in group)
    for link in (model.link, *others):
        likelihood = here
        if link is not model.link:
            likelihood = here.through(model.through(link))
        fits = extended(likelihood, likelihood.start(), candidates)
        evidence = max((f.evidence for f in fits), default=-math.inf)
        if evidence > reached:
            best, reached = likelihood.model, evidence
            reached += READ_OTHERWISE if best is model else 0.0
    assert isinstance(best, LinkModel)
    return best


def with_other_noise(
    model: LinkModel, found: Searched, counts: Array
) -> tuple[LinkModel, PosteriorFit]:
    """The model with noise of the log as well, and the hypothesis to go on from: what the best one
    leaves may be such noise, or all of what it explains; both themselves where neither is so.
    """
    best = found.best
    if not model.leaves_noise(best.left):
        return with_noise_of_the_log(model, best), best
    if best.causes and model.link.name == "dynamics":
        noisy = with_noise_of_the_log(model, found.null)
        alone = Likelihood(noisy, counts).start()
        if noisy is not model and noisy.deviance(alone) < model.deviance(best):
            return noisy, found.null
    return model, best


def with_noise_of_the_log(model: LinkModel, best: PosteriorFit) -> LinkModel:
    """The model with the noise that a hypothesis leaves; itself where what is left is no noise."""
    if isinstance(model.link, WrenchLink) or model.link.computed:
        return model
    shown = model.link.predict([(i, best.of.each()) for i in model.members])
    left = [(i, model.link.runs[i].measured - p) for i, p in zip(model.members, shown, strict=True)]
    noisier = model.link.noisier(left)
    other = model.coloured(best.left) if noisier is model.link else model.through(noisier)
    return other if other.leaves_noise(other.residuals(best.of)) else model


def interpreted(model: LinkModel, found: PosteriorFit) -> LinkModel:
    """The model with the interpretation of the facility that suits a hypothesis best."""
    if not isinstance(model.link, WrenchLink):
        return model
    for others in model.link.interpretations():
        models = [model, *(model.through(link) for link in others)]
        fits = [
            Likelihood(m, independent(m.residuals(found.of), True)).fit(
                found.causes, [found.of.theta]
            )
            for m in models
        ]
        costs = [f.cost for f in fits]
        best = int(np.argmin(costs))
        if costs[best] < costs[0] - 2.0 * READ_OTHERWISE:
            model, found = models[best], fits[best]
    return model


def hums(model: LinkModel, left: Sequence[Array]) -> tuple[Candidate, ...]:
    """Tones of one phase in all runs in what is left of the forces."""
    link, rows = model.link, max(r.rows for r in model.link.runs)
    size = max(MIN_SPECTRUM_ROWS, 1 << (rows - 1).bit_length())
    total, count, level = np.zeros((3, size // 2 + 1), complex), np.zeros(3), np.zeros(3)
    for (n, c, inside), at, z in zip(model.groups, model.rows, left, strict=False):
        if c > 2 or (inside and not link.runs[model.members[n]].touching.all()):
            continue
        sigma = link.runs[model.members[n]].sigma[at, c]
        x = np.zeros(size)
        x[at] = z * sigma - np.mean(z * sigma)
        total[c] += np.fft.rfft(x)
        count[c] += len(at)
        level[c] = max(level[c], float(np.median(sigma)))
    frequencies = np.fft.rfftfreq(size, link.tick)
    total[:, frequencies < MIN_FREQUENCY] = 0.0
    found = strongest_lines(total, frequencies, count, level)
    return tuple(SensorHum.near(axis, *line) for axis, line in found.items())


def strongest_lines(
    spectra: np.ndarray, frequencies: np.ndarray, counts: np.ndarray, levels: Array
) -> dict[str, tuple[float, float, float]]:
    """Axis to frequency [Hz], amplitude [N] and phase [rad] of the strongest line of its spectrum
    (3, F) of so many samples, if it exceeds white noise of the ``levels`` (3,) [N].
    """
    out = {}
    for axis, spectrum, count, level in zip("xyz", spectra, counts, levels, strict=True):
        at = int(np.argmax(np.abs(spectrum)))
        line = spectrum[at]
        if count and abs(line) ** 2 > MIN_LINE_POWER * count * level**2:
            phase = float(np.angle(line) + math.pi / 2.0)
            out[axis] = (float(frequencies[at]), 2.0 * abs(line) / count, phase)
    return out
