"""A case's row depends on its number and the seed alone: not on its neighbours, on what is kept, or
on who runs it.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hiltestbed.campaign.cases import run_chunk, skeleton, structural_keys, trace_sha256
from hiltestbed.campaign.columns import SCALARS, table
from hiltestbed.campaign.schema import LoadedCampaign, load_campaign
from hiltestbed.campaign.sweep import case_scenario, planned_chunks
from hiltestbed.scenario import scenario_from
from hiltestbed.simulation import run


def test_one_case_run_alone_and_in_full_has_the_row_and_the_trace_of_the_campaign(
    campaign: LoadedCampaign,
) -> None:
    cells = run_chunk(campaign, range(8)).rows
    by_case = {row["case"]: row for row in cells}
    alone = run(case_scenario(campaign, 5))
    assert {name: by_case[5][name] for name in SCALARS} == {
        name: alone.summary[name] for name in SCALARS
    }
    assert alone.trace is not None
    assert by_case[5]["trace_sha256"] == trace_sha256(alone.trace)


def test_every_scalar_of_a_summary_is_a_column(campaign: LoadedCampaign) -> None:
    summary = run(campaign.nominal).summary
    scalars = {name for name, value in summary.items() if not isinstance(value, dict | list)}
    assert scalars - {"payload_left", "force_delay"} == set(SCALARS), (
        "these are mappings where there is one"
    )


def test_a_record_that_is_stamped_late_has_the_hash_of_its_file(file: Path) -> None:
    campaign = load_campaign(file, {"set": {"effects": [{"kind": "log.skew", "delay": 0.0015}]}})
    (cells,) = run_chunk(campaign, [5]).rows
    alone = run(case_scenario(campaign, 5))
    assert alone.trace is not None
    assert cells["trace_sha256"] == trace_sha256(alone.trace)


@pytest.mark.parametrize(
    ("keep", "files"),
    [
        ("trace", {"trace.parquet"}),
        ("all", {"scenario.yaml", "summary.json", "trace.parquet", "recording.rrd"}),
    ],
)
def test_what_is_kept_beside_the_row(file: Path, keep: str, files: set[str]) -> None:
    campaign = load_campaign(file, {"keep": keep})
    result = run_chunk(campaign, [2, 3])
    assert set(result.files) == {f"{case:08d}/{name}" for case in (2, 3) for name in files}
    assert pq.read_table(io.BytesIO(result.files["00000002/trace.parquet"])).num_rows == 300
    plain = table(campaign.spec, run_chunk(load_campaign(file), [2, 3]).rows)
    assert table(campaign.spec, result.rows).equals(plain), "the row is the same whatever is kept"


def test_a_case_that_diverges_or_is_stopped_ends_alone(file: Path) -> None:
    """k = 1e12 N/m at 1 kHz has w h = 160, where semi-implicit Euler ends at 2: the model is thrown
    out of the workspace.
    """
    file.write_text(
        "scenario: scenario.yaml\nvary: {mechanism.contact.stiffness: {values: [2.0e4, 1.0e12, "
        "3.0e4]}}\ndesign: {kind: grid}\n"
    )
    campaign = load_campaign(file)
    rows = {row["case"]: row for row in run_chunk(campaign, range(3)).rows}
    assert rows[1]["status"] in ("diverged", "stopped")
    assert rows[1]["error"] == rows[1]["stop_reason"]
    assert "t = " in rows[1]["error"]
    for case in (0, 2):
        assert rows[case] == run_chunk(campaign, [case]).rows[0]
        assert rows[case]["status"] == "completed"


def test_values_that_do_not_go_together_are_told_in_the_row(file: Path) -> None:
    """Each rate is right beside the scenario's own 1000 Hz; 500 over 1000 is not."""
    file.write_text(
        "scenario: scenario.yaml\nset: {physics_rate: 2000}\nvary: {rate: {values: [1000, 2000]}, "
        "physics_rate: {values: [1000, 2000]}}\ndesign: {kind: grid}\n"
    )
    rows = {row["case"]: row for row in run_chunk(load_campaign(file), range(4)).rows}
    assert [rows[case]["status"] for case in range(4)] == [
        "completed",
        "completed",
        "invalid",
        "completed",
    ]
    assert "whole multiple of rate" in rows[2]["error"]


def test_cases_of_one_structure_go_together(campaign: LoadedCampaign) -> None:
    assert structural_keys(campaign) == ["compensation.force.kind"]
    chunks = list(planned_chunks(campaign, np.arange(96), 16))
    assert sorted(case for chunk in chunks for case in chunk) == list(range(96))
    for chunk in chunks:
        assert len({skeleton(case_scenario(campaign, case)) for case in chunk}) == 1
        assert list(chunk) == sorted(chunk)
    assert sum(len(chunk) == 16 for chunk in chunks) >= 5


@pytest.mark.parametrize(
    ("key", "value", "same"),
    [
        ("mechanism.contact.stiffness", 3e4, True),
        ("seed", 9, True),
        ("sensor.delay", 0.01, True),
        ("duration", 0.2, False),
        ("rate", 500, False),
        ("compensation.force", {"kind": "none"}, True),
        ("compensation.force", {"kind": "phase_lead"}, False),
        ("sensor.lowpass", 100.0, False),
        ("mechanism.contact.friction", 0.1, False),
        ("effects", [{"kind": "sensor.delay", "delay": 0.001}], False),
    ],
)
def test_a_structure_is_all_but_the_numbers(
    campaign: LoadedCampaign, key: str, value: object, same: bool
) -> None:
    assert (
        skeleton(scenario_from(campaign.source, {key: value})) == skeleton(campaign.nominal)
    ) is same
