"""Identification of the sensor: sign, attitude, delay, and the gains and crosstalk that are needed
to explain the readings.

The wrench of the mechanism is computed from the platform's poses; the reading is that wrench
delayed, mixed, and rotated into the sensor's frame. Sign and attitude come from the best rotation
between the two (G. Wahba, SIAM Review 7, 1965; solved by F. L. Markley's singular values, J.
Astronautical Sciences 36, 1988), all parameters together from least squares. Gains and crosstalk
are added one at a time, each time the one that explains most, as long as it explains a good part of
the residual: 36 numbers at once would absorb every error.

A press cannot distinguish a wrong gain from a wrong stiffness: the stiffness of the mechanism in
the scenario is the reference. If the mechanism pushes in only one direction, other numbers are
indistinguishable as well: each estimate lists those that fit equally well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hiltestbed.build import runnable_from
from hiltestbed.devices.commission.platform import SIGNIFICANT, spread_of
from hiltestbed.frames import Array, rotation_matrix
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import AXES

ROWS = 6000  # largest number of rows, of all motions together, in a fit
WORTH = 0.2  # fraction of the residual sum of squares that one more number has to explain
LEAST = 5e-4  # smallest gain error or crosstalk that is reported
# [deg] smallest rotation of the axes that is reported: it puts 2e-3 of the force on a lateral axis
LEAST_TURN = 0.1
MOST = 8  # largest number of gains and crosstalk terms
FAR = 5.0  # times larger than another that fits equally well: the less likely number
TIE = 0.9  # of the best number's improvement: another that reaches it fits equally well
LONGEST = 0.05  # [s] largest delay that is fitted
FLOOR = 1e-5  # of the largest reading: noise assumed for channels without noise

Element = tuple[int, int]  # source and axis of a number


class Expected:
    """The wrench (N m, 6) that the nominal mechanism exerts at the poses that the platform reached,
    at the physics instants, in P at P's origin; the last of each tick is t_k.
    """

    def __init__(self, scenario: Scenario, poses: Array) -> None:
        """``poses`` (N, 7) of A in P at t_k."""
        data: dict[str, Any] = resolved(scenario) | {"effects": []}
        data["rig"]["platform"]["tracking"] = data["rig"]["upper"]["tracking"] = "ideal"
        believed = runnable_from(data)
        plant = plant_of([believed])
        still = np.zeros((1, 6))
        plant.reset(poses[None, 0], still)
        self._substeps, self._tick = believed.substeps, believed.tick
        self.wrench = np.zeros((len(poses) * self._substeps, 6))
        self.wrench[: self._substeps] = plant.wrench_sub[0, -1]
        for k in range(1, len(poses)):
            plant.advance(poses[None, k], still, still)
            self.wrench[k * self._substeps : (k + 1) * self._substeps] = plant.wrench_sub[0]

    def at(self, ticks: Array, delay: float) -> Array:
        """(K, 6) the wrench ``delay`` [s] before each of the ``ticks`` (K,), interpolated."""
        m = self._substeps
        instant = np.clip(m * ticks + m - 1 - delay / self._tick * m, 0.0, len(self.wrench) - 1.0)
        low = np.floor(instant).astype(int)
        high = np.minimum(low + 1, len(self.wrench) - 1)
        return self.wrench[low] + (instant - low)[:, None] * (self.wrench[high] - self.wrench[low])


@dataclass(frozen=True)
class Shown:
    """A motion: the expected wrench, and the reading (N, 6) in the sensor's frame less its tare."""

    expected: Expected
    reading: Array


@dataclass(frozen=True)
class Number:
    """A gain (``source`` = ``axis``) or a crosstalk: estimate, half the width of its 95 % interval,
    and (source, axis) of those that would fit equally well: the motions cannot distinguish them.
    """

    source: str
    axis: str
    value: float
    ci95: float
    or_else: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class SensorFit:
    """Estimates with the half width of their 95 % interval.

    Attributes:
        sign: of the wrench. attitude: quaternion (4,) of the sensor's frame in P. numbers: gains
            and crosstalk, in P.
        residual, reading: (6,) rms of the residual and of the reading, in the sensor's frame.
            misfit: residual sum of squares, in units of the noise variance.
        turn_deg: (3,) rotation vector of the sensor's axes against the given ones, to which the
            numbers then refer; None: they refer to P's axes.
    """

    sign: int
    attitude: Array
    attitude_ci95_deg: list[float]
    delay: float
    delay_ci95: float
    numbers: tuple[Number, ...]
    residual: list[float]
    reading: list[float]
    misfit: float = 0.0
    turn_deg: tuple[float, ...] | None = None

    def turned(self) -> bool:
        """Whether the axes differ significantly from the given ones."""
        if self.turn_deg is None:
            return False
        spread = SIGNIFICANT * np.array(self.attitude_ci95_deg)
        return bool(np.any(np.abs(self.turn_deg) > np.maximum(LEAST_TURN, spread)))


def fit_sensor(
    motions: Sequence[Shown], position: Array, noise: Array, given: Array | None = None
) -> SensorFit:
    """The sensor that fits all ``motions`` best.

    Args:
        position: (3,) nominal position of the sensor's origin in P. noise: (6,) standard deviation
            of its channels.
        given: quaternion (4,), nominal attitude of its frame in P: gains and crosstalk then act in
            its own axes, after the rotation; None: in P's axes, before it.
    """
    data = _Data(motions, position, noise, None if given is None else rotation_matrix(given))
    sign, rotation, delay = data.first_guess()
    chosen: list[Element] = []
    others: list[list[Element]] = []
    best = data.fit(sign, rotation, delay, chosen, np.zeros(0))
    while len(chosen) < MOST:
        candidate, *rivals = data.most_telling(sign, best, chosen)
        more = [*chosen, candidate]
        trial = data.fit(sign, best.rotation, best.delay, more, np.append(best.p[4:], 0.0))
        if trial.square > (1.0 - WORTH) * best.square or not trial.holds():
            break
        best, chosen = trial, more
        others.append(rivals)
    spread = best.spread()
    numbers = []
    for (i, j), v, ci95, rivals in zip(chosen, best.p[4:], spread[4:], others, strict=True):
        or_else = tuple((AXES[a], AXES[b]) for a, b in rivals)
        numbers.append(Number(AXES[i], AXES[j], float(v) + (i == j), float(ci95), or_else))
    turn = None
    if data.given is not None:
        turned = Rotation.from_matrix(best.rotation @ data.given.T)
        turn = tuple(turned.as_rotvec(degrees=True).tolist())
    return SensorFit(
        sign=sign,
        attitude=Rotation.from_matrix(best.rotation).as_quat(),
        attitude_ci95_deg=np.degrees(spread[:3]).tolist(),
        delay=best.delay,
        delay_ci95=float(spread[3] * 1e-3),
        numbers=tuple(numbers),
        residual=data.rms(best).tolist(),
        reading=np.sqrt(np.mean(data.reading**2, axis=0)).tolist(),
        misfit=best.square,
        turn_deg=turn,
    )


@dataclass
class _Fit:
    """``p``: (4 + numbers,) rotation vector relative to the start of the fit, delay [ms], numbers;
    ``rotation``: matrix of S in P.
    """

    p: Array
    rotation: Array
    delay: float
    square: float
    jacobian: Array

    def spread(self) -> Array:
        """(4 + numbers,) half widths of the 95 % intervals."""
        return spread_of(self.jacobian, self.square)

    def holds(self) -> bool:
        """Whether the number added last is significant."""
        return abs(self.p[-1]) > max(LEAST, SIGNIFICANT * self.spread()[-1])


class _Data:
    def __init__(
        self, motions: Sequence[Shown], position: Array, noise: Array, given: Array | None
    ) -> None:
        self.given = given
        total = sum(len(m.reading) for m in motions)
        every = max(total // ROWS, 1)
        self._parts = [
            (m.expected, np.arange(every, len(m.reading), every).astype(float), m.reading)
            for m in motions
        ]
        self._position = position
        readings = [_centred(reading[ticks.astype(int)]) for _, ticks, reading in self._parts]
        self.reading = np.concatenate(readings)
        rms = np.sqrt(np.mean(self.reading**2, axis=0))
        floor = FLOOR * np.repeat([rms[:3].max(), rms[3:].max()], 3)
        self._weight = 1.0 / np.maximum(np.maximum(noise, floor), 1e-12)

    def first_guess(self) -> tuple[int, Array, float]:
        """Sign, rotation matrix of S in P and delay [s] that fit the readings best."""
        found = []
        for delay in np.arange(0.0, LONGEST, 0.001):
            felt = self._at_sensor(self._wrench(delay))
            square = self.reading * self._weight
            for sign in (1, -1):
                rotation = _wahba(felt, sign * self.reading, self._weight)
                turned = sign * _turned(felt, rotation) * self._weight
                found.append((float(np.sum((square - turned) ** 2)), sign, rotation, float(delay)))
        return min(found, key=lambda item: item[0])[1:]

    def fit(
        self, sign: int, rotation: Array, delay: float, chosen: Sequence[Element], start: Array
    ) -> _Fit:
        """Least squares over rotation, delay and the ``chosen`` numbers, from ``start``."""

        def turned(p: Array) -> Array:
            return rotation @ Rotation.from_rotvec(p[:3]).as_matrix()

        def residuals(p: Array) -> Array:
            shown = self._shown(turned(p), 1e-3 * p[3], _calibration(chosen, p[4:]))
            return ((self.reading - sign * shown) * self._weight).ravel()

        first = np.concatenate([np.zeros(3), [1e3 * delay], start])
        fit = least_squares(residuals, first, method="lm")
        return _Fit(fit.x, turned(fit.x), float(1e-3 * fit.x[3]), float(2.0 * fit.cost), fit.jac)

    def most_telling(self, sign: int, fit: _Fit, chosen: Sequence[Element]) -> list[Element]:
        """The number that would reduce the sum of squares most, to first order; then its equals.

        Among equals, crosstalk from a force precedes that from a torque; a number :data:`FAR` times
        as large as another comes last: where a rotation puts a little of fz on x, a gain of 2 has
        the same result as crosstalk of 5 %.
        """
        shown = self._shown(fit.rotation, fit.delay, _calibration(chosen, fit.p[4:]))
        left = ((self.reading - sign * shown) * self._weight).ravel()
        basis, _ = np.linalg.qr(fit.jacobian)
        gains, sizes = {}, {}
        for candidate in ((i, j) for i in range(6) for j in range(6)):
            if candidate in chosen:
                continue
            unit = _calibration([candidate], [1.0]) - np.eye(6)
            column = sign * self._shown(fit.rotation, fit.delay, unit) * self._weight
            column = column.ravel()
            own = column - basis @ (basis.T @ column)
            square = float(own @ own)
            independent = square > 1e-9 * float(column @ column)
            gains[candidate] = float(own @ left) ** 2 / square if independent else 0.0
            if independent and (candidate[0] > 2) == (candidate[1] > 2):  # dimensionless
                sizes[candidate] = abs(float(own @ left)) / square
        most = max(gains.values())
        equal = [c for c in gains if gains[c] >= TIE * most]
        least = min((sizes[c] for c in equal if c in sizes), default=0.0)

        def order(c: Element) -> tuple[bool, bool, bool, bool, float]:
            far = sizes.get(c, 0.0) > FAR * least
            return far, c[0] != c[1], c[0] > 2, c[1] > 2, -gains[c]

        return sorted(equal, key=order)

    def rms(self, fit: _Fit) -> Array:
        """(6,) rms of the residual of each channel."""
        rows, columns = len(self.reading), len(fit.p)
        return np.sqrt(fit.square / (6.0 * rows - columns)) / self._weight

    def _wrench(self, delay: float) -> Array:
        parts = [_centred(expected.at(ticks, delay)) for expected, ticks, _ in self._parts]
        return np.concatenate(parts)

    def _at_sensor(self, wrench: Array) -> Array:
        """The wrench in P's axes, at the sensor's origin."""
        force = wrench[:, :3]
        return np.hstack([force, wrench[:, 3:] - np.cross(self._position, force)])

    def _shown(self, rotation: Array, delay: float, calibration: Array) -> Array:
        wrench = self._wrench(delay)
        if self.given is None:
            return _turned(self._at_sensor(wrench @ calibration.T), rotation)
        wrench = _turned(wrench, rotation @ self.given.T) @ calibration.T
        return _turned(self._at_sensor(wrench), self.given)


def _calibration(chosen: Sequence[Element], values: Sequence[float] | Array) -> Array:
    """(6, 6) matrix from wrench to reading, with ``values`` for the ``chosen`` (source, axis)."""
    out = np.eye(6)
    for (i, j), value in zip(chosen, values, strict=True):
        out[j, i] += value
    return out


def _turned(wrench: Array, rotation: Array) -> Array:
    """(N, 6) a wrench expressed in the axes of a frame with the given rotation matrix."""
    return np.hstack([wrench[:, :3] @ rotation, wrench[:, 3:] @ rotation])


def _centred(values: Array) -> Array:
    return values - values.mean(axis=0)


def _wahba(felt: Array, reading: Array, weight: Array) -> Array:
    """The rotation matrix R of S in P with reading = R^T felt, for forces and torques alike."""
    profile = np.zeros((3, 3))
    for part in (slice(0, 3), slice(3, 6)):
        scale = float(weight[part].max())
        profile += scale**2 * felt[:, part].T @ reading[:, part]
    u, _, vt = np.linalg.svd(profile)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
