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


def as_a_wall(spec: mujoco.MjSpec) -> None:
    """No turning of the chaser on the time scale of a test, and the ring fixed to it."""
    spec.body("active_bus").inertia = [1e7] * 3
    stiff_attenuation(spec)


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


@pytest.mark.parametrize("mu", [0.0, 0.3, 0.8])
def test_below_the_friction_angle_a_ring_slides_off_a_petal_as_statics_say(mu: float) -> None:
    """Pushed along the axis on one petal of each side: along the wedge (F/m) (sin 45 - mu cos 45) =
    (F/m) (1 - mu)/sqrt 2.
    """
    moved, duration, force, mass = slide(mu)
    free = 0.5 * force / mass * math.sin(WEDGE) * duration**2
    assert moved == pytest.approx(free * (1.0 - mu / math.tan(WEDGE)), abs=0.02 * free)


def test_beyond_the_friction_angle_a_ring_jams_on_a_petal() -> None:
    """mu = 1.25 > tan 45 deg: it holds, but for the creep of regularised friction."""
    moved, duration, _, _ = slide(1.25)
    assert moved < 1e-3 * duration


def slide(mu: float) -> tuple[float, float, float, float]:
    """How far [m] along the petal a ring slides in a time [s], under a force [N], with a mass [kg]
    that it moves.
    """
    rig = Rig("idss_ring", edit=as_a_wall, free_target=False, friction=mu)
    force, duration = 100.0, 0.6
    # Two petals bear F cos 45 across the wedge between them: 0.35 mm each, 0.5 mm along the axis
    # past the touch at 30 mm.
    rig.start(0.03 - force * math.cos(WEDGE) / 2e5 * math.sqrt(2.0), offset=(0.03, 0.0))
    rig.batch.bind("xfrc_applied")[0, rig.model.body("active_bus").id, 2] = force
    mass = float(rig.model.body("active_bus").subtreemass[0])
    down = np.array([-math.sin(WEDGE), 0.0, math.cos(WEDGE)])
    start = rig.site("active_A") @ down
    rig.run(duration, phases=False)
    return float(rig.site("active_A") @ down - start), duration, force, mass
