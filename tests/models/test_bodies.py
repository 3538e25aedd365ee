"""The shipped mechanisms between two free bodies: capture in phases."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.rig import Rig
from tests.slow import slow


@pytest.mark.parametrize(
    ("name", "gap", "speed", "offset", "attitude", "duration", "site", "within"),
    [
        slow("idss_ring", 0.17, 0.08, (0.05, 0.03), (2.0, -1.0, 1.5), 17.0, "base", 0.015),
        ("kinematic_coupling", 0.05, 0.03, (0.02, -0.01), (0.0, 0.0, 2.0), 8.0, "A", 0.003),
    ],
)
def test_capture_in_all_its_phases(
    name, gap, speed, offset, attitude, duration, site, within
) -> None:
    rig = Rig(name, timestep=5e-4)
    rig.start(gap, (0.0, 0.0, speed), offset, attitude)
    rig.run(duration)
    assert rig.done == [phase.name for phase in rig.description.phases]
    assert np.linalg.norm(rig.site(f"active_{site}") - rig.site("passive_P")) < within
    assert rig.momentum()[2] == pytest.approx(500.0 * speed, rel=1e-5)
    together = 500.0 * speed / 2500.0
    assert rig.qvel[rig.model.joint("active_free").dofadr[0] + 2] == pytest.approx(
        together, abs=0.01
    )
