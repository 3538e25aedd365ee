"""The shipped mechanisms between two free bodies: what a bounce keeps, capture in phases."""

from __future__ import annotations

import numpy as np
import pytest

from tests.models.rig import Rig


@pytest.mark.parametrize(
    ("name", "gap", "speed", "offset", "attitude"),
    [
        # petals, one to six contacts at a time, on the springs of the attenuation
        ("idss_ring", 0.17, 0.05, (0.06, 0.0), (2.0, 1.0, 2.0)),
        ("kinematic_coupling", 0.03, 0.03, (0.004, -0.003), (0.0, 0.0, 0.0)),
        # head and rod on the funnel's facets, stroke spring within its range
        ("probe_drogue", 0.12, 0.05, (0.1, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_nothing_is_lost_or_gained_in_a_bounce_that_nothing_damps(
    name, gap, speed, offset, attitude
) -> None:
    """Kinetic energy with that of the mechanism's springs, and momentum, before and after."""
    rig = Rig(name, dissipative=False)
    rig.start(gap, (0.0, 0.0, speed), offset, attitude)
    rig.step()
    energy, momentum = rig.energy.sum(), rig.momentum()
    touched = False
    for _ in range(round(12.0 / rig.model.opt.timestep)):
        rig.step()
        touched |= bool(rig.found.any())
        if touched and rig.site("active_A")[2] - rig.site("passive_P")[2] < -gap:
            break
    assert touched
    assert not rig.found.any()
    assert rig.energy.sum() == pytest.approx(energy, rel=1e-3)
    assert np.abs(rig.momentum() - momentum).max() < 1e-5 * 500.0 * 0.05


@pytest.mark.parametrize(
    ("name", "gap", "speed", "offset", "attitude", "duration", "site", "within"),
    [
        ("idss_ring", 0.17, 0.08, (0.05, 0.03), (2.0, -1.0, 1.5), 17.0, "base", 0.015),
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
