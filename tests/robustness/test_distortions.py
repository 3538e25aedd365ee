"""A good data set, distorted as people distort theirs: refused or remarked on before the fit, with
what to change.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed.config.yaml_source import dump_yaml, read_source
from hiltestbed.measured import examine
from tests.equipment.independent_rig.log import write_set
from tests.equipment.independent_rig.sets import draw_set
from tests.robustness.distortions import DISTORTIONS
from tests.slow import ALL, slow

# of every group of channels one unit and one factor shows what the others do
OTHER_UNITS = re.compile(r" in (cm|inch|feet|kgf|daN|kN|mN|x100|/100?)$")
RUNS = {"bumper": 2, "docking": 1}  # that are distorted: what a second says, two bumpers say


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A healthy set of a design."""
    folder = tmp_path_factory.mktemp("good")

    @cache
    def made(design: str) -> Path:
        healthy = draw_set(np.random.default_rng(3), "healthy", design=design)  # type: ignore[arg-type]
        return write_set(folder / design, healthy)

    return made


def distorted(good: Path, folder: Path, name: str, runs: int = 2, lines: str = "") -> Path:
    """The dataset of the first runs, each distorted."""
    (folder / "nominal.yaml").write_text((good / "nominal.yaml").read_text())
    entries = read_source(good / "dataset.yaml").data["runs"][:runs]
    for entry in entries:
        columns = pq.read_table(good / entry["file"]).to_pydict()
        table = {name: np.array(values) for name, values in columns.items()}
        DISTORTIONS[name].apply(table)
        pq.write_table(pa.table(table), folder / entry["file"])
    path = folder / "dataset.yaml"
    path.write_text(dump_yaml({"scenario": "nominal.yaml", "runs": entries}) + lines)
    return path


@pytest.mark.parametrize("design", ["bumper", slow("docking")])
def test_a_distortion_is_met_before_the_fit_and_the_good_set_left_alone(
    good: Callable[[str], Path], tmp_path: Path, design: str, subtests: pytest.Subtests
) -> None:
    whole = good(design)
    assert examine(whole / "dataset.yaml").remarks == ()
    for name, expected in DISTORTIONS.items():
        if OTHER_UNITS.search(name) and not ALL:
            continue
        with subtests.test(name):
            remarks = examine(distorted(whole, tmp_path, name, runs=RUNS[design])).remarks
            errors = [r for r in remarks if r.severity == "error"]
            if expected.verdict == "refused":
                assert errors, remarks
                assert not expected.check or expected.check in {r.check for r in errors}, errors
                assert all(r.fix for r in errors)
            else:
                assert not errors, errors
                assert remarks


def test_a_refusal_is_overridden_by_what_it_names(
    good: Callable[[str], Path], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    of_each = {d.check: name for name, d in DISTORTIONS.items() if d.check}
    for name in of_each.values():
        with subtests.test(name):
            path = distorted(good("bumper"), tmp_path, name)
            checks = sorted({r.check for r in examine(path).remarks if r.severity == "error"})
            accept = f"accept: [{', '.join(checks)}]\n"
            remarks = examine(distorted(good("bumper"), tmp_path, name, lines=accept)).remarks
            assert not [r for r in remarks if r.severity == "error"]
            assert any("accepted by the dataset" in r.text for r in remarks)
