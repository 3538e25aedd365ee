"""The second rig: each hidden effect in its link, sets from seeds, whole files. What effects do there is
compared with the package's own in tests/physics."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from tests.equipment.independent_rig import (
    DOCKING_SIZES,
    EFFECTS,
    FOREIGN,
    LOOK_ALIKES,
    NEEDS,
    PLAIN,
    SIZES,
    DockingFacility,
    Facility,
    acting_in,
    draw_docking_facility,
    draw_effects,
    draw_facility,
    draw_look_alike,
    draw_set,
    foreign_in,
    link_of,
    rig_of,
    silence,
    simulate,
    write_set,
)
from tests.slow import ALL, SLOW

CHANGED = {
    "platform": {"pose_act", "wrench_meas", "wrench_comp"},
    "contact": {"wrench_meas", "wrench_comp"},
    "sensor": {"wrench_meas", "wrench_comp"},
    "compensation": {"wrench_comp"},
    "dynamics": {"pose_cmd"},
    "log": {"wrench_meas"},
}


def changed_by(facility: Facility, effects: list[dict], rng: np.random.Generator) -> set[str]:
    """Channels that the nominal links, each on what a rig with these effects recorded as its input,
    give otherwise than that rig.
    """
    rig, healthy = (rig_of(facility, 3, e, PLAIN) for e in (effects, []))
    noise = silence(rig.ticks)._replace(
        delay=rng.standard_normal(rig.ticks), repeat=rng.random(rig.ticks)
    )
    records = simulate(rig, noise)
    replayed = simulate(healthy, noise, pose_cmd=records.pose_cmd, wrench_comp=records.wrench_comp)
    floors = {"pose_cmd": 1e-9, "pose_act": 1e-9, "wrench_meas": 1e-4, "wrench_comp": 1e-3}
    return {
        c
        for c, floor in floors.items()
        if np.abs(getattr(records, c) - getattr(replayed, c)).max() > floor
    }


@pytest.mark.parametrize(
    "name", [*EFFECTS, *FOREIGN] if ALL else {link_of(n): n for n in (*FOREIGN, *EFFECTS)}.values()
)
def test_an_effect_changes_what_its_link_gives_and_nothing_else(name: str) -> None:
    rng = np.random.default_rng(11)
    facility = draw_facility(rng, frozenset({"slide"}) | NEEDS.get(name, frozenset()))
    effects = draw_effects(rng, (name,), facility)
    assert changed_by(facility, effects, rng) == CHANGED[link_of(name)]


def test_every_effect_has_a_size_and_the_touch_falls_between_ticks() -> None:
    assert set(SIZES) == set(EFFECTS)
    facility = draw_facility(np.random.default_rng(6), frozenset({"slide"}))
    for changes, speed in zip(facility.runs, facility.speeds, strict=True):
        assert 0.2 < (changes["approach.gap"] / speed * facility.scenario["rate"]) % 1.0 < 0.8


@cache
def _facility(design: str) -> DockingFacility:
    return draw_docking_facility(np.random.default_rng(2), design)


HIDDEN = [
    (design, name)
    for design in ("docking", "held")
    for name in (*acting_in(design), *foreign_in(design))
]  # type: ignore[arg-type]
OF_EACH = {link_of(name): (design, name) for design, name in HIDDEN}  # one of each link


@pytest.mark.parametrize(("design", "name"), HIDDEN if ALL else OF_EACH.values())
def test_in_a_docking_an_effect_changes_what_its_link_gives_and_nothing_else(
    design: str, name: str
) -> None:
    facility, rng = _facility(design), np.random.default_rng(12)
    effects = draw_effects(rng, (name,), facility)
    assert changed_by(facility, effects, rng) == CHANGED[link_of(name)]


def test_what_acts_where_is_told() -> None:
    assert set(DOCKING_SIZES) == set(EFFECTS)
    assert set(acting_in("docking")) == set(EFFECTS) - {"contact.backlash"}
    for design in ("bumper", "docking", "mounted", "held"):
        assert len(foreign_in(design)) >= 16
    assert set(FOREIGN) < set(foreign_in("bumper"))
    with pytest.raises(ValueError, match="cannot be hidden"):
        draw_set(np.random.default_rng(1), "single", names=("contact.backlash",), design="docking")
    with pytest.raises(ValueError, match="unknown noise"):
        draw_set(np.random.default_rng(1), "healthy", noise=("hiss", 1.0))


@pytest.mark.parametrize("design", ["docking", "held"])
def test_a_docking_set_comes_from_its_seed_and_is_written_as_a_dataset(
    design: Literal["docking", "held"], tmp_path: Path
) -> None:
    first, second = (
        draw_set(np.random.default_rng(4), "single", names=("sensor.delay",), design=design)
        for _ in range(2)
    )
    assert (first.effects, first.strengths) == (second.effects, second.strengths)
    for a, b in zip(first.runs, second.runs, strict=True):
        assert a.wrench_comp.tobytes() == b.wrench_comp.tobytes()
    folder = write_set(tmp_path / "set", first)
    nominal = YAML(typ="safe").load(folder / "nominal.yaml")
    assert nominal == first.facility.scenario
    assert nominal["mechanism"]["kind"] == ("probe_cone" if design == "docking" else "latched")
    table = pq.read_table(folder / "run_0.parquet")
    assert table.column_names[0] == "t"
    assert {"pose_act.qz", "wrench_comp.tz"} < set(table.column_names)
    assert first.strengths[0] >= 3.0
    assert table["pose_act.pz"].to_numpy().tobytes() == first.runs[0].pose_act[:, 2].tobytes()


@SLOW
@pytest.mark.parametrize("pair", list(LOOK_ALIKES), ids="/".join)
def test_look_alikes_do_much_the_same_to_the_records(pair: tuple[str, str]) -> None:
    """On one command, under one force, both change the records of their link alike."""
    rng = np.random.default_rng(9)
    facility = draw_facility(rng, frozenset({"slide"}))
    both = draw_look_alike(rng, pair, facility)
    assert (both[0]["kind"], both[1]["kind"]) == pair
    plain = simulate(rig := rig_of(facility, 3, [], PLAIN), silence(rig.ticks))
    (link, *others) = {link_of(name) for name in pair}
    channel = {"dynamics": "pose_cmd", "platform": "pose_act"}.get(link, "wrench_meas")
    channel = "wrench_meas" if others else channel
    channel = "wrench_comp" if "loop.deadzone" in pair else channel
    cuts = {"pose_cmd": plain.pose_cmd, "wrench_comp": plain.wrench_comp}
    changes = []
    for effect in both:
        cut = simulate(rig_of(facility, 3, [effect], PLAIN), silence(rig.ticks), **cuts)
        changes.append((getattr(cut, channel) - getattr(plain, channel))[:, 2])
    sizes = [float(np.linalg.norm(c)) for c in changes]
    assert 0.4 < sizes[0] / sizes[1] < 2.5
    assert changes[0] @ changes[1] > 0.7 * sizes[0] * sizes[1]


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
