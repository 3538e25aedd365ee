"""Momentum balance: comparison of the logged pose with the motion that the logged force causes on
the believed bodies.

The bodies float freely, so the relative motion of the ports follows from the wrench alone::

    x(t) = x0 + v0 t - s integral integral L W dt dt
    L = the sum over both bodies of their inverse inertia seen at the port

s is 1 if the units of mass, force and length are consistent, whatever contact, sensor and
compensation do. A force in pounds makes it 4.448, a reversed sign -1, and exchanged axes leave
motion that no s explains.

A delay or a filter between force and motion keeps the impulse and makes s wrong by some per cent;
of an oscillation the cosine of its phase is left, and the sine is motion that no s explains.

This checks unit, sign and axes of force and pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.noise import white_noise
from hiltestbed.measured.ratio import (
    AGREE,
    CLEAR,
    EXPLAINED,
    OTHER_UNIT,
    REMAINDER,
    factor_text,
    likely_scale,
    scale_fix,
)
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.start import start_of
from hiltestbed.measured.survey import Survey
from hiltestbed.numerical_model.bodies import mobility
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

PLACES = ("px", "py", "pz")
FORCES = ("fx", "fy", "fz")
# part of the rows that may be missing: an impulse that was not logged cannot be integrated
GAP_LIMIT = 0.02


@dataclass(frozen=True)
class Momentum:
    """Momentum balance of one force and one pose.

    Attributes:
        force, pose: the groups. scale: s above. axes: those that clearly move.
        explained: part of the motion's sum of squares that s explains. order, signs: of the force's
            axes that explain it best.
        explained_in_order: the same part with the axes in that order and with these signs, for the
            best s > 0.
    """

    force: str
    pose: str
    scale: float
    axes: tuple[str, ...]
    explained: float
    order: tuple[str, ...]
    signs: tuple[int, ...]
    explained_in_order: float


def momentum(record: Record, scenario: Scenario, force: str, pose: str) -> Momentum | None:
    """The momentum balance of force and pose; None if axes or rows are missing or nothing moves.

    Torques that were not measured count as zero where a tip meets a plane, whose torque about the
    port is small, or all is centred. In a cone or a latch they move the ports as much as the forces
    do.
    """
    places, wrench = [f"{pose}.{p}" for p in PLACES], list(GROUPS[force].columns)
    there = {name for name in (*places, *wrench) if record.has(name)}
    symmetric = centred(scenario)
    along_z = symmetric and {places[2], wrench[2]} <= there
    if not along_z and not {*places, *wrench[:3]} <= there:
        return None
    if not (set(wrench) <= there or scenario.mechanism.flat or symmetric):
        return None
    rows = np.flatnonzero(np.all([record.measured(name) for name in there], axis=0))
    stride = max(1.0, scenario.rate / record.sample_rate) if record.sample_rate else 1.0
    if len(rows) < 50 or rows[0] >= 0.2 * record.ticks:
        return None
    if len(rows) * stride <= (1 - GAP_LIMIT) * (rows[-1] - rows[0]):
        return None
    t, place = record.t[rows], _columns(record, places)[:, rows]
    motion = _without_line(t, place)
    noise = np.array([white_noise(p) for p in place])
    least = np.maximum(CLEAR * noise, 1e-9 * (np.abs(place).max() or 1.0))
    moved = np.sqrt(np.mean(motion**2, axis=1)) > least
    if not moved.any():
        return None
    given = _columns(record, wrench)[:, rows]
    if not given.any():
        return None
    fits = _Fits(t, -mobility(scenario.spacecraft)[:3], given, motion, scenario.tick)
    scale, explained = fits.fit(FORCES, (1, 1, 1))
    order, signs, best = fits.best(explained)
    large = moved & (np.sum(motion**2, axis=1) > 0.05 * np.sum(motion**2))
    axes = tuple(axis for axis, far in zip("xyz", large, strict=True) if far)
    return Momentum(force, pose, scale, axes, explained, order, signs, best)


class _Fits:
    """Fits of the logged motion by the force, for every order and sign of its axes."""

    def __init__(
        self, t: Array, response: Array, wrench: Array, motion: Array, tick: float
    ) -> None:
        """``motion`` (3, rows): without its linear trend. ``response`` (3, 6): acceleration of A
        in P per wrench of A on P.
        """
        step = np.diff(t, prepend=t[0] - tick)  # semi-implicit like the model's
        doubled = np.cumsum(np.cumsum(wrench * step, axis=1) * step, axis=1)
        # by column j of the force acting along axis i, at 3 i + j; by the torques last
        driven = [response[:, i, None] * doubled[j] for i in range(3) for j in range(3)]
        driven.append(response[:, 3:] @ doubled[3:])
        seen = np.stack([_without_line(t, part).reshape(-1) for part in driven])
        self._gram, self._shown = seen @ seen.T, seen @ motion.reshape(-1)
        self._square = float(np.sum(motion**2))

    def fit(self, order: tuple[str, ...], signs: tuple[int, ...]) -> tuple[float, float]:
        """s for one order and signs, and the part of the motion's square that it explains; torques
        scale with the force or not, as fits better.
        """
        force = np.zeros(10)
        for i, (name, sign) in enumerate(zip(order, signs, strict=True)):
            force[3 * i + FORCES.index(name)] = sign
        torque = np.eye(10)[9]
        tied, apart = self._fit(force + torque, np.zeros(10)), self._fit(force, torque)
        return tied if tied[1] > apart[1] - 0.01 else apart

    def _fit(self, scaled: Array, fixed: Array) -> tuple[float, float]:
        square = float(scaled @ self._gram @ scaled)
        left = float(scaled @ (self._shown - self._gram @ fixed))
        s = left / square if square > 0 else 0.0
        weights = s * scaled + fixed
        rest = self._square - 2 * weights @ self._shown + weights @ self._gram @ weights
        return s, 1.0 - float(rest) / self._square

    def best(self, explained: float) -> tuple[tuple[str, ...], tuple[int, ...], float]:
        """The order and signs that explain the motion best, and the explained part. The given ones
        have ``explained`` it; where that is enough, the order is not in question.
        """
        found: tuple[tuple[str, ...], tuple[int, ...], float] = (FORCES, (1, 1, 1), explained)
        orders = permutations(FORCES) if explained < EXPLAINED else [FORCES]
        for order, signs in product(orders, product((1, -1), repeat=3)):
            s, part = self.fit(order, signs)
            if s > 0 and part > found[2]:
                found = order, signs, part
        return found


def centred(scenario: Scenario) -> bool:
    """Whether nothing moves beside the axis of insertion: other axes are zero, measured or not."""
    approach, vehicles = scenario.approach, (scenario.spacecraft.chaser, scenario.spacecraft.target)
    still = (*approach.offset, *approach.velocity[:2], *approach.attitude_deg, *approach.rate_deg)
    ports = [v for body in vehicles for v in (*body.port.position[:2], *body.port.attitude_deg)]
    products = [v for body in vehicles for v in body.inertia[3:]]
    return not any((*still, *ports, *products))


def _columns(record: Record, names: list[str]) -> Array:
    """``(names, ticks)``; zero for columns that were not measured."""
    zero = np.zeros(record.ticks)
    return np.stack([record.column(n) if record.has(n) else zero for n in names])


def _without_line(t: Array, values: Array) -> Array:
    """``values`` ``(axes, rows)`` minus their best line in t: start and speed do not count."""
    basis = np.stack([np.ones_like(t), t - t.mean()])
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    return values - (values @ basis.T) @ basis


def balances(record: Record, scenario: Scenario) -> dict[str, Momentum]:
    """The momentum balance of each force (by its group) with the pose, where it can be evaluated.

    The commanded pose follows from wrench_comp by the law of the numerical model. Without
    wrench_comp, or with a reached pose only, the force must have moved the bodies: assumed if they
    approach with the scenario's speed, but not for a driven machine.
    """
    pose = "pose_cmd" if record.has("pose_cmd") else "pose_act"
    modelled = record.has("wrench_comp") and pose == "pose_cmd"
    if not (modelled or any(scenario.approach.velocity)):
        return {}
    forces = (f for f in ("wrench_comp", "wrench_meas") if record.has(f))
    found = {force: momentum(record, scenario, force, pose) for force in forces}
    return {force: pair for force, pair in found.items() if pair is not None}


def imbalances(
    record: Record, found: Survey, scenario: Scenario, pairs: dict[str, Momentum]
) -> Iterator[Remark]:
    """Errors for a force that cannot have caused the recorded motion."""
    for pair in pairs.values():
        left, left_in_order = 1.0 - pair.explained, 1.0 - pair.explained_in_order
        otherwise = left_in_order < REMAINDER * left
        if otherwise and pair.order != FORCES:
            yield _exchanged(record, pair)
        elif otherwise and -1 in pair.signs:
            yield from _turned(record, pair)
        elif pair.explained > EXPLAINED:
            yield from _scaled(record, found, scenario, pair)


def _seen(pair: Momentum, change: str) -> str:
    return (
        f"does not explain the motion of {pair.pose} ({100 * max(pair.explained, 0.0):.0f} % of "
        f"it); {change} it explains {100 * pair.explained_in_order:.0f} %"
    )


def _exchanged(record: Record, pair: Momentum) -> Remark:
    moved = [(given, f) for given, f in zip(FORCES, pair.order, strict=True) if given != f]
    text = _seen(pair, "with its axes exchanged")
    taken = ", ".join(f"{pair.force}.{a} takes the column of {pair.force}.{b}" for a, b in moved)
    fix = f"exchange the columns under channels: {taken}"
    name = f"{pair.force}.{moved[-1][0]}"
    return error("axes", record.run, name, f"{text}: the axes are swapped", fix)


def _turned(record: Record, pair: Momentum) -> Iterator[Remark]:
    text = f"{_seen(pair, 'with this axis reversed')}: the sign is reversed"
    for part, sign in zip(FORCES, pair.signs, strict=True):
        name = f"{pair.force}.{part}"
        if sign < 0:
            yield error("sign", record.run, name, text, scale_fix(name, -1.0))


def _scaled(record: Record, found: Survey, scenario: Scenario, pair: Momentum) -> Iterator[Remark]:
    start = start_of(record, found, scenario, f"{pair.pose}.pz")
    scale, size = pair.scale, abs(pair.scale)
    # whether the start of the pose shows the same factor or sign: then its unit is wrong
    at_fault = False
    if start is not None:
        apart = abs(math.log((start.unit or 1.0) / max(size, 1e-300)))
        same_size = start.unit is not None and apart < 2.0 * math.log(AGREE)
        at_fault = same_size or (scale < 0 and start.reversed)
    # the columns of the force that clearly move the pose; at least z
    moving = [f"{pair.force}.f{axis}" for axis in dict.fromkeys(("z", *pair.axes))]
    if not at_fault and scale < 0:
        text = (
            f"pulls while pushing: the motion of {pair.pose} is {scale:.3g} times what "
            f"it causes; the sign is reversed"
        )
        for name in moving:
            yield error("sign", record.run, name, text, scale_fix(name, -1.0))
    if 1 / OTHER_UNIT < size < OTHER_UNIT or at_fault:
        return
    text = (
        f"mass times the change of velocity in {pair.pose} is {size:.4g} times the "
        f"impulse of the force: {factor_text(1.0 / size, 'N')}"
    )
    for name in moving:
        fix = scale_fix(name, likely_scale(1.0 / size, "N"))
        yield error("unit", record.run, name, text, fix)
