"""Healthy sets of the independent rig as facilities log them are left alone, each kind on a rig
that alarmed once.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.measured import load_dataset
from tests.equipment.independent_rig import draw_set, write_set
from tests.slow import SLOW, slow


@pytest.mark.parametrize(
    ("noise", "seed"),
    [
        (("digits", 4.0), 610027),  # a command in few digits is a rough path
        # latched from the start: the springs balance the drift, and the path shows it
        (("slow_drift", 4.0), 601068),
        # latched from the start: its axes at rest show the noise of poses between samples
        slow(("log_rate", 1700.0), 602089),
        (("pose_steps", 1e-5), 601454),  # 60 mm/s are three steps a row
        slow(("digits", 5.0), 601589),
        slow(("digits", 4.0), 601645),  # a command in four digits
        slow(("digits", 4.0), 601668),  # whose rounding errors a mode would smooth
        slow(("digits", 4.0), 601670),  # and a lag of the sensor
        slow(("log_rate", 1700.0), 602087),  # a short flight, from which a cubic is taken off
        # a search for a logger's filter that went far beyond any cutoff
        slow(("log_rate", 500.0), 602103),
        slow(("anti_aliasing", 50.0), 601319),  # the filter's delay is off by a hundredth of a row
        slow(("pose_steps", 1e-5), 601476),  # third differences are whole steps
        slow(("slow_drift", 4.0), 601022),  # a wave of which a cubic leaves a tenth
        slow(("spikes", 0.002), 600641),  # three outliers before the first touch, dozens after it
        slow(("digits", 5.0), 610026),  # a pair that is latched from the start, and turns freely
        slow(("converter_steps", 1.0), 620012),  # forces across that stay within two steps
        slow(("log_rate", 250.0), 610036),  # seven ticks of eight without a row
        slow(("log_rate", 500.0), 610035),
        # a compensation that follows: another stamp would only suit the errors of bridging
        (("log_rate", 1700.0), 602094),
        slow(("log_rate", 1700.0), 602090),
        pytest.param(
            *(("log_rate", 1700.0), 602040),
            marks=[
                SLOW,
                pytest.mark.xfail(
                    strict=True, reason="interpolation of path and force: 0.065 % of the stiffness"
                ),
            ],
        ),
        slow(("log_rate", 1700.0), 610034),  # noise of samples that were put between others twice
        slow(("stamp_jitter", 0.1), 610031),
        # latched: poses across stay within a step, which hides how far they move
        slow(("pose_steps", 1e-5), 601441),
        slow(("pose_steps", 2e-5), 610025),
        slow(("anti_aliasing", 150.0), 650003),
        slow(("anti_aliasing", 50.0), 601261),  # the filter's delay is known to some 10 us
        # latched from the start: nothing tells its noise but what the loop computed
        slow(("anti_aliasing", 50.0), 650004),
    ],
)
def test_what_a_logger_does_is_no_departure(
    tmp_path: Path, noise: tuple[str, float], seed: int
) -> None:
    write_set(tmp_path, draw_set(np.random.default_rng(seed), "healthy", noise=noise))
    assert (
        judge(investigate(load_dataset(tmp_path / "dataset.yaml"))).verdict.verdict
        == "no_discrepancy"
    )


@pytest.mark.parametrize(
    ("noise", "effect", "seed"),
    [
        slow(("pink", 1.0), "sensor.bias", 640002),  # beside a baseline that wanders
        slow(("log_rate", 500.0), "contact.stiffness", 640001),
        (("log_rate", 250.0), "contact.dry_friction", 640016),
        slow(("anti_aliasing", 150.0), "contact.stiffness", 650011),
        slow(("anti_aliasing", 50.0), "sensor.lag", 660024),
        slow(("anti_aliasing", 150.0), "log.skew", 660027),
        # of 3.9 Hz, where the valley of chi-square is a tenth wide
        slow(("digits", 5.0), "frame.mode", 602486),
    ],
)
def test_what_departs_is_named_alone_whatever_the_logger_does(
    tmp_path: Path, noise: tuple[str, float], effect: str, seed: int
) -> None:
    write_set(
        tmp_path, draw_set(np.random.default_rng(seed), "single", names=(effect,), noise=noise)
    )
    verdict = judge(investigate(load_dataset(tmp_path / "dataset.yaml"))).verdict
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == [effect]
