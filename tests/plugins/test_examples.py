"""The worked plugins under examples/plugins: found by --plugin and by an entry point, run, in the
benchmark, and named by a diagnosis; a registry whose modules cannot be imported says so."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hiltestbed
from hiltestbed import plugins
from hiltestbed.compensation.settings import FORCE_METHODS
from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.contact.settings import MECHANISMS
from hiltestbed.diagnosis.investigate import candidates_of
from hiltestbed.effects import EFFECTS
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.plugins import Registry
from hiltestbed.scenario import scenario_from
from tests.diagnosis.made import SCALES, contact_link, effect, explained
from tests.running import run
from tests.scripts import CLI, program

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


pytestmark = pytest.mark.usefixtures("tables_as_shipped")


def shipped(name: str, **changes: Any) -> hiltestbed.Scenario:
    return hiltestbed.load_scenario(hiltestbed.shipped("scenarios") / f"{name}.yaml", changes)


def test_an_effect_acts_as_its_equation_says() -> None:
    plugins.load([str(EXAMPLES / "worn_pad.py")])
    p = ContactParameters(1e5, 200.0)
    EFFECTS["contact.worn_pad"](wear=0.25).apply(p)  # type: ignore[call-arg]
    assert (p.stiffness, p.damping) == (0.75e5, 400.0)
    worn = shipped("02-bumper", effects=[{"kind": "contact.worn_pad", "wear": 0.25}])
    k, c = worn.mechanism.contact.stiffness, worn.mechanism.contact.damping
    other = shipped(
        "02-bumper",
        **{"mechanism.contact.stiffness": 0.75 * k, "mechanism.contact.damping": 2.0 * c},
    )
    assert run(worn).summary["cor"] == run(other).summary["cor"]


def test_a_diagnosis_names_an_effect_of_the_users() -> None:
    """One number moves stiffness and damping together: the worn pad explains with one what two
    built-in effects need two for.
    """
    plugins.load([str(EXAMPLES / "worn_pad.py")])
    assert "contact.worn_pad" in {c.kind for c in candidates_of(SCALES, ("contact",))}
    kinds = ("contact.worn_pad", "contact.stiffness", "contact.damping")
    found = explained(contact_link([effect("contact.worn_pad", wear=0.2)]), *kinds)
    assert found.kinds == kinds[:1]
    assert found.causes[0].estimates[0].value == pytest.approx(0.2, abs=0.01)


def test_a_compensation_takes_the_delay_out(
    tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    """Of second order: |ln(e/e_ref)| falls from (pi/2) w tau = 0.124 to a few per cent."""
    given = ("--plugin", str(EXAMPLES / "slope_lead.py"), "--json", "--no-rerun")
    out = ("--out", str(tmp_path / "r"), "--set", "compensation.force={kind: slope_lead}")
    status, told, wrong = call("run", "03-bumper-delay-uncompensated", *given, *out)
    assert status == 0, wrong
    summary = json.loads(told)
    assert abs(summary["cor_log_error"]) < 0.01
    assert {"source": "compensation.slope_lead"}.items() <= summary["delay_ledger"][1].items()
    assert list(summary["plugins"].values()) != [""]


def test_the_benchmark_takes_a_compensation_of_the_users() -> None:
    from hiltestbed.bench.contacts import bounce, grid
    from hiltestbed.bench.contenders import CONTENDERS, contenders
    from hiltestbed.bench.cor import _takes_part, measure, reference_scenario

    plugins.load([str(EXAMPLES / "slope_lead.py")])
    mine = [c for c in contenders() if c not in CONTENDERS]
    assert [c.name for c in mine] == ["slope_lead"]
    contacts = grid((2.0,), (0.005,), damping_ratios=(0.05,))
    reference = bounce([reference_scenario(c.scenario({"kind": "none"})) for c in contacts])
    (record,) = measure(mine[0], contacts, reference)
    assert record["stable"]
    # in every column, also where it is quick; a built-in one that leads in nothing is left out
    for condition in (("ideal", "exact"), ("ideal", "off"), ("servo", "exact")):
        assert _takes_part(mine[0], condition, quick=True)
    dead_zone = next(c for c in CONTENDERS if c.name == "dead_zone")
    assert not _takes_part(dead_zone, ("ideal", "off"), quick=True)


def test_a_method_of_the_users_that_raises_is_left_out_and_a_built_in_one_is_not() -> None:
    from hiltestbed.bench.contenders import BEST, Contender
    from hiltestbed.bench.cor import _unless_failed

    def works(contender: Contender) -> list[int]:
        return [1]

    def breaks(contender: Contender) -> list[int]:
        raise HiltestbedError("mine.py:59: ValueError: too steep")

    failed: dict[str, str] = {}
    mine, theirs = (
        Contender(name, "first", lambda c: {}, own=own)
        for name, own in (("mine", True), (BEST, False))
    )
    assert _unless_failed(failed, mine, works) == [1]
    assert _unless_failed(failed, mine, breaks) is None
    assert failed == {"mine": "mine.py:59: ValueError: too steep"}
    assert _unless_failed(failed, mine, works) is None  # it is not tried again
    with pytest.raises(HiltestbedError, match="too steep"):
        _unless_failed(failed, theirs, breaks)


def test_one_batch_and_many_give_the_same_bytes() -> None:
    plugins.load([str(EXAMPLES / "slope_lead.py")])
    scenarios = [
        shipped(
            "03-bumper-delay-uncompensated",
            **{"sensor.delay": d, "compensation.force": {"kind": "slope_lead", "ticks": n}},
        )
        for d, n in ((0.002, 3), (0.005, 6))
    ]
    together = hiltestbed.run_batch(scenarios, trace=True)
    for scenario, among in zip(scenarios, together, strict=True):
        alone = run(scenario)
        np.testing.assert_array_equal(alone.trace["pose_act"], among.trace["pose_act"])


def test_a_mechanism_touches_with_all_of_its_pads() -> None:
    """Head-on, three springs are a bumper of three times a pad's stiffness and damping."""
    plugins.load([str(EXAMPLES / "three_pads.py")])
    slower = {"rate": 2000, "physics_rate": 4000}
    bumper = shipped("02-bumper", **slower)
    contact = bumper.mechanism.contact
    pad = {"stiffness": contact.stiffness / 3.0, "damping": contact.damping / 3.0}
    pads = run(shipped("02-bumper", mechanism={"kind": "three_pads", "contact": pad}, **slower))
    plain = run(bumper)
    assert pads.summary["cor"] == pytest.approx(plain.summary["cor"], rel=1e-4)
    assert pads.summary["peak_force"] == pytest.approx(plain.summary["peak_force"], rel=1e-4)
    tilted = run(
        shipped(
            "02-bumper",
            mechanism={"kind": "three_pads", "contact": pad},
            **slower,
            **{"approach.attitude_deg": [1.0, 0, 0]},
        )
    )
    assert np.abs(tilted.trace["wrench_true.tx"]).max() > 1.0  # one pad is met first, off the axis


def test_a_platform_follows_as_late_as_it_says(tmp_path: Path) -> None:
    """A gantry under position control without feed-forward of the acceleration lags; the delay
    ledger predicts what that does to e.
    """
    plugins.load([str(EXAMPLES / "gantry.py")])
    summary = run(
        shipped(
            "02-bumper", **{"rig.platform": {"kind": "gantry"}, "rate": 2000, "physics_rate": 4000}
        )
    ).summary
    assert summary["cor_log_error"] == pytest.approx(summary["cor_log_error_predicted"], abs=0.01)
    assert (
        next(e["delay"] for e in summary["delay_ledger"] if e["source"] == "platform.servo") > 0.0
    )


def test_a_campaign_runs_them_in_worker_processes(
    tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    campaign = {
        "scenario": "02-bumper",
        "set": {"duration": 0.3},
        "vary": {"compensation.force": {"values": [{"kind": "none"}, {"kind": "slope_lead"}]}},
        "design": {"kind": "grid"},
    }
    (tmp_path / "c.yaml").write_text(json.dumps(campaign))
    options = ("--workers", "2", "--chunk", "1", "--out", str(tmp_path / "out"), "--json")
    plugin = ("--plugin", str(EXAMPLES / "slope_lead.py"))
    status, told, wrong = call("sweep", str(tmp_path / "c.yaml"), *options, *plugin)
    assert status == 0, wrong
    assert json.loads(told)["counts"] == {"completed": 2}


def test_an_installed_package_needs_no_option(
    tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    """The entry-point group does what --plugin does."""
    about = tmp_path / "my_rig-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-rig\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{plugins.GROUP}]\nmine = my_worn_pad\n")
    (tmp_path / "my_worn_pad.py").write_text((EXAMPLES / "worn_pad.py").read_text())
    env = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(hiltestbed.__file__).parents[1])])
    }
    done = program(*CLI, "schema", env=env)
    assert done.returncode == 0, done.stderr
    assert '"contact.worn_pad"' in done.stdout
    assert '"contact.worn_pad"' not in call("schema")[1]


BASE = (
    "from hiltestbed.effects import Effect, quantity\nfrom hiltestbed.plugins import "
    "register\nfrom typing import Literal\n"
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            BASE + "@register\nclass Half(Effect):\n    '''Half.'''\n    kind: Literal['x.half'] = "
            "'x.half'\n",
            "lacks link",
        ),
        (BASE + "@register\nclass Nameless(Effect):\n    '''No kind.'''\n", "lacks `kind`"),
        (BASE + "@register\nclass Stranger:\n    kind = 'x'\n", "derives from nothing"),
        ("def broken(:\n", "SyntaxError"),
        ("import a_package_that_is_not_there\n", "a_package_that_is_not_there"),
        ("1 / 0\n", "ZeroDivisionError"),
        (
            (EXAMPLES / "worn_pad.py").read_text().replace("contact.worn_pad", "contact.stiffness"),
            "exists already",
        ),
        (
            (EXAMPLES / "slope_lead.py").read_text().replace('{"wrench"}', '{"wrench", "force"}'),
            "'captured', 'identified', 'model', 'pose'",
        ),
    ],
)
def test_a_bad_plugin_is_bad_input(
    text: str, words: str, tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    (tmp_path / "mine.py").write_text(text)
    status, _, told = call("check", "02-bumper", "--plugin", str(tmp_path / "mine.py"))
    assert status == 2
    assert words in told


@pytest.mark.parametrize("name", ["no_such_module", "no/such/file.py"])
def test_an_unknown_plugin_is_bad_input(
    name: str, call: Callable[..., tuple[int, str, str]]
) -> None:
    status, _, told = call("run", "02-bumper", f"--plugin={name}")
    assert status == 2
    assert name.rpartition("/")[2] in told


def test_a_scenario_that_needs_a_plugin_says_what_is_there() -> None:
    with pytest.raises(InputError, match="unknown kind"):
        scenario_from(
            shipped("02-bumper").model_dump(mode="json")
            | {"effects": [{"kind": "contact.worn_pad", "wear": 0.1}]}
        )
    assert "slope_lead" not in FORCE_METHODS
    assert "three_pads" not in MECHANISMS


def test_a_run_that_a_plugin_made_says_which_one_it_needs(
    tmp_path: Path, call: Callable[..., tuple[int, str, str]]
) -> None:
    plugin, folder = EXAMPLES / "slope_lead.py", tmp_path / "run"
    given = ("--plugin", str(plugin), "--set", "compensation.force={kind: slope_lead}")
    out = ("--set", "duration=0.3", "--no-rerun", "--out", str(folder))
    assert call("run", "03-bumper-delay-uncompensated", *given, *out)[0] == 0
    fresh = {key: value for key, value in os.environ.items() if key != plugins.ENVIRONMENT}
    refused = program(*CLI, "compare", str(folder), str(folder), env=fresh)
    assert refused.returncode == 2
    assert f"give --plugin {plugin}" in refused.stderr
    assert call("compare", str(folder), str(folder), "--plugin", str(plugin))[0] == 0


class Part:
    """A base class."""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of parts, the second of which needs a package that is not installed."""
    package = tmp_path / "parts_of_a_test"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "first.py").touch()
    (package / "second.py").write_text("import package_that_is_missing\n")
    monkeypatch.setattr(plugins, "_REGISTRIES", list(plugins._REGISTRIES))
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in [n for n in sys.modules if n.startswith(("parts_of_a", "package_that_is"))]:
        del sys.modules[name]


def test_the_missing_package_is_named_at_each_access(home: Path) -> None:
    table = Registry("part", Part, ("parts_of_a_test",))
    for access in (lambda: table["first"], lambda: list(table), lambda: len(table)) * 2:
        with pytest.raises(ModuleNotFoundError, match="package_that_is_missing"):
            access()
    (home / "package_that_is_missing.py").touch()
    assert len(table) == 0


@pytest.mark.parametrize(
    "body",
    [
        "raise RuntimeError('own words')",
        "assert False, 'own words'",
        "import sys; sys.exit('own words')",
        "class Odd(Exception): pass\nraise Odd('own words')",
        "import own_words",
    ],
)
def test_a_plugin_that_fails_at_import_is_told_each_time(body: str, tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(body)
    for _ in range(2):
        with pytest.raises(InputError, match=r"own\.py.*own.words"):
            plugins.load([str(file)])
