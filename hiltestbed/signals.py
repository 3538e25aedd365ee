"""Named signals on a time base: the columns of a trace, with unit and frame, and the arrays behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltestbed.frames import Array

AXES = ("x", "y", "z", "rx", "ry", "rz")
_POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
_SLIDERS = ("0", "1", "2", "3", "4", "5")
_POSE_UNITS = ("m",) * 3 + ("1",) * 4
_TWIST_UNITS = ("m/s",) * 3 + ("rad/s",) * 3
_WRENCH_UNITS = ("N",) * 3 + ("N m",) * 3


@dataclass(frozen=True)
class Group:
    """A group of columns ``name.part`` that are one array ``(ticks, n, len(parts))``."""

    name: str
    parts: tuple[str, ...]
    units: tuple[str, ...]
    frame: str
    meaning: str

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(f"{self.name}.{part}" for part in self.parts)


GROUPS = {
    g.name: g
    for g in (
        Group("pose_cmd", _POSE, _POSE_UNITS, "A in P", "relative pose that the numerical model computed"),
        Group("pose_act", _POSE, _POSE_UNITS, "A in P", "relative pose that the rig reached"),
        Group("twist_cmd", _TWIST, _TWIST_UNITS, "A relative to P, in P", "velocity of the numerical model"),
        Group("twist_act", _TWIST, _TWIST_UNITS, "A relative to P, in P", "velocity that the rig reached"),
        Group("wrench_true", _WRENCH, _WRENCH_UNITS, "in P at P's origin", "physical contact wrench, active on passive"),
        Group("wrench_meas", _WRENCH, _WRENCH_UNITS, "in P at P's origin", "wrench that the sensor gave"),
        Group("wrench_comp", _WRENCH, _WRENCH_UNITS, "in P at P's origin", "wrench that drove the numerical model"),
        Group("stiffness_est", AXES, ("N/m",) * 3 + ("N m/rad",) * 3, "in P at P's origin", "running estimate of stiffness"),
        Group("damping_est", AXES, ("N s/m",) * 3 + ("N m s/rad",) * 3, "in P at P's origin", "running estimate of damping"),
        Group("slider_cmd", _SLIDERS, ("m",) * 6, "platform", "slider positions commanded"),
        Group("slider_act", _SLIDERS, ("m",) * 6, "platform", "slider positions reached"),
        Group("upper_cmd", _SLIDERS[:3], ("m",) * 3, "upper platform", "slider positions of the upper platform commanded; 0 at home"),
        Group("upper_act", _SLIDERS[:3], ("m",) * 3, "upper platform", "slider positions of the upper platform reached; 0 at home"),
    )
}

CYCLE = Group(
    "cycle",
    ("period", "busy", "sensor_age", "missed"),
    ("s", "s", "s", "1"),
    "",
    "of a run against devices: from the start of the cycle before, from its start to the command, age of the reading, ticks missed",
)
RECORDED = GROUPS | {CYCLE.name: CYCLE}  # what a trace may hold; the simulation has no cycles


class Trace:
    """What a batch of runs did, tick by tick.

    Attributes:
        t: ``(ticks,)`` time [s], ``tick/rate``.
        data: group name to ``(ticks, n, parts)``.
        contact: ``(ticks, n)`` bool, the mechanisms touch.
        length: ``(n,)`` rows that hold data: fewer than ``ticks`` where a run was stopped.
    """

    def __init__(self, ticks: int, n: int, rate: float) -> None:
        self.t = np.arange(ticks) / rate
        self.data = {g.name: np.full((ticks, n, len(g.parts)), np.nan) for g in GROUPS.values()}
        self.contact = np.zeros((ticks, n), dtype=bool)
        self.length = np.full(n, ticks)

    def __getitem__(self, name: str) -> Array:
        return self.data[name]

    def run(self, i: int) -> RunTrace:
        """The rows of run ``i``."""
        rows = int(self.length[i])
        data = {name: array[:rows, i] for name, array in self.data.items()}
        return RunTrace(self.t[:rows], data, self.contact[:rows, i])


@dataclass
class RunTrace:
    """One run: ``t`` ``(rows,)``, ``data`` group name to ``(rows, parts)``, ``contact`` ``(rows,)``."""

    t: Array
    data: dict[str, Array]
    contact: np.ndarray

    def __getitem__(self, name: str) -> Array:
        return self.data[name]

    def columns(self) -> dict[str, Array]:
        """Column name to ``(rows,)``, in the order of the trace file."""
        out = {"t": self.t}
        for group in RECORDED.values():
            if group.name in self.data:
                out |= {c: self.data[group.name][:, j] for j, c in enumerate(group.columns)}
        out["contact"] = self.contact
        return out
