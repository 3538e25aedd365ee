"""Measured data against the simulation: what departs, why, the model extended, and the gain."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.output.conclude import conclude
from hiltestbed.diagnosis.output.result import Diagnosis
from hiltestbed.measured import MeasuredDataset, load_dataset


def diagnose(dataset: str | Path | MeasuredDataset, progress: Callable[[str], None] | None = None) -> Diagnosis:
    """The diagnosis of a dataset, or of the dataset in a file; `progress` is told what is being done.

    Raises:
        InputError: a file cannot be read, or its data contradict the physics.
        MissingExtra: the reader of a format is not installed.
    """
    start = time.monotonic()
    if not isinstance(dataset, MeasuredDataset):
        if progress:
            progress("reading and checking the data")
        dataset = load_dataset(dataset)
    with np.errstate(all="ignore"):  # candidates far from the truth may overflow: their misfit is bounded, and they are not chosen
        finding = find(dataset, progress)
    if progress:
        progress("nominal and extended runs in closed loop")
    return conclude(dataset, finding, time.monotonic() - start)
