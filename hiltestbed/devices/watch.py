"""Communication monitoring: once per cycle, the events since the last cycle are compared with
limits.

A cycle without a new record is a *miss*; so is each record that the sequence numbers show as lost.
A rejected record (malformed, from another sender, repeated, out of order) is a *disturbance*: it
changes nothing, but many of them mean that the connection is unreliable. An error status (beyond
the allowed number), a closed connection, a sample older than allowed and a value that is not
physical stop the run at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from hiltestbed.config.validation import Positive, Strictly
from hiltestbed.devices.interface import Client, Event, Link

DISTURBANCES = (Event.MALFORMED, Event.SENDER, Event.REPEATED, Event.REORDERED)


class CommunicationLimits(Strictly):
    """Allowed numbers of communication events; exceeding one stops the run. 0 allows none."""

    misses_in_a_row: int = Field(
        default=3, ge=0, description="Allowed consecutive misses, without a new record in between"
    )
    misses_in_window: int = Field(default=10, ge=0, description="Allowed misses within the window")
    disturbances_in_window: int = Field(
        default=10, ge=0, description="Allowed rejected records within the window"
    )
    window: int = Field(
        default=1000, ge=1, le=1_000_000, description="Length of the window [cycles]"
    )
    stale: Positive = Field(default=0.02, description="Highest age of the newest sample [s]")
    status_in_a_row: int = Field(
        default=0, ge=0, description="Allowed consecutive records with an error status"
    )


@dataclass(frozen=True)
class Stop:
    """Reason why a run has to stop: the event, and a sentence with the number and the limit."""

    event: Event
    reason: str


class CommunicationWatch:
    """Monitors one connection, once per cycle; ``stop`` is the first reason to stop, or None."""

    def __init__(self, link: Client, limits: CommunicationLimits, name: str) -> None:
        """``name``: the device's role in the messages (``sensor``, ``platform``)."""
        self.link, self.limits = link, limits
        self._name = f"{name} {link.where}"
        self._before = np.zeros(len(Event), dtype=np.int64)
        self._happened = np.zeros(len(Event), dtype=np.int64)
        self._misses = np.zeros(limits.window, dtype=np.int64)
        self._disturbances = np.zeros(limits.window, dtype=np.int64)
        self._last_miss, self._last_disturbance = Event.LATE, Event.MALFORMED
        self.start()

    def start(self) -> None:
        """Ignore everything that has happened so far."""
        self._before[:] = self.link.counts
        self._misses[:] = self._disturbances[:] = 0
        self._cycle = self._in_a_row = self._errors = self._missed = self._disturbed = 0
        self._waited = 0  # late cycles since the last new record
        self.stop: Stop | None = None
        self.link.sample.implausible = None

    def check(self, new: bool) -> Stop | None:
        """Call after the reads of a cycle; ``new``: whether a sample was; returns :attr:`stop`."""
        self.link.counts[Event.LATE] += not new
        age = self.link.sample.age()
        if age > self.limits.stale:
            self.link.counts[Event.STALE] += 1
        np.subtract(self.link.counts, self._before, out=self._happened)
        self._before[:] = self.link.counts
        self._tally(new)
        if self.stop is None:
            self.stop = self._judge(age)
        self._cycle += 1
        return self.stop

    def _tally(self, new: bool) -> None:
        slot, happened = self._cycle % self.limits.window, self._happened
        late, lost, disturbances = int(happened[Event.LATE]), int(happened[Event.LOST]), 0
        if lost:
            self._last_miss = Event.LOST
        elif late:
            self._last_miss = Event.LATE
        # if the loop waited for a lost or late record, that cycle has already been counted
        misses = max(late + lost - self._waited, 0) if new else late + lost
        self._waited = 0 if new else self._waited + misses
        for event in DISTURBANCES:
            if happened[event]:
                disturbances += int(happened[event])
                self._last_disturbance = event
        self._missed += misses - int(self._misses[slot])
        self._disturbed += disturbances - int(self._disturbances[slot])
        self._misses[slot], self._disturbances[slot] = misses, disturbances
        self._in_a_row = misses if new else self._in_a_row + misses
        errors = int(happened[Event.STATUS])
        self._errors = self._errors + errors if errors or not new else 0

    def _judge(self, age: float) -> Stop | None:
        limits, sample = self.limits, self.link.sample
        if sample.implausible is not None:
            return self._stop(Event.MALFORMED, sample.implausible)
        if self._errors > (limit := limits.status_in_a_row):
            status = f"status {sample.status:#x}; allowed are {limit} in a row"
            return self._stop(Event.STATUS, f"the device reports an error ({status})")
        if self._happened[Event.GONE]:
            gone = "the connection is gone; nothing listens at the device's address any more"
            return self._stop(Event.GONE, gone)
        if age > (limit := limits.stale):
            old = f"the newest sample is {1e3 * age:.1f} ms old (limit {1e3 * limit:g} ms)"
            return self._stop(Event.STALE, old)
        if self._in_a_row > (limit := limits.misses_in_a_row):
            return self._too_many(self._last_miss, f"{self._in_a_row} misses in a row", limit)
        if self._missed > (limit := limits.misses_in_window):
            often = f"{self._missed} misses in {limits.window} cycles"
            return self._too_many(self._last_miss, often, limit)
        if self._disturbed > (limit := limits.disturbances_in_window):
            often = f"{self._disturbed} records rejected in {limits.window} cycles"
            return self._too_many(self._last_disturbance, often, limit)
        return None

    def _stop(self, event: Event, reason: str) -> Stop:
        return Stop(event, f"{self._name}: {reason}")

    def _too_many(self, last: Event, often: str, limit: int) -> Stop:
        return self._stop(last, f"{often}, the last {last.name.lower()} (limit {limit})")


def said(link: Link) -> dict[str, int]:
    """The counts of a connection by name, for the record of a run."""
    return {event.name.lower(): int(link.counts[event]) for event in Event}
