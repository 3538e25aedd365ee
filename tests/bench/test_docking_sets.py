"""Docking sets of the second rig: what is hidden stays in its link, sets come from their seeds,
files are whole.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from tests.bench.test_independent_rig import CHANGED
from tests.equipment.independent_rig import (
    EFFECTS,
    FOREIGN,
    LOOK_ALIKES,
    NOISE_KINDS,
    Nuisances,
    acting_in,
    draw_docking_facility,
    draw_effects,
    draw_facility,
    draw_look_alike,
    draw_set,
    foreign_in,
    link_of,
    silence,
    simulate,
    strength,
    write_set,
)
from tests.equipment.independent_rig.contact import STATES, Contact, force_on
from tests.equipment.independent_rig.docking_facility import DockingFacility
from tests.equipment.independent_rig.docking_sizes import SIZES
from tests.equipment.independent_rig.generation import PLAIN, rig_of

FACILITIES: dict[str, DockingFacility] = {}


def _facility(design: str) -> DockingFacility:
    if design not in FACILITIES:
        FACILITIES[design] = draw_docking_facility(np.random.default_rng(2), design)
    return FACILITIES[design]


HIDDEN = [
    (design, name)
    for design in ("docking", "held")
    for name in (*acting_in(design), *foreign_in(design))
]  # type: ignore[arg-type]


@pytest.mark.parametrize(("design", "name"), HIDDEN)
def test_in_a_docking_an_effect_changes_what_its_link_gives_and_nothing_else(
    design: str, name: str
) -> None:
    facility = _facility(design)
    rng = np.random.default_rng(12)
    effects = draw_effects(rng, (name,), facility)
    rig, healthy = (rig_of(facility, 3, e, PLAIN) for e in (effects, []))
    noise = silence(rig.ticks)._replace(
        delay=rng.standard_normal(rig.ticks), repeat=rng.random(rig.ticks)
    )
    records = simulate(rig, noise)
    replayed = simulate(healthy, noise, pose_cmd=records.pose_cmd, wrench_comp=records.wrench_comp)
    floors = {"pose_cmd": 1e-9, "pose_act": 1e-9, "wrench_meas": 1e-4, "wrench_comp": 1e-3}
    differs = {
        c
        for c, floor in floors.items()
        if np.abs(getattr(records, c) - getattr(replayed, c)).max() > floor
    }
    assert differs == CHANGED[link_of(name)]


def test_what_acts_where_is_told() -> None:
    assert set(SIZES) == set(EFFECTS)
    assert set(acting_in("docking")) == set(EFFECTS) - {"contact.backlash"}
    for design in ("bumper", "docking", "mounted", "held"):
        assert len(foreign_in(design)) >= 16
    assert set(FOREIGN) < set(foreign_in("bumper"))
    with pytest.raises(ValueError, match="cannot be hidden"):
        draw_set(np.random.default_rng(1), "single", names=("contact.backlash",), design="docking")
    with pytest.raises(ValueError, match="unknown noise"):
        draw_set(np.random.default_rng(1), "healthy", noise=("hiss", 1.0))


def test_a_docking_facilitys_first_touch_falls_between_ticks() -> None:
    facility = _facility("docking")
    rate = facility.scenario["rate"]
    for run in range(6):
        rig = rig_of(facility, run, [], PLAIN)
        records = simulate(rig, silence(rig.ticks))
        first = int(np.flatnonzero(records.touching)[0])
        force = np.linalg.norm(records.physical[first, :3])
        speed = facility.speeds[run]
        stiff = rig.contact.stiffness
        # The step of the damper, and the spring over the part of a tick since the touch: neither
        # none nor the whole of it.
        step = force / (rig.contact.damping * speed + stiff * speed / rate)
        assert 0.3 < step < 1.2


@pytest.mark.parametrize("design", ["docking", "held"])
def test_a_docking_set_comes_from_its_seed_and_is_written_as_a_dataset(
    design: Literal["docking", "held"], tmp_path: Path
) -> None:
    first, second = (
        draw_set(
            np.random.default_rng(4), "single", names=("sensor.delay",), design=design, twists=True
        )
        for _ in range(2)
    )
    assert first.truth == second.truth
    for a, b in zip(first.runs, second.runs, strict=True):
        assert a.wrench_comp.tobytes() == b.wrench_comp.tobytes()
    folder = write_set(tmp_path / "set", first, truth=True)
    nominal = YAML(typ="safe").load(folder / "nominal.yaml")
    assert nominal == first.facility.scenario
    assert nominal["mechanism"]["kind"] == ("probe_cone" if design == "docking" else "latched")
    table = pq.read_table(folder / "run_0.parquet")
    assert table.column_names[0] == "t"
    assert {"pose_act.qz", "wrench_comp.tz", "twist_act.wx", "twist_cmd.vz"} < set(
        table.column_names
    )
    truth = YAML(typ="safe").load(folder / "truth.yaml")
    assert truth["effects"][0]["kind"] == "sensor.delay"
    assert first.strengths[0] >= 3.0
    pose = np.stack([table[f"pose_act.p{a}"].to_numpy() for a in "xyz"], axis=1)
    speed = np.stack([table[f"twist_act.v{a}"].to_numpy() for a in "xyz"], axis=1)
    np.testing.assert_allclose(speed[1:], np.diff(pose, axis=0) * nominal["rate"], atol=1e-9)


def test_noise_of_the_sensor_acts_in_the_loop_and_that_of_the_log_does_not() -> None:
    options = {"names": ("contact.stiffness",), "design": "docking", "literal": True}
    logged = draw_set(np.random.default_rng(5), "single", noise=("held_rows", 0.05), **options)  # type: ignore[arg-type]
    for records, log in zip(logged.runs, logged.logs, strict=True):
        assert not np.array_equal(records.wrench_meas, log.wrench_meas)
        np.testing.assert_array_equal(records.wrench_comp, log.wrench_comp)
    felt = draw_set(np.random.default_rng(5), "single", noise=("converter_steps", 1.0), **options)  # type: ignore[arg-type]
    for i, log in enumerate(felt.logs):
        np.testing.assert_allclose(
            log.wrench_meas[:, :3], np.round(log.wrench_meas[:, :3]), atol=1e-9
        )
        # The compensator was driven with what is in the log: replayed on it, it gives what is in
        # the log.
        rig = rig_of(felt.facility, i, felt.effects, felt.variants)
        a, b = rig.compensator.t2 * rig.rate, rig.compensator.t1 * rig.rate
        u, y = log.wrench_meas, np.zeros_like(log.wrench_comp)
        for k in range(len(u)):
            y[k] = ((y[k - 1] * a if k else 0.0) + u[k] + b * (u[k] - (u[k - 1] if k else 0.0))) / (
                1.0 + a
            )
        np.testing.assert_allclose(log.wrench_comp, y, atol=1e-9)


@pytest.mark.parametrize("name", [n for n, k in NOISE_KINDS.items() if k.place == "sensor"])
def test_in_a_set_the_reading_in_free_flight_is_the_noise_alone(name: str) -> None:
    weak = NOISE_KINDS[name].strengths[0]
    hidden = draw_set(np.random.default_rng(6), "healthy", noise=(name, weak), literal=True)
    free = [r.wrench_meas[~r.touching][:80, :3] for r in hidden.runs]
    assert all(np.isfinite(f).all() for f in free)
    spread = np.std(np.concatenate([f - f.mean(axis=0) for f in free]))
    assert (
        0.5 * hidden.facility.noise
        < spread
        < 3.0 * hidden.facility.noise + (0.6 if name == "converter_steps" else 0.0)
    )


def test_a_text_log_is_a_csv_with_as_many_digits(tmp_path: Path) -> None:
    hidden = draw_set(np.random.default_rng(7), "healthy", noise=("digits", 5.0), literal=True)
    folder = write_set(tmp_path / "set", hidden)
    lines = (folder / "run_0.csv").read_text().splitlines()
    assert lines[0].startswith("t,pose_cmd.px")
    assert len(lines) == len(hidden.logs[0].t) + 1
    numbers = np.loadtxt(lines, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(numbers[:, 0], hidden.logs[0].t)
    fz = lines[0].split(",").index("wrench_meas.fz")
    np.testing.assert_array_equal(numbers[:, fz], hidden.logs[0].wrench_meas[:, 2])


@pytest.mark.parametrize(
    "method",
    ["none", "second_order_lead", "smith_predictor", "passivity_control", "reconstruction"],
)
def test_a_set_may_use_any_compensation(method: str) -> None:
    hidden = draw_set(
        np.random.default_rng(8),
        "single",
        names=("sensor.gain",),
        compensation=method,
        nuisances=Nuisances(substeps=7),
    )
    assert hidden.facility.scenario["compensation"]["force"]["kind"] == method
    assert hidden.truth["compensation"] == method
    assert hidden.truth["nuisances"]["substeps"] == 7
    changed = [np.abs(r.wrench_comp - r.wrench_meas).max() for r in hidden.runs]
    assert max(changed) == 0.0 if method == "none" else max(changed) > 0.0


@pytest.mark.parametrize("pair", list(LOOK_ALIKES), ids="/".join)
def test_look_alikes_do_much_the_same_to_the_records(pair: tuple[str, str]) -> None:
    """On the same command, and under the same force, both change the records of their link
    alike.
    """
    rng = np.random.default_rng(9)
    facility = draw_facility(rng, frozenset({"slide"}))
    both = draw_look_alike(rng, pair, facility)
    assert (both[0]["kind"], both[1]["kind"]) == pair
    plain = simulate(rig := rig_of(facility, 3, [], PLAIN), silence(rig.ticks))
    links = {link_of(name) for name in pair}
    channel = (
        {"dynamics": "pose_cmd", "platform": "pose_act"}.get(links.pop(), "wrench_meas")
        if len(links) == 1
        else "wrench_meas"
    )
    channel = "wrench_comp" if "loop.deadzone" in pair else channel
    changes = []
    for effect in both:
        cut = simulate(
            rig_of(facility, 3, [effect], PLAIN),
            silence(rig.ticks),
            pose_cmd=plain.pose_cmd,
            wrench_comp=plain.wrench_comp,
        )
        changes.append((getattr(cut, channel) - getattr(plain, channel))[:, 2])
    sizes = [float(np.linalg.norm(c)) for c in changes]
    assert 0.4 < sizes[0] / sizes[1] < 2.5
    assert changes[0] @ changes[1] > 0.7 * sizes[0] * sizes[1]


def test_a_set_of_look_alikes_names_its_rival() -> None:
    hidden = draw_set(np.random.default_rng(10), "alike", pair=("sensor.delay", "contact.damping"))
    assert hidden.effects[0]["kind"] == "sensor.delay"
    assert hidden.truth["rival"]["kind"] == "contact.damping"
    drawn = {draw_set(np.random.default_rng(s), "alike").effects[0]["kind"] for s in range(4)}
    assert len(drawn) > 1


@pytest.mark.parametrize(
    "name", ["sensor.delay", "contact.surface_friction", "dynamics.inertia", "platform.lag"]
)
def test_in_a_docking_the_strength_of_an_effect_grows_with_its_size(name: str) -> None:
    facility = _facility("docking")
    sized = [
        draw_effects(np.random.default_rng(6), (name,), facility, scale)
        for scale in (0.25, 0.5, 1.0)
    ]
    strengths = [strength(facility, effects, 0, PLAIN) for effects in sized]
    assert strengths[0] < strengths[1] < strengths[2]


def test_the_rig_shares_no_code_with_what_it_checks() -> None:
    import ast

    import tests.equipment.independent_rig as package

    allowed = {"numpy", "numba", "scipy", "pyarrow", "ruamel"}
    for path in Path(package.__file__).parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        names = [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]
        names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        for name in names:
            top = name.split(".")[0]
            # which compiles and computes nothing
            own = (
                name.startswith("tests.equipment.independent_rig")
                or name == "hiltestbed.compiled.jit"
            )
            assert own or top in allowed or top in sys.stdlib_module_names, (
                f"{path.name} imports {name}"
            )


def test_wear_goes_on_from_run_to_run() -> None:
    facility = _facility("docking")
    effects = [{"kind": "unknown.wear", "rate": -0.03}]
    nominal = [rig_of(facility, i, [], PLAIN).contact.stiffness for i in range(4)]
    worn = [rig_of(facility, i, effects, PLAIN).contact.stiffness for i in range(4)]
    np.testing.assert_allclose(np.array(worn) / nominal, 1.0 - 0.03 * np.arange(4))


def test_what_a_latch_holds_is_damped_where_its_spring_is_not_stretched() -> None:
    law, states = (
        Contact(np.array([0.0, 0.0, 1.0]), 2e4, 900.0, 0.0, latched=True),
        np.zeros(STATES),
    )
    assert force_on(law, 0.0, 0.01, states) == pytest.approx(9.0)
    assert force_on(law._replace(play=1e-4), 0.0, 0.01, states) == 0.0
    assert force_on(law._replace(latched=False), 0.0, 0.01, states) == 0.0
