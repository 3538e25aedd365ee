"""The law that lowers the residual of a link most, with as few numbers as left-out runs allow, and
its gain on them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.config.piecewise import Pairs
from hiltestbed.diagnosis.learned.families import (
    BLOCKS_WITHOUT_SLIDER,
    REACH_RANGE,
    REACHES_TRIED,
    ContactForce,
    Family,
    contact_family,
    platform_families,
    sensor_families,
)
from hiltestbed.diagnosis.learned.selection import (
    LEAST_LOSS,
    MIN_HELDOUT_GAIN,
    Choices,
    Linear,
    Selected,
    roughness,
    select,
    shape,
)
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout
from hiltestbed.diagnosis.settings import MIN_RUN_SHARE
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array

# chosen: share of the residual on left-out runs by which a law has to lower it
MIN_LAW_GAIN = 0.05
MIN_RUNS = 2
# chosen: factor by which a slider's reach is first changed, and how often it is
REACH_STEP, REACH_REFINEMENTS = 1.2, 5
LINEARISATIONS = 2  # chosen: a pushing contact is clipped where its force would pull


@dataclass(frozen=True)
class Law:
    """A law on its link.

    Attributes:
        family: its curves. choices: the knots of each. values: (P,) on the finest knots. known:
            effects beside which it was learned.
    """

    family: Family
    choices: Choices
    values: Array
    known: tuple[Effect, ...]

    @property
    def effect(self) -> Effect:
        return self.family.effect(self.values, self.choices)

    @property
    def curves(self) -> list[Pairs]:
        return self.family.curves(self.values, self.choices)

    @property
    def numbers(self) -> int:
        """How many numbers were fitted, the reach of a slider among them."""
        return shape(self.family.blocks, self.choices).shape[1] + _slides(self.family, self.choices)


def _slides(family: Family, choices: Choices) -> bool:
    return isinstance(family, ContactForce) and family.slides and choices[-1] is not None


def learn(residual: Residual, known: Effects = ()) -> tuple[Law, Heldout] | None:
    """The best law of a link beside ``known`` effects, and its gain; None where no law carries over
    to left-out runs.
    """
    if not isinstance(residual.link, (WrenchLink, PlatformLink)) or len(residual.runs) < MIN_RUNS:
        return None
    found = _candidates(residual, known)
    if not found:
        return None
    lowest = min(s.carried for _, s in found)
    near = [(f, s) for f, s in found if s.carried < lowest + LEAST_LOSS]
    family, selected = min(
        near,
        key=lambda item: (item[1].numbers + _slides(item[0], item[1].choices), item[1].carried),
    )
    if isinstance(family, ContactForce) and _slides(family, selected.choices):
        family, selected = _refined(residual, known, family, selected)
    if not any(selected.choices):
        return None
    values = np.zeros(family.count)
    law, linear = _settled(residual, Law(family, selected.choices, values, tuple(known)))
    gain = _gain(residual, law, linear)
    return (law, gain) if gain.reduction > 1.0 - math.exp(-MIN_LAW_GAIN) else None


def carries_over(gain: Heldout) -> bool:
    """Whether the same law holds in all runs: it improves most of those it was not fitted to,
    beyond chance and beyond a placebo.
    """
    helped = [b < (1.0 - MIN_HELDOUT_GAIN) * a for a, b in gain.per_run.values()]
    return gain.significant and sum(helped) >= MIN_RUN_SHARE * len(helped)


def linearised(
    residual: Residual, known: Effects, family: Family, start: Array, directions: Array
) -> Linear:
    """The linearisation about the values ``start`` (P,) along the ``directions`` (P, D), by
    replays; of the samples in contact, where there is one.
    """
    tried = [start, *(start + family.size * d for d in directions.T)]
    found = residual.by_run([[*known, family.effect(v)] for v in tried])
    residuals, jacobians = [], []
    for n, i in enumerate(residual.runs):
        counted = residual.counted(i)
        base, *moved = (rows[n][counted] for rows in found)
        residuals.append(base)
        jacobians.append(np.stack([(m - base) / family.size for m in moved], axis=1))
    return Linear(residuals, jacobians)


def _from_nothing(
    residual: Residual, known: Effects, family: Family, have: Linear | None = None
) -> Linear:
    """The linearisation about no law, in all values; have: that of a family with the first of these
    blocks, to be reused.
    """
    done = have.jacobians[0].shape[1] if have else 0
    along = np.eye(family.count)[:, done:]
    new = linearised(residual, known, family, np.zeros(family.count), along)
    if have is None:
        return new
    pairs = zip(have.jacobians, new.jacobians, strict=True)
    return Linear(new.residuals, [np.concatenate(pair, axis=1) for pair in pairs])


def _candidates(residual: Residual, known: Effects) -> list[tuple[Family, Selected]]:
    link, families = residual.link, list[tuple[Family, Linear | None]]()
    if isinstance(link, PlatformLink):
        families += [(f, None) for f in platform_families(link, residual.runs)]
    elif isinstance(link, WrenchLink):
        if (plain := contact_family(link, residual.runs)) is not None:
            family, travel = plain
            first = _from_nothing(residual, known, family)
            reaches = travel * np.geomspace(*REACH_RANGE, REACHES_TRIED)
            families += [(family, None), *((family.with_slider(r), first) for r in reaches)]
        families += [(f, None) for f in sensor_families(residual, known)]
    return [
        (f, select(_from_nothing(residual, known, f, first), f.blocks)) for f, first in families
    ]


def _refined(
    residual: Residual, known: Effects, family: ContactForce, selected: Selected
) -> tuple[ContactForce, Selected]:
    """The family with a slider's reach between those tried."""
    factor, plain = REACH_STEP, replace(family, blocks=family.blocks[:BLOCKS_WITHOUT_SLIDER])
    first = _from_nothing(residual, known, plain)
    for _ in range(REACH_REFINEMENTS):
        reach = float(family.blocks[-1].places[-1])
        others = [family.with_slider(r) for r in (reach / factor, reach * factor)]
        tried = [(f, select(_from_nothing(residual, known, f, first), f.blocks)) for f in others]
        best = min(tried, key=lambda item: item[1].carried)
        if best[1].carried < selected.carried:
            family, selected = best
        else:
            factor = math.sqrt(factor)
    return family, selected


def _settled(residual: Residual, law: Law) -> tuple[Law, Linear]:
    """The law fitted to all runs and linearised again about the result; and the last linearisation,
    by its numbers.
    """
    blocks, runs = law.family.blocks, range(len(residual.runs))
    basis = shape(blocks, law.choices)
    rough, numbers = basis.T @ roughness(blocks) @ basis, np.zeros(basis.shape[1])
    linear = linearised(residual, law.known, law.family, law.values, basis)
    for _ in range(LINEARISATIONS):
        numbers = numbers + linear.solve(runs, np.eye(len(numbers)), rough, numbers)
        law = replace(law, values=basis @ numbers)
        linear = linearised(residual, law.known, law.family, law.values, basis)
    return law, linear


def _gain(residual: Residual, law: Law, linear: Linear) -> Heldout:
    """The gain with each run left out of the fit in turn; the placebo is the same law fitted to
    residuals shifted by half a contact.
    """
    family, runs = law.family, residual.runs
    basis = shape(family.blocks, law.choices)
    rough, every = basis.T @ roughness(family.blocks) @ basis, np.eye(basis.shape[1])
    numbers = np.asarray(np.linalg.lstsq(basis, law.values, rcond=None)[0], dtype=float)
    flat = linearised(residual, law.known, family, np.zeros(family.count), basis)
    shifted = Linear([np.roll(r, len(r) // 2) for r in flat.residuals], flat.jacobians)

    def left(i: int, fitted: Sequence[float] | Array) -> float:
        effect = family.effect(basis @ fitted, law.choices)
        return residual.mean_square(i, [*law.known, effect])

    before, after, wrong = {}, {}, {}
    for n, i in enumerate(runs):
        others = [j for j in range(len(runs)) if j != n]
        before[i] = residual.mean_square(i, law.known)
        after[i] = left(i, numbers + linear.solve(others, every, rough, numbers))
        wrong[i] = left(i, shifted.solve(others, every, rough))
    return Heldout.of(runs, before, after, wrong)
