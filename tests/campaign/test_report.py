"""The report of a campaign: choices are never averaged over, axes end where the data end, the
command that repeats a case is whole.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.campaign.columns import choices_of, in_words, results
from hiltestbed.campaign.figures import _cells, _edges, heat_maps, with_unit
from hiltestbed.campaign.schema import LoadedCampaign, Variation, load_campaign
from hiltestbed.campaign.sweep import Sweep, sweep
from hiltestbed.config.gallery import shipped

CAMPAIGN = """\
name: choices
scenario: s.yaml
set: {duration: 0.5, approach.velocity: [0, 0, 0.05], approach.gap: 0.001, rig.platform.tracking: ideal}
vary:
  compensation.force: {values: [{kind: none}, {kind: phase_lead, lag: 0.001}]}
  mechanism.contact.stiffness: {log_uniform: [1.0e5, 5.0e5], points: 4}
  sensor.delay: {values: [0.0, 0.004, 0.008]}
  approach.velocity.2: {values: [0.02, 0.05, 0.1]}
design: {kind: grid}
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> LoadedCampaign:
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "s.yaml").write_text((shipped("scenarios") / "reference-bumper.yaml").read_text())
    (folder / "c.yaml").write_text(CAMPAIGN)
    return load_campaign(folder / "c.yaml")


@pytest.fixture(scope="module")
def swept(campaign: LoadedCampaign) -> Sweep:
    return sweep(campaign, campaign.path.parent / "out")


def test_each_choice_has_a_row_and_the_best_is_named(swept: Sweep) -> None:
    page = (swept.folder / "report.html").read_text()
    rows = re.findall(
        r"<tr><td>(phase_lead \(lag 0\.001\)[^<]*|none[^<]*)</td><td>(\d+)</td>", page
    )
    assert rows == [("phase_lead (lag 0.001) (best)", "36"), ("none", "36")]
    assert "compensation.force (a choice)" in page
    command = re.search(r"<pre>(.*?)</pre>", page)
    assert command[1].startswith(f"hiltestbed run {swept.folder}/campaign.yaml --case ")


def test_a_map_shows_the_cases_of_one_choice_alone(swept: Sweep, campaign: LoadedCampaign) -> None:
    """The mean of a cell, by hand, for each of the two choices."""
    cases = swept.cases()
    choices = choices_of(campaign, cases)
    figures = {name: cases[name].to_numpy() for name in ("cor", "cor_log_error")}
    keys = ("sensor.delay", "mechanism.contact.stiffness")
    places = (cases[keys[0]].to_numpy(), cases[keys[1]].to_numpy())
    picture, _ = heat_maps(campaign, keys, places, figures, "cor_log_error", choices)
    for axes, choice in zip(picture.axes, choices, strict=False):
        assert axes.get_title() == choice.label
        shown = np.reshape(np.asarray(axes.collections[0].get_array()), (4, 3))
        here = choice.cases & (places[0] == 0.008) & (places[1] == places[1].max())
        assert here.sum() == 3
        assert shown[3, 2] == pytest.approx(figures["cor_log_error"][here].mean())
        assert axes.get_xlim() == (0.0, 0.008)
        assert axes.get_ylim() == pytest.approx((1e5, 5e5))


def test_edges_end_where_the_data_end() -> None:
    edges, log = _edges(Variation(uniform=(0.0, 0.025), points=6), np.linspace(0.0, 0.025, 6))
    assert not log
    assert (edges[0], edges[-1]) == (0.0, 0.025)
    values = np.geomspace(5e4, 5e5, 7)
    edges, log = _edges(Variation(log_uniform=(5e4, 5e5), points=7), values)
    assert log
    assert (edges[0], edges[-1]) == (values[0], values[-1])
    assert np.histogram(values, edges)[0].tolist() == [1] * 7


def test_the_worst_of_a_cell_is_the_largest_magnitude_with_its_sign() -> None:
    x, y = np.array([0.0, 0.1, 0.2, 1.0]), np.zeros(4)
    cells = _cells(
        (x, y),
        (np.array([0.0, 0.5, 1.0]), np.array([-1.0, 1.0])),
        np.array([0.2, -0.5, 0.3, 0.1]),
        worst=True,
    )
    assert cells[:, 0].tolist() == [-0.5, 0.1]


def test_choices_that_do_not_complete_come_last() -> None:
    from hiltestbed.campaign.columns import CaseGroup

    first, second = (
        CaseGroup("a", np.array([True, True, False, False])),
        CaseGroup("b", np.array([False, False, True, True])),
    )
    statuses = np.array(["completed", "diverged", "completed", "completed"])
    ranked = results(
        [first, second],
        statuses,
        np.array([0.5, np.nan, 1.1, 0.9]),
        np.array([0.01, np.nan, 0.5, -0.4]),
    )
    assert [(r.label, r.completed, r.active, r.best) for r in ranked] == [
        ("b", 2, 1, True),
        ("a", 1, 0, False),
    ]


def test_words_and_units(campaign: LoadedCampaign) -> None:
    assert in_words('{"kind": "phase_lead", "lag": 0.001}') == "phase_lead (lag 0.001)"
    assert in_words("servo") == "servo"
    assert in_words("[1, 2]") == "[1, 2]"
    assert with_unit("mechanism.contact.stiffness", campaign) == "mechanism.contact.stiffness [N/m]"
    assert with_unit("peak_force") == "peak_force [N]"
    assert with_unit("cor") == "cor"


def test_the_criterion_is_the_users(campaign: LoadedCampaign, tmp_path: Path) -> None:
    from hiltestbed.campaign.report import write_report

    by_force = load_campaign(
        campaign.path,
        {
            "criterion": "peak_force",
            "vary": {"sensor.delay": {"values": [0.0, 0.01]}, "seed": {"values": [1, 2]}},
        },
    )
    found = sweep(by_force, tmp_path / "out")
    write_report(found.folder, by_force)
    assert "peak_force: median" in (found.folder / "report.html").read_text()
