"""The gripper that closes three jaws on the interface ring of a launch adapter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.models.rig import Rig

GROOVE = math.radians(20.0)  # half angle
FINGERS = 4  # of a jaw


def test_the_groove_turns_the_drive_into_normal_force_as_a_wedge_does() -> None:
    """Without friction F = 4 N sin 20 deg at each jaw: the drive's kp (0.078 - q) against 4 K x sin
    20, x the penetration.
    """
    rig = Rig("marman_gripper", friction=0.0)
    rig.start(0.0)
    rig.ctrl[:] = 0.078
    rig.run(1.5, phases=False)
    stroke = rig.qpos[[rig.model.joint(f"active_jaw_{k}").qposadr[0] for k in range(3)]]
    drive = 2e4 * (0.078 - stroke)
    data = rig.batch.get_data(0)
    depth = -data.contact.dist[
        [
            rig.model.geom(int(g[1])).name.startswith("active_jaw") or "finger" in _names(rig, g)
            for g in data.contact.geom
        ]
    ]
    assert len(depth) == 3 * FINGERS
    assert depth * 5e5 == pytest.approx(drive.mean() / (FINGERS * math.sin(GROOVE)), rel=0.02)
    assert np.ptp(drive) < 1e-3 * drive.mean()


def _names(rig: Rig, geoms: np.ndarray) -> str:
    return " ".join(rig.model.geom(int(g)).name for g in geoms)


def test_a_closed_gripper_pulls_its_target_along() -> None:
    """Clamped, not yet latched: 100 N at the chaser give 2,500 kg their acceleration together."""
    rig = Rig("marman_gripper")
    rig.start(0.0)
    rig.ctrl[:] = 0.078
    rig.run(1.0, phases=False)
    before = rig.qvel[
        [rig.model.joint(f"{s}_free").dofadr[0] + 2 for s in ("active", "passive")]
    ].copy()
    rig.batch.bind("xfrc_applied")[0, rig.model.body("active_bus").id, 2] = -100.0
    rig.run(1.0, phases=False)
    after = rig.qvel[[rig.model.joint(f"{s}_free").dofadr[0] + 2 for s in ("active", "passive")]]
    assert after - before == pytest.approx(-100.0 / 2500.0, rel=0.03)
