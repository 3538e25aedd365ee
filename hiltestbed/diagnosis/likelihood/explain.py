"""The explanation of one link: the causes with the most evidence, as far as they carry over to runs
that were not fitted, and whether they leave only noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.jitter_and_hum import MIN_FREQUENCY, MIN_SPECTRUM_ROWS, strongest_lines
from hiltestbed.diagnosis.likelihood.model import LinkModel
from hiltestbed.diagnosis.links import ModelLink, Timing, WrenchLink
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.diagnosis.search import Progress
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import SearchConclusion, conclude
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit, independent
from hiltestbed.inference.model import Hypothesis
from hiltestbed.inference.search import search
from hiltestbed.sensor.effects import SensorHum

ROUNDS = 4  # explanations of a link, each under the interpretation that suits the last
# half of chi-square by which another interpretation of a facility has to be better: odds of 1000
READ_OTHERWISE = math.log(1000.0)


@dataclass(frozen=True, eq=False)
class Explained:
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
    def departs(self) -> bool:
        """Whether the nominal link does not explain the record."""
        return bool(self.conclusion.causes) or not self.adequate

    def effects(self) -> list[Effect]:
        """The causes as effects."""
        return [e for e in self.fit.of.each() if not isinstance(e, Timing)]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(e.kind for e in self.effects())

    def timing(self) -> Timing:
        """The timing of the facility."""
        out = NO_SHIFT
        for effect in self.fit.of.each():
            out = out.plus(effect) if isinstance(effect, Timing) else out
        return out


def explain(
    model: LinkModel, candidates: Sequence[Candidate], progress: Progress | None = None
) -> Explained:
    """The explanation of a link."""
    nothing = Hypothesis((), np.zeros(0), np.zeros(0))
    model = model.under(())
    base = None
    rich = tuple(c for c in candidates if c.effect.rich)
    candidates = tuple(c for c in candidates if not c.effect.rich)
    if isinstance(model.link, WrenchLink) and not model.leaves_noise(model.residuals(nothing)):
        candidates = (*candidates, *hums(model, model.residuals(nothing)))
    for _ in range(ROUNDS):
        counts = independent(model.residuals(nothing), noise_known=True)
        everything = (*candidates, *model.timings())
        likelihood = Likelihood(model, counts)
        start = base and likelihood.fit(base.causes, [base.of.theta])
        found = search(likelihood, everything, progress, start)
        best = found.best
        if base is not None and best.keys == base.keys:
            break
        base = best
        more: tuple[Candidate, ...] = ()
        if isinstance(model.link, WrenchLink):
            more = () if model.leaves_noise(best.left) else hums(model, best.left)
            candidates = (*candidates, *more)
        if rich and not model.leaves_noise(best.left):
            candidates, more, rich = (*candidates, *rich), (*more, *rich), ()
        there = interpreted(model.under(best.of.each()), best)
        if not model.leaves_noise(best.left):
            there = with_noise_of_the_log(there, best)
        elif best.causes and model.link.name == "dynamics":
            noisy = with_noise_of_the_log(model, found.null)
            alone = Likelihood(noisy, counts).start()
            if noisy is not model and noisy.deviance(alone) < model.deviance(best):
                there, base = noisy, found.null
        if there is model and not more:
            break
        model = there
    concluded = conclude(found, model.folds(), everything, progress)
    left = concluded.fit.left
    return Explained(
        model, tuple(candidates), concluded, model.leaves_noise(left), model.excess(left)
    )


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
