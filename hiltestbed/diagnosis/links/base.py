"""What every link has: its runs, and the prediction of what they should have shown.

A link predicts what was measured at its output for any list of effects. Many hypotheses on many runs are one replay: a *lane* is a run
under a list of effects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import Scenario

Effects = Sequence[Effect]
Lane = tuple[int, Effects]  # a run and what departs in it
MEMORY = 64_000_000  # [byte] of predictions that are made in one replay


class Later(Effect):
    """When a facility samples, stamps and steps, where no definition says it; no effect of the vocabulary.

    Attributes:
        delay: [s] by which the output of a link is stamped later than the believed rig has it; negative: earlier.
        before: [s] by which its input acts later, or is stamped earlier, where that differs from a late output: where the output goes on
            without an input, and where noise goes from input to output. Of contact and sensor: by which the reading is put late between
            its rows, where ``delay`` is that of the instant at which it is read.
        obeyed: [s] by which a platform obeys its command later, on all six axes.
        old: part of the old twist in a new pose of the numerical model: 0 semi-implicit, 1 would be explicit Euler.
    """

    kind: Literal["later"] = "later"
    delay: float = 0.0
    before: float = 0.0
    obeyed: float = 0.0
    old: float = 0.0
    link = "sensor"

    def apply(self, p: object) -> None:
        """Nothing: the link reads the shift itself."""

    def plus(self, other: Later) -> Later:
        """Both together."""
        return Later(**{name: value + getattr(other, name) for name, value in self.parameters().items()})


PROMPT = Later()


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
        timing: when the facility samples, stamps and steps, as far as that is not believed.
    """

    name: str
    channels: tuple[str, ...]
    runs: Sequence[LinkRun]
    witnesses: tuple[float, ...] = ()
    timing: Later = PROMPT

    def stamped(self, place: Later) -> Self:
        """The same link of a facility that samples, stamps and steps otherwise."""
        out = copy(self)
        out.timing = place
        return out

    def placed(self, effects: Effects) -> Later:
        """When the facility samples, stamps and steps under ``effects``."""
        place = self.timing
        for effect in effects:
            if isinstance(effect, Later):
                place = place.plus(effect)
        return place

    def _between(self, i: int, shown: Array, timing: Later) -> Array:
        """(N, C) of run i where the output is stamped late, or the input early.

        What follows linearly from an input that lies between two rows is what lies there between the rows of the output, noise included,
        which is less there than in a row.
        """
        tick, given = self.runs[i].scenario.tick, self.runs[i].measured
        out = moved(shown, timing.delay / tick)
        return given - (moved(given, -timing.before / tick) - out) if timing.before else out

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


def moved(values: Array, rows: float) -> Array:
    """``values`` (N, C) as they were ``rows`` before, on straight lines between rows and beyond both ends."""
    return shifted(values, -rows, held=False) if rows else values


def flat_pose(pose: Array) -> Array:
    """(N, 6) position [m] and rotation vector [rad] (for small angles twice the vector part) of poses (N, 7)."""
    sign = np.where(pose[..., 6:] < 0, -1.0, 1.0)
    return np.concatenate([pose[..., :3], 2.0 * sign * pose[..., 3:6]], axis=-1)
