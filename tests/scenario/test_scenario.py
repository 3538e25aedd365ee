"""What a scenario file may say, and what is refused: where, what was given, what is allowed."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from hiltestbed.build import runnable_from
from hiltestbed.config.models import models_folder
from hiltestbed.config.yaml_source import read_source
from hiltestbed.contact.settings import MECHANISMS
from hiltestbed.errors import InputError
from hiltestbed.scenario import dump_scenario, load_scenario, scenario_from, scenario_sha256

TEXT = """\
name: head-on
duration: 2.0
rate: 2000
physics_rate: 4000
spacecraft:
  chaser: {mass: 500.0, inertia: [200.0, 180.0, 150.0], port: {position: [0, 0, 1.0]}}
  target: {mass: 2000.0, inertia: [900.0, 900.0, 700.0]}
approach: {gap: 0.01, velocity: [0, 0, 0.03]}
mechanism:
  kind: bumper
  contact: {stiffness: 1e5, damping: 100.0}
sensor: {delay: 0.005}
compensation: {force: {kind: phase_lead}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(TEXT)
    return path


def faults_of(path: Path, overrides: dict | None = None) -> list[str]:
    with pytest.raises(InputError) as caught:
        runnable_from(read_source(path), overrides)
    assert caught.value.exit_status == 2
    return [str(fault) for fault in caught.value.faults]


def replaced(path: Path, old: str, new: str) -> Path:
    assert TEXT.count(old) == 1
    path.write_text(TEXT.replace(old, new))
    return path


def test_a_scenario_is_read_as_it_stands(file: Path) -> None:
    scenario = load_scenario(file)
    assert scenario.mechanism.contact.stiffness == 1e5, "1e5 is a number in YAML 1.2"
    assert scenario.spacecraft.chaser.port.position == (0.0, 0.0, 1.0)
    assert (scenario.ticks, scenario.substeps, scenario.tick) == (4000, 2, 1 / 2000)


def test_the_resolved_form_holds_every_default_and_reloads_to_the_same(
    file: Path, tmp_path: Path
) -> None:
    bias = {"effects.0": "{kind: sensor.bias, force: [1, 0, 0]}"}
    scenario = load_scenario(file, bias | {"sensor.noise": 1e-7, "name": "off"})
    resolved = tmp_path / "resolved.yaml"
    resolved.write_text(dump_scenario(scenario))
    assert load_scenario(resolved) == scenario
    assert scenario_sha256(load_scenario(resolved)) == scenario_sha256(scenario)
    defaults = "seed: 0", "tracking: servo", "lag: 0.0005", "torque: [0.0, 0.0, 0.0]", "drift:"
    assert all(default in resolved.read_text() for default in (*defaults, "forgetting: 1.0"))


def test_the_hash_sees_numbers_and_not_how_they_are_written(file: Path) -> None:
    before = load_scenario(file)
    for mass, same in (("5e2", True), ("500.0000001", False)):
        after = load_scenario(replaced(file, "mass: 500.0", f"mass: {mass}"))
        assert (scenario_sha256(after) == scenario_sha256(before)) is same
        assert (after == before) is same


def test_physics_rate_left_out_is_twice_the_rate(file: Path) -> None:
    scenario = load_scenario(replaced(file, "physics_rate: 4000\n", ""), {"rate": 8000})
    assert scenario.physics_rate == 16000.0


INERTIA = "[200.0, 180.0, 150.0]"
FAULTS = {  # what stands in the file, and where a fault in its place is; what is wrong there, words
    ("mass: 500.0", "6:12: spacecraft.chaser.mass"): {
        "mass: heavy": "got 'heavy'); allowed is a number",
        "mass: true": "allowed is a number",
        "mass: -500": "got -500); allowed is > 0",
        "mass: .nan": "a finite number",
        "mass: 1e999": "a finite number",
    },
    ("mass: 500.0,", "6:25: spacecraft.chaser.mass"): {
        "mass: 500.0, mass: 600.0,": "given twice (first in line 6)"
    },
    ("mass: 2000.0, ", "7:3: spacecraft.target.mass"): {"": "is missing"},
    (INERTIA, "6:25: spacecraft.chaser.inertia"): {
        "[200.0, 180.0, 400.0]": "triangle inequality",
        "[200.0, 180.0, 150.0, 190.0, 0, 0]": "positive definite",
        # on principal moments: the diagonal alone would pass
        "[2, 2, 2, 1.9, 0, 0]": "0.1, 2, 3.9",
    },
    (INERTIA, "6:49: spacecraft.chaser.inertia.2"): {"[200.0, 180.0, x]": "got 'x'"},
    ("physics_rate: 4000", "4:1: physics_rate"): {
        "physics_rate: 3000": "allowed is a whole multiple of rate, such as",
    },
    ("duration: 2.0", "2:1: duration"): {"duration: 0": "allowed is > 0", "duration: 1e7": "ticks"},
    ("delay: 0.005", "12:10: sensor.delay"): {
        "delay: -0.005": "allowed is >= 0",
        "delay: 5": "cannot be held",
    },
    ("gap: 0.01", "8:12: approach.gap"): {
        "gap: 0.3": "outside the workspace (got 0.3 m); allowed is 0 to 0.25 m",
    },
    ("gap: 0.01", "8:24: approach.offset.1"): {"offset: [0, -0.3]": "allowed is -0.25 to 0.25 m"},
    ("gap: 0.01", "8:30: approach.attitude_deg.1"): {
        "attitude_deg: [0, 11, 0]": "allowed is -10 to 10 deg"
    },
    ("velocity: [0, 0, 0.03]", "8:23: approach.velocity"): {
        "velocity: [0, 0]": "at least 3",
        "velocity: 0.03": "allowed is a list",
    },
    ("kind: bumper", "10:3: mechanism.kind"): {"kind: airbag": "allowed: bumper"},
    ("stiffness: 1e5", "11:13: mechanism.contact.stifness"): {
        "stifness: 1e5": "did you mean 'stiffness'"
    },
    ("{kind: phase_lead}", "13:24: compensation.force.kind"): {
        "{kind: phase_laed}": "did you mean 'phase_lead'"
    },
    ("{kind: phase_lead}", "13:42: compensation.force.led"): {
        "{kind: phase_lead, led: 1}": "did you mean 'lead'"
    },
    ("name: head-on", "1:1: name"): {"name:": "got null); allowed is text"},
    ("name: head-on\n", "1:1: name"): {"": "is missing"},
}


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [(old, new, at, words) for (old, at), of in FAULTS.items() for new, words in of.items()],
)
def test_a_fault_says_where_what_and_what_is_allowed(
    file: Path, old: str, new: str, place: str, words: str
) -> None:
    (fault,) = faults_of(replaced(file, old, new))
    assert fault.startswith(f"{file}:{place}: ")
    assert words in fault


def test_a_thin_disc_is_the_limit_of_the_triangle_inequality(file: Path) -> None:
    flat = load_scenario(file, {"spacecraft.chaser.inertia": "[1, 1, 2]"})
    assert flat.spacecraft.chaser.inertia == (1.0, 1.0, 2.0)


def test_every_fault_at_once_joined_ones_included(file: Path) -> None:
    text = (
        TEXT.replace("stiffness:", "stifness:")
        .replace("mass: 500.0", "mass: -1")
        .replace("physics_rate: 4000", "physics_rate: 3000")
    )
    file.write_text(text.replace("delay: 0.005", "dely: 0.005"))
    faults = faults_of(file)
    keys = ["physics_rate", "spacecraft.chaser.mass", "mechanism.contact.stifness", "sensor.dely"]
    assert [fault.split(": ")[1] for fault in faults] == keys, "in the order of the file"


def test_two_duplicate_keys_are_both_named(file: Path) -> None:
    file.write_text(TEXT + "sensor: {delay: 0.001}\nname: again\n")
    assert [fault.split(": ")[1] for fault in faults_of(file)] == ["sensor", "name"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"just words\n", "a YAML mapping"),
        (b"name: [1, 2\nrate: 3\n", "is not YAML"),
        (b"a: 1\n---\nb: 2\n", "is not YAML"),
        (b"\x7fELF\x02\x01\x01\0\0\0", "binary"),
        (b"name: \xff\xfe\n", "UTF-8"),
        (b"name: !!python/object:os.system x\n", "tag"),
        (b"name: &a [*a]\n", "levels"),
        (b"[" * 500, "levels"),
        (b"? [1, 2]\n: 3\n", "a key is a name"),
        (b"rate: " + b"9" * 5000 + b"\n", "number"),
    ],
)
def test_what_is_not_a_scenario_at_all_is_refused(
    tmp_path: Path, content: bytes, words: str
) -> None:
    path = tmp_path / "odd.yaml"
    path.write_bytes(content)
    faults = faults_of(path)
    assert all(fault.startswith(str(path)) for fault in faults)
    assert any(words in fault for fault in faults)


def test_aliases_of_aliases_are_not_expanded_without_bound(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    path = tmp_path / "laughs.yaml"
    path.write_text("\n".join(lines))
    assert "too large" in faults_of(path)[0]


def test_what_is_no_file_to_read_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "huge.yaml").open("wb") as handle:
        handle.truncate(100_000_000)
    assert "too large (got 100.0 MB); at most 0.5 MB" in faults_of(tmp_path / "huge.yaml")[0]
    assert "no such file" in faults_of(tmp_path / "none.yaml")[0]
    assert "is a folder" in faults_of(tmp_path)[0]


def test_set_overrides_keys_items_and_what_the_file_leaves_out(file: Path) -> None:
    changes = {"approach.velocity.2": "5e-2", "approach.offset": "[0.01, 0]"}
    scenario = load_scenario(file, changes | {"rig.platform.tracking": "ideal"})
    assert scenario.approach.velocity == (0.0, 0.0, 0.05)
    assert scenario.approach.offset == (0.01, 0.0)
    assert scenario.rig.platform.tracking == "ideal"
    # from Python the value is what it is
    assert load_scenario(file, {"sensor.delay": 0.001}).sensor.delay == 0.001


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("sensor.dely", "1", "did you mean 'delay'"),
        ("sensor.delay", "-1", "allowed is >= 0"),
        ("approach.velocity.7", "0", "has 3 items"),
        ("approach.velocity.x", "0", "is a list"),
        ("name.first", "x", "has no keys"),
        ("name", "[x", "is not YAML"),
        ("a..b", "1", "is not a key"),
        ("effects.0", "{kind: sensor.dealy, delay: 1}", "did you mean 'sensor.delay'"),
        ("effects.0", "{kind: sensor.delay}", "missing"),
        ("effects.0", "{kind: sensor.delay, delay: 1, axis: z}", "allowed: kind, delay"),
        ("effects.0", "{kind: sensor.gain, factor: 1.1, axis: w}", "allowed: x, y, z, rx, ry, rz"),
        ("effects.0", "{delay: 0.001}", "kind"),
        ("effects", "sensor.delay", "a list"),
    ],
)
def test_a_faulty_override_is_named_by_its_key(
    file: Path, key: str, value: str, words: str
) -> None:
    faults = faults_of(file, {key: value})
    assert any(words in fault for fault in faults)
    places = f"--set {key}: ", f"{file}:4:1: physics_rate"
    assert all(fault.startswith(places) for fault in faults)


def test_an_override_leaves_its_source_alone() -> None:
    body = {"mass": 1, "inertia": [1, 1, 1]}
    data = {
        "name": "plain",
        "spacecraft": {"chaser": body, "target": body},
        "approach": {"velocity": [0, 0, 0.1]},
        "mechanism": {"contact": {"stiffness": 1e4}},
    }
    before = copy.deepcopy(data)
    assert scenario_from(data, {"approach.velocity.0": 0.01}).approach.velocity[0] == 0.01
    assert data == before


def test_a_contact_keeps_what_an_override_leaves_out() -> None:
    own = load_scenario("15-ring-docking").mechanism.contact
    softer = load_scenario("15-ring-docking", {"mechanism.contact.stiffness": 1e5})
    assert own.damping > 0.0
    assert softer.mechanism.contact == own.model_copy(update={"stiffness": 1e5})
    sides = {
        side: str(models_folder() / "bumper" / f"{side}.xml") for side in ("active", "passive")
    }
    pairs = [{"active": "*", "passive": "*", "stiffness": 8e4, "damping": 120.0}]
    mine = MECHANISMS["mjcf"](kind="mjcf", **sides, pairs=pairs, contact={"stiffness": 1e5})
    assert (mine.contact.stiffness, mine.contact.damping) == (1e5, 120.0)
