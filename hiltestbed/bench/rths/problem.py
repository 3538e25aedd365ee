"""Structure, specimen, transfer system and indices of the benchmark; [in brackets] its files.

Degrees of freedom are those of the finite-element model, counted from 0. Displacements of actuators
are in mm, as in the block diagram; all else is in SI units.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.signal import correlate, correlation_lags

from hiltestbed.errors import InputError
from hiltestbed.frames import Array

SOURCE, COMMIT = "github:FermandoisLab/maRTHS-bmk-RoDeAC", "eb0f21b"
GROUNDS = ("ElCentro", "Kobe", "Morgan")
TICK, INTENSITY = 1.0 / 1024.0, 0.4  # [s]; of the ground acceleration [main_vmaRTHS.m]
STOREYS = (26, 25, 12)  # horizontal displacements, from below
SPECIMEN = (26, 28, 20)  # its displacement, and rotations of its other and its controlled node
NODE, UPPER = (26, 20), (25, 21, 12, 2)  # displacement and rotation of the node; storeys 2 and 3
NODE_SIGN = np.array([1.0, -1.0])  # the coupler counts rotations the other way round
MM = np.array([1000.0, 1.0])
ARM, ANGLE = math.hypot(0.26670, 0.127), math.radians(25.4633)  # [m], of the coupler, to its pins
NOISE = math.sqrt(1.5e-7 / TICK)  # [mm] of a reading: of the power, over a tick [S1_Input_Data.m]
NOISE_SEED = 123  # of both sensors: their noise is the same [S1_Input_Data.m]
INCH, STEEL = 0.0254, 200e9  # [m], [Pa]
# transfer functions [fcn_build_uncert_plant.m]: gains [output][input]; of each input the zeros
# [output] and poles [Hz], and their relative standard deviations; the pole of the frame, likewise
GAINS = np.array([[2165.2, 4.5394e6], [349.95, 1.9238e7]])
ZEROS = (([120.0, 90.0], [120.0, 90.0]), ([3.0], [5.0]))
POLES = ([2.65, 40.0], [3.5, 18.5])
SPREAD = ((0.055, 0.06), (0.03, 0.03))
FRAME, FRAME_SPREAD = 50.0 + 63.0j, 0.05
SAME_GAIN = 0.01  # [Hz] where an uncertain plant has the nominal gain

Complex = NDArray[np.complex128]
# from target and reading (n, 2) [mm] of a tick to its command
Method = Callable[[Array, Array], Array]


class Material(NamedTuple):
    """Of the public repository: mass and stiffness (29, 29) of the structure; records of ground
    acceleration (2, rows), time and value; the authors' initial filters (2, 4) and correlations.
    """

    mass: Array
    stiffness: Array
    ground: dict[str, Array]
    coefficients: Array
    correlation: Array


def read(data: Path) -> Material:
    """What is read of a clone of the repository. Raises InputError for a missing or other file."""
    from scipy.io import loadmat

    root = data / "maRTHS-bmk-RoDeAC" / "Support_files"
    sums = (files("hiltestbed.bench.rths") / "SHA256SUMS").read_text().split()
    for sha256, name in zip(sums[::2], sums[1::2], strict=True):
        path = root / name
        if not path.is_file():
            raise InputError(f"bench rths: no {path}; --data DIR has to be a clone of {SOURCE}")
        if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            raise InputError(
                f"bench rths: {path} is another file than the one that is described here (SHA-256 "
                f"{sha256[:12]}...); check out commit {COMMIT} of {SOURCE}"
            )
    model, start = root / "FE_Model/REF_SAP2000_Model", loadmat(root / "Initial_parameters.mat")
    return Material(
        np.loadtxt(model / "M_matrix.csv", delimiter=","),
        np.loadtxt(model / "K_matrix.csv", delimiter=","),
        {g: loadmat(root / f"Ground_motions/{g}AccelNoScaling.mat")[f"{g}Accel"] for g in GROUNDS},
        np.stack([start["theta0_1"][:, 0], start["theta0_2"][:, 0]]),
        np.stack([start["P0_1"], start["P0_2"]]),
    )


def sampled(ground: Array, intensity: float = INTENSITY) -> Array:
    """A record [m/s^2] at ticks, linear between its rows."""
    t = TICK * np.arange(math.floor(ground[0, -1] / TICK) + 1)
    return intensity * np.interp(t, *ground)


class Substructure(NamedTuple):
    """Mass, damping and stiffness."""

    mass: Array
    damping: Array
    stiffness: Array

    @classmethod
    def rayleigh(cls, mass: Array, stiffness: Array, low: float, high: float) -> Substructure:
        """With a damping ratio of 5 % at two frequencies [rad/s]."""
        beta = 2.0 * 0.05 / (low + high)
        return cls(mass, beta * (low * high * mass + stiffness), stiffness)


def reference(material: Material) -> Substructure:
    """The undivided structure [build_reference.m]."""
    return Substructure.rayleigh(material.mass, material.stiffness, 13.493, 165.125)


def planned_specimen() -> Substructure:
    """The specimen that is taken out of the structure, at SPECIMEN [build_physical_ideal.m].

    Density, a hundred times that of steel, and the sign of the coupling of its rotations, which a
    beam has the other way round, are those of the source.
    """
    beam, column, density = 0.762, 0.635, 785e3  # [m], [m], [kg/m^3]
    b, c = density * 0.947 * INCH**2 * beam, density * 1.670 * INCH**2 * column
    bend = 3.0 * STEEL * 2.520 * INCH**4 / column**2
    turn = 2.0 * STEEL * 0.6132 * INCH**4 / beam
    own = bend * column + 2.0 * turn
    stiffness = np.array(
        [[2.0 * bend / column, -bend, -bend], [-bend, own, -turn], [-bend, -turn, own]]
    )
    inertia = (b * beam**2 + c * column**2) / 24.0
    mass = np.diag([b + c, inertia, inertia])
    w = np.sqrt(eigh(stiffness, mass, eigvals_only=True))
    damping = Substructure.rayleigh(mass, stiffness, w[0], w[2]).damping
    return Substructure(np.diag([b + c, 0.0, 0.0]), damping, stiffness)


def without(whole: Substructure, part: Substructure) -> Substructure:
    """The numerical substructure [build_numerical.m]."""
    rest = Substructure(*(matrix.copy() for matrix in whole))
    for matrix, own in zip(rest, part, strict=True):
        matrix[np.ix_(SPECIMEN, SPECIMEN)] -= own
    return rest


def actual_specimen() -> Substructure:
    """The specimen that is tested and fed back: (29, 2) matrices from displacement [m] and rotation
    [rad] of the node to what it resists with [physicalFrame_feedbackForce.m].

    A portal frame on pins without axial strain, other rotations condensed statically. It is not the
    planned one: its columns have 0.7 of their stiffness, its mass is that of steel.
    """
    beam, column, density = 0.762, 0.64135, 7.85e3  # [m], [m], [kg/m^3]
    b, c = density * 7.56e-4 * beam, density * 1.670 * INCH**2 * column
    bend = 6.0 * STEEL * 0.7 * 2.520 * INCH**4 / column**2
    turn, cross = bend * column / 3.0, 2.0 * STEEL * 4.21372e-7 / beam
    own = 2.0 * (turn + cross)
    stiffness = np.array(
        [
            [4.0 * bend / column, bend, bend, bend, bend],
            [bend, own, cross, 0.0, turn],
            [bend, cross, own, turn, 0.0],
            [bend, 0.0, turn, 2.0 * turn, 0.0],
            [bend, turn, 0.0, 0.0, 2.0 * turn],
        ]
    )
    node, foot = (b * beam**2 + c * column**2) / 6.0, c * column**2 / 6.0
    mass = 1.1 * np.diag([b / 2.0 + c, node, node, foot, foot])
    squares, shapes = eigh(stiffness, mass)
    modal = np.diag(2.0 * 0.05 * np.round(np.sqrt(squares), 2))
    damping = mass @ shapes @ modal @ shapes.T @ mass
    follow = np.vstack([np.eye(2), -np.linalg.solve(stiffness[2:, 2:], stiffness[2:, :2])])
    place = np.zeros((29, 5))
    place[(26, 20, 28), (0, 1, 2)] = 1.0, -1.0, -1.0
    return Substructure(*(place @ matrix @ follow for matrix in (mass, damping, stiffness)))


class Newmark:
    """Newmark's method of average acceleration, for ``n`` runs from rest.

    ``added``: stiffness of a load that depends on the new position.
    """

    def __init__(self, structure: Substructure, n: int, added: Array | float = 0.0) -> None:
        self._mass, self._damping, stiffness = (matrix.T for matrix in structure)
        whole = stiffness + 2.0 / TICK * self._damping + 4.0 / TICK**2 * self._mass
        self._inverse = np.linalg.inv(whole + np.transpose(added))
        self._state = np.zeros((3, n, len(whole)))

    def step(self, load: Array) -> Array:
        """``(n, m)`` the position after a tick at whose end the ``load`` (n, m) acts."""
        x, v, a = self._state
        gone = 4.0 / TICK**2 * x + 4.0 / TICK * v + a
        new = load + gone @ self._mass + (2.0 / TICK * x + v) @ self._damping
        new = new @ self._inverse
        now = 4.0 / TICK**2 * new - gone
        self._state = np.stack([new, v + 0.5 * TICK * (a + now), now])
        return new


class Plants(NamedTuple):
    """Transfer functions of output, input: sum over p of residues (n, 2, 2, p)/(s - poles (n, 2,
    p)), a pole belonging to an input.
    """

    poles: Complex
    residues: Complex


def transfer(of: Plants, s: complex) -> Complex:
    """``(n, 2, 2)`` the transfer functions at ``s``."""
    return (of.residues / (s - of.poles[:, None])).sum(axis=-1)


def plants(count: int, rng: np.random.Generator) -> Plants:
    """The nominal transfer system and ``count`` uncertain ones [fcn_build_uncert_plant.m].

    Nine normal numbers a plant: zeros and poles of input 1, the frame, input 2: zero of output 1,
    poles, zero of output 2.
    """
    draws = np.vstack([np.zeros(9), rng.standard_normal((count, 9))])
    poles, residues = np.empty((count + 1, 2, 4), complex), np.empty((count + 1, 2, 2, 4), complex)
    for run, d in enumerate(draws):
        frame = FRAME * (1.0 + FRAME_SPREAD * d[4])
        for j, drawn in enumerate(((d[:2], d[:2], d[2:4]), (d[5:6], d[8:], d[6:8]))):
            moved = np.array(POLES[j]) * (1.0 + SPREAD[j][1] * drawn[2])
            p = poles[run, j] = -2.0 * np.pi * np.array([*moved, frame, frame.conjugate()])
            apart = np.prod(p[:, None] - p + np.eye(4), axis=1)
            for i in range(2):
                z = -2.0 * np.pi * np.array(ZEROS[j][i]) * (1.0 + SPREAD[j][0] * drawn[i])
                residues[run, i, j] = GAINS[i, j] * np.prod(p[:, None] - z, axis=1) / apart
    gain = np.abs(transfer(Plants(poles, residues), 2j * np.pi * SAME_GAIN))
    residues *= (gain[:1] / gain)[..., None]
    return Plants(poles, residues)


def ode4(x: Complex) -> Complex:
    """exp(x) by Runge and Kutta's method of fourth order, the block diagram's solver."""
    return 1.0 + x * (1.0 + x / 2.0 * (1.0 + x / 3.0 * (1.0 + x / 4.0)))


def to_actuators(node: Array) -> Array:
    """``(n, 2)`` [mm] for displacement [m] and rotation [rad] of the node (n, 2)."""
    angles = np.array([-ANGLE, ANGLE])
    return 1e3 * (node[:, :1] + ARM * (np.cos(node[:, 1:] + angles) - np.cos(angles)))


def to_node(reached: Array) -> Array:
    """The inverse of :func:`to_actuators`; in the displacement, the block diagram takes the sine of
    the rotation for the rotation. NaN where the coupler cannot be.
    """
    first, second = 1e-3 * reached.T
    sine = (first - second) / (2.0 * ARM * math.sin(ANGLE))
    x = first - ARM * (np.cos(sine - ANGLE) - math.cos(ANGLE))
    with np.errstate(invalid="ignore"):
        return np.stack([x, np.arcsin(sine)], axis=1)


def simulink_normal(seed: int, count: int) -> Array:
    """Simulink's normal numbers (``seed`` below 32768): the uniform ones of S. K. Park and K. W.
    Miller (Comm. ACM 31, 1988), and of a pair by G. Marsaglia's polar method the first.
    """
    state, found = seed << 16, []
    while len(found) < count:
        u, v = (2.0 * (state := 16807 * state % 2147483647) / 2147483647 - 1.0 for _ in range(2))
        if (square := u * u + v * v) <= 1.0:
            found.append(math.sqrt(-2.0 * math.log(square) / square) * u)
    return np.array(found)


def noise(ticks: int, count: int, rng: np.random.Generator) -> Array:
    """``(ticks, 1 + count)`` [mm]: of the readings with the nominal plant, and drawn ones."""
    nominal = simulink_normal(NOISE_SEED, ticks)
    return NOISE * np.column_stack([nominal, rng.standard_normal((ticks, count))])


class RthsRecord(NamedTuple):
    """Rows by tick of ``n`` runs: target, measured displacement and command (ticks, n, 2) of the
    actuators [mm]; measured and computed motion (ticks, n, 2) of the node [mm, rad]; displacement
    and rotation of storeys 2 and 3 (ticks, n, 4) [m, rad].
    """

    target: Array
    measured: Array
    command: Array
    reached: Array
    node: Array
    upper: Array


def push(structure: Substructure) -> Array:
    """(m,) load of a unit ground acceleration."""
    return -structure.mass[:, STOREYS].sum(axis=1)


def hybrid(
    rest: Substructure, fed_back: Substructure | None, ground: Array, of: Plants, readings: Array,
    method: Callable[[int], Method], growth: Callable[[Complex], Complex] = ode4,
) -> RthsRecord:  # fmt: skip
    """The hybrid simulation from rest; NaN once a reading is no position of the coupler.

    Args:
        fed_back: the specimen; None: no force. readings: ``(ticks, n)`` their noise [mm]. method:
            for a number of runs. growth: of a pole over a tick.
    """
    n, load = len(of.poles), push(rest)
    solver, command = Newmark(rest, n), method(n)
    state, keep = np.zeros_like(of.poles), growth(TICK * of.poles)
    take = (keep - 1.0) / of.poles
    record = RthsRecord(*(np.full((len(ground), n, w), np.nan) for w in (2, 2, 2, 2, 2, 4)))
    rate, alive = np.zeros((n, 2)), np.ones((n, 1), dtype=bool)
    here = to_node(readings[0, :, None] + rate)
    for k, shaken in enumerate(ground):
        measured = np.einsum("nijp,njp->ni", of.residues, state).real + readings[k, :, None]
        before, here, rate_before = here, to_node(measured), rate
        alive &= np.isfinite(here).all(axis=1, keepdims=True)
        rate = (here - before) / TICK  # as Simulink's Derivative takes it
        loads = np.tile(load * shaken, (n, 1))
        if fed_back is not None:
            moved = ((rate - rate_before) / TICK, rate, here)
            loads -= sum(m @ part.T for m, part in zip(moved, fed_back, strict=True))
        position = solver.step(np.where(alive, loads, 0.0))
        node = NODE_SIGN * position[:, NODE]
        target = to_actuators(node)
        done = command(*(np.where(alive, x, 0.0) for x in (target, measured)))
        state = keep * state + take * np.where(alive, done, 0.0)[:, :, None]
        row = (target, measured, done, MM * here, MM * node, position[:, UPPER])
        for rows, value in zip(record, row, strict=True):
            rows[k] = np.where(alive, value, np.nan)
    return record


def undivided(whole: Substructure, fed_back: Substructure | None, ground: Array) -> RthsRecord:
    """The reference: without actuators, or with a specimen, if any, that is moved without error.

    With the backward differences of the hybrid simulation the specimen resists with K + C/h + M/h^2
    times the new motion of the node, which stands on the left side, and with terms of the old one.
    """
    new = viscous = inertial = np.zeros((len(whole.mass), 2))
    if fed_back is not None:
        viscous, inertial = fed_back.damping / TICK, fed_back.mass / TICK**2
        new = fed_back.stiffness + viscous + inertial
    take = np.zeros((2, len(whole.mass)))
    take[(0, 1), NODE] = NODE_SIGN
    solver, load = Newmark(whole, 1, new @ take), push(whole)
    z, step, rows = np.zeros(2), np.zeros(2), []
    for shaken in ground:
        rows.append(solver.step(load * shaken + viscous @ z + inertial @ (z + step)))
        z, step = take @ rows[-1][0], take @ rows[-1][0] - z
    course = np.array(rows)
    node = NODE_SIGN * course[:, :, NODE]
    target = to_actuators(node[:, 0])[:, None]
    return RthsRecord(target, target, target, MM * node, MM * node, course[:, :, UPPER])


def late(signal: Array, of: Array) -> int:
    """Delay [ticks] at the largest magnitude of the cross-correlation (MATLAB's ``finddelay``)."""
    size = np.abs(correlate(signal, of, method="fft"))
    return int(correlation_lags(len(signal), len(of))[np.argmax(size)])


def indices(record: RthsRecord, run: int, right: RthsRecord) -> dict[str, list[float]] | None:
    """J1 to J10 of a run beside the reference, None if it was lost [S5_Evaluation.m].

    With t the target of an actuator, m its measured displacement; z the measured motion of the
    node, c the computed and r the reference's; u the computed motion of an upper storey, w the
    reference's:

    - J1 = delay of m from t, at the largest cross-correlation [ms]; J4 is the same in the source
    - J2 = 100 std(m - t)/std(t); J3 = 100 max|m - t|/max|t|
    - J5 = 100 std(z - c)/std(c); J6 = 100 max|z - c|/max|c|
    - J7 = 100 std(z - r)/std(r); J9 = 100 max|z - r|/max|r|
    - J8 = 100 std(u - w)/std(w); J10 = 100 max|u - w|/max|w|
    """
    t, m, _, z, c, u = (rows[:, run] for rows in record)
    r, w = right.node[:, 0], right.upper[:, 0]
    if np.isnan(t).any():
        return None
    found = {"J1": [1e3 * TICK * late(m[:, i], t[:, i]) for i in range(2)]}
    found["J4"] = found["J1"]
    for of_std, of_peak, a, b in (
        ("J2", "J3", m, t),
        ("J5", "J6", z, c),
        ("J7", "J9", z, r),
        ("J8", "J10", u, w),
    ):
        found[of_std] = (100.0 * np.std(a - b, axis=0) / np.std(b, axis=0)).tolist()
        found[of_peak] = (100.0 * np.abs(a - b).max(axis=0) / np.abs(b).max(axis=0)).tolist()
    return {f"J{i}": found[f"J{i}"] for i in range(1, 11)}
