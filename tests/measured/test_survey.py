"""What one run holds, from its contacts."""

from __future__ import annotations

import pytest

from hiltestbed.measured.survey import Contact, Survey


@pytest.mark.parametrize("peak", [200.0, -200.0, None])
def test_what_pulls_touches_as_well_as_what_pushes(peak: float | None) -> None:
    survey = Survey(0, {}, (Contact(10, 20, peak, 1e-3, None),), (), 0.0)
    assert survey.touching(40, late=4, least=50.0).sum() == 10 + 2 + 4 + 3
    assert survey.touching(40, late=4, least=500.0).any() == (peak is None)
