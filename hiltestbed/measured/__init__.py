"""Reading of measured data: files in seven formats to records on the loop's ticks, checked before
they are used.

A diagnosis only needs :func:`load_dataset`::

    # InputError when a file is unreadable or the data contradict the physics
    dataset = load_dataset("dataset.yaml")
    for run in dataset.runs:
        run.scenario                            # the facility's scenario with this run's `set`
        run.record.t                            # (ticks,) [s], tick/rate
        run.record.data["pose_act"]             # (ticks, 7), NaN where not measured
        run.record.valid["pose_act"]  # (ticks, 7), the mask of samples that count in residuals
        run.record.filled("pose_act")           # (ticks, 7) without NaN, as the input of a model
        run.record.absent                       # columns that were not measured
        run.survey.noise["wrench_meas.fz"].rms  # from before the first touch
        run.survey.contacts                     # start, end, peak force, penetration, speed
    dataset.remarks  # losses and notes, each with run, channel and numbers

Nothing is corrected: the error for a wrong sign or unit gives the line to write in the channel map,
and the key ``accept`` with which the dataset accepts the data unchanged. :func:`examine` returns
the errors as remarks instead of raising them. Readers are imported when a file of their format is
opened.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hiltestbed.measured.load import (
        MeasuredDataset,
        MeasuredRun,
        Record,
        Remark,
        Survey,
        as_faults,
        examine,
        load_dataset,
    )

__all__ = [
    "MeasuredDataset",
    "MeasuredRun",
    "Record",
    "Remark",
    "Survey",
    "as_faults",
    "examine",
    "load_dataset",
]


def __getattr__(name: str) -> Any:
    """Imports on first access: the process of a reader, which needs none, starts faster."""
    if name in __all__:
        return getattr(import_module("hiltestbed.measured.load"), name)
    raise AttributeError(f"module 'hiltestbed.measured' has no attribute {name!r}")
