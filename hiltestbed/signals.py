"""Named signals on a time base: the columns of a trace, with unit and frame, and the arrays behind them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

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
        Group("slider_cmd", _SLIDERS, ("m",) * 6, "platform", "driven joints of the platform commanded: its sliders; 0 at home"),
        Group("slider_act", _SLIDERS, ("m",) * 6, "platform", "driven joints of the platform reached: its sliders; 0 at home"),
        Group("upper_cmd", _SLIDERS[:3], ("m",) * 3, "upper platform", "slider positions of the upper platform commanded; 0 at home"),
        Group("upper_act", _SLIDERS[:3], ("m",) * 3, "upper platform", "slider positions of the upper platform reached; 0 at home"),
    )
}


SIX_SLIDERS = ("m",) * 6
_JOINTS = ("slider_cmd", "slider_act")


@lru_cache
def groups(joints: tuple[str, ...] = SIX_SLIDERS) -> dict[str, Group]:
    """The groups of a trace of a platform whose driven joints have the units ``joints``: as many columns; none where nothing is driven."""
    parts = tuple(map(str, range(len(joints))))
    return {name: replace(g, parts=parts, units=joints) if name in _JOINTS else g for name, g in GROUPS.items()}


class Trace:
    """What a batch of runs did, tick by tick.

    Attributes:
        joints: units of the platform's driven joints.
        t: ``(ticks,)`` time [s], ``tick/rate``.
        data: group name to ``(ticks, n, parts)``.
        contact: ``(ticks, n)`` bool, the mechanisms touch.
        length: ``(n,)`` rows that hold data: fewer than ``ticks`` where a run was stopped.
    """

    def __init__(self, ticks: int, n: int, rate: float, joints: tuple[str, ...] = SIX_SLIDERS) -> None:
        self.joints = joints
        self.t = np.arange(ticks) / rate
        self.data = {g.name: np.full((ticks, n, len(g.parts)), np.nan) for g in groups(joints).values()}
        self.contact = np.zeros((ticks, n), dtype=bool)
        self.length = np.full(n, ticks)

    def __getitem__(self, name: str) -> Array:
        return self.data[name]

    def run(self, i: int) -> RunTrace:
        """The rows of run ``i``."""
        rows = int(self.length[i])
        data = {name: array[:rows, i] for name, array in self.data.items()}
        return RunTrace(self.t[:rows], data, self.contact[:rows, i], self.joints)


@dataclass
class RunTrace:
    """One run: ``t`` ``(rows,)``, ``data`` group name to ``(rows, parts)``, ``contact`` ``(rows,)``; ``joints``: their units."""

    t: Array
    data: dict[str, Array]
    contact: np.ndarray
    joints: tuple[str, ...] = SIX_SLIDERS

    def __getitem__(self, name: str) -> Array:
        return self.data[name]

    def columns(self) -> dict[str, Array]:
        """Column name to ``(rows,)``, in the order of the trace file."""
        out = {"t": self.t}
        for group in groups(self.joints).values():
            if group.name in self.data:
                out |= {c: self.data[group.name][:, j] for j, c in enumerate(group.columns)}
        out["contact"] = self.contact
        return out
