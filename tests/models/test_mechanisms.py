"""The shipped mechanisms with moving parts, each by what its drawing says of it."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.active_ring import ActiveRing, RetractionLaw
from hiltestbed.contact.surfaces.surface import TURNED
from hiltestbed.platform.build import plant_of
from tests.models.rig import Rig
from tests.platform.rigs import scenario
from tests.slow import slow

QUICK = ActiveRing(retraction=RetractionLaw(speed=0.02))


@pytest.mark.parametrize(
    ("name", "gap", "speed", "offset", "attitude", "duration", "site", "within", "ring"),
    [
        slow("idss_ring", 0.17, 0.08, (0.05, 0.03), (2.0, -1.0, 1.5), 17.0, "base", 0.015, None),
        slow("idss_ring", 0.17, 0.08, (0.05, 0.03), (2.0, -1.0, 1.5), 20.0, "base", 0.001, QUICK),
        ("kinematic_coupling", 0.05, 0.03, (0.02, -0.01), (0.0, 0.0, 2.0), 8.0, "A", 0.003, None),
    ],
)
def test_capture_in_all_its_phases(
    name, gap, speed, offset, attitude, duration, site, within, ring
) -> None:
    rig = Rig(name, timestep=5e-4, ring=ring)
    rig.start(gap, (0.0, 0.0, speed), offset, attitude)
    rig.run(duration)
    assert rig.done == [phase.name for phase in rig.description.phases]
    assert np.linalg.norm(rig.site(f"active_{site}") - rig.site("passive_P")) < within
    kept = [0.0, 0.0, 500.0 * speed]
    np.testing.assert_allclose(rig.momentum()[:3], kept, atol=1e-5 * kept[2])
    together = 500.0 * speed / 2500.0
    assert rig.qvel[rig.model.joint("active_free").dofadr[0] + 2] == pytest.approx(
        together, abs=0.01
    )


def test_the_drogue_is_the_funnel_of_its_dimensions() -> None:
    rig = Rig("probe_drogue")
    surface = rig.facets[0].surface
    assert surface.kind == TURNED
    arcs = surface.profile[surface.profile[:, 0] == 1.0][:, 9]
    assert sorted(arcs) == pytest.approx([0.01, 0.045], abs=1e-7)


def test_the_brake_holds_the_rod_until_it_slips() -> None:
    """Friction of 40 N in the stroke: 30 N leave it where it is, 60 N move it."""
    rig = Rig("probe_drogue")
    for force, moves in ((30.0, False), (60.0, True)):
        rig.start(0.5)
        rig.ctrl[:] = -force
        rig.run(0.3, phases=False)
        stroke = rig.qpos[rig.model.joint("active_stroke").qposadr[0]]
        assert (stroke < -1e-3) == moves


def test_a_head_that_misses_the_mouth_is_turned_away() -> None:
    """The mouth's radius is 0.38 m: at 0.45 m aside the head does not even touch the inside."""
    rig = Rig("probe_drogue", timestep=5e-4)
    rig.start(0.25, (0.0, 0.0, 0.1), (0.45 * math.cos(0.3), 0.45 * math.sin(0.3)))
    rig.run(4.0)
    assert rig.done == []


K, R = 1e5, 0.25  # N/m of a contact, m: as mechanism.yaml and the files have them
PRELOAD, SHIFT = 2e-4, 5e-5  # m: seated so deep, and moved by so little, that all six points bear


def wrench(shift: np.ndarray) -> np.ndarray:
    """Wrench (6,) on P of balls that are PRELOAD deep and moved by ``shift`` (6,) [m, rad]."""
    contact = {"stiffness": K, "damping": 0.0, "friction": 0.0}
    plant = plant_of(
        [scenario("ideal", mechanism={"kind": "kinematic_coupling", "contact": contact})]
    )
    place = shift[:3] + np.array([0.0, 0.0, PRELOAD])
    plant.reset(
        np.concatenate([place, Rotation.from_rotvec(shift[3:]).as_quat()])[None], np.zeros((1, 6))
    )
    return plant.wrench_sub[0, -1].copy()


def test_a_seat_is_six_springs_that_do_not_act_on_each_other() -> None:
    """The sum of k J^T J over six points, J = (n, p x n): k diag(3/2, 3/2, 3) and k R^2 diag(3/2,
    3/2, 3), nothing beside the diagonal.

    A turned pair's forces also move with their points, by PRELOAD/R of the stiffness at most
    (8e-4): of an entry of 3, three times that.
    """
    steps = np.diag([SHIFT] * 3 + [SHIFT / R] * 3)
    found = np.stack([(wrench(s) - wrench(-s)) / (2.0 * s.sum()) for s in steps], axis=1)
    scale = np.array([1.0] * 3 + [R] * 3)
    assert found / (K * np.outer(scale, scale)) == pytest.approx(
        np.diag([1.5, 1.5, 3.0] * 2), abs=3.0 * PRELOAD / R
    )


def test_a_seat_bears_its_preload_on_six_faces_at_45_degrees() -> None:
    """Each face is met PRELOAD/sqrt(2) deep and pushes at 45 degrees: 6 k PRELOAD/2 in all; the
    files give places to 1e-9 m.
    """
    assert wrench(np.zeros(6)) == pytest.approx(
        [0.0, 0.0, 3.0 * K * PRELOAD, 0.0, 0.0, 0.0], abs=6.0 * K * 1e-9
    )


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
