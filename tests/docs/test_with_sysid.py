"""The comparison with mujoco.sysid: its record is right, and both sides find the same numbers where
sysid's extras are installed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco.sysid
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.slow import SLOW

FOLDER = Path(__file__).parents[2] / "docs" / "examples" / "with_sysid"


@pytest.fixture
def contact(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in ("contact", "sides"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return __import__("contact")


def test_the_bounce_in_closed_form_is_that_of_the_differential_equation(contact: Any) -> None:
    k, c = contact.TRUE.values()
    for speed in contact.SPEEDS:
        t, place, force = contact.bounce(speed)

        def rates(_: float, y: np.ndarray) -> list[float]:
            return [y[1], -max(k * y[0] + c * y[1], 0.0) / contact.MASS if y[0] > 0.0 else 0.0]

        exact = solve_ivp(
            rates,
            (0.0, t[-1]),
            [-contact.GAP, speed],
            t_eval=t,
            rtol=1e-10,
            atol=1e-13,
            max_step=5e-4,
        ).y
        np.testing.assert_allclose(place, exact[0], atol=1e-8)
        inside = force > 5.0
        np.testing.assert_allclose(force[inside], (k * exact[0] + c * exact[1])[inside], atol=5e-3)


@SLOW
def test_both_find_stiffness_and_damping(contact: Any, tmp_path: Path) -> None:
    if not hasattr(mujoco.sysid, "optimize"):
        pytest.skip("needs: pip install 'mujoco[sysid]'")
    given = contact.records(0)
    ours = contact.hiltestbed_sides(given, tmp_path)
    for side in (contact.fitted(given, 4), *ours):
        for name, value in contact.TRUE.items():
            assert side.found[name][0] == pytest.approx(value, rel=1e-3), side.name
    for side in ours:
        for name, value in contact.TRUE.items():
            assert abs(side.found[name][0] - value) <= side.found[name][1], side.name
    assert ours[0].seconds < contact.fitted(given, 4).seconds
