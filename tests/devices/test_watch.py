"""The limits of a connection, on one that is made up."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hiltestbed.config.validation import validate
from hiltestbed.config.yaml_source import Source
from hiltestbed.devices.interface import Event, SensorClient
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.devices.watch import CommunicationLimits, CommunicationWatch, said
from hiltestbed.errors import InputError


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
    assert stop is not None
    assert stop.reason == "sensor made-up://: 3 misses in a row, the last late (limit 2)"


def test_a_record_that_was_waited_for_in_vain_and_then_found_lost_is_one_miss() -> None:
    link, watch = _watch(misses_in_window=3)
    for _ in range(3):
        assert watch.check(link.gets(False)) is None
        assert watch.check(link.gets(True, lost=1)) is None
    stop = watch.check(link.gets(True, lost=1))  # nobody has waited for this one
    assert stop is not None
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
    assert stop is not None
    assert stop.event is Event[event.upper()]


def test_status_in_a_row() -> None:
    link, watch = _watch(status_in_a_row=2)
    for status in (1, 1, 0, 1, 1):
        assert watch.check(link.gets(not status, status=status)) is None
    link.reading.status = 0x21
    stop = watch.check(link.gets(False, status=1))
    assert stop is not None
    assert (
        stop.reason
        == "sensor made-up://: the device reports an error (status 0x21; allowed are 2 in a row)"
    )


def test_the_first_reason_stays() -> None:
    link, watch = _watch(disturbances_in_window=0)
    first = watch.check(link.gets(True, sender=1))
    assert first is not None
    assert first.event is Event.SENDER
    assert watch.check(link.gets(True, gone=1)) is first


def test_an_old_sample_stops_whatever_else_is_allowed() -> None:
    link, watch = _watch(stale=1e-9)
    stop = watch.check(link.gets())
    assert stop is not None
    assert stop.event is Event.STALE
    assert "ms old (limit" in stop.reason
    assert said(link) == {"received": 2, "stale": 1} | dict.fromkeys(
        ["late", "lost", "repeated", "reordered", "malformed", "status", "sender", "gone"], 0
    )


def test_limits_are_checked() -> None:
    with pytest.raises(InputError, match=r"stale: is out of range \(got 0\); allowed is > 0"):
        validate(CommunicationLimits, Source("safety", {"stale": 0}))
