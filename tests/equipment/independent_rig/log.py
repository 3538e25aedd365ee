"""A facility's log of a run: stamps and channels, as written by its logger."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.equipment.independent_rig.links import Records
from tests.equipment.independent_rig.measured_pose import slope

POSES, WRENCHES, TWISTS = (
    ("pose_cmd", "pose_act"),
    ("wrench_meas", "wrench_comp"),
    ("twist_cmd", "twist_act"),
)


@dataclass(frozen=True)
class Log:
    """The log of a run, n rows.

    Attributes:
        t: (n,) stamps [s]. pose_cmd, pose_act: (n, 7). wrench_meas, wrench_comp: (n, 6). twist_cmd,
            twist_act: (n, 6) or None.
        tick: [s], of the loop. sigma: (6,) standard deviation of the white noise stated by the
            facility [N, N m].
        run: its number in the set. digits: significant digits of a text file; None: a binary file.
    """

    t: np.ndarray
    pose_cmd: np.ndarray
    pose_act: np.ndarray
    wrench_meas: np.ndarray
    wrench_comp: np.ndarray
    tick: float
    sigma: np.ndarray
    run: int = 0
    digits: int | None = None
    twist_cmd: np.ndarray | None = None
    twist_act: np.ndarray | None = None

    def channels(self) -> dict[str, np.ndarray]:
        """The existing channels, by name."""
        return {
            name: rows
            for name in (*POSES, *TWISTS, *WRENCHES)
            if (rows := getattr(self, name)) is not None
        }

    def each(self, change) -> Log:
        """The log with every channel replaced by `change(rows)`; quaternions are normalised."""
        found = {name: change(rows) for name, rows in self.channels().items()}
        for name in POSES:
            found[name][:, 3:] /= np.linalg.norm(found[name][:, 3:], axis=1, keepdims=True)
        return replace(self, **found)


def log_of(records: Records, rate: float, sigma: np.ndarray, run: int, twists: bool) -> Log:
    """The log of a run's records, one row per tick; with `twists` also the velocities, as
    differences of the poses over a tick.
    """
    t = np.arange(len(records.pose_cmd)) / rate
    log = Log(
        t,
        records.pose_cmd,
        records.pose_act,
        records.wrench_meas,
        records.wrench_comp,
        1.0 / rate,
        sigma,
        run,
    )
    if not twists:
        return log
    return replace(
        log, twist_cmd=_rates(log.pose_cmd, 1.0 / rate), twist_act=_rates(log.pose_act, 1.0 / rate)
    )


def _rates(pose: np.ndarray, h: float) -> np.ndarray:
    """(n, 6) from poses (n, 7); the first row repeats the second."""
    out = np.zeros((len(pose), 6))
    for k in range(1, len(pose)):
        slope(pose[k - 1], pose[k], h, out[k])
    out[0] = out[1]
    return out
