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
from hiltestbed.diagnosis.settings import REACHES_TRIED
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.platform.effects.learned import LearnedResponse
from hiltestbed.sensor.effects import WRENCH_AXES, SensorMap

# chosen: knots of a curve at most; of a slider's curve while its reach is sought
FINE_KNOTS, COARSE_KNOTS = 17, 9
HELD_LEVELS, PUSHED_LEVELS = (3, 5, 9, 17), (2, 3, 5, 9, 17)
DIFFERENCE_SHARE = 1e-4  # chosen: of the peak force: size of a finite difference
BLOCKS_WITHOUT_SLIDER = 4  # of a contact force
REACH_RANGE = (0.02, 0.5)  # chosen: of the travel, over which a slider's reach is tried
MEMORIES_TRIED = 9  # lengths of a platform's response
MIN_MEMORY_TICKS = 2.0  # chosen: ticks, of such a response
MAX_MEMORY_SHARE = 0.2  # chosen: of the shortest run, and one second at most
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
        """The (abscissa, value) pairs of each block."""
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
            # its values are forces at the peak, of the size of the others
            unit = self.peak if b.part else 1.0
            out.append(
                tuple(
                    (float(x), float(y / unit))
                    for x, y in zip(b.places[::every], part[::every], strict=True)
                )
            )
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
        return ContactMap.hypothesis(
            {},
            **{b.name: c for b, c in zip(self.blocks, self.curves(values, choices), strict=True)},
        )

    @property
    def slides(self) -> bool:
        """Whether it has a slider."""
        return len(self.blocks) > BLOCKS_WITHOUT_SLIDER

    @property
    def plain(self) -> ContactForce:
        """Without its slider."""
        return replace(self, blocks=self.blocks[:BLOCKS_WITHOUT_SLIDER])


@dataclass(frozen=True)
class SensorCurve(Family):
    """What a sensor axis shows beyond what it feels; the effect is the whole curve."""

    axis: str

    def effect(self, values: Array, choices: Choices | None = None) -> Effect:
        return SensorMap.hypothesis(
            {},
            reading=tuple((x, x + y) for x, y in self.curves(values, choices)[0]),
            axis=self.axis,
        )


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


def platform_families(residual: Residual) -> Iterator[PlatformStep]:
    """One for each length of response, with knots closer just after the step."""
    link = residual.link
    if not isinstance(link, PlatformLink):
        raise TypeError(
            f"a platform's response is learned on its link (got {link.name}); allowed is a "
            f"PlatformLink"
        )
    tick = link.runs[0].scenario.tick
    longest = max(
        min(1.0, MAX_MEMORY_SHARE * tick * min(link.runs[i].rows for i in residual.runs)),
        2.0 * MIN_MEMORY_TICKS * tick,
    )
    since = np.linspace(1.0, 0.0, FINE_KNOTS) ** 2
    for memory in np.geomspace(MIN_MEMORY_TICKS * tick, longest, MEMORIES_TRIED):
        yield PlatformStep((Block("step", memory * (1.0 - since), False, PUSHED_LEVELS),), 1.0)


def contact_families(residual: Residual) -> tuple[ContactForce, list[ContactForce]]:
    """The contact force without a slider, and with a slider of each reach."""
    link, held = _wrench(residual), _wrench(residual).runs[0].scenario.mechanism.captured
    places, rates = zip(*(reached(link, i) for i in residual.runs), strict=True)
    depth = max(float(np.max(np.abs(x), initial=0.0)) for x in places)
    speed = max(float(np.max(np.abs(v), initial=0.0)) for v in rates)
    peak = _peak(residual)
    if depth <= 0.0 or speed <= 0.0:
        return ContactForce((), peak), []
    over = Block(
        "penetration",
        np.linspace(-depth if held else 0.0, depth, FINE_KNOTS),
        False,
        HELD_LEVELS if held else PUSHED_LEVELS,
    )
    u = np.linspace(-1.0, 1.0, FINE_KNOTS)
    # closer about 0, where a force may change sign with the motion
    rates_at = speed * u * np.abs(u)
    blocks = (
        over,
        Block("rate", rates_at, True, HELD_LEVELS),
        Block("spring", over.places, False, (1, *over.levels), part=True),
        Block("spring_rate", rates_at, True, HELD_LEVELS, part=True),
    )
    plain = ContactForce(blocks, peak)
    travel = max(float(np.ptp(np.append(x, 0.0))) for x in places)
    return plain, [
        with_slider(plain, travel * part) for part in np.geomspace(*REACH_RANGE, REACHES_TRIED)
    ]


def with_slider(plain: ContactForce, reach: float, knots: int = COARSE_KNOTS) -> ContactForce:
    """The same law with a slider whose stretch stays within ``reach`` [m]."""
    levels = tuple(n for n in HELD_LEVELS if n <= knots)
    return replace(
        plain,
        blocks=(
            *plain.blocks[:BLOCKS_WITHOUT_SLIDER],
            Block("stretch", np.linspace(-reach, reach, knots), True, levels),
        ),
    )


def sensor_families(residual: Residual, known: Effects) -> Iterator[SensorCurve]:
    """One for the force axis and one for the torque axis with the largest residual."""
    link = _wrench(residual)
    left = np.sum(
        [
            np.sum(residual.of_run(i, known)[link.runs[i].touching] ** 2, axis=0)
            for i in residual.runs
        ],
        axis=0,
    )
    for j in (int(np.argmax(left[:3])), 3 + int(np.argmax(left[3:]))):
        if left[j] < 0.1 * left.max():
            continue
        felt = [link.shown(i, known)[link.runs[i].touching, j] for i in residual.runs]
        least, highest = (
            min(float(f.min(initial=0.0)) for f in felt),
            max(float(f.max(initial=0.0)) for f in felt),
        )
        most = max(-least, highest)
        if most > 0.0:
            both = least < -0.1 * most and highest > 0.1 * most
            sign = 1.0 if highest >= 0.1 * most else -1.0
            ends = (-most, most) if both else (0.0, most) if sign > 0.0 else (-most, 0.0)
            levels = HELD_LEVELS if both else PUSHED_LEVELS
            yield SensorCurve(
                (Block("reading", np.linspace(*ends, FINE_KNOTS), True, levels),),
                most,
                WRENCH_AXES[j],
            )


def reached(link: WrenchLink, i: int) -> tuple[Array, Array]:
    """Penetration [m] and its rate [m/s] in the rows of run i with contact, or while latched."""
    depth = link.penetration(i)
    rate = np.gradient(depth, link.runs[i].scenario.tick)
    inside = link.runs[i].touching & (
        np.isfinite(depth) if link.runs[i].scenario.mechanism.captured else depth > 0.0
    )
    return depth[inside], rate[inside]


def _peak(residual: Residual) -> float:
    link = _wrench(residual)
    return max(
        float(np.max(np.abs(link.runs[i].measured[:, :3]), initial=0.0)) for i in residual.runs
    )


def _wrench(residual: Residual) -> WrenchLink:
    if not isinstance(residual.link, WrenchLink):
        raise TypeError(
            f"a law of contact or sensor from the link {residual.link.name}; allowed is a "
            f"WrenchLink"
        )
    return residual.link
