"""wrench_comp to pose_cmd."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links.base import Lane, Link, LinkRun, flat_pose, padded
from hiltestbed.frames import Array
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_model


class DynamicsLink(Link):
    """The numerical model: position, and attitude as a small rotation vector."""

    name = "dynamics"
    channels = ("pose_cmd.px", "pose_cmd.py", "pose_cmd.pz", "pose_cmd.rx", "pose_cmd.ry", "pose_cmd.rz")

    def __init__(self, runs: Sequence[LinkRun], wrenches: Sequence[Array]) -> None:
        """wrenches: (N, 6) wrench_comp of each run. The runs' `measured` is (N, 6), see `flat_pose`."""
        self.runs = runs
        self._wrenches = padded(wrenches)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departing = Departing([self.runs[i].scenario for i in run], stack([DynamicsParameters.of(effects) for _, effects in lanes]))
        poses = flat_pose(replay_model(departing, self._wrenches, run))
        return [pose[: self.runs[i].rows] for pose, i in zip(poses, run, strict=True)]
