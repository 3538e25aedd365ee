"""What a computed channel may leave by chance."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.diagnosis.adequacy import judge_of_compensation
from hiltestbed.diagnosis.links import CompensationLink, LinkRun
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.scenario import scenario_from

from .made import scenario

ROWS, INSIDE = 1500, 400  # of which in contact
NOISE = 0.1  # [N] of the readings


def left_over(rng: np.random.Generator, mixed: bool, louder: float = 1.0) -> bool:
    """Whether a compensation of 1, read with errors, passes: errors are larger in contact by a
    factor. mixed: where rows of a log lie between those of the loop, they are larger on every third
    and follow their neighbours.
    """
    errors = rng.standard_normal((ROWS + 1, 6))
    if mixed:
        errors = (errors[1:] + 0.35 * errors[:-1]) * np.where(np.arange(ROWS) % 3 == 0, 1.0, 0.35)[
            :, None
        ]
    touching = np.arange(ROWS) < INSIDE
    measured = NOISE * errors[:ROWS] * np.where(touching, louder, 1.0)[:, None]
    plain = scenario().model_dump(mode="json") | {
        "compensation": {"force": {"kind": "none"}, "motion": {"kind": "none"}}
    }
    run = LinkRun(scenario_from(plain), measured, np.full((ROWS, 6), 1e-3), touching)
    link = CompensationLink([run], [np.zeros((ROWS, 6))], {})
    noise = {f"wrench_meas.{axis}": 10.0 * NOISE for axis in ("fx", "fy", "fz", "tx", "ty", "tz")}
    return all(
        left.noise for left in judge_of_compensation(link, noise)(Residual(link), ()).values()
    )


@pytest.mark.parametrize("mixed", [False, True])
def test_errors_are_no_departure_by_chance_however_uneven_they_are(mixed: bool) -> None:
    """Of 50 compensations on six axes none is, and all are where errors are larger in contact by
    half.
    """
    rng = np.random.default_rng(7)
    assert all(left_over(rng, mixed) for _ in range(50))
    assert not any(left_over(rng, mixed, louder=1.5) for _ in range(50))
