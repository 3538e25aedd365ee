"""What a method of somebody else may do wrong in the loop is told with its name, and no number
comes of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hiltestbed.compensation.blocks import ForceDrive
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.errors import InputError

UNKNOWN = np.full((2, 6), np.nan)


class Free:
    """A numerical model that goes nowhere."""

    def __init__(self) -> None:
        self.pose, self.twist = np.zeros((2, 7)), np.zeros((2, 6))

    def advance(self, wrench: np.ndarray) -> None:
        pass


class Method:
    def __init__(self, law: Callable[[np.ndarray], Any]) -> None:
        self.law = law

    def compensate(self, measurement: Measurement) -> Any:
        return self.law(measurement.wrench)


def driven(law: Callable[[np.ndarray], Any], reading: float = 1.0) -> np.ndarray:
    drive = ForceDrive(Free(), Method(law))  # type: ignore[arg-type]
    given = np.full((2, 6), reading)
    drive.advance(
        Measurement(
            given, np.zeros((2, 7)), np.zeros((2, 6)), UNKNOWN, UNKNOWN, np.zeros(2, dtype=bool)
        )
    )
    return drive.wrench


def test_what_it_gives_is_what_drives_the_model() -> None:
    assert np.array_equal(driven(lambda wrench: 2.0 * wrench), np.full((2, 6), 2.0))


@pytest.mark.parametrize(
    ("law", "told"),
    [
        (lambda wrench: None, "gave NoneType"),
        (lambda wrench: wrench[:, 2], r"gave an array \(2,\)"),
        (lambda wrench: wrench[0], r"gave an array \(6,\)"),
        (lambda wrench: wrench + np.nan, "NaN or infinity"),
        (lambda wrench: [1, 2][int(wrench.sum())], r"test_foreign_methods.py:\d+: IndexError"),
    ],
)
def test_what_it_does_wrong_is_told(law: Callable[[np.ndarray], Any], told: str) -> None:
    with pytest.raises(InputError, match=f"Method.*{told}"):
        driven(law)


def test_a_reading_that_is_lost_is_not_laid_to_the_method() -> None:
    assert np.isnan(driven(lambda wrench: wrench, np.nan)).all()
