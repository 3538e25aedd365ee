"""Named signals on a time base: a trace's columns, with unit and frame, and their arrays."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.errors import InputError, of_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hiltestbed.frames import Array

AXES = ("x", "y", "z", "rx", "ry", "rz")
_POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
_SLIDERS = ("0", "1", "2", "3", "4", "5")
_POSE_UNITS = ("m",) * 3 + ("1",) * 4
_TWIST_UNITS = ("m/s",) * 3 + ("rad/s",) * 3
_WRENCH_UNITS = ("N",) * 3 + ("N m",) * 3
_STIFFNESS_UNITS = ("N/m",) * 3 + ("N m/rad",) * 3
_DAMPING_UNITS = ("N s/m",) * 3 + ("N m s/rad",) * 3
SIX_SLIDERS = ("m",) * 6


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


_A_IN_P, _OF_A, _AT_P = "A in P", "A relative to P, in P", "in P at P's origin"
_DRIVEN = "driven joints of the platform {}: its sliders; 0 at home"
_UPPER = "slider positions of the upper platform {}; 0 at home"
GROUPS = {
    name: Group(name, parts, units, frame, meaning)
    for name, parts, units, frame, meaning in (
        (
            "pose_cmd",
            _POSE,
            _POSE_UNITS,
            _A_IN_P,
            "relative pose that the numerical model computed",
        ),
        ("pose_act", _POSE, _POSE_UNITS, _A_IN_P, "relative pose that the rig reached"),
        ("twist_cmd", _TWIST, _TWIST_UNITS, _OF_A, "velocity of the numerical model"),
        ("twist_act", _TWIST, _TWIST_UNITS, _OF_A, "velocity that the rig reached"),
        (
            "wrench_true",
            _WRENCH,
            _WRENCH_UNITS,
            _AT_P,
            "physical contact wrench, active on passive",
        ),
        ("wrench_meas", _WRENCH, _WRENCH_UNITS, _AT_P, "wrench that the sensor gave"),
        ("wrench_comp", _WRENCH, _WRENCH_UNITS, _AT_P, "wrench that drove the numerical model"),
        ("stiffness_est", AXES, _STIFFNESS_UNITS, _AT_P, "running estimate of stiffness"),
        ("damping_est", AXES, _DAMPING_UNITS, _AT_P, "running estimate of damping"),
        ("slider_cmd", _SLIDERS, SIX_SLIDERS, "platform", _DRIVEN.format("commanded")),
        ("slider_act", _SLIDERS, SIX_SLIDERS, "platform", _DRIVEN.format("reached")),
        ("upper_cmd", _SLIDERS[:3], ("m",) * 3, "upper platform", _UPPER.format("commanded")),
        ("upper_act", _SLIDERS[:3], ("m",) * 3, "upper platform", _UPPER.format("reached")),
    )
}
CYCLE = Group(
    "cycle",
    ("period", "busy", "sensor_age", "missed"),
    ("s", "s", "s", "1"),
    "",
    "of a run against devices: from the start of the cycle before, from its start to the command, "
    "age of the reading, ticks missed",
)
JOINT = Group("joint", (), (), "mechanism", "joint of the mechanism's moving parts, as in its MJCF")
# all groups that a trace may have; the simulation has no cycles
RECORDED = GROUPS | {CYCLE.name: CYCLE}
_JOINTS = ("slider_cmd", "slider_act")
MovingParts = tuple[tuple[str, str], ...]  # name and unit of each joint of a mechanism


@lru_cache
def groups(joints: tuple[str, ...] = SIX_SLIDERS, moving: MovingParts = ()) -> dict[str, Group]:
    """The groups of a trace for a platform with driven joints of the units ``joints``, and a
    mechanism with the joints ``moving``; no joint columns if nothing is driven, or moves.
    """
    parts = tuple(map(str, range(len(joints))))
    found = {
        name: replace(g, parts=parts, units=joints) if name in _JOINTS else g
        for name, g in RECORDED.items()
    }
    if moving:
        names, units = zip(*moving, strict=True)
        found[JOINT.name] = replace(JOINT, parts=names, units=units)
    return found


class Trace:
    """The signals of a batch of runs, tick by tick.

    Attributes:
        joints: units of the platform's driven joints. moving: joints of the mechanism.
        t: ``(ticks,)`` time [s], ``tick/rate``.
        data: group name to ``(ticks, n, parts)``.
        contact: ``(ticks, n)`` bool, the mechanisms touch.
        length: ``(n,)`` rows with data: fewer than ``ticks`` if a run was stopped.
    """

    def __init__(
        self,
        ticks: int,
        n: int,
        rate: float,
        joints: tuple[str, ...] = SIX_SLIDERS,
        moving: MovingParts = (),
    ) -> None:
        self.joints, self.moving = joints, moving
        self.t = np.arange(ticks) / rate
        self.data = {
            g.name: np.full((ticks, n, len(g.parts)), np.nan)
            for g in groups(joints, moving).values()
            if g.name != CYCLE.name
        }
        self.contact = np.zeros((ticks, n), dtype=bool)
        self.length = np.full(n, ticks)

    def __getitem__(self, name: str) -> Array:
        return self.data[name]

    def filled(self, ticks: int) -> None:
        """The first ``ticks`` rows are written."""

    def run(self, i: int) -> RunTrace:
        """The rows of run ``i``."""
        rows = int(self.length[i])
        data = {name: array[:rows, i] for name, array in self.data.items()}
        return RunTrace(self.t[:rows], data, self.contact[:rows, i], self.joints, self.moving)


class RunTrace(dict[str, NDArray[np.float64]]):
    """One run: ``t`` ``(rows,)``, ``data`` group name to ``(rows, parts)``, ``contact``
    ``(rows,)``.

    A dict of column names to columns, so that ``pandas.DataFrame(trace)`` has the same columns; the
    name of a group gives the whole group: ``trace["wrench_meas.fz"]`` ``(rows,)``,
    ``trace["wrench_meas"]`` ``(rows, 6)``,
        ``trace["t"]``, ``trace["contact"]``.
    """

    def __init__(
        self,
        t: Array,
        data: dict[str, Array],
        contact: np.ndarray,
        joints: tuple[str, ...] = SIX_SLIDERS,
        moving: MovingParts = (),
    ) -> None:
        """``joints``: units of the driven joints; ``moving``: joints of the mechanism."""
        self.t, self.data, self.contact, self.joints = t, data, contact, joints
        self.moving = moving
        super().__init__(t=t)
        for group in self.groups():
            self |= {column: data[group.name][:, j] for j, column in enumerate(group.columns)}
        self["contact"] = contact

    def __missing__(self, name: str) -> Array:
        if name in self.data:
            return self.data[name]
        raise UnknownColumn(name, [*self, *self.data])

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in self.data

    def __reduce__(self) -> tuple:
        return RunTrace, (self.t, self.data, self.contact, self.joints, self.moving)

    def __repr__(self) -> str:
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "empty"
        return f"RunTrace({len(self.t)} rows, {span}: t, {', '.join(self.data)}, contact)"

    def _repr_html_(self) -> str:
        from hiltestbed.run_folder.folders import html_table

        rows = [
            (g.name, ", ".join(g.parts), ", ".join(dict.fromkeys(g.units)), g.frame, g.meaning)
            for g in self.groups()
        ]
        return html_table(
            f"Trace of {len(self.t)} rows", ("group", "parts", "unit", "frame", "meaning"), rows
        )

    def groups(self) -> list[Group]:
        """The groups of this trace, with the columns of its platform."""
        found = groups(self.joints, self.moving).values()
        return [group for group in found if group.name in self.data]

    def columns(self) -> dict[str, Array]:
        """Column name to ``(rows,)``, in the order of the trace file."""
        return dict(self)

    def about(self) -> dict[str, dict[str, str]]:
        """Column name to its unit, frame and meaning."""
        return {name: about_column(name, self.joints, self.moving) for name in self}

    def to_pandas(self):
        """A pandas DataFrame over time [s]; ``attrs``: unit, frame, meaning of each column."""
        pd = of_extra("pandas", "to_pandas()", "pandas")
        columns = self.columns()
        frame = pd.DataFrame(
            {name: values for name, values in columns.items() if name != "t"},
            index=pd.Index(columns["t"], name="t"),
        )
        about = self.about()
        frame.attrs = {"index": about.pop("t"), "columns": about}
        return frame

    def to_xarray(self):
        """An xarray Dataset: one variable ``(t, part)`` per group, with units and frame in its
        ``attrs``. Raises MissingExtra.
        """
        xr = of_extra("xarray", "to_xarray()", "xarray")
        variables: dict[str, Any] = {
            "contact": (
                "t",
                self.contact,
                {"units": "1", "long_name": about_column("contact")["meaning"]},
            )
        }
        coordinates: dict[str, Any] = {
            "t": ("t", self.t, {"units": "s", "long_name": about_column("t")["meaning"]})
        }
        for group in self.groups():
            name = group.name
            axis = f"{name}_part"
            units = list(dict.fromkeys(group.units))
            about = {
                "units": units[0] if len(units) == 1 else list(group.units),
                "frame": group.frame,
                "long_name": group.meaning,
            }
            variables[name] = (("t", axis), self[name], about)
            coordinates[axis] = (axis, list(group.parts), {"units": list(group.units)})
        return xr.Dataset(variables, coordinates)

    def plot(self, *names: str, axes: Axes | None = None) -> Axes:
        """Columns or groups over time, contacts shaded; the axes. Raises UnknownColumn."""
        from hiltestbed.report.curves import PALETTE, shade_contacts

        names = names or ("wrench_meas.fz",)
        groups = {group.name: group for group in self.groups()}
        columns = [
            column
            for name in names
            for column in (groups[name].columns if name in groups else (name,))
        ]
        # raises for an unknown column before anything is drawn
        values = [self[column] for column in columns]
        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")[1]
        shade_contacts(axes, self.t, self.contact)
        for i, (column, value) in enumerate(zip(columns, values, strict=True)):
            axes.plot(self.t, value, label=column, color=PALETTE[i % len(PALETTE)], linewidth=1.4)
        units = list(dict.fromkeys(self.about()[column]["unit"] for column in columns))
        axes.set(xlabel="time [s]", ylabel=f"[{', '.join(units)}]")
        axes.legend(loc="best", fontsize=8)
        return axes


class UnknownColumn(KeyError, InputError):
    """A trace has no such column or group; the message offers the nearest name."""

    def __init__(self, name: str, allowed: Sequence[str]) -> None:
        close = difflib.get_close_matches(str(name), allowed, n=1, cutoff=0.5)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        groups = [a for a in allowed if a in GROUPS]
        InputError.__init__(
            self,
            f"trace: no column {name!r}{hint}; allowed are t, contact, the groups "
            f"{', '.join(groups)} and their parts",
        )

    def __str__(self) -> str:
        return Exception.__str__(self)


def about_column(
    name: str, joints: tuple[str, ...] = SIX_SLIDERS, moving: MovingParts = ()
) -> dict[str, str]:
    """Unit, frame and meaning of a column of the trace."""
    if name == "t":
        return {"unit": "s", "frame": "", "meaning": "time from the start, tick/rate"}
    if name == "contact":
        return {"unit": "1", "frame": "", "meaning": "the mechanisms touch"}
    group, _, part = name.partition(".")
    found = groups(joints, moving)[group]
    return {
        "unit": found.units[found.parts.index(part)],
        "frame": found.frame,
        "meaning": found.meaning,
    }
