"""Free flight before the first contact: it does not depend on the contact hypothesis, so it is
simulated once for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from hiltestbed.compiled.state import arrays_of
from hiltestbed.contact.parameters import OFFSET, TILT_X, TILT_Y
from hiltestbed.frames import Array
from hiltestbed.platform.plant import Plant

# [m] least distance of the sides during free flight; a hypothesis may shift a surface by half of it
CLEAR = 0.01
EVERY = 16  # rows between two checks of the distance


class Flight(NamedTuple):
    """The free flight of all runs, until the first of them comes near a contact.

    Attributes:
        row: its last row. wrench: (R, row + 1, m, 6). arm: [m] from W's origin to the farthest
            point of any geom.
        state: of the plant of all R runs at that row: the arrays that have changed since the start,
            by name.
    """

    row: int
    wrench: Array
    arm: float
    state: dict[str, Array]

    def holds(self, plant: Plant) -> bool:
        """Whether the contact hypothesis of ``plant`` shifts no surface by more than half of
        :data:`CLEAR`.
        """
        rows = plant.contacts().parameters
        shift = np.abs(rows[..., OFFSET]) + self.arm * np.hypot(
            rows[..., TILT_X], rows[..., TILT_Y]
        )
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
