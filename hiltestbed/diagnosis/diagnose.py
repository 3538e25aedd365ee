"""Measured data against the simulation: what departs, why, the model extended, and the gain."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from hiltestbed.dataset import LoadedDataset
from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.report.conclude import conclude
from hiltestbed.diagnosis.result import Diagnosis
from hiltestbed.diagnosis.search import Progress
from hiltestbed.measured import MeasuredDataset, load_dataset


def diagnose(dataset: str | Path | LoadedDataset | MeasuredDataset, progress: Progress | None = None) -> Diagnosis:
    """The diagnosis of a dataset, or of the dataset in a file; `progress` is told what is being done.

    The stages, each of which leaves what it is given as it is: the data are laid out for the links of the loop; each link is replayed on
    measured inputs, and what it leaves is explained by effects that are fitted and selected (:mod:`hiltestbed.diagnosis.investigate`);
    the explanations become a verdict (:mod:`hiltestbed.diagnosis.verdict`), its evidence is gathered (:mod:`hiltestbed.diagnosis.find`)
    and both models are played in closed loop for the report.

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
        finding = find(investigate(dataset, progress), progress)
    if progress:
        progress("nominal and extended runs in closed loop")
    return conclude(dataset, finding, time.monotonic() - start)
