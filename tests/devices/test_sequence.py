"""What sequence numbers say, against the truth of a stream that was disturbed on purpose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.devices.interface import Event
from hiltestbed.devices.layout import WireRecord, read_layout
from hiltestbed.devices.sequence import Advancing, Sequence
from hiltestbed.devices.table import sensor_client
from hiltestbed.devices.udp import UdpSensorClient


def _follow(
    numbers: list[int], bits: int = 32, step: int = 1
) -> tuple[list[bool], np.ndarray, Sequence]:
    counts = np.zeros(len(Event), dtype=np.int64)
    sequence = Sequence(counts, bits, step, longest_gap=10 if bits == 8 else 10_000)
    return [sequence.judge(n) for n in numbers], counts, sequence


# numbers, what is news of them, the counts of events, the newest number, and the step
CASES = {
    "lost, repeated and out of order": (
        [7, 8, 11, 9, 11, 12], [1, 1, 1, 0, 0, 1], {"lost": 2, "reordered": 1, "repeated": 1}, 12, 1
    ),
    "a counter of milliseconds": (
        [1000, 1004, 1012, 1013, 1016], [1, 1, 1, 0, 1], {"lost": 1, "malformed": 1}, 1016, 4
    ),
    "a number that cannot follow": (
        [5, 5 + 10_001, 5 - 10_001, 6], [1, 0, 0, 1], {"malformed": 2}, 6, 1
    ),
    "a reader that has paused goes on with the second record": (
        [5, 20_000, 20_001, 20_002], [1, 0, 1, 1], {"malformed": 1, "lost": 20_000 - 6}, 20_002, 1
    ),
    "a device that counts from the start again": (
        [4_000_000, 0, 4_000_001, 7, 3, 4, 5], [1, 0, 1, 0, 0, 0, 0], {"malformed": 5}, 4_000_001, 1
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_the_numbers_say(case: str) -> None:
    numbers, news, events, newest, step = CASES[case]
    judged, counts, sequence = _follow(numbers, step=step)
    assert judged == [bool(new) for new in news]
    assert {event.name.lower(): counts[event] for event in Event if counts[event]} == events
    assert sequence.newest == newest


@pytest.mark.parametrize("bits", [8, 32])
def test_a_counter_that_wraps_goes_on(bits: int) -> None:
    top = (1 << bits) - 2
    judged, counts, sequence = _follow([(top + k) % (1 << bits) for k in (0, 1, 2, 4, 3)], bits)
    assert judged == [True, True, True, True, False]
    assert (counts[Event.LOST], counts[Event.REORDERED]) == (1, 1)
    assert sequence.newest == top + 4


@pytest.mark.parametrize("bits", [8, 62])
def test_numbers_that_are_sent_again_are_never_news(bits: int) -> None:
    """Whether one by one, in blocks, or counted from the start again: the past is not news."""
    count = np.zeros(len(Event), dtype=np.int64)
    sequence, top = Sequence(count, bits), (1 << bits) - 40
    first = [(top + k) % (1 << bits) for k in range(80)]  # over the wrap
    assert all(sequence.judge(n) for n in first)
    again = [*first, *reversed(first), *first[10:40] * 3]
    assert not any(sequence.judge(n) for n in again)
    assert count[[Event.REPEATED, Event.REORDERED]].sum() == len(again)
    assert sequence.judge((first[-1] + 1) % (1 << bits))


@pytest.mark.parametrize("bits", [0, 16])
def test_a_counter_of_any_steps_has_to_advance(bits: int) -> None:
    counts = np.zeros(len(Event), dtype=np.int64)
    samples = Advancing(counts, bits)
    numbers = [3, 10, 10, 9, 10_000, 3, 10_001]
    assert [samples.judge(n) for n in numbers] == [True, True, False, False, True, False, True]
    assert (counts[Event.REPEATED], counts[Event.REORDERED]) == (1, 2)
    if bits:
        top = (1 << bits) - 1
        samples.restart()
        assert [samples.judge(n) for n in (top, 4, top)] == [True, True, False]


def test_a_stream_with_losses_and_swaps_is_accounted_for() -> None:
    """Every record is new, lost or out of order; those that are both lost at first and late after
    are counted as both.
    """
    rng = np.random.default_rng(8)
    sent = np.arange(5000)
    kept = sent[rng.random(5000) > 0.02]
    swaps = np.flatnonzero(rng.random(len(kept) - 1) < 0.02)
    for i in swaps[np.diff(swaps, prepend=-9) > 1]:
        kept[[i, i + 1]] = kept[[i + 1, i]]
    kept = kept[np.argmin(kept) :]
    judged, counts, _ = _follow([int(n) for n in kept])
    new, last = sum(judged), int(kept.max())
    assert counts[Event.REORDERED] == len(kept) - new
    assert new + counts[Event.LOST] == last - int(kept[0]) + 1


@pytest.mark.parametrize(("kind", "scale"), [("uint32", 1e-6), ("float64", 1.0)])
def test_records_without_a_number_are_ordered_by_their_time(
    kind: str, scale: float, tmp_path: Path
) -> None:
    """A counter of microseconds wraps after 71 minutes, a floating-point time never."""
    wrench = [{"name": name, "type": "float64"} for name in ("fx", "fy", "fz", "tx", "ty", "tz")]
    time = {"name": "time", "type": kind, "scale": scale}
    data = {"sensor": [time, *wrench]}

    path = tmp_path / "layout.yaml"
    path.write_text(dump_yaml(data), encoding="utf-8")
    receiver = sensor_client(f"udp://127.0.0.1:1?layout={path}")
    assert isinstance(receiver, UdpSensorClient)
    sent, counts = WireRecord(read_layout(path), "sensor"), receiver.counts

    def is_news(seconds: float) -> bool:
        return receiver._take(sent.pack(np.zeros(6), 0, seconds), ("127.0.0.1", 1))

    top = (1 << 32) * 1e-6
    judged = [is_news(t) for t in (1.0, 1.001, 1.001, 0.5, 1.002, top - 0.001)]
    assert judged == [True, True, False, False, True, kind == "float64"]
    assert (counts[Event.REPEATED], counts[Event.REORDERED]) == (1, 2 - (kind == "float64"))
    if kind == "uint32":
        after = [1500.0, 3000.0, top - 0.001, 0.001, top - 0.001]
        assert [is_news(t) for t in after] == [True, True, True, True, False]
