"""Contacts whose wrench does not follow from the pose of A in P alone, simulated by MuJoCo along
recorded paths.

Moving parts, phases of capture and native pairs have no closed form. The sides are carried along
the path as with ideal tracking (:mod:`hiltestbed.platform.ideal`), from the first row on, with the
force law of a hypothesis. For a platform with a servo, the motion within a tick is one that the
servo's steps can have produced between the rows. Free flight before the first contact does not
depend on the hypothesis, so it is simulated once for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.compiled.state import arrays_of
from hiltestbed.compiled.warm import threads
from hiltestbed.contact.composition import carried_by, structure_of
from hiltestbed.contact.mount import CARRIER, MOUNTED
from hiltestbed.contact.parameters import (
    FRICTION,
    OFFSET,
    TILT_X,
    TILT_Y,
    MechanismParameters,
    mechanism_parameters,
)
from hiltestbed.contact.settings import Mechanism
from hiltestbed.contact.sides import sides_of
from hiltestbed.frames import Array, pose_step, twist_between
from hiltestbed.platform.build import built
from hiltestbed.platform.facilities.composed import BODY
from hiltestbed.platform.facilities.facility import Runs
from hiltestbed.platform.kinds import PLATFORMS
from hiltestbed.platform.parameters import PlatformParameters, RigParameters
from hiltestbed.platform.plant import Plant
from hiltestbed.replay.felt import Kept

TOGETHER = 32  # lanes that are stepped in one batch
# [m] least distance of the sides during free flight; a hypothesis may shift a surface by half of it
CLEAR = 0.01
EVERY = 16  # rows between two checks of the distance


class Engaged(NamedTuple):
    """Results of a run as A is carried along its path.

    Attributes:
        wrench: (N, m, 6) [N, N m] at the instants of the tick that ends at each row. depth: (N,)
            [m] of the deepest contact at each row, negative while apart.
        taken: (N, 6) [N, N m] in P at P's origin, the rate of change of the momentum of moving
            parts on both sides, beyond that of the same parts at rest on their side. Added to the
            wrench at the sensor, it gives the load on an A whose parts are fixed.
    """

    wrench: Array
    depth: Array
    taken: Array

    @property
    def between(self) -> Array:
        """(N, m, 6) difference of the wrench from linear interpolation between rows."""
        m = self.wrench.shape[1]
        before = np.concatenate([self.wrench[:1, -1:], self.wrench[:-1, -1:]])
        return np.asarray(
            self.wrench - before - np.arange(1, m + 1)[:, None] / m * (self.wrench[:, -1:] - before)
        )


class Flight(NamedTuple):
    """The free flight of all runs, until the first of them comes near a contact.

    Attributes:
        row: its last row. wrench: (R, row + 1, m, 6). arm: [m] from W's origin to the farthest
            point of any geom. state: of the plant of all R runs at that row: the arrays that have
            changed since the start, by name.
    """

    row: int
    wrench: Array
    arm: float
    state: dict[str, Array]

    def holds(self, laws: Array) -> bool:
        """Whether ``laws`` (..., PARAMETERS) shift no surface by over half of :data:`CLEAR`."""
        tilt = np.hypot(laws[..., TILT_X], laws[..., TILT_Y])
        shift = np.abs(laws[..., OFFSET]) + self.arm * tilt
        return bool(shift.max(initial=0.0) < 0.5 * CLEAR)

    def resume(self, plant: Plant, runs: Sequence[int]) -> None:
        """Set ``plant``, which has been reset and whose lanes belong to ``runs``, to their state at
        the end of the flight.
        """
        live, count = _live(plant), len(self.wrench)
        for name, array in self.state.items():
            of_lanes = array.shape[:1] == (count,) and live[name].shape[:1] == (len(runs),)
            live[name][...] = array[list(runs)] if of_lanes else array


def fly(plant: Plant, rows: Iterator[int]) -> Flight:
    """The flight of ``plant``, with nominal contacts, as the iterator ``rows`` carries it from row
    to row.
    """
    live, began = _live(plant), dict[str, Array]()
    apart, wrench, last, state, arm = _Apart(plant), list[Array](), -1, dict[str, Array](), 0.0
    for k in rows:
        if k == 0:
            began = {name: array.copy() for name, array in live.items()}
        wrench.append(plant.wrench_sub.copy())
        if k % EVERY:
            continue
        if (
            not apart.clear()
            or plant.captured.any()
            or (plant.phases is not None and plant.phases.begun.any())
        ):
            break
        last, arm = k, max(arm, apart.arm())
        state = {
            name: array.copy()
            for name, array in live.items()
            if not np.array_equal(array, began[name], equal_nan=array.dtype.kind == "f")
        }
    return Flight(
        last, np.stack(wrench[: last + 1], axis=1) if last >= 0 else np.empty((0, 0)), arm, state
    )


def _live(plant: Plant) -> dict[str, Array]:
    """The state of a plant, including the activations of its actuators, which none of its blocks
    store.
    """
    activations = {"act": plant.watch("act", 1)} if plant.model.na else {}
    return arrays_of(plant) | activations


class _Apart:
    """Distances between the geoms that may touch, in a plant of R runs."""

    def __init__(self, plant: Plant) -> None:
        self._model, self._met = plant.model, plant.contacts().met
        self._data = mujoco.MjData(plant.model)
        self._place, self._turn = plant.watch("geom_xpos", 3), plant.watch("geom_xmat", 9)
        names = [f"native_{k}" for k in range(self._met.shape[1])]
        pairs = [
            self._model.pair(name)
            for name in names
            if mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_PAIR, name) >= 0
        ]
        self._native = [(int(p.geom1.item()), int(p.geom2.item())) for p in pairs]

    def clear(self) -> bool:
        """Whether all distances, in every run, exceed :data:`CLEAR`."""
        facets = self._met.shape[1] - len(self._native)
        if not (self._met[:, :facets, 0] < -CLEAR).all():
            return False
        for i in range(len(self._met)):
            self._data.geom_xpos[:], self._data.geom_xmat[:] = self._place[i], self._turn[i]
            if any(
                mujoco.mj_geomDistance(self._model, self._data, *pair, CLEAR, None) < CLEAR
                for pair in self._native
            ):
                return False
        return True

    def arm(self) -> float:
        """Distance from W's origin to the farthest point of any geom [m]."""
        return float(
            (np.linalg.norm(self._place, axis=2) + self._model.geom_rbound).max(initial=0.0)
        )


class Simulated:
    """Recorded paths, and the sides that are carried along them.

    Attributes:
        poses: (R, N, 7) of A in P at t_k. tick: [s]. substeps: physics instants per tick.
        kept: cached contact wrenches of the latest replays.
    """

    def __init__(
        self,
        mechanisms: Sequence[Mechanism],
        start: Array,
        rig: Runs,
        poses: Array,
        rates: Array | None = None,
    ) -> None:
        """``mechanisms``: nominal, of one shape, of the R runs. ``start``: (R, 13) of A in P.
        ``rig``: gives tick and substeps. ``rates``: (R, N, 6) twist at t_k, None: A moves uniformly
        within a tick.
        """
        self.poses, self._rates, self._start = poses, rates, start
        self.tick, self.substeps = rig.tick, rig.substeps
        self.kept = Kept()
        self._mechanisms = mechanisms
        none = [()] * len(mechanisms)
        self._nominal = mechanism_parameters(mechanisms, none, sides_of(mechanisms[0]).rules)
        self._believed: dict[int, Engaged] = {}
        self._flights: dict[bool, Flight | None] = {}

    def instants(self, grid: int | None) -> int:
        """Number of instants per tick to compute: always those of the physics."""
        return self.substeps

    def exerted(self, wanted: Sequence[tuple[int, Array]]) -> list[Array]:
        """(N, m, 6) contact wrench [N, N m], for each run with the laws (C + 1, PARAMETERS) of its
        candidates and its latch, at the instants of the tick that ends at each row.
        """
        groups: dict[bool, list[int]] = {}
        for i, (_, laws) in enumerate(wanted):
            groups.setdefault(_rubs(laws), []).append(i)
        out: dict[int, Array] = {}
        for members in groups.values():
            for first in range(0, len(members), TOGETHER):
                some = members[first : first + TOGETHER]
                runs, laws = zip(*(wanted[i] for i in some), strict=True)
                out |= zip(some, self._together(runs, np.stack(laws)), strict=True)
        return [out[i] for i in range(len(wanted))]

    def believed(self, run: int) -> Engaged:
        """The run with the nominal mechanism."""
        if run not in self._believed:
            plant, count = self._plant([run], self._nominal.laws[[run]]), self.poses.shape[1]
            on_A, on_P = (
                carried_by(plant.model, c)[1]
                for c in (BODY, MOUNTED if self._mechanisms[run].mount else CARRIER)
            )
            parts = [*on_A, *on_P]
            wrench, depth = np.empty((count, self.substeps, 6)), np.full(count, -1.0)
            places, turns = np.zeros((count, len(parts), 3)), np.zeros((count, len(parts), 3, 3))
            met = plant.contacts().met
            place, turn = plant.watch("xipos", 3), plant.watch("ximat", 9)
            for k in self._carry(plant, [run]):
                wrench[k], depth[k] = plant.wrench_sub[0], met[0, :, 0].max(initial=-1.0)
                places[k] = place[0, parts]
                turns[k] = turn[0, parts].reshape(len(parts), 3, 3)
            taken = _rate_of_momentum(
                plant.model, on_A, on_P, self.poses[run], places, turns, self.tick
            )
            self._believed[run] = Engaged(wrench, depth, taken)
        return self._believed[run]

    def _together(self, runs: Sequence[int], laws: Array) -> Array:
        """(L, N, m, 6) contact wrenches of runs with ``laws`` of which all rub, or none."""
        plant = self._plant(runs, laws, min(threads(), len(runs)))
        flight = self._flight(_rubs(laws))
        wrench = np.empty((len(runs), self.poses.shape[1], self.substeps, 6))
        if flight is not None and flight.holds(laws):
            wrench[:, : flight.row + 1] = flight.wrench[list(runs)]
        else:
            flight = None
        for k in self._carry(plant, runs, flight):
            wrench[:, k] = plant.wrench_sub
        return wrench

    def _flight(self, rubs: bool) -> Flight | None:
        """The free flight of all runs in plants with or without friction; None if there is none."""
        if rubs not in self._flights:
            self._flights[rubs], laws = None, self._nominal.laws
            if {_rubs(rows) for rows in laws} == {rubs}:
                runs = range(len(self.poses))
                plant = self._plant(runs, laws)
                flight = fly(plant, self._carry(plant, runs))
                self._flights[rubs] = flight if flight.row > 0 else None
        return self._flights[rubs]

    def _plant(self, runs: Sequence[int], laws: Array, nthread: int = 1) -> Plant:
        """The mechanisms of ``runs`` with ``laws`` (L, C + 1, PARAMETERS), under ideal tracking."""
        n, lanes, (_, mounts, closing) = len(runs), list(runs), self._nominal
        springs = None if mounts is None else (mounts[0][lanes], mounts[1][lanes])
        platform = PLATFORMS["pss33"].model_validate({"kind": "pss33", "tracking": "ideal"})
        # not constant: the model computes every contact
        structure = structure_of(self._mechanisms[lanes[0]], ())
        parameters = RigParameters(
            built(platform),
            replace(structure, constant=False, rubs=_rubs(laws)),
            Runs(self.tick, self.substeps, [platform] * n, np.ones(n, dtype=bool)),
            MechanismParameters(laws, springs, closing[lanes]),
            [PlatformParameters(self.tick)] * n,
            False,
            self._start[lanes],
        )
        return Plant(parameters, nthread)

    def _carry(
        self, plant: Plant, runs: Sequence[int], flight: Flight | None = None
    ) -> Iterator[int]:
        """Carry the sides of the runs along their paths, from the end of the ``flight`` on; yields
        each row as it is reached.
        """

        def by_row(values: Array) -> Array:
            return np.ascontiguousarray(values[list(runs)].swapaxes(0, 1))

        paths, rates = by_row(self.poses), None if self._rates is None else by_row(self._rates)
        count, lanes = paths.shape[:2]
        still, poses = np.zeros((lanes, 6)), np.empty((self.substeps, lanes, 7))
        twists, dt = np.empty((self.substeps, lanes, 6)), self.tick / self.substeps
        plant.reset(paths[0], self._start[list(runs), 7:])
        if flight is not None:
            flight.resume(plant, runs)
        for k in range(0 if flight is None else flight.row + 1, count):
            if k and rates is None:
                plant.advance(paths[k], still, still)
            elif k and rates is not None:
                ends = paths[k - 1], rates[k - 1], paths[k], rates[k]
                step_between(*ends, dt, poses, twists)
                plant.carry(poses, twists)
            yield k


def _rubs(laws: Array) -> bool:
    """Whether there is friction in the ``laws`` (..., C + 1, PARAMETERS), the latch's aside."""
    return bool((laws[..., :-1, FRICTION] > 0.0).any())


def _rate_of_momentum(
    model: mujoco.MjModel,
    on_A: Sequence[int],
    on_P: Sequence[int],
    path: Array,
    places: Array,
    turns: Array,
    tick: float,
) -> Array:
    """(N, 6) rate of change of the momentum of bodies on A, which moves along ``path`` (N, 7), and
    on P, beyond that with the bodies fixed in their home positions: at each row, about W's origin.
    Their positions are ``places`` (N, B, 3), their attitudes ``turns`` (N, B, 3, 3). NaN if any of
    these is not finite.
    """
    if not np.isfinite(places).all() or not np.isfinite(turns).all():
        return np.full((len(path), 6), np.nan)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    attitude, momentum = Rotation.from_quat(path[:, 3:]), np.zeros((len(path) - 1, 6))
    for n, b in enumerate([*on_A, *on_P]):
        home = Rotation.from_matrix(data.ximat[b].reshape(3, 3))
        momentum += _momentum(model, b, places[:, n], Rotation.from_matrix(turns[:, n]), tick)
        if n < len(on_A):
            momentum -= _momentum(
                model, b, path[:, :3] + attitude.apply(data.xipos[b]), attitude * home, tick
            )
    return np.asarray(np.diff(momentum, axis=0, prepend=momentum[:1], append=momentum[-1:]) / tick)


def _momentum(model: mujoco.MjModel, body: int, place: Array, turn: Rotation, tick: float) -> Array:
    """(N - 1, 6) momentum of a body between rows, linear [kg m/s] and about W's origin [kg m^2/s],
    from ``place`` (N, 3) and ``turn``.
    """
    linear = model.body_mass[body] * np.diff(place, axis=0) / tick
    change = (turn[1:] * turn[:-1].inv()).as_rotvec()
    between = Rotation.from_rotvec(0.5 * change) * turn[:-1]
    spin = between.apply(model.body_inertia[body] * between.inv().apply(change / tick))
    return np.hstack([linear, np.cross(0.5 * (place[1:] + place[:-1]), linear) + spin])


@njit(cache=True)
def step_between(pose_before, twist_before, pose, twist, dt, poses, twists):
    """Interpolate the instants of the tick between two rows, ``dt`` [s] apart, to ``poses`` (m, n,
    7) and ``twists`` (m, n, 6).

    Each twist is the mean over the step that ends there, as in semi-implicit Euler; over the tick
    they follow a parabola that begins and ends with the rows' own twists, and takes A from one
    row's pose to the other's.
    """
    m = poses.shape[0]
    mean, bend = np.empty(6), np.empty(6)
    weight = 0.0
    for s in range(1, m + 1):
        weight += s * (m - s)
    for i in range(pose.shape[0]):
        twist_between(pose_before[i], pose[i], m * dt, mean)
        # displacement that a linear change between both twists lacks in the sum over the steps
        for j in range(6):
            lacks = (
                m * mean[j]
                - m * twist_before[i, j]
                - 0.5 * (m + 1) * (twist[i, j] - twist_before[i, j])
            )
            bend[j] = lacks / weight if m > 1 else 0.0
        for s in range(1, m + 1):
            for j in range(6):
                twists[s - 1, i, j] = (
                    twist_before[i, j]
                    + (twist[i, j] - twist_before[i, j]) * s / m
                    + bend[j] * s * (m - s)
                )
            pose_step(
                pose_before[i] if s == 1 else poses[s - 2, i], twists[s - 1, i], dt, poses[s - 1, i]
            )
        copied(pose[i], poses[m - 1, i])
