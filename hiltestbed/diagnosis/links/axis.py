"""Stage "replay": wrench_comp.fz to pose_cmd.pz of a machine's axis: a force that drives a mass
whose position was measured.

Nothing restores the mass, so that an error of the modelled force stays in the position for good:
the misfit is a random walk. Least squares of positions would weigh the last rows by the accumulated
error of all rows before, and bias mass and friction; least squares of displacements over a short
span, in which each stretch of the record speaks for itself, is the estimate of least variance. The
motion is predicted in one piece in both cases, and adequacy is judged on the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.links.base import Effects, Lane, LinkRun, ModelLink, padded
from hiltestbed.frames import Array
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_axis

# chosen: [s] of a run from which the model's initial position and speed are estimated
START_TIME = 0.5
SPEED_STEP = 1e-4  # chosen: [m/s] of the initial speed, for its derivative


class AxisLink(ModelLink):
    """The numerical model along z alone, from the position and speed at the start of the record."""

    name = "dynamics"
    channels = ("pose_cmd.pz",)
    witnesses = (1.0, 3.0)

    def __init__(
        self,
        runs: Sequence[LinkRun],
        forces: Sequence[Array],
        place: Sequence[float],
        speed: Sequence[float],
    ) -> None:
        """forces: (N,) wrench_comp.fz of each run. place, speed: of row 0 [m], [m/s]. The runs'
        `measured` is (N, 1).
        """
        self.runs, self.forces, self.place, self.speed = runs, forces, tuple(place), tuple(speed)
        self._padded = padded(forces)
        self._from: list[np.ndarray] | None = None
        self._places = self

    @property
    def whole(self) -> ModelLink:
        return self._places

    def over(self, span: float) -> AxisLink:
        """The same link on the displacements over a ``span`` [s], or from the start."""
        out = copy(self)
        out._places, out._from, runs = self, [], []
        for run in self.runs:
            known = np.flatnonzero(np.isfinite(run.sigma[:, 0]))
            before = np.concatenate([[0], known])
            back = before[
                np.searchsorted(
                    before, np.arange(run.rows) - round(span / run.scenario.tick), side="right"
                ).clip(1)
                - 1
            ]
            sigma = np.where(
                np.isfinite(run.sigma[back]), np.hypot(run.sigma, run.sigma[back]), run.sigma
            )
            out._from.append(back)
            runs.append(replace(run, measured=run.measured - run.measured[back], sigma=sigma))
        out.runs = runs
        return out

    def restarted(self, effects: Effects) -> AxisLink:
        """The same link from the start that the model with ``effects`` fits to the first rows."""
        nudged = AxisLink(self.runs, self.forces, self.place, [v + SPEED_STEP for v in self.speed])
        place, speed = [], []
        for i, run in enumerate(self.runs):
            rows = np.flatnonzero(np.isfinite(run.sigma[:, 0]))
            rows = rows[rows * run.scenario.tick < START_TIME]
            shown, moved = (link.shown(i, effects)[rows, 0] for link in (self, nudged))
            basis = np.column_stack([np.ones(len(rows)), (moved - shown) / SPEED_STEP])
            change = (
                np.linalg.lstsq(basis, run.measured[rows, 0] - shown, rcond=None)[0]
                if len(rows) > 2
                else (0.0, 0.0)
            )
            place.append(self.place[i] + float(change[0]))
            speed.append(self.speed[i] + float(change[1]))
        return AxisLink(self.runs, self.forces, place, speed)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departing = Departing(
            [self.runs[i].scenario for i in run],
            stack([DynamicsParameters.of(effects) for _, effects in lanes]),
        )
        rows = [r.rows for r in self.runs]
        found = replay_axis(
            departing, self._padded, np.array(self.place), np.array(self.speed), run, rows
        )
        places = [
            np.ascontiguousarray(place[: rows[i], None])
            for place, i in zip(found, run, strict=True)
        ]
        if self._from is None:
            return places
        return [p - p[self._from[i]] for p, i in zip(places, run, strict=True)]
