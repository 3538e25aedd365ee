"""wrench_comp.fz to pose_cmd.pz of a machine's axis: a force that drives a mass whose position was read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links.base import Lane, Link, LinkRun, padded
from hiltestbed.frames import Array
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_axis


class AxisLink(Link):
    """The numerical model along z alone, from where and as fast as the record starts."""

    name = "dynamics"
    channels = ("pose_cmd.pz",)

    def __init__(self, runs: Sequence[LinkRun], forces: Sequence[Array], place: Sequence[float], speed: Sequence[float]) -> None:
        """forces: (N,) wrench_comp.fz of each run. place, speed: of row 0 [m], [m/s]. The runs' `measured` is (N, 1)."""
        self.runs, self.forces, self.place, self.speed = runs, forces, tuple(place), tuple(speed)
        self._padded = padded(forces)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departing = Departing([self.runs[i].scenario for i in run], stack([DynamicsParameters.of(effects) for _, effects in lanes]))
        rows = [r.rows for r in self.runs]
        found = replay_axis(departing, self._padded, np.array(self.place), np.array(self.speed), run, rows)
        return [np.ascontiguousarray(place[: rows[i], None]) for place, i in zip(found, run, strict=True)]
