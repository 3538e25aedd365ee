"""Rows that a log has lost: what their neighbours show is compared, with the errors of what bridges
them, and a link of which too little is left is not judged.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.lacking import too_little
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.link_model import NOTHING, LinkModel
from hiltestbed.diagnosis.recorded import dynamics_link, input_variance
from hiltestbed.frames import Array
from hiltestbed.measured import load_dataset
from hiltestbed.measured.clock import bend, to_ticks
from hiltestbed.measured.record import MAX_BRIDGED, Record
from tests.slow import slow

from .made import link_run
from .recorded import drawn, recorded

H, ROWS = 1e-3, 1200


def record(pose: Array, lost: np.ndarray) -> Record:
    """A record of pose_act with lost rows."""
    data = np.where(lost[:, None], np.nan, pose)
    valid = np.repeat(~lost[:, None], 7, axis=1)
    t = np.asarray(H * np.arange(len(pose)), dtype=np.float64)
    return Record(0, Path("run.csv"), t, {"pose_act": data}, {"pose_act": valid})


def test_a_short_gap_of_a_pose_lies_on_its_motion_and_a_long_one_is_unknown() -> None:
    """The acceleration of bodies of 400 kg steps by c v/mu at the touch, in the middle of a gap."""
    t, touch = H * np.arange(ROWS), 0.5
    step = 300.0 * 0.03 / 400.0
    pose = np.zeros((ROWS, 7))
    pose[:, 6] = 1.0
    pose[:, 2] = 0.03 * t - 0.5 * step * np.maximum(t - touch, 0.0) ** 2
    lost = np.zeros(ROWS, dtype=bool)
    lost[498 : 498 + MAX_BRIDGED] = True
    short = record(pose, lost)
    bound = step * ((MAX_BRIDGED + 1) * H) ** 2 / 16.0
    assert np.abs(short.filled("pose_act") - pose).max() < bound
    assert not short.unknown("pose_act", 0.05).any()
    assert short.lost("pose_act").sum() == MAX_BRIDGED
    lost[498 : 498 + MAX_BRIDGED + 1] = True
    long = record(pose, lost)
    assert long.unknown("pose_act", 0.05).sum() == MAX_BRIDGED + 1 + 50
    assert long.in_long_gaps("pose_act").sum() == MAX_BRIDGED + 1


def test_errors_between_the_rows_of_a_slower_log_are_as_large_as_they_are_said_to_be() -> None:
    """White noise of 2 N on a half sine, one row in four ticks, integrated twice: the error at the
    end over its standard deviation. The noise of a row counts three times on the lines beside it,
    each of the three ticks between has its own: 9 + 3, where 3 times 1 + 4 are said.
    """
    rng, noise, stride = np.random.default_rng(5), 2.0, 4
    t = np.asarray(H * np.arange(ROWS), dtype=float)
    force = np.outer(200.0 * np.sin(np.pi * t / t[-1]), np.ones(6))
    ratios = []
    for _ in range(40):
        read = force + noise * rng.standard_normal(force.shape)
        data, valid, bends = np.empty((ROWS, 6)), np.empty((ROWS, 6), bool), np.empty((ROWS, 6))
        for j in range(6):
            rows = t[::stride], read[::stride, j]
            data[:, j], valid[:, j] = to_ticks(*rows, ROWS, H, stride * H)
            bent = bend(*rows, data[:, j], valid[:, j], H)
            assert bent is not None
            bends[:, j] = bent
        group = "wrench_comp"
        log = Record(
            0, Path("run.csv"), t, {group: data}, {group: valid},
            sample_rate=1.0 / (stride * H), bends={group: bends},
        )  # fmt: skip
        lasting = np.arange(ROWS, 0, -1)[:, None]
        variance = input_variance(log, group, np.full(6, noise), np.full(6, 200.0))
        error = np.sum(lasting * (log.filled(group) - read), axis=0)
        ratios.append(error / np.sqrt(np.sum(lasting**2 * variance, axis=0)))
    # 240 ratios: their rms is found to 5 %
    rms = float(np.sqrt(np.mean(np.square(ratios))))
    assert rms == pytest.approx(np.sqrt(12.0 / 15.0), abs=0.15)


@pytest.mark.parametrize(("runs", "judged"), [((1,), True), ((0, 1), False)])
def test_a_contact_that_a_log_has_lost_does_not_depart(
    tmp_path: Path, runs: tuple[int, ...], judged: bool
) -> None:
    """What the numerical model was driven with in the gap may have been as large as anywhere else;
    where no run has it on record, nothing can be said.
    """
    dataset = load_dataset(recorded(tmp_path, []))
    for i in runs:
        record = dataset.runs[i].record
        (contact,) = dataset.runs[i].survey.contacts
        lost = slice(contact.start - 10, contact.end + 10)
        record.data["wrench_comp"][lost] = np.nan
        record.valid["wrench_comp"][lost] = False
    layout = lay_out(dataset)
    model = LinkModel(dynamics_link(layout, layout.rows))
    assert model.leaves_noise(model.residuals(NOTHING))
    assert (too_little(model.link) is None) == judged


class Seen:
    """A link of which a share of the rows is on record."""

    name, channels = "wrench", ("wrench_meas.fz",)

    def __init__(self, share: float) -> None:
        sigma = np.where(np.arange(100)[:, None] < 100 * share, 0.1, np.inf)
        self.runs = [link_run(load_scenario("02-bumper"), np.zeros((100, 1)), sigma)]


@pytest.mark.parametrize(
    ("share", "judged"), [(0.9, True), (0.3, True), (0.2, False), (0.0, False)]
)
def test_a_quarter_of_the_information_shows_effects_twice_as_large(
    share: float, judged: bool
) -> None:
    why = too_little(Seen(share))  # type: ignore[arg-type]
    assert (why is None) == judged
    if share == 0.2:
        assert why is not None
        assert "2.2 times as large" in why  # 1/sqrt(0.2)


@pytest.mark.parametrize(
    ("share", "effect", "scale", "verdicts"),
    [
        slow(0.1, "contact.dry_friction", 0.5, {"named"}),
        slow(0.1, "sensor.delay", 0.5, {"named"}),
        slow(0.1, None, 1.0, {"no_discrepancy", "inconclusive"}),
        slow(0.4, "contact.dry_friction", 0.5, {"named", "inconclusive"}),
    ],
)
def test_what_departs_is_named_or_said_to_be_unseen(
    tmp_path: Path, share: float, effect: str | None, scale: float, verdicts: set[str]
) -> None:
    hidden = (effect,) if effect else ()
    dataset = drawn(tmp_path, 910_012, *hidden, scale=scale, noise=("lost_rows", share))
    found = judge(investigate(dataset)).verdict
    assert found.verdict in verdicts
    assert [c.effect for c in found.causes] == ([effect] if found.verdict == "named" else [])
