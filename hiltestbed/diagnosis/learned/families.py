"""Laws that may be learned: a force of the contact, a curve of an axis of the sensor, and the platform's answer to a step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.contact.effects.learned import ContactMap
from hiltestbed.diagnosis.learned.curves import Block
from hiltestbed.diagnosis.learned.selection import Choices
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.settings import STRETCHES
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.piecewise import Pairs
from hiltestbed.platform.effects.learned import LearnedResponse
from hiltestbed.sensor.effects.calibration import WRENCH_AXES
from hiltestbed.sensor.effects.learned import SensorMap

FINE, COARSE = 17, 9  # knots of a curve at most; of a slider's while its reach is sought
HELD_LEVELS, PUSHED_LEVELS = (3, 5, 9, 17), (2, 3, 5, 9, 17)
SMALL = 1e-4  # of the peak force: the size of a difference
PLAIN = 4  # blocks without a slider
REACHES = (0.02, 0.5)  # of the travel, that a slider's stretch is tried over
MEMORIES = 9  # of a platform's response, that are tried
SHORTEST = 2.0  # ticks, of such a memory
LONGEST = 0.2  # of the shortest run, and one second at most
AT_ONCE = ((0.0, 1.0), (1.0, 1.0))  # a step that is followed by itself


@dataclass(frozen=True)
class Family(ABC):
    """A law as curves whose values on all knots, one block after the other, are its numbers.

    Attributes:
        blocks: its curves. peak: the largest force [N].
    """

    blocks: tuple[Block, ...]
    peak: float

    @abstractmethod
    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        """The effect with the ``values`` (P,); on the knots that were chosen alone, where they are given."""

    def curves(self, values: Array, choices: Choices | None = None) -> list[Pairs]:
        """The pairs of each block."""
        out, at = [], 0
        for i, b in enumerate(self.blocks):
            part = values[at : at + len(b.places)]
            at += len(b.places)
            every = 1
            if choices is not None:
                choice = choices[i]
                if choice is None:
                    out.append(())
                    continue
                every = choice.every(len(b.places))
            unit = self.peak if b.part else 1.0  # its values are forces at the peak, as large as the others
            out.append(tuple((float(x), float(y / unit)) for x, y in zip(b.places[::every], part[::every], strict=True)))
        return out

    @property
    def size(self) -> float:
        """A value [N] that is small beside those to be found, for differences."""
        return SMALL * self.peak

    @property
    def count(self) -> int:
        """P."""
        return sum(len(b.places) for b in self.blocks)


@dataclass(frozen=True)
class ContactForce(Family):
    """Curves over penetration and rate, of a force and of a part of the spring, and over the stretch of a slider in a last block."""

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        return ContactMap.hypothesis({}, **{b.name: c for b, c in zip(self.blocks, self.curves(values, choices), strict=True)})

    @property
    def slides(self) -> bool:
        """Whether it has a slider."""
        return len(self.blocks) > PLAIN

    @property
    def plain(self) -> ContactForce:
        """Without its slider."""
        return replace(self, blocks=self.blocks[:PLAIN])


@dataclass(frozen=True)
class SensorCurve(Family):
    """What an axis shows beside what it feels; the effect is the whole curve."""

    axis: str

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        return SensorMap.hypothesis({}, reading=tuple((x, x + y) for x, y in self.curves(values, choices)[0]), axis=self.axis)


@dataclass(frozen=True)
class PlatformStep(Family):
    """What a platform has reached of a step of its command, over the time since; its values are that less the whole step.

    The places of the block count back from the end of its memory, so that an odd curve is one that ends at the whole step.
    """

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        return LearnedResponse.hypothesis({}, step=self.curves(values, choices)[0] or AT_ONCE)

    def curves(self, values: Array, choices: Choices | None = None) -> list[Pairs]:
        memory = float(self.blocks[0].places[-1])
        return [tuple((memory - x, 1.0 + y) for x, y in reversed(curve)) for curve in super().curves(values, choices)]


def platform_families(residual: Residual) -> Iterator[PlatformStep]:
    """One of each memory, its knots closer where the step is fresh."""
    link = residual.link
    if not isinstance(link, PlatformLink):
        raise TypeError(f"a platform's response is learned on its link (got {link.name}); allowed is a PlatformLink")
    tick = link.runs[0].scenario.tick
    longest = max(min(1.0, LONGEST * tick * min(link.runs[i].rows for i in residual.runs)), 2.0 * SHORTEST * tick)
    since = np.linspace(1.0, 0.0, FINE) ** 2
    for memory in np.geomspace(SHORTEST * tick, longest, MEMORIES):
        yield PlatformStep((Block("step", memory * (1.0 - since), False, PUSHED_LEVELS),), 1.0)


def contact_families(residual: Residual) -> tuple[ContactForce, list[ContactForce]]:
    """Without a slider, and with one of each reach."""
    link, held = _wrench(residual), _wrench(residual).runs[0].scenario.mechanism.captured
    places, rates = zip(*(reached(link, i) for i in residual.runs), strict=True)
    depth = max(float(np.max(np.abs(x), initial=0.0)) for x in places)
    speed = max(float(np.max(np.abs(v), initial=0.0)) for v in rates)
    peak = _peak(residual)
    if depth <= 0.0 or speed <= 0.0:
        return ContactForce((), peak), []
    over = Block("penetration", np.linspace(-depth if held else 0.0, depth, FINE), False, HELD_LEVELS if held else PUSHED_LEVELS)
    u = np.linspace(-1.0, 1.0, FINE)
    rates_at = speed * u * np.abs(u)  # closer about 0, where a force may turn with the motion
    blocks = (
        over, Block("rate", rates_at, True, HELD_LEVELS), Block("spring", over.places, False, (1, *over.levels), part=True),
        Block("spring_rate", rates_at, True, HELD_LEVELS, part=True),
    )  # fmt: skip
    plain = ContactForce(blocks, peak)
    travel = max(float(np.ptp(np.append(x, 0.0))) for x in places)
    return plain, [with_slider(plain, travel * part) for part in np.geomspace(*REACHES, STRETCHES)]


def with_slider(plain: ContactForce, reach: float, knots: int = COARSE) -> ContactForce:
    """The same law with a slider whose stretch stays within ``reach`` [m]."""
    levels = tuple(n for n in HELD_LEVELS if n <= knots)
    return replace(plain, blocks=(*plain.blocks[:PLAIN], Block("stretch", np.linspace(-reach, reach, knots), True, levels)))


def sensor_families(residual: Residual, known: Effects) -> Iterator[SensorCurve]:
    """Of the axis of force and of that of torque on which most is left."""
    link = _wrench(residual)
    left = np.sum([np.sum(residual.of_run(i, known)[link.runs[i].touching] ** 2, axis=0) for i in residual.runs], axis=0)
    for j in (int(np.argmax(left[:3])), 3 + int(np.argmax(left[3:]))):
        if left[j] < 0.1 * left.max():
            continue
        felt = [link.shown(i, known)[link.runs[i].touching, j] for i in residual.runs]
        least, highest = min(float(f.min(initial=0.0)) for f in felt), max(float(f.max(initial=0.0)) for f in felt)
        most = max(-least, highest)
        if most > 0.0:
            both = least < -0.1 * most and highest > 0.1 * most
            sign = 1.0 if highest >= 0.1 * most else -1.0
            ends = (-most, most) if both else (0.0, most) if sign > 0.0 else (-most, 0.0)
            levels = HELD_LEVELS if both else PUSHED_LEVELS
            yield SensorCurve((Block("reading", np.linspace(*ends, FINE), True, levels),), most, WRENCH_AXES[j])


def reached(link: WrenchLink, i: int) -> tuple[Array, Array]:
    """Penetration [m] and its rate [m/s] in the rows of run i in which something touches, or is held."""
    depth = link.penetration(i)
    rate = np.gradient(depth, link.runs[i].scenario.tick)
    inside = link.runs[i].touching & (np.isfinite(depth) if link.runs[i].scenario.mechanism.captured else depth > 0.0)
    return depth[inside], rate[inside]


def _peak(residual: Residual) -> float:
    link = _wrench(residual)
    return max(float(np.max(np.abs(link.runs[i].measured[:, :3]), initial=0.0)) for i in residual.runs)


def _wrench(residual: Residual) -> WrenchLink:
    if not isinstance(residual.link, WrenchLink):
        raise TypeError(f"a law of contact or sensor from the link {residual.link.name}; allowed is a WrenchLink")
    return residual.link
