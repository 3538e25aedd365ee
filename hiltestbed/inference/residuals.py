"""The residuals of the runs of a model as one array, and their changes per parameter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, overload

import numpy as np

from hiltestbed.frames import Array

BINS = 100  # of a range; a part of it is then known to 1 %
HALF = 0.5  # of the sum of squares of a residual


class RunResiduals(Sequence[Array]):
    """What a hypothesis leaves of each run and, last, of the priors of its nuisances.

    A sequence of these arrays, which are views of one; none of them is written to.

    Attributes:
        samples: (M,) of all runs, one after another. starts: (R,) the first sample of each run.
        priors: (Q,) in standard deviations.
    """

    def __init__(self, samples: Array, starts: np.ndarray, priors: Array) -> None:
        self.samples, self.starts, self.priors = samples, starts, priors
        self.rows = np.diff(np.append(starts, len(samples)))

    @classmethod
    def of(cls, parts: Sequence[Array]) -> RunResiduals:
        """parts: (N,) of each run, and last the priors."""
        ends = np.cumsum([0, *(len(x) for x in parts[:-1])])
        return cls(np.concatenate([np.zeros(0), *parts[:-1]]), ends[:-1], parts[-1])

    def __len__(self) -> int:
        return len(self.starts) + 1

    @overload
    def __getitem__(self, index: int) -> Array: ...
    @overload
    def __getitem__(self, index: slice) -> list[Array]: ...
    def __getitem__(self, index: int | slice) -> Array | list[Array]:
        return list(self)[index]

    def __iter__(self) -> Iterator[Array]:
        for start, rows in zip(self.starts, self.rows, strict=True):
            yield self.samples[start : start + rows]
        yield self.priors

    def with_priors(self, more: Array) -> RunResiduals:
        """The same with further priors."""
        priors = np.concatenate([self.priors, more])
        return RunResiduals(self.samples, self.starts, priors) if len(more) else self

    def sums(self, x: Array) -> Array:
        """(..., R) of samples (..., M) of each run."""
        if not len(self.starts):
            return np.zeros((*x.shape[:-1], 0))
        return np.add.reduceat(x, self.starts, axis=-1)

    def squares(self) -> Array:
        """(R,) mean square of each run."""
        return self.sums(self.samples * self.samples) / self.rows


class Changes(NamedTuple):
    """Changes of residuals, one a row: (P, M) of the samples and (P, Q) of the priors."""

    samples: Array
    priors: Array


class Gram(NamedTuple):
    """Scalar products of changes with each other, (P, P, R), and with the residuals, (P, R), of
    each run; and of the priors, (P, P) and (P,).
    """

    products: Array
    along: Array
    priors: Array
    along_priors: Array

    @classmethod
    def of(cls, left: RunResiduals, changes: Changes) -> Gram:
        x = changes.samples
        return cls(
            _products(left, x, x),
            left.sums(x * left.samples),
            changes.priors @ changes.priors.T,
            changes.priors @ left.priors,
        )

    def and_(self, left: RunResiduals, known: Changes, more: Changes) -> Gram:
        """Of the changes of this one, which are ``known``, and ``more`` after them."""
        count, own = self.along.shape[0], Gram.of(left, more)
        across = _products(left, known.samples, more.samples)
        priors = np.zeros((count, more.priors.shape[1]))
        priors[:, : known.priors.shape[1]] = known.priors
        beside = priors @ more.priors.T
        return Gram(
            np.concatenate(
                [
                    np.concatenate([self.products, across], axis=1),
                    np.concatenate([across.transpose(1, 0, 2), own.products], axis=1),
                ]
            ),
            np.concatenate([self.along, own.along]),
            np.block([[self.priors, beside], [beside.T, own.priors]]),
            np.concatenate([self.along_priors, own.along_priors]),
        )


def _products(left: RunResiduals, a: Array, b: Array) -> Array:
    """(P, Q, R) of the rows of a (P, M) and b (Q, M), run by run."""
    each = [left.sums(row * b) for row in a]
    return np.array(each).reshape(len(a), len(b), len(left.starts))


def range_of_half(position: Array, residual: Array) -> tuple[float, float]:
    """The shortest range of ``position`` (N,) that holds half of the sum of squares of a
    ``residual`` (N,).
    """
    squares, edges = np.histogram(position, bins=BINS, weights=residual**2)
    total = np.concatenate([[0.0], np.cumsum(squares)])
    ends = np.searchsorted(total, total[:-1] + HALF * total[-1])
    widths = np.where(ends <= BINS, ends - np.arange(BINS), BINS + 1)
    first = int(np.argmin(widths))
    return float(edges[first]), float(edges[min(int(ends[first]), BINS)])
