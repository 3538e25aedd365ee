"""Effects of the record: differences between the logged signals and those in the loop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from hiltestbed.effects.base import Effect, LinkParameters
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.signals import Trace


@dataclass
class LogParameters(LinkParameters):
    """The record of one run. skew: [s] by which the wrench is stamped late. reread: whether it was
    read again at the later time, instead of being interpolated between the loop's own readings.
    """

    link = "log"
    skew: float = 0.0
    reread: bool = False


@register
class LogSkew(Effect):
    """The force is stamped late in the record only; the loop itself is not affected."""

    kind: Literal["log.skew"] = "log.skew"
    delay: float = quantity(
        "s", "Time by which the force is stamped late", ge=0.0, le=1.0, search=(0.0, 0.03)
    )
    link = "log"
    equation = "logged w_meas(t) = w_meas(t - delay)"
    reference = "clock of the recorder"
    resembles = ("sensor.delay", "contact.damping")
    repeats = True
    jumps = "delay"

    def apply(self, p: LogParameters) -> None:
        p.skew += self.delay
        p.reread = p.reread or bool(self.variant.get("reread"))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        starts, ends = scales.delays, (0.0, scales.longest_delay)
        for variant in ({}, {"reread": True}):
            yield candidate(cls, {"delay": starts}, bounds={"delay": ends}, variant=variant)


def stamp_late(trace: Trace, rate: float, skews: Sequence[float]) -> None:
    """For a record of a ``rate`` [Hz] whose runs are stamped late by ``skews`` [s], put the reading
    of t - skew, interpolated linearly, into the row of t; zero before the start.
    """
    rows = np.arange(len(trace.t))
    for i, skew in enumerate(skews):
        if skew > 0.0:
            at = rows - skew * rate
            record = trace["wrench_meas"][:, i].copy()
            for j in range(6):
                trace["wrench_meas"][:, i, j] = np.interp(at, rows, record[:, j], left=0.0)
