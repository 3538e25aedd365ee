"""A stability verdict is kept for as long as nothing that it is computed from has changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltestbed import plugins
from hiltestbed.analysis import kept_stability, stability
from hiltestbed.analysis.kept_stability import stability_of_file
from tests.scripts import program

TEXT = """\
name: head-on
spacecraft:
  chaser: {mass: 500.0, inertia: [200.0, 180.0, 150.0]}
  target: {mass: 2000.0, inertia: [900.0, 900.0, 700.0]}
approach: {gap: 0.002, velocity: [0, 0, 0.03]}
mechanism: {kind: mjcf, active: active.xml, passive: passive.xml, contact: {stiffness: 1e5}}
rig: {platform: {tracking: ideal}}
"""
ACTIVE = """\
<mujoco><worldbody><geom name="ball" type="sphere" size="{radius}" pos="0 0 -0.01"/>
  <site name="A"/></worldbody></mujoco>
"""
PASSIVE = """\
<mujoco><worldbody><geom name="plate" type="box" size="0.1 0.1 0.01" pos="0 0 0.01"/>
  <site name="P"/></worldbody></mujoco>
"""


@pytest.fixture
def computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """A scenario file in the working folder, an empty cache, and the verdicts computed so far."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(TEXT)
    Path("active.xml").write_text(ACTIVE.format(radius=0.01))
    Path("passive.xml").write_text(PASSIVE)
    found: list[dict] = []

    def judged(scenario) -> dict:
        found.append({"verdict": "stable", "delay": 0.1 + scenario.sensor.delay, "limit": None})
        return found[-1]

    monkeypatch.setattr(stability, "stability", judged)
    return found


def test_a_kept_verdict_is_the_computed_one_to_the_last_bit(computed: list[dict]) -> None:
    assert [stability_of_file("s.yaml") for _ in range(3)] == 3 * computed
    assert len(computed) == 1


def test_what_changes_the_verdict_has_it_computed_again(
    computed: list[dict], monkeypatch: pytest.MonkeyPatch, subtests
) -> None:
    provenance = kept_stability.provenance
    changes = {
        "a key": lambda: Path("s.yaml").write_text(TEXT + "sensor: {delay: 0.01}\n"),
        "a model that it names": lambda: Path("active.xml").write_text(ACTIVE.format(radius=0.009)),
        "the code": lambda: monkeypatch.setattr(
            kept_stability, "provenance", lambda: provenance() | {"hiltestbed's code": "another"}
        ),
    }
    stability_of_file("s.yaml")
    for count, (what, change) in enumerate(changes.items(), 2):
        with subtests.test(what):
            change()
            assert stability_of_file("s.yaml") == stability_of_file("s.yaml") == computed[-1]
            assert len(computed) == count


def test_an_override_is_a_change_too(computed: list[dict]) -> None:
    for delay in (0.0, 0.01, 0.0, 0.01):
        judged = stability_of_file("s.yaml", {"sensor.delay": delay})
        assert judged is not None
        assert judged["delay"] == 0.1 + delay
    assert len(computed) == 2


def test_with_a_users_module_nothing_is_kept(
    computed: list[dict], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plugins, "loaded", lambda: {"mine.py": "0" * 64})
    stability_of_file("s.yaml"), stability_of_file("s.yaml")
    assert len(computed) == 2


@pytest.mark.parametrize("fault", ["garbled", "not a folder"])
def test_a_cache_that_cannot_be_used_is_done_without(
    computed: list[dict], tmp_path: Path, fault: str
) -> None:
    if fault == "garbled":
        stability_of_file("s.yaml")
        for file in (tmp_path / "cache").rglob("*.json"):
            file.write_text('{"verdict": "st')
    else:
        (tmp_path / "cache").write_text("")
    assert stability_of_file("s.yaml") == computed[-1]
    assert len(computed) == (2 if fault == "garbled" else 1)


def test_a_file_is_checked_once_more_without_compiled_code(computed: list[dict]) -> None:
    """What takes longest of a check is importing: Numba and SciPy wait for a new verdict."""
    stability_of_file("s.yaml")
    text = (
        "import sys; from hiltestbed.cli import main; sys.argv = ['hiltestbed', 'check', 's.yaml']\n"
        "try: main()\n"
        "except SystemExit as ended: assert not ended.code\n"
        "print([name for name in ('numba', 'scipy', 'pinocchio') if name in sys.modules])"
    )
    done = program("-c", text, check=True)
    assert "no faults" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"
