"""Tables for a terminal: whole words at every width, and no sign on nought."""

from __future__ import annotations

import pytest

from hiltestbed.report.table import print_comparison

NAMES = ("late", "right", "with-a-long-name-of-a-run")
ROWS = [
    ["mechanism.contact.stiffness", "100000.0", "120000.0", "80000.0"],
    ["stability.net_damping [N s/m, N m s/rad]", "12.34", "-1.2", "3.456"],
    ["approach.velocity", "[0.0, 0.0, 0.03]", "[0.0, 0.0, 0.02]", "[0.001, 0.0, 0.03]"],
    [
        "energy",
        "neutral: within 0.5 % of the approach energy",
        "active: made 3 % of the approach energy",
        "passive",
    ],
]


@pytest.mark.parametrize("width", [40, 60, 80, 100, 140])
def test_a_comparison_breaks_no_word(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    print_comparison(NAMES, ROWS, None)
    printed = capsys.readouterr().out
    words = printed.split()
    for cell in (*NAMES, *(cell for row in ROWS for cell in row)):
        assert all(word in words or f"{word}:" in words for word in cell.split())
