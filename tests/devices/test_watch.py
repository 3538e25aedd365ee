"""What sequence numbers say, against the truth of a stream that was disturbed on purpose; the limits of a
connection, on one that is made up."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.config.validation import validate
from hiltestbed.config.yaml_source import Source, dump_yaml
from hiltestbed.devices.interface import Event, SensorClient
from hiltestbed.devices.layout import WireRecord, read_layout
from hiltestbed.devices.sequence import Advancing, Sequence
from hiltestbed.devices.table import sensor_client
from hiltestbed.devices.udp import UdpSensorClient
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.devices.watch import CommunicationLimits, CommunicationWatch, said
from hiltestbed.errors import InputError


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


class MadeUp(SensorClient):
    """A sensor whose records come when the test says so."""

    def __init__(self) -> None:
        super().__init__(DeviceSettings(where="made-up://"))

    def open(self) -> None: ...
    def close(self) -> None: ...
    def poll(self) -> bool:
        return False

    def gets(self, new: bool = True, **events: int) -> bool:
        """A cycle with a new record or without, and so many other events."""
        if new:
            self.counts[Event.RECEIVED] += 1
            self.reading.sequence += 1
            self.reading.arrival = time.monotonic_ns()
        for name, count in events.items():
            self.counts[Event[name.upper()]] += count
        return new


LOOSE = {
    "misses_in_a_row": 1000,
    "misses_in_window": 1000,
    "disturbances_in_window": 1000,
    "stale": 1000.0,
}


def _watch(**limits: float) -> tuple[MadeUp, CommunicationWatch]:
    link = MadeUp()
    watch = CommunicationWatch(link, CommunicationLimits.model_validate(LOOSE | limits), "sensor")
    link.gets()
    watch.start()
    return link, watch


def test_what_happened_before_the_start_does_not_count() -> None:
    link, watch = _watch(misses_in_window=0, disturbances_in_window=0)
    link.gets(lost=50, malformed=50)
    watch.start()
    assert watch.check(link.gets()) is None


def test_misses_in_a_row_begin_anew_with_each_record() -> None:
    link, watch = _watch(misses_in_a_row=2)
    for new in (False, False, True, False, False, True, False, False):
        assert watch.check(link.gets(new)) is None
    stop = watch.check(link.gets(False))
    assert stop.reason == "sensor made-up://: 3 misses in a row, the last late (limit 2)"


def test_a_record_that_was_waited_for_in_vain_and_then_found_lost_is_one_miss() -> None:
    link, watch = _watch(misses_in_window=3)
    for _ in range(3):
        assert watch.check(link.gets(False)) is None
        assert watch.check(link.gets(True, lost=1)) is None
    stop = watch.check(link.gets(True, lost=1))  # nobody has waited for this one
    assert stop.event is Event.LOST


@pytest.mark.parametrize(
    ("limit", "event"), [("misses_in_window", "lost"), ("disturbances_in_window", "reordered")]
)
def test_a_window_is_the_sum_of_its_cycles(limit: str, event: str) -> None:
    rng = np.random.default_rng(4)
    lost = rng.poisson(0.3, 500)
    link, watch = _watch(**{limit: 15, "window": 40})
    sums = np.convolve(lost, np.ones(40, dtype=int))[:500]
    expected = int(np.argmax(sums > 15))
    assert sums[expected] > 15
    for k in range(500):
        stop = watch.check(link.gets(True, **{event: int(lost[k])}))
        assert (stop is not None) == (k >= expected)
    assert stop.event is Event[event.upper()]


def test_status_in_a_row() -> None:
    link, watch = _watch(status_in_a_row=2)
    for status in (1, 1, 0, 1, 1):
        assert watch.check(link.gets(not status, status=status)) is None
    link.reading.status = 0x21
    stop = watch.check(link.gets(False, status=1))
    assert (
        stop.reason
        == "sensor made-up://: the device reports an error (status 0x21; allowed are 2 in a row)"
    )


def test_the_first_reason_stays() -> None:
    link, watch = _watch(disturbances_in_window=0)
    first = watch.check(link.gets(True, sender=1))
    assert first.event is Event.SENDER
    assert watch.check(link.gets(True, gone=1)) is first


def test_an_old_sample_stops_whatever_else_is_allowed() -> None:
    link, watch = _watch(stale=1e-9)
    stop = watch.check(link.gets())
    assert stop.event is Event.STALE
    assert "ms old (limit" in stop.reason
    assert said(link) == {"received": 2, "stale": 1} | dict.fromkeys(
        ["late", "lost", "repeated", "reordered", "malformed", "status", "sender", "gone"], 0
    )


def test_limits_are_checked() -> None:
    with pytest.raises(InputError, match=r"stale: is out of range \(got 0\); allowed is > 0"):
        validate(CommunicationLimits, Source("safety", {"stale": 0}))
