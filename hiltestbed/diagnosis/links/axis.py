"""wrench_comp.fz to pose_cmd.pz of a machine's axis: a force that drives a mass whose position was read.

Nothing brings the mass back: what a model misses of the force stays in the position for good.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links.base import Effects, Lane, Link, LinkRun, padded
from hiltestbed.frames import Array
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_axis


BEGINNING = 0.5  # [s] at the start of a run from which a model reads its place and speed there
NUDGE = 1e-4  # [m/s] of the start, for what it does


class AxisLink(Link):
    """The numerical model along z alone, from where and as fast as the record starts."""

    name = "dynamics"
    channels = ("pose_cmd.pz",)
    walks = (0.1, 0.3, 1.0, 3.0)

    def __init__(self, runs: Sequence[LinkRun], forces: Sequence[Array], place: Sequence[float], speed: Sequence[float]) -> None:
        """forces: (N,) wrench_comp.fz of each run. place, speed: of row 0 [m], [m/s]. The runs' `measured` is (N, 1)."""
        self.runs, self.forces, self.place, self.speed = runs, forces, tuple(place), tuple(speed)
        self._padded = padded(forces)

    def restarted(self, effects: Effects) -> AxisLink:
        """The same link from the place and speed that the model with ``effects`` reads from the first half second of each run."""
        nudged = AxisLink(self.runs, self.forces, self.place, [v + NUDGE for v in self.speed])
        place, speed = [], []
        for i, run in enumerate(self.runs):
            rows = np.flatnonzero(np.isfinite(run.sigma[:, 0]))
            rows = rows[rows * run.scenario.tick < BEGINNING]
            shown, moved = (link.shown(i, effects)[rows, 0] for link in (self, nudged))
            basis = np.column_stack([np.ones(len(rows)), (moved - shown) / NUDGE])
            change = np.linalg.lstsq(basis, run.measured[rows, 0] - shown, rcond=None)[0] if len(rows) > 2 else (0.0, 0.0)
            place.append(self.place[i] + float(change[0]))
            speed.append(self.speed[i] + float(change[1]))
        return AxisLink(self.runs, self.forces, place, speed)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departing = Departing([self.runs[i].scenario for i in run], stack([DynamicsParameters.of(effects) for _, effects in lanes]))
        rows = [r.rows for r in self.runs]
        found = replay_axis(departing, self._padded, np.array(self.place), np.array(self.speed), run, rows)
        return [np.ascontiguousarray(place[: rows[i], None]) for place, i in zip(found, run, strict=True)]
