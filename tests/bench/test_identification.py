"""The benchmark of identification on a corner of its grid."""

from __future__ import annotations

from hiltestbed.bench.contacts import grid
from hiltestbed.bench.identification import METHODS, identification_report, leaderboard, measure

RECORD = set(
    ["method", "frequency", "delay", "damping_ratio", "noise", "stiffness_error", "damping_error"]
)


def test_methods_side_by_side() -> None:
    contacts = grid((8.0,), (0.002, 0.005), damping_ratios=(0.2,))
    records = [record for method in METHODS for record in measure(method, contacts, 0.002, seeds=4)]
    assert all(record.keys() >= RECORD for record in records)
    board = leaderboard(records)
    by_name = {row["method"]: row for row in board}
    assert abs(by_name["rls"]["stiffness_error"]) < 0.002
    assert abs(by_name["rls"]["damping_error"]) < 0.02
    assert by_name["rls_raw"]["damping_error"] > 0.1
    assert by_name["rls_delay_estimated"]["delay_error"] < 3e-4
    page = identification_report(
        records,
        {"leaderboard": board, "intervals": {"stiffness": 0.95, "damping": 0.95, "seeds": 400.0}},
    ).html()
    assert "rls_lead" in page
