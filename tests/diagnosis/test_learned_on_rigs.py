"""Learned laws on records of whole rigs: one that shares no code with the simulation, and the loop
itself with a law hidden in it.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.learned import learn
from hiltestbed.diagnosis.learned.finding import learned_on
from hiltestbed.diagnosis.learned.learn import carries_over
from hiltestbed.diagnosis.paths import best_path, make_wrench_link
from hiltestbed.diagnosis.report.diagnosis import conclude
from hiltestbed.diagnosis.report.evidence import link_series
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Finding
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.scenario import load_scenario
from tests.equipment.independent_rig import draw_set, write_set
from tests.slow import slow

from .recorded import recorded

# a tenth of the spring's force is lost on the way out
LOSS = {"kind": "contact.map", "spring_rate": [[-1e-3, -0.1], [1e-3, 0.0]]}


def residual_of(dataset: MeasuredDataset) -> Residual:
    layout = lay_out(dataset)
    return Residual(make_wrench_link(layout, best_path(layout, None), layout.rows))


@pytest.mark.parametrize("name", ["unknown.curve", slow("unknown.unloading")])
def test_a_foreign_law_of_an_independent_rig_is_worth_nearly_what_the_truth_is(
    name: str, tmp_path: Path
) -> None:
    """The true model leaves noise: its gain is 1 - 1/before. A fifth less is what a law that is
    known from five runs may lose.
    """
    write_set(tmp_path, draw_set(np.random.default_rng(1), "foreign", names=(name,)))
    found = learn(residual_of(load_dataset(tmp_path / "dataset.yaml")))
    assert found is not None
    law, gain = found
    assert law.effect.kind == "contact.map"
    assert gain.reduction > 0.8 * (1.0 - 1.0 / gain.rms_before)
    assert carries_over(gain)


def test_the_extended_scenario_runs_with_the_law_and_rebounds_as_the_rig_did(
    tmp_path: Path,
) -> None:
    dataset = load_dataset(recorded(tmp_path, [LOSS]))
    residual = residual_of(dataset)
    departing: Any = SimpleNamespace(residual=lambda: residual, singles=list)
    result = learned_on(departing, ())
    assert result is not None
    learned, effect = result
    assert learned.carries_over
    diagnosis = conclude(
        dataset,
        Finding("unknown", "contact", series=link_series(residual.link, [effect]), learned=learned),
    )
    for measured, nominal, extended in zip(
        *(getattr(diagnosis.closed_loop, n) for n in ("measured", "nominal", "extended")),
        strict=True,
    ):
        assert measured.cor is not None
        assert abs(nominal.cor - measured.cor) > 0.02
        assert extended.cor == pytest.approx(measured.cor, abs=0.004)
    folder = diagnosis.write(tmp_path / "out")
    said = json.loads((folder / "diagnosis.json").read_text())
    assert said["verdict"] == "unknown"
    assert said["causes"] == []
    assert said["learned"]["effect"] == "contact.map"
    assert said["learned"]["gain"] > 0.8
    assert load_scenario(folder / said["extended_scenario"]).effects[0].kind == "contact.map"
    assert "A law without a name" in (folder / "report.html").read_text()
