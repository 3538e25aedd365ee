"""What every link has: its runs, and the prediction of what they should have shown.

A link predicts what was measured at its output for any list of effects. Many hypotheses on many runs are one replay: a *lane* is a run
under a list of effects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

Effects = Sequence[Effect]
Lane = tuple[int, Effects]  # a run and what departs in it
MEMORY = 64_000_000  # [byte] of predictions that are made in one replay


class Later(Effect):
    """A shift of the reading that is no effect of the vocabulary: to see what lateness does."""

    kind: Literal["later"] = "later"
    delay: float
    link = "sensor"

    def apply(self, p: object) -> None:
        """Nothing: the link reads the shift itself."""


@dataclass(frozen=True)
class LinkRun:
    """One run as a link sees it.

    Attributes:
        scenario: as believed. measured: (N, C) at the output, 0 where it was not measured.
        sigma: (N, C) its noise, infinite where not measured. touching: (N,) bool, the nominal or the measured contact, with its tail
        through the sensor. heavy: whether the noise has outliers, see :func:`hiltestbed.diagnosis.noise.softened`. tail: variance of the
        square of a sample of noise. baseline: degree of a polynomial of each run that is no misfit, -1 for none; tones: [rad] a row, which
        are none either, see :mod:`hiltestbed.diagnosis.aside`.
    """

    scenario: Scenario
    measured: Array
    sigma: Array
    touching: np.ndarray
    heavy: bool = False
    tail: float = 2.0
    baseline: int = -1
    tones: tuple[float, ...] = ()

    @property
    def rows(self) -> int:
        """N."""
        return len(self.measured)


class Link(ABC):
    """One link on measured inputs.

    Attributes:
        name: of the link. channels: what was measured at its output. runs: as it sees them.
        witnesses: [s] stretches of a run whose misfits are independent of each other; none where each row's is.
    """

    name: str
    channels: tuple[str, ...]
    runs: Sequence[LinkRun]
    witnesses: tuple[float, ...] = ()

    @property
    def whole(self) -> Link:
        """The link as it is judged, which is fitted in another form; itself as a rule."""
        return self

    def predict(self, lanes: Sequence[Lane]) -> list[Array]:
        """(N, C) of each lane what its run should have shown."""
        size = max((self.runs[i].rows for i, _ in lanes), default=1) * len(self.channels) * 8
        chunk = max(1, MEMORY // size)
        out: list[Array] = []
        for start in range(0, len(lanes), chunk):
            out += self._replay(lanes[start : start + chunk])
        return out

    @abstractmethod
    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        """Predictions of a handful of lanes in one replay."""

    def shown(self, i: int, effects: Effects = ()) -> Array:
        """(N, C) what run i should have shown."""
        return self.predict([(i, effects)])[0]

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """(N, C) how far the prediction hangs on how finely the facility divides its time; None: not at all."""
        return None


def padded(arrays: Sequence[Array]) -> Array:
    """``(R, N, ...)`` of arrays of different length, the last row of each held."""
    longest = max(len(a) for a in arrays)
    return np.stack([np.concatenate([a, np.repeat(a[-1:], longest - len(a), axis=0)]) for a in arrays])


def flat_pose(pose: Array) -> Array:
    """(N, 6) position [m] and rotation vector [rad] (for small angles twice the vector part) of poses (N, 7)."""
    sign = np.where(pose[..., 6:] < 0, -1.0, 1.0)
    return np.concatenate([pose[..., :3], 2.0 * sign * pose[..., 3:6]], axis=-1)
