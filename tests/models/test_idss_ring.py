"""The androgynous ring with three guide petals: shared load, friction."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from tests.models.rig import Rig

WEDGE = math.radians(45.0)  # of the petals against the axis


def stiff_attenuation(spec: mujoco.MjSpec) -> None:
    """The ring as good as fixed to its base."""
    for axis in ("x", "y", "z", "rx", "ry", "rz"):
        spec.joint(f"active_ring_{axis}").stiffness[0] = 1e7
        spec.joint(f"active_ring_{axis}").damping[0] = 2e4


def petal_forces(rig: Rig) -> dict[str, np.ndarray]:
    """What each petal of either side bears, in the world [N]."""
    data, model = rig.batch.get_data(0), rig.batch.get_model(0)
    mujoco.mj_forward(model, data)
    forces: dict[str, np.ndarray] = {}
    local = np.zeros(6)
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, local)
        names = [model.geom(int(g)).name for g in contact.geom]
        for name in (n for n in names if "petal" in n):
            petal = f"{name.split('_')[0]} {name[-1]}"
            forces[petal] = (
                forces.get(petal, np.zeros(3)) + contact.frame.reshape(3, 3).T @ local[:3]
            )
    return forces


def test_the_petals_share_a_load() -> None:
    """Pressed on straight by 1 mm, all six petals bear the same on their middle rods: K times 1 mm
    sin 45 deg.
    """
    rig = Rig("idss_ring", edit=stiff_attenuation, dissipative=False)
    rig.start(-0.001)
    forces = petal_forces(rig)
    assert sorted(forces) == [f"{side} {k}" for side in ("active", "passive") for k in range(3)]
    sizes = np.array([np.linalg.norm(f) for f in forces.values()])
    assert np.ptp(sizes) < 1e-9 * sizes.mean()
    axial, radial = abs(forces["active 0"][2]), np.linalg.norm(forces["active 0"][:2])
    # the first 2 um are rounding of the dimensions
    assert axial == pytest.approx(1e5 * 0.001 * math.sin(WEDGE) ** 2, rel=5e-3)
    assert axial == pytest.approx(radial, rel=1e-3)
    total = np.sum([forces[f"active {k}"] for k in range(3)], axis=0)
    assert np.linalg.norm(total[:2]) < 1e-9 * axial
