"""A recording, read back: what is drawn is what the trace holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from hiltestbed import load_scenario
from hiltestbed.frames import Array, rotation_matrix
from hiltestbed.platform.facilities.prs3 import Upper
from hiltestbed.platform.facilities.pss33 import shipped_limbs
from hiltestbed.run_folder.result import Run
from hiltestbed.scenario import Scenario
from hiltestbed.signals import RunTrace
from hiltestbed.viewer import write_recording
from hiltestbed.viewer.drawing import force_scale
from hiltestbed.viewer.plots import contact_phases
from hiltestbed.viewer.record import CONTACT, FREE, frame_rows
from tests.running import run

CENTRE = np.array([0.0, 0.0, -0.64])  # [m] the platform's origin from A's, models/pss33
SINGLE = 1e-6  # poses and arrows are in single precision: 6e-8 of a metre or two


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    """Wrong calls of rerun raise rather than warn."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Both ports off the axis, tilted and turning, with friction and noise: every axis moves."""
    return load_scenario("05-off-centre", {"duration": 0.6})


@pytest.fixture(scope="module")
def done(scenario: Scenario) -> Run:
    return run(scenario)


class Read:
    """A recording's chunks, by entity: moving ones joined in time order."""

    def __init__(self, path: Path) -> None:
        self.moving: dict[str, dict[str, list]] = {}
        self.static: dict[str, dict[str, list]] = {}
        for chunk in RrdReader(path).stream():
            into = (self.static if chunk.is_static else self.moving).setdefault(
                chunk.entity_path, {}
            )
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                into.setdefault(name, []).extend(batch.column(name).to_pylist())

    def times(self, entity: str) -> Array:
        # pandas before 3.1 cuts the nanoseconds off what it calls total seconds
        return np.array([t / np.timedelta64(1, "s") for t in self.moving[entity]["time"]])

    def values(self, entity: str, component: str) -> Array:
        """``(rows, instances, ...)``, squeezed."""
        return np.squeeze(np.array(self.moving[entity][component], dtype=float))

    def pose(self, body: str) -> tuple[Array, Array]:
        """Positions ``(frames, 3)`` and rotations ``(frames, 3, 3)`` of a body."""
        entity = f"/{body}"
        return self.values(entity, "Transform3D:translation"), rotation_matrix(
            self.values(entity, "Transform3D:quaternion")
        )


@pytest.fixture(scope="module")
def recording(done: Run, tmp_path_factory: pytest.TempPathFactory) -> Read:
    path = tmp_path_factory.mktemp("recording") / "recording.rrd"
    write_recording(path, done)
    return Read(path)


@pytest.fixture(scope="module")
def trace(done: Run) -> RunTrace:
    assert done.trace is not None
    return done.trace


@pytest.fixture(scope="module")
def rows(done: Run, trace: RunTrace) -> np.ndarray:
    return frame_rows(trace, done.scenario.rate)


def test_frames_cover_the_run(done: Run, trace: RunTrace, rows: np.ndarray) -> None:
    gaps = np.diff(trace.t[rows])
    assert rows[0] == 0
    assert rows[-1] == len(trace.t) - 1
    assert gaps.max() <= 1.0 / FREE + 1.0 / done.scenario.rate
    inside = trace.contact[rows[:-1]] & trace.contact[rows[1:]]
    assert gaps[inside].max() <= 1.0 / CONTACT + 1.0 / done.scenario.rate
    assert np.argmax(np.linalg.norm(trace["wrench_true"][:, :3], axis=1)) in rows


def test_active_port_stands_at_the_pose_that_was_reached(
    recording: Read, trace: RunTrace, rows: np.ndarray
) -> None:
    position, rotation = recording.pose("rig/platform")
    np.testing.assert_allclose(recording.times("/rig/platform"), trace.t[rows], atol=1e-9)
    port = position - rotation @ CENTRE
    np.testing.assert_allclose(port, trace["pose_act"][rows, :3], atol=SINGLE)
    np.testing.assert_allclose(rotation, rotation_matrix(trace["pose_act"][rows, 3:]), atol=SINGLE)


def test_links_end_at_the_platform_and_start_at_their_slider(
    recording: Read, trace: RunTrace, rows: np.ndarray
) -> None:
    position, rotation = recording.pose("rig/platform")
    for j, limb in enumerate(shipped_limbs()):
        anchor = position + rotation @ (limb[6:9] - CENTRE)
        foot, turn = recording.pose(f"rig/link_{j}")
        np.testing.assert_allclose(foot + turn @ [0.0, 0.0, limb[9]], anchor, atol=3 * SINGLE)
        carriage, _ = recording.pose(f"rig/carriage_{j}")
        travel = (carriage - limb[0:3]) @ limb[3:6]
        # the ball joints give a little under load
        np.testing.assert_allclose(travel, trace["slider_act"][rows, j], atol=2e-4)


def test_arrow_is_the_contact_force_where_it_acts(
    recording: Read, done: Run, trace: RunTrace, rows: np.ndarray
) -> None:
    entity, wrench = "/rig/at_P/contact_force", trace["wrench_true"][rows]
    scale = force_scale(np.linalg.norm(trace["wrench_true"][:, :3], axis=1).max())
    vectors, origins = (
        recording.moving[entity][f"Arrows3D:{part}"] for part in ("vectors", "origins")
    )
    assert len(vectors) == len(rows)
    for vector, origin, w, touching in zip(
        vectors, origins, wrench, trace.contact[rows], strict=True
    ):
        assert len(vector) == (touching and bool(np.any(w[:3])))
        if len(vector):
            np.testing.assert_allclose(np.array(vector[0]) / scale, w[:3], rtol=1e-5, atol=1e-3)
            # one sphere on a plane carries no couple: the torque about P is that of the force where
            # it is drawn
            np.testing.assert_allclose(
                np.cross(origin[0], w[:3]), w[3:], atol=1e-4 * float(np.linalg.norm(w[:3]))
            )


def test_every_tick_of_every_signal_is_there(recording: Read, trace: RunTrace) -> None:
    ticks = len(trace.t)
    for name, columns in (("force", slice(0, 3)), ("torque", slice(3, 6))):
        expected = np.stack(
            [trace[f"wrench_{k}"][:, columns] for k in ("true", "meas", "comp")], axis=-1
        )
        for j, axis in enumerate("xyz"):
            np.testing.assert_allclose(
                recording.values(f"/signals/{name}/{axis}", "Scalars:scalars"), expected[:, j]
            )
    for j, axis in enumerate("xyz"):
        both = np.stack([trace["pose_cmd"][:, j], trace["pose_act"][:, j]], axis=-1)
        np.testing.assert_allclose(
            recording.values(f"/signals/position_mm/{axis}", "Scalars:scalars"), 1e3 * both
        )
        assert len(recording.times(f"/signals/attitude_deg/{axis}")) == ticks
    np.testing.assert_allclose(recording.times("/signals/force/z"), trace.t, atol=1e-9)


def test_estimates_stand_beside_their_true_values(
    recording: Read, done: Run, trace: RunTrace
) -> None:
    contact = done.scenario.mechanism.contact
    for name, truth in (("stiffness", contact.stiffness), ("damping", contact.damping)):
        line = f"/signals/{name}/z/true"
        assert recording.values(line, "Scalars:scalars").tolist() == [truth, truth]
        assert recording.times(line).tolist() == pytest.approx([trace.t[0], trace.t[-1]])
        estimate = trace[f"{name}_est"][:, 2]
        known = np.flatnonzero(np.isfinite(estimate))[0]
        np.testing.assert_allclose(
            recording.values(f"/signals/{name}/z/identified", "Scalars:scalars"), estimate[known:]
        )


def test_energy_ends_at_the_figure_of_the_summary(recording: Read, done: Run) -> None:
    energy = recording.values("/signals/energy_generated", "Scalars:scalars")
    assert energy[-1] == pytest.approx(done.summary["energy_generated"], rel=1e-6, abs=1e-12)


def test_phases_change_with_the_contact(recording: Read, trace: RunTrace) -> None:
    times = recording.times("/signals/contact_phase")
    states = [s[0] for s in recording.moving["/signals/contact_phase"]["StateChange:state"]]
    assert states[0] == "approach"
    assert states[-1] == "free"
    at = np.searchsorted(times, trace.t + 1e-9) - 1
    touching = np.isin(np.array(states)[at], ["compression", "restitution"])
    np.testing.assert_array_equal(touching, trace.contact)


def test_phase_is_captured_from_the_latch_on(trace: RunTrace) -> None:
    phases = np.array(contact_phases(trace, captured_at=trace.t[700]))
    assert set(phases[700:]) == {"captured"}
    assert phases[:700].tolist() == contact_phases(trace)[:700]


def test_spacecraft_stand_apart_as_their_ports_do(
    recording: Read, done: Run, trace: RunTrace, rows: np.ndarray
) -> None:
    craft = done.scenario.spacecraft
    x_c, r_c = recording.pose("spacecraft/chaser")
    x_t, r_t = recording.pose("spacecraft/target")
    apart = x_c + r_c @ craft.chaser.port.position - x_t - r_t @ craft.target.port.position
    seen = np.einsum("fji,fj->fi", r_t, apart)
    np.testing.assert_allclose(seen, trace["pose_cmd"][rows, :3], atol=2 * SINGLE)


def test_centre_of_mass_of_the_spacecraft_moves_uniformly(
    recording: Read, done: Run, trace: RunTrace, rows: np.ndarray
) -> None:
    craft = done.scenario.spacecraft
    weights = np.array([craft.chaser.mass, craft.target.mass])
    both = np.stack([recording.pose(f"spacecraft/{name}")[0] for name in ("chaser", "target")])
    centre = np.einsum("b,bfi->fi", weights / weights.sum(), both)
    t = trace.t[rows]
    line = np.stack([np.polyval(np.polyfit(t, centre[:, i], 1), t) for i in range(3)], axis=-1)
    # drawn from a step a frame: half a frame (1/480 s) at the change of velocity (0.07 m/s) leaves
    # 0.15 mm at most
    np.testing.assert_allclose(centre, line, atol=2e-4)


def test_scene_holds_rig_ports_and_spacecraft(recording: Read) -> None:
    meshes = {
        entity
        for entity, columns in recording.static.items()
        if any(c.startswith("Mesh3D:") for c in columns)
    }
    limbs = {f"/rig/{part}_{j}/shape" for part in ("carriage", "link") for j in range(6)}
    assert limbs | {"/rig/platform/shape", "/rig/platform/port_A", "/rig/at_P/port_P"} <= meshes
    assert {
        "/rig/platform/active_mechanism/shape",
        "/rig/fixed/passive_mechanism/shape",
        "/rig/fixed/frame_frame/shape",
    } <= meshes
    assert {"/spacecraft/chaser/body", "/spacecraft/target/body"} <= meshes


def test_the_same_run_gives_the_same_content_and_the_layout_lies_inside_the_file(
    recording: Read, done: Run, tmp_path: Path
) -> None:
    write_recording(tmp_path / "again.rrd", done)
    again = Read(tmp_path / "again.rrd")
    assert len(RrdReader(tmp_path / "again.rrd").blueprints()) == 1
    for one, other in ((recording.moving, again.moving), (recording.static, again.static)):
        assert one.keys() == other.keys()
        for entity in one:
            for name in one[entity].keys() - {"rerun.controls.RowId"}:
                assert str(one[entity][name]) == str(other[entity][name]), (entity, name)


def test_upper_platform_carries_P_and_its_legs_close(tmp_path: Path) -> None:
    far = load_scenario("14-rendezvous", {"duration": 0.2})
    done = run(far)
    assert done.trace is not None
    write_recording(tmp_path / "recording.rrd", done)
    read, rows = Read(tmp_path / "recording.rrd"), frame_rows(done.trace, far.rate)
    port, attitude = read.pose("rig/at_P")
    assert port[0, 2] > 1.0  # a gap of 2 m is for the upper platform to close
    lower, turn = read.pose("rig/platform")
    relative = np.einsum("fji,fj->fi", attitude, lower - turn @ CENTRE - port)
    # P is drawn where it is planned to be
    np.testing.assert_allclose(relative, done.trace["pose_act"][rows, :3], atol=2e-5)
    upper = Upper.load()
    for j, leg in enumerate(upper.limbs):
        foot, swing = read.pose(f"rig/upper_link_{j}")
        end = foot + swing @ [-1.0, 0.0, -0.98]  # link_end of models/prs3
        np.testing.assert_allclose(end, port + attitude @ leg[6:9], atol=1e-5)


def test_a_run_that_does_not_touch(scenario: Scenario, tmp_path: Path) -> None:
    away = run(scenario.model_copy(update={"duration": 0.1}))
    write_recording(tmp_path / "recording.rrd", away)
    read = Read(tmp_path / "recording.rrd")
    assert all(len(v) == 0 for v in read.moving["/rig/at_P/contact_force"]["Arrows3D:vectors"])
    assert not [entity for entity in read.moving if entity.endswith("/identified")]


def test_a_run_that_left_the_numbers_is_drawn_up_to_there(
    done: Run, trace: RunTrace, tmp_path: Path
) -> None:
    data = {name: values.copy() for name, values in trace.data.items()}
    for name in data:
        data[name][-3:] = np.nan
    lost = dataclasses.replace(done, trace=RunTrace(trace.t, data, trace.contact))
    write_recording(tmp_path / "recording.rrd", lost)
    read = Read(tmp_path / "recording.rrd")
    assert np.isfinite(read.pose("rig/platform")[0]).all()
    assert read.times("/rig/platform")[-1] < trace.t[-3]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is always full: Linux only")
def test_a_full_disk_is_an_error(done: Run) -> None:
    with pytest.raises(OSError, match="disk full"):
        write_recording(Path("/dev/full"), done)
