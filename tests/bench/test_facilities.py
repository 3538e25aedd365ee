"""The benchmark of the facilities, on one driven and one free of them."""

from __future__ import annotations

import math

import pytest

from hiltestbed.bench import facilities as bench
from hiltestbed.platform.kinds import PLATFORMS


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        entered = bench.facilities_entered()
        patch.setattr(
            bench,
            "facilities_entered",
            lambda: {name: entered[name] for name in ("serial_arm", "air_bearing")},
        )
        return bench.facilities(quick=True)


def test_every_kind_of_platform_takes_part() -> None:
    assert {settings["kind"] for settings in bench.facilities_entered().values()} == set(PLATFORMS)
    assert {"stewart, hydraulic", "stewart, electric"} <= set(bench.facilities_entered())


def test_a_record_a_facility_and_treatment(result) -> None:
    assert {(r["facility"], r["treatment"]) for r in result.records} >= {
        ("serial_arm", "uncompensated"),
        ("serial_arm", "default"),
        ("air_bearing", "as it is"),
    }
    for rig in result.summary["rigs"]:
        assert rig["cost"] > 0.0
        assert len(rig["distorts"].split(". ")) >= 1
    assert "What each kind distorts" in result.report.html()


def test_the_virtual_damper_brings_the_designed_restitution_back(result) -> None:
    """EPOS' hybrid: designed by the damping that the measured rig takes and tuned by one trial, e
    is that of the contact within 1 %.
    """
    by = {r["treatment"]: r for r in result.records if r["facility"] == "serial_arm"}
    hybrid = next(r for name, r in by.items() if name.startswith("hybrid"))
    assert not by["uncompensated"]["passive"]
    assert math.exp(abs(hybrid["cor_log_error"])) - 1.0 < 0.01
    assert hybrid["passive"]
