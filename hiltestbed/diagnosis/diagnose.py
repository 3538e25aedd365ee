"""The diagnosis from top to bottom: a dataset of measured runs in, a :class:`Diagnosis` out.

The stages, in order, with the module in which to read each:

1. layout: which rows, noise floors and scales the links get (:mod:`hiltestbed.diagnosis.layout`);
2. replay: each link of the loop predicts its output from measured inputs
(:mod:`hiltestbed.diagnosis.links`, `residual`);
3. explain: the causes of each link that have the most evidence by one likelihood, as far as they
carry over to runs that were not fitted (:mod:`hiltestbed.diagnosis.link_model`, `explain`; link by
link in `investigate`);
4. decide: from the explanations of the links to a verdict and its evidence
(:mod:`hiltestbed.diagnosis.verdict`, `find`);
5. report: both models in closed loop, the next experiment, the folder
(:mod:`hiltestbed.diagnosis.report`).
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from hiltestbed.axis.dataset import is_axis, load_axis
from hiltestbed.config.dataset import LoadedDataset, dataset_from
from hiltestbed.config.yaml_source import read_source
from hiltestbed.diagnosis.find import CLOSING_STEPS, find
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.report.diagnosis import Diagnosis, conclude
from hiltestbed.inference.search import Progress
from hiltestbed.measured import MeasuredDataset, load_dataset

if TYPE_CHECKING:
    from hiltestbed.axis.diagnose import AxisDiagnosis


@overload
def diagnose(
    dataset: LoadedDataset | MeasuredDataset, progress: Progress | None = None
) -> Diagnosis: ...


@overload
def diagnose(dataset: str | Path, progress: Progress | None = None) -> Any: ...


def diagnose(
    dataset: str | Path | LoadedDataset | MeasuredDataset, progress: Progress | None = None
) -> Diagnosis | AxisDiagnosis:
    """The diagnosis of a dataset, or of the dataset in a file; `progress` is called with a line on
    what is being done.

    It is a :class:`Diagnosis`, or an :class:`~hiltestbed.axis.diagnose.AxisDiagnosis` where the
    file is one of a single axis. `investigate` runs the stages 1 to 3 of the list above, `find` the
    fourth and `conclude` the last. No stage changes its input.

    Raises:
        InputError: a file cannot be read, or its data contradict the physics.
        MissingExtra: the reader of a format is not installed.
    """
    start = time.monotonic()
    if isinstance(dataset, (str, Path)):
        source = read_source(dataset)
        if is_axis(source):
            from hiltestbed.axis.diagnose import diagnose_axis

            return diagnose_axis(load_axis(source), progress)
        dataset = dataset_from(source)
    if not isinstance(dataset, MeasuredDataset):
        if progress:
            progress("reading and checking the data")
        dataset = load_dataset(dataset)
    # hypotheses far from the truth may overflow; their misfit is clipped, and they are not selected
    with np.errstate(all="ignore"):
        finding = find(investigate(dataset, progress), progress)
    if progress:
        progress(f"closing step 3 of {CLOSING_STEPS}: nominal and extended runs in closed loop")
    return conclude(dataset, finding, time.monotonic() - start)
