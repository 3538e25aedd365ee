"""What a model has to offer so that its departures can be sought: predictions under a list of
effects, and numbers that nobody asked for.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.effects.departure import Departure
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.residuals import RunResiduals

FEWEST = 3  # runs of which each can be left out: two others still tell what differs between runs


@dataclass(frozen=True)
class Nuisance:
    """A number that is not known and not asked for, such as a time-stamp offset: 0 as believed,
    with a Gaussian prior of standard deviation ``sigma`` in ``unit``, that ends at ``most`` and at
    ``least``, by default minus that. starts: where else than at 0 a descent may begin.
    """

    name: str
    unit: str
    sigma: float
    most: float
    least: float | None = None
    starts: tuple[float, ...] = ()


def places(causes: Sequence[Candidate]) -> list[slice]:
    """Where the parameters of each cause stand among those of all."""
    ends = itertools.accumulate((len(c.names) for c in causes), initial=0)
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


class Hypothesis(NamedTuple):
    """Causes with their parameters, concatenated, and the values of the nuisances."""

    causes: tuple[Candidate, ...]
    theta: Array
    nuisances: Array

    def each(self) -> list[Any]:
        """Each cause as an effect."""
        pairs = zip(self.causes, places(self.causes), strict=True)
        return [c.at(self.theta[own]) for c, own in pairs]

    def effects(self) -> list[Departure]:
        """The causes as effects: parts of one effect, such as the viscous and the dry friction of
        one force, are one.
        """
        made: dict[tuple, dict[str, float]] = {}
        kinds: dict[tuple, Candidate] = {}
        for number, (cause, own) in enumerate(zip(self.causes, places(self.causes), strict=True)):
            alone = cause.effect.repeats and not cause.needs
            key = (cause.kind, *sorted(cause.fixed.items()), number if alone else -1)
            kinds.setdefault(key, cause)
            values = zip(cause.names, self.theta[own], strict=True)
            made.setdefault(key, {**cause.fixed}).update({n: float(v) for n, v in values})
        return [kinds[key].effect.hypothesis({}, **values) for key, values in made.items()]


class Model(ABC):
    """A model of some runs.

    Attributes:
        runs: their names. floors: (R,) noise of each run's output, below which a residual means
            nothing. nuisances: their priors. noise_known: whether the floors are those of the noise
            and the residual is white where nothing departs, so that the evidence can be trusted by
            itself.
    """

    runs: tuple[str, ...]
    floors: Array
    nuisances: tuple[Nuisance, ...]
    stretches: int = 16  # of a run, of which every fourth is left out together
    noise_known: bool = False
    axes: int = 1

    @abstractmethod
    def residuals(self, of: Hypothesis) -> Sequence[Array]:
        """(N,) measured less predicted of each run, in the unit of the output; and last, in
        standard deviations of their priors, the nuisances and the zero that was taken off each run.
        """

    def many(self, of: Sequence[Hypothesis]) -> list[RunResiduals]:
        """:meth:`residuals` of several hypotheses."""
        return [RunResiduals.of(self.residuals(h)) for h in of]

    def scored(self, of: Hypothesis) -> Sequence[Array]:
        """(N,) residual of each run by which hypotheses are compared on runs that were not fitted:
        less no more of its zero than the prior allows.
        """
        return self.residuals(of)[:-1]

    def kept(self, x: Array) -> Array:
        """Of (N,) samples of a run those that the model has."""
        return x

    @abstractmethod
    def departure(self, of: Hypothesis) -> list[Array]:
        """(N,) measured less predicted of each run as its owner would compare them, where the
        likelihood compares something else.
        """

    def sample_weights(self) -> Array | float:
        """(M,) by which the residual of each sample is weighted; 1 where all are alike."""
        return 1.0

    def leaves_noise(self, left: Sequence[Array]) -> bool:
        """Whether residuals are known to be noise alone, so that no set of causes can explain more
        of them than chance does.
        """
        return False

    def contradicts(self, of: Hypothesis, left: RunResiduals) -> bool:
        """Whether what a hypothesis leaves contradicts it, whatever its likelihood."""
        return False

    def negligible(self, of: Hypothesis, index: int) -> bool:
        """Whether a cause changes the prediction by no more than models of the same physics differ:
        it is fitted, and not named.
        """
        return False

    def common_errors(self, of: Hypothesis) -> list[list[Array]]:
        """(N,) of each run, for each error that a model of the same physics may have in all runs
        alike: what a standard deviation of it adds to the residual.
        """
        return []

    def in_time(self) -> Model | None:
        """The same model whose residuals are its :meth:`departure`, on which the estimates of a
        hypothesis are settled; None where they are that already.
        """
        return None

    @abstractmethod
    def measured(self) -> list[Array]:
        """(N,) what the owner measured in each run."""

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of what was recorded at a time, and is left out as a whole."""
        return self.runs

    def folds(self) -> list[tuple[str, Model, Model]]:
        """What is left out, by name: the model of the rest, and of that. What was :attr:`recorded`,
        one after the other; of fewer than three, stretches of all.
        """
        names = self.recorded
        if len(names) < FEWEST:
            return self.stretch_folds()
        rest = [[j for j in range(len(names)) if j != i] for i in range(len(names))]
        return [(name, self.on(rest[i]), self.on([i])) for i, name in enumerate(names)]

    def stretch_folds(self) -> list[tuple[str, Model, Model]]:
        """The folds of few runs: stretches of all of them."""
        cut = Cut(self.stretches, FOLDS)
        return [
            (f"stretches {f + 1} of {FOLDS}", Part(self, cut, f, False), Part(self, cut, f, True))
            for f in range(FOLDS)
        ]

    def halves(self) -> list[tuple[Model, Model]]:
        """The model of one half of each run, and of the other, both ways."""
        return [(Part(self, HALVES, f, False), Part(self, HALVES, f, True)) for f in range(2)]

    @abstractmethod
    def on(self, runs: Sequence[int]) -> Model:
        """The same model of some of what was :attr:`recorded`."""

    def prior_sigma(self) -> Array:
        """(E,) of the nuisances."""
        return np.array([n.sigma for n in self.nuisances])


FOLDS = 4  # parts of a run that are left out in turn, each of stretches all over it


class Cut(NamedTuple):
    """Of every run: into how many stretches, which belong to so many folds in turn."""

    stretches: int
    folds: int


HALVES = Cut(2, 2)


class Part(Model):
    """The rows of a model that one fold of a cut leaves out, or all others: with several stretches
    a fold, each holds all that the runs do. The model still predicts whole runs.
    """

    def __init__(self, whole: Model, cut: Cut, fold: int, inside: bool) -> None:
        self.whole, self.cut, self.fold, self.inside = whole, cut, fold, inside
        self.runs, self.floors, self.nuisances = whole.runs, whole.floors, whole.nuisances
        self.stretches, self.axes = whole.stretches, whole.axes
        self.noise_known = whole.noise_known

    def kept(self, x: Array) -> Array:
        block = np.arange(len(x)) * self.cut.stretches // len(x)
        return x[(block % self.cut.folds == self.fold) == self.inside]

    def residuals(self, of: Hypothesis) -> list[Array]:
        *left, priors = self.whole.residuals(of)
        return [*map(self.kept, left), priors]

    def many(self, of: Sequence[Hypothesis]) -> list[RunResiduals]:
        parts = self.whole.many(of)
        return [RunResiduals.of([*map(self.kept, x[:-1]), x.priors]) for x in parts]

    def scored(self, of: Hypothesis) -> list[Array]:
        return [self.kept(x) for x in self.whole.scored(of)]

    def departure(self, of: Hypothesis) -> list[Array]:
        return [self.kept(x) for x in self.whole.departure(of)]

    def measured(self) -> list[Array]:
        return [self.kept(x) for x in self.whole.measured()]

    def in_time(self) -> Model | None:
        moved = self.whole.in_time()
        return None if moved is None else Part(moved, self.cut, self.fold, self.inside)

    def on(self, runs: Sequence[int]) -> Model:
        return Part(self.whole.on(runs), self.cut, self.fold, self.inside)
