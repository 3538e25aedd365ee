"""A trace as pandas and xarray objects, and as a plot, with units and frames of the columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.signals import RunTrace, about_column

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette: distinguishable with any of the common colour-vision deficiencies
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")


def trace_to_pandas(trace: RunTrace) -> Any:
    """A DataFrame with the trace's columns over time [s]; ``frame.attrs["columns"]`` has unit,
    frame and meaning. Raises MissingExtra.
    """
    try:
        import pandas as pd
    except ImportError:
        raise MissingExtra("to_pandas()", "pandas") from None
    columns = trace.columns()
    frame = pd.DataFrame(
        {name: values for name, values in columns.items() if name != "t"},
        index=pd.Index(columns["t"], name="t"),
    )
    about = trace.about()
    frame.attrs = {"index": about.pop("t"), "columns": about}
    return frame


def trace_to_xarray(trace: RunTrace) -> Any:
    """A Dataset: each group ``(t, parts of the group)``; ``attrs`` of a variable: units, frame,
    long_name. Raises MissingExtra.
    """
    try:
        import xarray as xr
    except ImportError:
        raise MissingExtra("to_xarray()", "xarray") from None
    variables: dict[str, Any] = {
        "contact": (
            "t",
            trace.contact,
            {"units": "1", "long_name": about_column("contact")["meaning"]},
        )
    }
    coordinates: dict[str, Any] = {
        "t": ("t", trace.t, {"units": "s", "long_name": about_column("t")["meaning"]})
    }
    for group in trace.groups():
        name = group.name
        axis = f"{name}_part"
        units = list(dict.fromkeys(group.units))
        about = {
            "units": units[0] if len(units) == 1 else list(group.units),
            "frame": group.frame,
            "long_name": group.meaning,
        }
        variables[name] = (("t", axis), trace[name], about)
        coordinates[axis] = (axis, list(group.parts), {"units": list(group.units)})
    return xr.Dataset(variables, coordinates)


def plot_trace(trace: RunTrace, names: Sequence[str], axes: Axes | None) -> Axes:
    """Columns or groups over time in one set of axes, contacts shaded."""
    groups = {group.name: group for group in trace.groups()}
    columns = [
        column for name in names for column in (groups[name].columns if name in groups else (name,))
    ]
    # raises for an unknown column before anything is drawn
    values = [trace[column] for column in columns]
    if axes is None:
        import matplotlib.pyplot as plt

        axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")[1]
    shade_contacts(axes, trace.t, trace.contact)
    for i, (column, value) in enumerate(zip(columns, values, strict=True)):
        axes.plot(trace.t, value, label=column, color=PALETTE[i % len(PALETTE)], linewidth=1.4)
    units = list(dict.fromkeys(trace.about()[column]["unit"] for column in columns))
    axes.set(xlabel="time [s]", ylabel=f"[{', '.join(units)}]")
    axes.legend(loc="best", fontsize=8)
    return axes


def shade_contacts(axes: Axes, t: np.ndarray, contact: np.ndarray) -> None:
    """Shade the times ``t`` ``(rows,)`` [s] at which ``contact`` ``(rows,)`` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], contact, [False]]).astype(np.int8)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(float(t[start]), float(t[min(end, len(t) - 1)]), color="#e9edf1", zorder=0)
