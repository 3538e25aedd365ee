"""What the bench of speed times is what it says."""

from __future__ import annotations

from pathlib import Path

from hiltestbed.bench.throughput import _oval_cone, docking_ratios
from hiltestbed.config.gallery import shipped
from hiltestbed.contact.geometry import FACES, KIND, ROW
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.surfaces.surface import MESH
from hiltestbed.scenario import load_scenario
from tests.slow import SLOW


@SLOW
def test_the_oval_cone_is_searched_by_its_triangles(tmp_path: Path) -> None:
    keys = {"mechanism.kind": "mjcf", "mechanism.latch": None, **_oval_cone(tmp_path)}
    sides = sides_of(load_scenario(shipped("scenarios") / "09-docking.yaml", set=keys).mechanism)
    rows = sides.geometry.index[: sides.geometry.count * ROW].reshape(-1, ROW)
    assert set(rows[:, KIND].tolist()) == {MESH}
    assert set(rows[:, FACES].tolist()) == {96_256}
    assert not sides.native


@SLOW
def test_every_case_of_a_docking_is_timed() -> None:
    ratios = docking_ratios(1, 2)
    assert set(ratios) == {
        "cone by its profile",
        "cone by its profile, upper platform moving",
        "cone by its triangles",
    }
    assert all(ratio > 0.0 for ratio in ratios.values())
