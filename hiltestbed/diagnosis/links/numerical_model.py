"""Stage "replay": the link dynamics: wrench_comp through the numerical model to pose_cmd."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from hiltestbed.diagnosis.links.base import Lane, Link, LinkRun, flat_pose, moved, padded
from hiltestbed.frames import Array
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_model


class DynamicsLink(Link):
    """The numerical model: position, and attitude as a small rotation vector."""

    name = "dynamics"
    channels = (
        "pose_cmd.px",
        "pose_cmd.py",
        "pose_cmd.pz",
        "pose_cmd.rx",
        "pose_cmd.ry",
        "pose_cmd.rz",
    )

    def __init__(self, runs: Sequence[LinkRun], wrenches: Sequence[Array]) -> None:
        """wrenches: (N, 6) wrench_comp of each run. The runs' `measured` is (N, 6), see
        `flat_pose`.
        """
        self.runs = runs
        self._wrenches = padded(wrenches)

    def with_unknown_start(self, level: Array) -> DynamicsLink:
        """The same link where the wrench that acted first may not be on record: nuisance terms of
        each run, which go on for its length.

        Of a wrench whose stamps are shifted, the record lacks up to a row at one end, of which only
        the noise, ``level`` (6,) [N, N m], is
        known: it makes the bodies drift.
        """
        out, terms = copy(self), [np.empty((r.rows, 6, 6)) for r in self.runs]
        everything = [(i, ()) for i in range(len(self.runs))]
        believed = self.predict(everything)
        for axis in range(6):
            first = self._wrenches.copy()
            first[:, 0, axis] += level[axis]
            shown = DynamicsLink(self.runs, list(first)).predict(everything)
            for t, a, b in zip(terms, believed, shown, strict=True):
                t[:, :, axis] = b - a
        out.runs = [r.with_nuisances(t) for r, t in zip(self.runs, terms, strict=True)]
        return out

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departing = Departing(
            [self.runs[i].scenario for i in run],
            stack([DynamicsParameters.of(effects) for _, effects in lanes]),
        )
        places, tick = (
            [self.timing_with(effects) for _, effects in lanes],
            self.runs[0].scenario.tick,
        )
        wrenches, driven = self._wrenches, run
        if any(place.before for place in places):
            wrenches = np.stack(
                [
                    moved(self._wrenches[i], p.before / tick)
                    for i, p in zip(run, places, strict=True)
                ]
            )
            driven = np.arange(len(lanes))
        poses = flat_pose(
            replay_model(departing, wrenches, driven, np.array([place.old for place in places]))
        )
        late = [place.delay / tick for place in places]
        return [
            moved(pose[: self.runs[i].rows], rows)
            for pose, rows, i in zip(poses, late, run, strict=True)
        ]
