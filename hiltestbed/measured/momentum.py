"""Momentum balance: comparison of the logged pose with the motion that the logged force causes on the believed bodies.

The bodies float freely, so the relative motion of the ports follows from the wrench alone::

    x(t) = x0 + v0 t - s integral integral L W dt dt,    L = the sum over both bodies of their inverse inertia seen at the port

s is 1 if the units of mass, force and length are consistent, whatever contact, sensor and compensation do. A force in pounds makes it
4.448, a reversed sign -1, and exchanged axes leave motion that no s explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from hiltestbed.frames import Array, quat_from_attitude_deg, rotation_matrix
from hiltestbed.measured.record import Record
from hiltestbed.numerical_model.bodies import inertia_matrix, port_pose
from hiltestbed.scenario import Scenario

PLACES = ("px", "py", "pz")
FORCES = ("fx", "fy", "fz")
GAP_LIMIT = 0.02  # part of the rows that may be missing: an impulse that was not logged cannot be integrated
BETTER = 0.02  # part of the motion that another order or other signs must explain in addition
CLEAR = 50.0  # least motion that the force causes, in units of the pose's noise


@dataclass(frozen=True)
class Momentum:
    """Momentum balance of one force and one pose.

    Attributes:
        force, pose: the groups. scale: s above, of all axes together; axes: axis to its own s, for axes that the force clearly moves.
        explained: part of the motion's sum of squares that s explains. order, signs: of the force's axes that explain it best.
        explained_in_order: the same part with the axes in that order and with these signs, for the best s > 0.
    """

    force: str
    pose: str
    scale: float
    axes: Mapping[str, float]
    explained: float
    order: tuple[str, ...]
    signs: tuple[int, ...]
    explained_in_order: float


def momentum(record: Record, scenario: Scenario, force: str, pose: str) -> Momentum | None:
    """The momentum balance of force and pose; None if axes or rows are missing or nothing moves."""
    names = [*(f"{pose}.{p}" for p in PLACES), *(f"{force}.{f}" for f in FORCES)]
    if centred(scenario) and {names[2], names[5]} <= set(record.columns()):
        names = [name for name in names if name in record.columns()]
    if not set(names) <= set(record.columns()):
        return None
    known = np.all([record.measured(name) for name in names], axis=0)
    rows = np.flatnonzero(known)
    if len(rows) < 50 or not _whole(rows, record, scenario):
        return None
    place, wrench = (_columns(record, n)[:, rows] for n in ([f"{pose}.{p}" for p in PLACES], _wrench(force)))
    scale = np.abs(place).max() or 1.0
    motion = _without_line(record.t[rows], place)
    noise = np.array([_roughness(p) for p in place])
    moved = np.sqrt(np.mean(motion**2, axis=1)) > np.maximum(CLEAR * noise, 1e-9 * scale)
    if not moved.any():
        return None
    parts = _Parts.of(record.t[rows], mobility(scenario), wrench, motion, scenario.tick)
    if not parts.driven.any():
        return None
    as_given = parts.fit(FORCES, (1, 1, 1))
    order, signs, best = parts.best(as_given)
    axes = {a: parts.axis(j) for j, a in enumerate("xyz") if moved[j] and np.sum(motion[j] ** 2) > 0.05 * np.sum(motion**2)}
    return Momentum(force, pose, as_given[0], {a: s for a, s in axes.items() if s}, as_given[1], order, signs, best)


@dataclass(frozen=True)
class _Parts:
    """Inner products of the motions that each column of the force causes on each axis, for the fit of every order and sign of the axes.

    Attributes:
        driven: (10, 3, rows) motion by column j acting along axis i, at 3 i + j; by the torques last; all without their linear trend.
        gram: (10, 10) inner products of these with each other; shown: (10,) with the motion; square: of the motion with itself.
    """

    driven: Array
    motion: Array
    gram: Array
    shown: Array
    square: float

    @classmethod
    def of(cls, t: Array, response: Array, wrench: Array, motion: Array, tick: float) -> _Parts:
        doubled = _without_line(t, _twice(t, wrench, tick))
        along = [response[:, i, None] * doubled[j] for i in range(3) for j in range(3)]
        driven = np.stack([*along, response[:, 3:] @ doubled[3:]])
        flat = driven.reshape(10, -1)
        return cls(driven, motion, flat @ flat.T, flat @ motion.reshape(-1), float(np.sum(motion**2)))

    def fit(self, order: tuple[str, ...], signs: tuple[int, ...]) -> tuple[float, float]:
        """s, and the part of the motion's square sum that it explains; torques are scaled like the force or not, whichever fits better."""
        force = np.zeros(10)
        for i, (name, sign) in enumerate(zip(order, signs, strict=True)):
            force[3 * i + FORCES.index(name)] = sign
        torque = np.eye(10)[9]
        tied, apart = force + torque, force
        found = [(s, 1.0 - self._left(s * tied) / self.square) for s in [self._best(tied, np.zeros(10))]]
        found += [(s, 1.0 - self._left(s * apart + torque) / self.square) for s in [self._best(apart, torque)]]
        return found[0] if found[0][1] > found[1][1] - 0.01 else found[1]

    def _best(self, scaled: Array, fixed: Array) -> float:
        square = float(scaled @ self.gram @ scaled)
        return float(scaled @ (self.shown - self.gram @ fixed)) / square if square > 0 else 0.0

    def _left(self, weights: Array) -> float:
        return float(self.square - 2 * weights @ self.shown + weights @ self.gram @ weights)

    def best(self, as_given: tuple[float, float]) -> tuple[tuple[str, ...], tuple[int, ...], float]:
        """The order and signs that explain the motion best (the given ones unless others are clearly better), and the explained part."""
        found: tuple[tuple[str, ...], tuple[int, ...], float] = FORCES, (1, 1, 1), as_given[1]
        for order in permutations(FORCES):
            for signs in product((1, -1), repeat=3):
                s, part = self.fit(order, signs)
                if s > 0 and part > found[2] + BETTER:
                    found = order, signs, part
        return found

    def axis(self, j: int) -> float:
        """The s of axis j alone, with forces in the given order; 0 if the force along it causes no motion."""
        driven = sum(self.driven[4 * i][j] for i in range(3)) + self.driven[9][j]
        square = float(np.sum(driven**2))
        return float(np.sum(driven * self.motion[j])) / square if square > 0 else 0.0


def mobility(scenario: Scenario) -> Array:
    """``(3, 6)`` [1/kg, 1/(kg m)] acceleration of A relative to P, in P, by a unit wrench of A on P, at the start attitude."""
    turned = rotation_matrix(quat_from_attitude_deg(scenario.approach.attitude_deg))
    total = np.zeros((3, 6))
    for body, port_in_p in ((scenario.spacecraft.chaser, turned), (scenario.spacecraft.target, np.eye(3))):
        port = port_pose(body)
        to_body = rotation_matrix(port[3:]) @ port_in_p.T
        r, inertia = port[:3], inertia_matrix(body.inertia)
        lever = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
        turn = np.linalg.inv(inertia) @ np.hstack([lever, np.eye(3)])
        at_port = np.hstack([np.eye(3) / body.mass, np.zeros((3, 3))]) - lever @ turn
        total -= to_body.T @ at_port @ np.kron(np.eye(2), to_body)
    return total


def centred(scenario: Scenario) -> bool:
    """Whether only the axis of insertion moves, so that the other axes are zero by symmetry even if they were not measured."""
    approach, vehicles = scenario.approach, (scenario.spacecraft.chaser, scenario.spacecraft.target)
    still = (*approach.offset, *approach.velocity[:2], *approach.attitude_deg, *approach.rate_deg)
    ports = [v for body in vehicles for v in (*body.port.position[:2], *body.port.attitude_deg)]
    products = [v for body in vehicles for v in body.inertia[3:]]
    return not any((*still, *ports, *products))


def _columns(record: Record, names: list[str]) -> Array:
    """``(names, ticks)``; zero for columns that were not measured."""
    return np.stack([record.column(n) if n in record.columns() else np.zeros(record.ticks) for n in names])


def _wrench(group: str) -> list[str]:
    return [f"{group}.{part}" for part in (*FORCES, "tx", "ty", "tz")]


def _whole(rows: np.ndarray, record: Record, scenario: Scenario) -> bool:
    """Whether at most GAP_LIMIT of the rows that the file's sampling rate gives are missing."""
    stride = max(1.0, scenario.rate / record.sample_rate) if record.sample_rate else 1.0
    return len(rows) * stride > (1 - GAP_LIMIT) * (rows[-1] - rows[0]) and rows[0] < 0.2 * record.ticks


def _twice(t: Array, rate: Array, tick: float) -> Array:
    """Double integral of ``rate`` ``(3, rows)``; semi-implicit like the model's step if no tick is missing."""
    step = np.diff(t, prepend=t[0] - tick)
    return np.cumsum(np.cumsum(rate * step, axis=1) * step, axis=1)


def _without_line(t: Array, values: Array) -> Array:
    """``values`` ``(axes, rows)`` minus their best-fit line in t, so that start and speed do not count."""
    basis = np.stack([np.ones_like(t), t - t.mean()])
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    return values - (values @ basis.T) @ basis


def _roughness(values: Array) -> float:
    """1 sigma of the difference from sample to sample."""
    third = np.abs(np.diff(values, 3))
    return 1.4826 * float(np.median(third)) / np.sqrt(20.0) if len(third) else 0.0
