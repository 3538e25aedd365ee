"""The families of laws that can be learned: a contact force, a curve of a sensor axis, the step
response of the platform.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.config.piecewise import Pairs
from hiltestbed.contact.effects.law import ContactMap
from hiltestbed.diagnosis.learned.selection import Block, Choices
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.platform.effects.learned import LearnedResponse
from hiltestbed.sensor.effects import SensorMap
from hiltestbed.signals import AXES

FINE_KNOTS = 17  # chosen: of a curve at most
HELD_LEVELS, PUSHED_LEVELS = (3, 5, 9, 17), (2, 3, 5, 9, 17)  # numbers of knots to choose from
DIFFERENCE_SHARE = 1e-4  # chosen: of the peak force: size of a finite difference
BLOCKS_WITHOUT_SLIDER = 4  # of a contact force
# chosen: of the travel, over which a slider's reach is tried, and how many reaches
REACH_RANGE, REACHES_TRIED = (0.02, 0.5), 7
MEMORIES_TRIED = 9  # lengths of a platform's response
MIN_MEMORY_TICKS = 2.0  # chosen: ticks, of such a response
MAX_MEMORY_SHARE = 0.2  # chosen: of the shortest run, and one second at most
LEAST_SHARE = 0.1  # chosen: of the largest, of a residual or a reading that counts beside it
IDENTITY_STEP = ((0.0, 1.0), (1.0, 1.0))  # the response of a platform that follows at once


@dataclass(frozen=True)
class Family(ABC):
    """A law as a set of curves; its numbers are their values on all knots, one block after the
    other.

    Attributes:
        blocks: its curves. peak: the largest force [N].
    """

    blocks: tuple[Block, ...]
    peak: float

    @abstractmethod
    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        """The effect with the ``values`` (P,); with ``choices``, on the chosen knots only."""

    def curves(self, values: Array, choices: Choices | None = None) -> list[Pairs]:
        """The (abscissa, value) pairs of each block; none of one that is left out."""
        out: list[Pairs] = []
        ends = np.cumsum([len(b.places) for b in self.blocks])[:-1]
        for i, (b, part) in enumerate(zip(self.blocks, np.split(values, ends), strict=True)):
            choice = None if choices is None else choices[i]
            if choices is not None and choice is None:
                out.append(())
                continue
            every = 1 if choice is None else choice.every(len(b.places))
            # the values of a part are forces at the peak, of the size of the others
            part = part / (self.peak if b.part else 1.0)
            pairs = zip(b.places[::every].tolist(), part[::every].tolist(), strict=True)
            out.append(tuple(pairs))
        return out

    @property
    def size(self) -> float:
        """Step of finite differences [N], small beside the values to be found."""
        return DIFFERENCE_SHARE * self.peak

    @property
    def count(self) -> int:
        """P, the number of values."""
        return sum(len(b.places) for b in self.blocks)


@dataclass(frozen=True)
class ContactForce(Family):
    """Curves over penetration and rate, as a force and as a factor on the spring; a last block over
    the stretch of a slider.
    """

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        pairs = zip(self.blocks, self.curves(values, choices), strict=True)
        return ContactMap.hypothesis({}, **{b.name: c for b, c in pairs})

    @property
    def slides(self) -> bool:
        return len(self.blocks) > BLOCKS_WITHOUT_SLIDER

    def with_slider(self, reach: float) -> ContactForce:
        """The same law with a slider whose stretch stays within ``reach`` [m]."""
        stretch = Block("stretch", np.linspace(-reach, reach, FINE_KNOTS), True, HELD_LEVELS)
        return replace(self, blocks=(*self.blocks[:BLOCKS_WITHOUT_SLIDER], stretch))


@dataclass(frozen=True)
class SensorCurve(Family):
    """What a sensor axis shows beyond what it feels; the effect is the whole curve."""

    axis: str

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        reading = tuple((x, x + y) for x, y in self.curves(values, choices)[0])
        return SensorMap.hypothesis({}, reading=reading, axis=self.axis)


@dataclass(frozen=True)
class PlatformStep(Family):
    """The step response of a platform over the time since the step; the values are the response
    less 1.

    The abscissae count back from the end of the response, so that an odd curve ends at 1.
    """

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        return LearnedResponse.hypothesis({}, step=self.curves(values, choices)[0] or IDENTITY_STEP)

    def curves(self, values: Array, choices: Choices | None = None) -> list[Pairs]:
        memory = float(self.blocks[0].places[-1])
        return [
            tuple((memory - x, 1.0 + y) for x, y in reversed(curve))
            for curve in super().curves(values, choices)
        ]


def platform_families(link: PlatformLink, runs: tuple[int, ...]) -> Iterator[PlatformStep]:
    """One for each length of response, with knots closer just after the step."""
    least = MIN_MEMORY_TICKS * link.tick
    longest = min(1.0, MAX_MEMORY_SHARE * link.tick * min(link.runs[i].rows for i in runs))
    since = np.linspace(1.0, 0.0, FINE_KNOTS) ** 2
    for memory in np.geomspace(least, max(longest, 2.0 * least), MEMORIES_TRIED):
        yield PlatformStep((Block("step", memory * (1.0 - since), False, PUSHED_LEVELS),), 1.0)


def contact_family(link: WrenchLink, runs: tuple[int, ...]) -> tuple[ContactForce, float] | None:
    """The contact force without a slider, and the travel [m]; None where nothing touches."""
    held = link.runs[0].scenario.mechanism.captured
    places, rates = zip(*(reached(link, i) for i in runs), strict=True)
    depth = max(float(np.max(np.abs(x), initial=0.0)) for x in places)
    speed = max(float(np.max(np.abs(v), initial=0.0)) for v in rates)
    if depth <= 0.0 or speed <= 0.0:
        return None
    over, levels = np.linspace(-depth if held else 0.0, depth, FINE_KNOTS), HELD_LEVELS
    if not held:
        levels = PUSHED_LEVELS
    u = np.linspace(-1.0, 1.0, FINE_KNOTS)
    # closer about 0, where a force may change sign with the motion
    rates_at = speed * u * np.abs(u)
    blocks = (
        Block("penetration", over, False, levels),
        Block("rate", rates_at, True, HELD_LEVELS),
        Block("spring", over, False, (1, *levels), part=True),
        Block("spring_rate", rates_at, True, HELD_LEVELS, part=True),
    )
    peak = max(float(np.max(np.abs(link.runs[i].measured[:, :3]), initial=0.0)) for i in runs)
    travel = max(float(np.ptp(np.append(x, 0.0))) for x in places)
    return ContactForce(blocks, peak), travel


def sensor_families(residual: Residual, known: Effects) -> Iterator[SensorCurve]:
    """One for the force axis and one for the torque axis with the largest residual."""
    link = residual.link
    touching = [link.runs[i].touching for i in residual.runs]
    pairs = list(zip(residual.runs, touching, strict=True))
    left = sum(np.sum(residual.of_run(i, known)[t] ** 2, axis=0) for i, t in pairs)
    left = np.asarray(left)
    for j in (int(np.argmax(left[:3])), 3 + int(np.argmax(left[3:]))):
        if left[j] < LEAST_SHARE * left.max():
            continue
        felt = np.concatenate([link.shown(i, known)[t, j] for i, t in pairs])
        least, highest = float(felt.min(initial=0.0)), float(felt.max(initial=0.0))
        most = max(-least, highest)
        if most > 0.0:
            low = -most if least < -LEAST_SHARE * most else 0.0
            high = most if highest > LEAST_SHARE * most else 0.0
            levels = HELD_LEVELS if low < 0.0 < high else PUSHED_LEVELS
            block = Block("reading", np.linspace(low, high, FINE_KNOTS), True, levels)
            yield SensorCurve((block,), most, AXES[j])


def reached(link: WrenchLink, i: int) -> tuple[Array, Array]:
    """Penetration [m] and its rate [m/s] in the rows of run i with contact, or while latched."""
    depth, run = link.penetration(i), link.runs[i]
    rate = np.gradient(depth, run.scenario.tick)
    inside = np.isfinite(depth) if run.scenario.mechanism.captured else depth > 0.0
    inside &= run.touching
    return depth[inside], rate[inside]
