"""Sets of the independent rig as facilities log them, and with errors that only the log has: a
healthy one is left alone, and what departs is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.random import Generator

from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.verdict import Verdict
from hiltestbed.measured import MeasuredDataset, load_dataset
from hiltestbed.signals import GROUPS
from tests.equipment.independent_rig import draw_set
from tests.slow import SLOW, slow

from .recorded import drawn

Columns = dict[str, np.ndarray]
Change = Callable[[Columns, Generator], Columns]
LONGEST_GAP = 4  # rows
KEPT_ENDS = 5  # rows at each end that are never lost
FORCES = tuple(f"wrench_meas.f{axis}" for axis in "xyz")
FRICTION, DELAY = ("contact.dry_friction", 400_601), ("sensor.delay", 400_042)


def lost(share: float) -> Change:
    """A ``share`` of the rows lost at random, in gaps of 1 to :data:`LONGEST_GAP` rows."""

    def change(columns: Columns, rng: Generator) -> Columns:
        rows = len(columns["t"])
        keep, k = np.ones(rows, dtype=bool), KEPT_ENDS
        begins = share / (1.0 - share) / (0.5 * (1 + LONGEST_GAP))
        while k < rows - KEPT_ENDS - LONGEST_GAP:
            if rng.random() < begins:
                gap = int(rng.integers(1, LONGEST_GAP + 1))
                keep[k : k + gap] = False
                k += gap
            k += 1
        return {name: values[keep] for name, values in columns.items()}

    return change


def of_the_reading(share: float, group: str = "wrench_meas") -> Change:
    """White noise of a ``share`` of each reading of a group."""

    def change(columns: Columns, rng: Generator) -> Columns:
        return columns | {
            name: columns[name] * (1.0 + share * rng.standard_normal(len(columns[name])))
            for name in GROUPS[group].columns
        }

    return change


def spikes(size: float, share: float, names: Sequence[str]) -> Change:
    """Spikes of ``size`` and either sign on a ``share`` of the rows."""

    def change(columns: Columns, rng: Generator) -> Columns:
        out = dict(columns)
        for name in names:
            hit = rng.random(len(out[name])) < share
            out[name] = out[name] + size * hit * rng.choice([-1.0, 1.0], len(hit))
        return out

    return change


def in_steps(size: float, names: Sequence[str]) -> Change:
    """Written in steps of ``size``."""

    def change(columns: Columns, rng: Generator) -> Columns:
        return columns | {name: np.round(columns[name] / size) * size for name in names}

    return change


def rewritten(folder: Path, change: Change) -> MeasuredDataset:
    """The set in ``folder`` with the log of every run changed after the loop, so that what the
    facility computed is not computed from what is on record.
    """
    rng = np.random.default_rng(0)
    for file in sorted(folder.glob("run_*.parquet")):
        table = pq.read_table(file)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        pq.write_table(pa.table(change(columns, rng)), file)
    return load_dataset(folder / "dataset.yaml")


def judged(dataset: MeasuredDataset) -> Verdict:
    with np.errstate(all="ignore"):
        return judge(investigate(dataset)).verdict


def known_to_fail(*values: Any, why: str) -> Any:
    """A case that a law does not hold in yet."""
    return pytest.param(*values, marks=(SLOW, pytest.mark.xfail(strict=True, reason=why)))


@pytest.mark.parametrize(
    ("noise", "seed"),
    [
        slow(("digits", 4.0), 610027),  # a command in few digits is a rough path
        # latched from the start: the springs balance the drift, and the path shows it
        slow(("slow_drift", 4.0), 601068),
        slow(("pose_steps", 1e-5), 601454),  # 60 mm/s are three steps a row
        slow(("spikes", 0.002), 600641),  # three outliers before the first touch, dozens after it
        slow(("converter_steps", 1.0), 620012),  # forces across that stay within two steps
        # a compensation that follows: another stamp would only suit the errors of bridging
        (("log_rate", 1700.0), 602094),
        slow(("stamp_jitter", 0.1), 610031),
        known_to_fail(("anti_aliasing", 50.0), 601261, why="a log.skew of 32 us is named"),
    ],
)
def test_what_a_logger_does_is_no_departure(
    tmp_path: Path, noise: tuple[str, float], seed: int
) -> None:
    assert judged(drawn(tmp_path, seed, noise=noise)).verdict == "no_discrepancy"


@pytest.mark.parametrize(
    ("noise", "effect", "seed"),
    [
        slow(("pink", 1.0), "sensor.bias", 640002),  # beside a baseline that wanders
        slow(("log_rate", 250.0), "contact.dry_friction", 640016),
        slow(("anti_aliasing", 50.0), "sensor.lag", 660024),
    ],
)
def test_what_departs_is_named_alone_whatever_the_logger_does(
    tmp_path: Path, noise: tuple[str, float], effect: str, seed: int
) -> None:
    verdict = judged(drawn(tmp_path, seed, effect, noise=noise))
    assert verdict.verdict == "named"
    assert [c.effect for c in verdict.causes] == [effect]


@pytest.mark.parametrize(
    "change",
    [
        slow(lost(0.1)),
        slow(lost(0.2)),
        slow(of_the_reading(0.01)),
        slow(of_the_reading(0.01, "wrench_comp")),
        known_to_fail(
            spikes(50.0, 1e-3, FORCES), why="a spike bends the baseline that is fitted to its run"
        ),
        slow(in_steps(1.0, FORCES)),
    ],
)
def test_errors_of_the_log_alone_are_no_departure(tmp_path: Path, change: Change) -> None:
    drawn(tmp_path, 400_126)
    verdict = judged(rewritten(tmp_path, change))
    assert verdict.causes == ()
    assert verdict.verdict in ("no_discrepancy", "inconclusive")


@pytest.mark.parametrize(
    ("hidden", "change"),
    [
        slow(FRICTION, lost(0.1)),
        slow(FRICTION, of_the_reading(0.01)),
        slow(DELAY, lost(0.1)),
        slow(DELAY, lost(0.4)),
        slow(DELAY, spikes(50.0, 1e-3, FORCES)),
    ],
)
def test_what_departs_is_named_all_the_same(
    tmp_path: Path, hidden: tuple[str, int], change: Change
) -> None:
    effect, seed = hidden
    drawn(tmp_path, seed, effect)
    verdict = judged(rewritten(tmp_path, change))
    assert [c.effect for c in verdict.causes] == [effect]
    true = draw_set(np.random.default_rng(seed), "single", names=(effect,)).effects[0]
    leading = next(v for k, v in true.items() if k != "kind")
    assert verdict.causes[0].cause.estimates[0].value == pytest.approx(leading, rel=0.03)
