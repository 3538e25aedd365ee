"""Evaluation of a device's sequence numbers: new, lost, repeated, reordered or implausible."""

from __future__ import annotations

from numpy.typing import NDArray

from hiltestbed.devices.interface import Event


class Sequence:
    """Follows a wrapping counter.

    Attributes:
        newest: the number of the newest record, unwrapped; -1 before the first.
    """

    def __init__(
        self, counts: NDArray, bits: int = 32, step: int = 1, longest_gap: int = 10_000
    ) -> None:
        """``longest_gap``: number of records that may be missing at once. A larger step is
        implausible (malformed), unless the next record
        continues from it: then the reader has paused, or the device has restarted its counter (RFC
            3550, appendix A.1).
        """
        self._counts = counts
        self._modulus = 1 << bits
        self._step = step
        self._longest = longest_gap * step
        self.newest = -1
        self._wrapped = 0
        self._resumed = -1  # the number that would continue from the last implausible one

    def restart(self) -> None:
        """Accept any number next: the device restarts its counter."""
        self.newest = self._resumed = -1

    def judge(self, number: int) -> bool:
        """Whether ``number`` is newer than all before; anything else is counted."""
        if self.newest < 0:
            self.newest = self._wrapped = number
            return True
        ahead = (number - self._wrapped) % self._modulus
        behind = self._modulus - ahead
        if ahead == 0:
            self._counts[Event.REPEATED] += 1
        elif ahead <= self._longest:
            if ahead % self._step:
                self._counts[Event.MALFORMED] += 1
                return False
            self._counts[Event.LOST] += ahead // self._step - 1
            self.newest += ahead
            self._wrapped = number
            return True
        elif behind <= self._longest:
            self._counts[Event.REORDERED] += 1
        elif number == self._resumed:
            if ahead < behind:
                # the previous record did arrive, but was rejected
                self._counts[Event.LOST] += ahead // self._step - 2
            self.newest += ahead if ahead < behind else self._step
            self._wrapped = number
            return True
        else:
            self._counts[Event.MALFORMED] += 1
            self._resumed = (number + self._step) % self._modulus
        return False
