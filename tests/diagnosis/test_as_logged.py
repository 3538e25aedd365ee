"""Sets of the independent rig as facilities log them: a healthy one is left alone, and what departs
is named.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from tests.slow import slow

from .recorded import drawn


@pytest.mark.parametrize(
    ("noise", "seed"),
    [
        slow(("digits", 4.0), 610027),  # a command in few digits is a rough path
        # latched from the start: the springs balance the drift, and the path shows it
        slow(("slow_drift", 4.0), 601068),
        slow(("pose_steps", 1e-5), 601454),  # 60 mm/s are three steps a row
        slow(("spikes", 0.002), 600641),  # three outliers before the first touch, dozens after it
        slow(("converter_steps", 1.0), 620012),  # forces across that stay within two steps
        # a compensation that follows: another stamp would only suit the errors of bridging
        (("log_rate", 1700.0), 602094),
        slow(("stamp_jitter", 0.1), 610031),
        slow(("anti_aliasing", 50.0), 601261),  # the filter's delay is known to some 10 us
    ],
)
def test_what_a_logger_does_is_no_departure(
    tmp_path: Path, noise: tuple[str, float], seed: int
) -> None:
    verdict = judge(investigate(drawn(tmp_path, seed, noise=noise))).verdict
    assert verdict.verdict == "no_discrepancy"


@pytest.mark.parametrize(
    ("noise", "effect", "seed"),
    [
        slow(("pink", 1.0), "sensor.bias", 640002),  # beside a baseline that wanders
        slow(("log_rate", 250.0), "contact.dry_friction", 640016),
        slow(("anti_aliasing", 50.0), "sensor.lag", 660024),
    ],
)
def test_what_departs_is_named_alone_whatever_the_logger_does(
    tmp_path: Path, noise: tuple[str, float], effect: str, seed: int
) -> None:
    verdict = judge(investigate(drawn(tmp_path, seed, effect, noise=noise))).verdict
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == [effect]
