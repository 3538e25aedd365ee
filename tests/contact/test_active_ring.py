"""A soft-capture ring on six legs: its statics, its impedance, what it may not do, and what it
tells when it cannot do it.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from hiltestbed.analysis.assessment import assess, figures_of
from hiltestbed.build import runnable_from
from hiltestbed.config.gallery import find_scenario
from hiltestbed.config.models import models_folder
from hiltestbed.config.part import named
from hiltestbed.config.yaml_source import read_source
from hiltestbed.contact.active_ring import JOINTS, LAWS, ActiveRing
from hiltestbed.contact.composition import ACTIVE
from hiltestbed.contact.legs import RingLegs, stand_on_legs
from hiltestbed.errors import InputError
from hiltestbed.scenario import load_scenario, scenario_from
from hiltestbed.simulation import Batch as Done
from hiltestbed.simulation import concluded, simulate
from tests.slow import SLOW

DT = 2.5e-4  # [s]
RATE = 2000.0  # [Hz] of the scenario
VEL = int(mujoco.mjtStage.mjSTAGE_VEL)
PASSIVE = {  # as models/idss_ring/active.xml has it
    "stiffness": [1500.0, 1500.0, 2000.0, 250.0, 250.0, 250.0],
    "damping": [350.0, 350.0, 540.0, 60.0, 60.0, 60.0],
}
INERTIA = np.array([20.0, 20.0, 20.0, 3.7, 3.7, 7.2])  # of the ring: kg, kg m^2
# no lag and no limit: a filter of 1 us is at its end within a step
IDEAL = {"bandwidth": 1e6, "force": 1e6}
SHIPPED = YAML(typ="safe").load(Path(find_scenario("28-active-ring")))


def ring_of(**sections) -> ActiveRing:
    return ActiveRing.model_validate(sections)


class Stand:
    """The active side alone, its base held or free, its ring on legs."""

    def __init__(self, ring: ActiveRing, n: int = 1, free: bool = False):
        spec, side = mujoco.MjSpec(), named(models_folder() / "idss_ring" / "active.xml")
        spec.option.timestep, spec.option.gravity = DT, [0.0, 0.0, 0.0]
        stand_on_legs(side, ring)
        body = spec.worldbody.add_body(name="base")
        if free:
            body.add_freejoint()
        spec.attach(side, prefix=ACTIVE, frame=body.add_frame())
        self.batch = Batch(spec.compile(), n, 1)
        self.model = m = self.batch.model
        self.legs = RingLegs(self.batch, ring, n, DT)
        joints = [m.joint(ACTIVE + name) for name in JOINTS]
        first = int(joints[0].qposadr[0]), int(joints[0].dofadr[0])
        self.q = self.batch.bind("qpos")[:, first[0] : first[0] + 6]
        self.v = self.batch.bind("qvel")[:, first[1] : first[1] + 6]
        self.ctrl, self.act = self.batch.bind("ctrl"), self.batch.bind("act")
        self.batch.reset(stage=0)

    def command(self) -> None:
        self.batch.forward(stage=VEL)
        self.legs.push()

    def run(self, seconds: float) -> np.ndarray:
        """Deflections (steps, n, 6) of the ring."""
        found = []
        for _ in range(round(seconds / DT)):
            self.command()
            self.batch.step()
            found.append(self.q.copy())
        return np.array(found)


def legs_at(ring: ActiveRing, q: np.ndarray) -> np.ndarray:
    """(6,) lengths of the legs by geometry: slides, then hinges about x, y, z of the ring."""
    base, ends = ring.legs.joints
    turned = Rotation.from_euler("XYZ", q[3:]).apply(ends)
    return np.linalg.norm(turned + q[:3] - base, axis=1)


@pytest.mark.parametrize("legs", [{}, {"base_radius": 0.5, "ring_half_angle_deg": 33.0}])
def test_the_forces_of_the_legs_do_the_work_of_the_impedance(legs: dict) -> None:
    """Sum of f_i dl_i/dq_j, by central differences of the lengths, is -K_j q_j - C_j v_j."""
    ring = ring_of(legs=legs | IDEAL, capture=PASSIVE)
    stand, rng = Stand(ring), np.random.default_rng(1)
    for _ in range(5):
        q, v = rng.uniform(-0.05, 0.05, 6), rng.uniform(-0.1, 0.1, 6)
        stand.q[:], stand.v[:] = q, v
        stand.command()
        step = 1e-6
        for j, unit in enumerate(np.eye(6)):
            stretch = (legs_at(ring, q + step * unit) - legs_at(ring, q - step * unit)) / (2 * step)
            wanted = -PASSIVE["stiffness"][j] * q[j] - PASSIVE["damping"][j] * v[j]
            assert stand.ctrl[0] @ stretch == pytest.approx(wanted, rel=1e-7, abs=1e-6)


def docking(duration: float, ring: dict | None) -> Done:
    """The shipped scenario on an ideal rig; None: on the springs."""
    data = {k: v for k, v in SHIPPED.items() if k not in ("sensor", "limits", "compensation")}
    mechanism = {"kind": "idss_ring"} | ({} if ring is None else {"active_ring": ring})
    data |= {"duration": duration, "mechanism": mechanism}
    data |= {"rig": {"platform": {"tracking": "ideal"}}, "identification": {"kind": "none"}}
    data |= {"compensation": {"force": {"kind": "none"}, "motion": {"kind": "none"}}}
    return simulate([scenario_from(data)], trace=True)


def test_a_docking_on_ideal_legs_is_that_on_springs() -> None:
    """Until the latches catch: a damper whose rate is that at the other end of a step is one that
    differs by the share dt C/M, and so do the impulses at most.
    """
    ways = [docking(3.1, ring) for ring in ({"legs": IDEAL, "capture": PASSIVE}, None)]
    legs, springs = (np.cumsum(way.trace["wrench_true"][:, 0, :3], axis=0) for way in ways)
    share = DT * max(PASSIVE["damping"][:3]) / INERTIA[0]
    assert np.abs(springs).max() / RATE > 5.0  # N s
    np.testing.assert_allclose(legs, springs, atol=share * np.abs(springs).max())
    # before a latch adds its own, no more than the approach brings
    absorbed = ways[0].outcomes[0]["active_ring"]["energy_absorbed"]
    assert 0.05 < absorbed < 0.5 * 400.0 * 0.05**2


@pytest.mark.parametrize(("share", "passive"), [(1.5, True), (0.3, False)])
def test_the_lag_of_the_legs_makes_no_energy_with_the_damping_that_is_asked_for(
    share: float, passive: bool
) -> None:
    """A ring that is moved slowly takes energy as long as C > K/w, and gives some else."""
    stiffness, bandwidth = 2000.0, 2.0
    damping = stiffness / (2.0 * math.pi * bandwidth)
    law = {"stiffness": [stiffness] * 6, "damping": [1.01 * damping] * 6}
    ring = ring_of(legs={"bandwidth": bandwidth, "force": 1e6}, capture=law)
    stand, least = Stand(ring), 0.0
    stand.legs._numbers.laws[0, 1] *= share / 1.01
    t = DT * np.arange(round(6.0 / DT))
    way = 0.01 * np.sin(2.0 * t) * np.sin(0.5 * t) ** 2
    for z, speed in zip(way, np.gradient(way, DT), strict=True):
        stand.q[:], stand.v[:] = 0.0, 0.0
        stand.q[0, 2], stand.v[0, 2] = z, speed
        stand.command()
        stand.batch.step()
        least = min(least, stand.legs.summary(0)["energy_absorbed"])
    assert (least > -1e-9) == passive


def test_legs_keep_the_momentum_of_base_and_ring() -> None:
    stand = Stand(ring_of(legs=IDEAL), free=True)
    stand.q[:], stand.v[:] = [0.03, 0.02, -0.02, 0.03, -0.02, 0.05], [0.1, 0, 0.2, 0.3, 0, -0.2]
    data, found = mujoco.MjData(stand.model), []
    for _ in range(2):
        data.qpos[:], data.qvel[:] = stand.batch.bind("qpos")[0], stand.batch.bind("qvel")[0]
        mujoco.mj_forward(stand.model, data)
        mujoco.mj_subtreeVel(stand.model, data)
        found.append(
            [*data.subtree_linvel[1] * stand.model.body_subtreemass[1], *data.subtree_angmom[1]]
        )
        stand.run(0.5)
    assert np.abs(stand.v).max() < 0.02
    np.testing.assert_allclose(found[1], found[0], atol=2e-4 * np.abs(found[0]).max())


def test_virtual_inertia_is_added_to_that_of_the_ring() -> None:
    """A quarter of a period until the middle is passed: T/4 = pi/2 sqrt((20 + 60)/2000) s. Two lags
    of 1/w = 1.6 ms move that by about as much, and damping by a share of 2 zeta/pi.
    """
    lag, zeta = 1.0 / (2.0 * math.pi * 100.0), 20.0 / (2.0 * math.sqrt(2000.0 * 80.0))
    law = {"stiffness": [2000.0] * 6, "damping": [20.0] * 6, "mass": [60.0] * 3 + [0.0] * 3}
    stand = Stand(ring_of(legs={"bandwidth": 100.0, "force": 1e6}, capture=law))
    stand.q[0, 2] = 0.01
    way, quarter = stand.run(0.5)[:, 0, 2], 0.5 * math.pi * math.sqrt(80.0 / 2000.0)
    bound = 2.0 * lag + quarter * 2.0 * zeta / math.pi
    assert DT * int(np.argmax(way < 0.0)) == pytest.approx(quarter, abs=bound)


def test_no_leg_exceeds_its_force_and_the_wrench_keeps_its_direction() -> None:
    free, limited = (
        Stand(ring_of(legs={"bandwidth": 1e6, "force": force}, capture=PASSIVE))
        for force in (1e6, 5.0)
    )
    for stand in (free, limited):
        stand.q[:] = [0.05, 0.0, 0.02, 0.0, 0.1, 0.0]
        stand.command()
    wanted, got = free.ctrl[0], limited.ctrl[0]
    assert np.abs(wanted).max() > 5.0
    assert np.abs(got).max() == pytest.approx(5.0, rel=1e-12)
    np.testing.assert_allclose(got / np.abs(got).max(), wanted / np.abs(wanted).max(), rtol=1e-9)
    limited.run(0.1)
    found = limited.legs.summary(0)
    assert found["leg_force"] <= 5.0 * (1.0 + 1e-12)
    assert found["faults"] == [{"what": "force", "phase": "capture", "at": 0.0}]
    assert free.legs.summary(0)["faults"] == []


def test_a_leg_stops_at_the_end_of_its_stroke_and_says_so() -> None:
    """A ring that nothing else brakes, at 0.5 m/s; the stop is MuJoCo's limit of a tendon, soft
    within its time constant of 20 ms: 10 mm of this speed.
    """
    loose = {"stiffness": [0.0] * 6, "damping": [1.0] * 6}
    stand = Stand(ring_of(legs={"stroke": 0.09}, capture=loose))
    stand.v[0, 2] = -0.5
    stand.run(0.5)
    found = stand.legs.summary(0)
    assert [fault["what"] for fault in found["faults"]] == ["stroke"]
    assert -0.10 < found["leg_travel"][0] <= -0.09


def test_a_phase_that_does_not_end_in_its_time_is_told() -> None:
    stand = Stand(ring_of(attenuation={"timeout": 0.05}))
    stand.run(0.1)
    assert stand.legs.summary(0)["faults"] == []  # there is no time for an approach
    stand.legs.begin("soft_capture", np.array([True]))
    stand.legs.begin("attenuation", np.array([True]))
    stand.run(0.1)
    (fault,) = stand.legs.summary(0)["faults"]
    assert (fault["what"], fault["phase"]) == ("timeout", "attenuation")
    assert fault["at"] == pytest.approx(0.15, abs=3 * DT)


def test_the_ring_is_aligned_from_where_it_is_at_the_rate_that_is_stated() -> None:
    """No jump of its force; then as fast as its reference, to the centre; then drawn in, until
    hard capture stops the reference.
    """
    stand = Stand(ring_of(alignment={"speed": 0.02}, retraction={"speed": 0.03, "depth": 0.06}))
    stand.q[0, :2] = 0.04, -0.03
    stand.legs.begin("alignment", np.array([True]))
    stand.command()
    # the step of the reference before the first command: 4000 N/m * 5 um in two axes
    assert np.abs(stand.ctrl).max() < 4000.0 * 0.02 * DT * 2.0
    way = stand.run(4.0)[:, 0]
    speed = np.abs(np.diff(way[:, 0])).max() / DT
    assert speed == pytest.approx(0.02, rel=0.05)
    assert np.abs(way[-1]).max() < 1e-4
    stand.legs.begin("retraction", np.array([True]))
    drawn = stand.run(1.0)[-1, 0, 2]
    assert drawn == pytest.approx(-0.03, abs=0.03 * 5600.0 / 20000.0 + 1e-4)
    stand.legs.begin("hard_capture", np.array([True]))
    assert stand.run(3.0)[-1, 0, 2] == pytest.approx(-0.03, abs=1e-4)


def test_a_ring_that_has_diverged_stops_no_other() -> None:
    stand, alone = (Stand(ring_of(), n=n) for n in (2, 1))
    stand.q[:], alone.q[:] = [[math.nan] * 6, [0.01] * 6], [0.01] * 6
    stand.command()
    alone.command()
    np.testing.assert_array_equal(stand.ctrl[1], alone.ctrl[0])


def test_a_batch_is_its_single_runs() -> None:
    starts = np.random.default_rng(2).uniform(-0.02, 0.02, (3, 6))
    ring = ring_of(capture={"mass": [5.0] * 6})
    several = Stand(ring, n=3)
    several.q[:] = starts
    several.legs.begin("alignment", np.array([False, True, False]))
    several.run(0.2)
    for i, start in enumerate(starts):
        single = Stand(ring)
        single.q[:] = start
        single.legs.begin("alignment", np.array([i == 1]))
        single.run(0.2)
        for name in ("q", "v", "ctrl", "act"):
            np.testing.assert_array_equal(getattr(single, name)[0], getattr(several, name)[i])
        assert single.legs.summary(0) == several.legs.summary(i)


@SLOW
def test_the_shipped_ring_is_seated_within_the_limits_of_its_standard() -> None:
    """In all its phases, until the flanges lie on each other: A is 103 mm before them. Both bodies
    then move as one, so that the impulses are those of 400 kg at 0.05 m/s. The passive ring's
    flanges meet with more than the standard allows.
    """
    done = simulate([load_scenario(find_scenario("28-active-ring"))], trace=True)
    out = done.outcomes[0]
    begun = [phase["at"] for phase in out["phases"]]
    assert [phase["name"] for phase in out["phases"]] == [
        "soft_capture", *LAWS[1:], "hard_capture",
    ]  # fmt: skip
    assert begun == sorted(begun)
    soft = out["interface"]["soft_capture"]
    assert soft["compression"] < 3900.0
    assert soft["bending"] < 2800.0
    assert out["active_ring"]["faults"] == []
    impulse = sum(event["impulse"][2] for event in out["contact_events"])
    assert impulse == pytest.approx(400.0 * 0.05, rel=0.01)
    pose = done.trace["pose_act"][-1, 0]
    np.testing.assert_allclose(pose[:3], [0.0, 0.0, 0.103], atol=5e-4)
    assert 2.0 * np.linalg.norm(pose[3:6]) < math.radians(0.1)


FAULTY = {
    "legs: {stroke: -0.1}": ("active_ring.legs.stroke", "0"),
    "legs: {force: null}": ("active_ring.legs.force", "number"),
    "legs: {stroke: 0.6}": ("active_ring.legs.stroke", "allowed is less"),
    "legs: {base_half_angle_deg: 45.0}": ("base_half_angle_deg", "must not be 60 deg"),
    "attenuatoin: {timeout: 9.0}": ("active_ring.attenuatoin", "did you mean 'attenuation'"),
    "alignment: {damping: [1.0, 1300, 2500, 1000, 1000, 1000]}": ("alignment.damping.0", "31.8"),
    "retraction: {depth: 0.3}": ("retraction.depth", "longer stroke"),
    "legs: {bandwidth: 5000}, capture: {damping: [350, 350, 2.0e5, 60, 60, 60]}": (
        "active_ring.capture: ring_z",
        "raise physics_rate",
    ),
    "capture: {stiffness: [1.0, 2.0]}": ("capture.stiffness", "6"),
}


@pytest.mark.parametrize("text", FAULTY)
def test_bad_input_is_told_with_its_place_and_what_to_do(text: str, tmp_path: Path) -> None:
    file = tmp_path / "scenario.yaml"
    lines = find_scenario("28-active-ring").read_text().splitlines()
    (row,) = [k for k, line in enumerate(lines) if line.startswith("mechanism:")]
    lines[row] = f"mechanism: {{kind: idss_ring, active_ring: {{{text}}}}}"
    file.write_text("\n".join(lines))
    with pytest.raises(InputError) as error:
        runnable_from(read_source(file))
    key, said = FAULTY[text]
    assert f"{file}:{row + 1}:" in str(error.value)
    assert key in str(error.value)
    assert said in str(error.value)


def test_what_went_wrong_is_in_the_table_and_in_the_warnings() -> None:
    done = docking(3.1, {"legs": {"force": 2.0}})
    summary = done.outcomes[0]
    (fault,) = summary["active_ring"]["faults"]
    assert (fault["what"], fault["phase"]) == ("force", "capture")
    assert 2.0 < fault["at"] < 3.1
    said = "active ring: a leg reached its largest force at 2.1"
    whole = concluded(done, None, None, 0).summary
    assert any(warning.startswith(said) for warning in assess(whole).warnings)
    rows = {name: (value, note) for name, value, note in figures_of(whole)}
    assert rows["active ring"][0] == "not captured"
    assert "a leg at most 2 N" in rows["active ring"][1]
