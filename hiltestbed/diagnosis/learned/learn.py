"""The law that lowers the residual of a link most, with as few numbers as left-out runs allow, and
its gain on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.heldout import mean_square, resampled
from hiltestbed.diagnosis.learned.families import (
    COARSE_KNOTS,
    FINE_KNOTS,
    ContactForce,
    Family,
    contact_families,
    platform_families,
    sensor_families,
    with_slider,
)
from hiltestbed.diagnosis.learned.selection import (
    Choices,
    Normal,
    Selected,
    normal_equations,
    roughness,
    select,
    shape,
    solve,
)
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout
from hiltestbed.diagnosis.settings import (
    MIN_HELDOUT_GAIN,
    MIN_HELDOUT_GAIN_IN_PART,
    MIN_RUN_SHARE,
    REACH_REFINEMENTS,
)
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array

MIN_RUNS = 2
REACH_STEP = 1.2  # chosen: factor by which a slider's reach is first changed
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
        """As it stands in a scenario."""
        return self.family.effect(self.values, self.choices)

    @property
    def numbers(self) -> int:
        """How many numbers were fitted, the reach of a slider among them."""
        slides = (
            isinstance(self.family, ContactForce)
            and self.family.slides
            and self.choices[-1] is not None
        )
        return shape(self.family.blocks, self.choices).shape[1] + int(slides)


@dataclass(frozen=True)
class Linear:
    """A family linearised about a law: residual and Jacobian of each run, in the rows in
    contact.
    """

    residuals: list[Array]
    jacobians: list[Array]

    def normal(self) -> Normal:
        """Its normal equations."""
        return normal_equations(self.residuals, self.jacobians)


def learn(residual: Residual, known: Effects = ()) -> tuple[Law, Heldout] | None:
    """The best law of a link beside ``known`` effects, and its gain; None where no law carries over
    to left-out runs.
    """
    if not isinstance(residual.link, (WrenchLink, PlatformLink)) or len(residual.runs) < MIN_RUNS:
        return None
    found, first = _candidates(residual, known)
    if not found:
        return None
    lowest = min(s.carried for _, s in found)
    near = [(f, s) for f, s in found if s.carried < lowest - math.log(1.0 - MIN_HELDOUT_GAIN)]
    family, selected = min(
        near,
        key=lambda item: (Law(item[0], item[1].choices, np.zeros(0), ()).numbers, item[1].carried),
    )
    if isinstance(family, ContactForce) and family.slides and selected.choices[-1] is not None:
        family, selected = _refined(residual, known, family, selected, first)
    if not any(selected.choices):
        return None
    law, linear = _settled(
        residual, Law(family, selected.choices, np.zeros(family.count), tuple(known))
    )
    gain = _gain(residual, law, linear)
    return (law, gain) if gain.reduction > 1.0 - math.exp(-MIN_HELDOUT_GAIN_IN_PART) else None


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
    replays.
    """
    tried = [start + family.size * d for d in directions.T]
    found = residual.by_run([[*known, family.effect(v)] for v in (start, *tried)])
    uses = [_counted(residual, i) for i in residual.runs]
    base = [r[use] for r, use in zip(found[0], uses, strict=True)]
    slopes = [
        np.stack([(moved[n][use] - r) / family.size for moved in found[1:]], axis=1)
        for n, (r, use) in enumerate(zip(base, uses, strict=True))
    ]
    return Linear(base, slopes)


def _from_nothing(
    residual: Residual, known: Effects, family: Family, have: Linear | None = None
) -> Linear:
    """The linearisation about no law, in all values; have: that of a family with the first of these
    blocks, to be reused.
    """
    done = have.jacobians[0].shape[1] if have else 0
    new = linearised(
        residual, known, family, np.zeros(family.count), np.eye(family.count)[:, done:]
    )
    if have is None:
        return new
    return Linear(
        new.residuals,
        [
            np.concatenate([a, b], axis=1)
            for a, b in zip(have.jacobians, new.jacobians, strict=True)
        ],
    )


def _counted(residual: Residual, i: int) -> np.ndarray:
    """(N, C) bool: the samples of run i that count: in contact, where there is one."""
    counts = residual.weight[i] > 0
    inside = counts & residual.link.runs[i].touching[:, None]
    return inside if inside.any() else counts


def _candidates(
    residual: Residual, known: Effects
) -> tuple[list[tuple[Family, Selected]], Linear | None]:
    """Every family with its best curves; and the linearised contact force without a slider."""
    if isinstance(residual.link, PlatformLink):
        return [
            (f, select(_from_nothing(residual, known, f).normal(), f.blocks))
            for f in platform_families(residual)
        ], None
    plain, sliding = contact_families(residual)
    first = _from_nothing(residual, known, plain) if plain.blocks else None
    linear: list[tuple[Family, Linear]] = [(plain, first)] if first else []
    linear += [(f, _from_nothing(residual, known, f, first)) for f in sliding]
    linear += [(f, _from_nothing(residual, known, f)) for f in sensor_families(residual, known)]
    return [(f, select(lin.normal(), f.blocks)) for f, lin in linear], first


def _refined(
    residual: Residual,
    known: Effects,
    family: ContactForce,
    selected: Selected,
    first: Linear | None,
) -> tuple[ContactForce, Selected]:
    """The family with a slider's reach between those tried, and more knots over its stretch; first:
    the law without slider, linearised.
    """
    factor = REACH_STEP

    def tried(reach: float, knots: int = COARSE_KNOTS) -> tuple[ContactForce, Selected]:
        f = with_slider(family.plain, reach, knots)
        return f, select(_from_nothing(residual, known, f, first).normal(), f.blocks)

    for _ in range(REACH_REFINEMENTS):
        reach = float(family.blocks[-1].places[-1])
        best = min((tried(reach / factor), tried(reach * factor)), key=lambda item: item[1].carried)
        if best[1].carried < selected.carried:
            family, selected = best
        else:
            factor = math.sqrt(factor)
    finer = tried(float(family.blocks[-1].places[-1]), FINE_KNOTS)
    return (
        finer
        if finer[1].carried < selected.carried + math.log(1.0 - MIN_HELDOUT_GAIN)
        else (family, selected)
    )


def _settled(residual: Residual, law: Law) -> tuple[Law, Linear]:
    """The law fitted to all runs and linearised again about the result; and the last linearisation,
    by its numbers.
    """
    blocks, runs = law.family.blocks, range(len(residual.runs))
    basis = shape(blocks, law.choices)
    rough, numbers = basis.T @ roughness(blocks) @ basis, np.zeros(basis.shape[1])
    linear = linearised(residual, law.known, law.family, law.values, basis)
    for _ in range(LINEARISATIONS):
        numbers = numbers + solve(linear.normal(), runs, np.eye(len(numbers)), rough, numbers)
        law = replace(law, values=basis @ numbers)
        linear = linearised(residual, law.known, law.family, law.values, basis)
    return law, linear


def _gain(residual: Residual, law: Law, linear: Linear) -> Heldout:
    """The gain with each run left out of the fit in turn; the placebo is the same law fitted to
    residuals shifted by half a contact.
    """
    blocks = law.family.blocks
    basis = shape(blocks, law.choices)
    rough, every = basis.T @ roughness(blocks) @ basis, np.eye(basis.shape[1])
    numbers = np.asarray(np.linalg.lstsq(basis, law.values, rcond=None)[0], dtype=float)
    flat = linearised(residual, law.known, law.family, np.zeros(law.family.count), basis)
    normal = linear.normal()
    shifted = normal_equations([np.roll(r, len(r) // 2) for r in flat.residuals], flat.jacobians)
    before, after, wrong = {}, {}, {}
    for n, i in enumerate(residual.runs):
        others = [j for j in range(len(residual.runs)) if j != n]
        before[i] = mean_square(residual, i, law.known)
        left_out = basis @ (numbers + solve(normal, others, every, rough, numbers))
        after[i] = mean_square(residual, i, [*law.known, law.family.effect(left_out, law.choices)])
        placebo = basis @ solve(shifted, others, every, rough)
        wrong[i] = mean_square(residual, i, [*law.known, law.family.effect(placebo, law.choices)])
    return resampled(residual.runs, before, after, wrong)
