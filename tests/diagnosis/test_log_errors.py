"""Errors that only the log of one channel has are no departure, and hide none that is larger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.measured import load_dataset
from tests.equipment.independent_rig import draw_set, write_set
from tests.equipment.independent_rig.log_errors import log_errors
from tests.slow import SLOW

KINDS = [(name, size) for name, (sizes, _) in log_errors().items() for size in sizes]
# of an output and of an input that are computed, which a dead zone or a lag would explain
QUICK = [("pose_cmd coloured", 2e-5), ("wrench_comp steps", 1.0)]


def _verdict(folder: Path, seed: int, noise: tuple[str, float], *hidden: str) -> tuple[str, list]:
    kind = "single" if hidden else "healthy"
    names = {"names": hidden} if hidden else {}
    write_set(folder, draw_set(np.random.default_rng(seed), kind, noise=noise, **names))
    found = judge(investigate(load_dataset(folder / "dataset.yaml"))).verdict
    return found.verdict, [c.effect for c in found.causes]


@pytest.mark.parametrize(
    "noise", [pytest.param(k, marks=() if k in QUICK else SLOW, id=f"{k[0]} {k[1]}") for k in KINDS]
)
def test_an_error_of_the_log_alone_is_no_departure(
    tmp_path: Path, noise: tuple[str, float]
) -> None:
    assert _verdict(tmp_path, 31, noise) == ("no_discrepancy", [])


@pytest.mark.parametrize("effect", [pytest.param("contact.stiffness", marks=SLOW), "loop.deadzone"])
def test_an_effect_beside_it_is_named(tmp_path: Path, effect: str) -> None:
    assert _verdict(tmp_path, 33, QUICK[0], effect) == ("named", [effect])
