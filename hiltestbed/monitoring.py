"""Process monitoring: what the identified stiffness and damping say of a docking while it happens, and between dockings.

- *touch*: the axial force exceeds five standard deviations of its noise on two readings in a row. On noise alone that happens with a
  probability of (2.9e-7)^2 a tick: once in 4e5 years at 2 kHz.
- *seat*: the stiffness over the last samples has risen to a multiple of what it was at first: the probe stands in its socket, a buffer
  on its stop. Said when the rise exceeds its own standard deviation ``SEAT_SIGMA`` times, on ``CONFIRM`` readings in a row.
- *capture*: the axial force pulls, beyond five standard deviations, on ``CONFIRM`` readings in a row: a contact alone cannot.
- *wear*: k and c of one more contact against those of the contacts before, by Hotelling's T^2 with the covariances that the identification
  reports: an alarm where chi-squared of two degrees of freedom says less than ``false_alarm_rate`` (D. C. Montgomery, Introduction to
  Statistical Quality Control, 7th ed. 2012, chapter 11). The rate is what its name says as long as the reported deviations hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.identification.samples import GATE_SIGMA, ContactSamples
from hiltestbed.scenario import Scenario

AXIAL = 2
CONFIRM = 5  # readings in a row
WINDOW = 0.02  # [s] memory of the stiffness that is compared with the first
SEAT_RATIO = 2.0  # times the first stiffness
SEAT_SIGMA = 5.0


class ProcessMonitor:
    """Touch, seat and capture of ``n`` runs, from what the rig measures.

    Attributes:
        touch, seat, capture: ``(n,)`` time [s] of each event, NaN before it.
        first_stiffness: ``(n,)`` [N/m] with which the first contact began, NaN before it is known.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n = len(scenarios)
        self.tick = 1.0 / scenarios[0].rate
        self._local = RecursiveLeastSquares(ContactSamples(scenarios), [math.exp(-self.tick / WINDOW)] * n)
        self._threshold = np.array([GATE_SIGMA * s.sensor.noise for s in scenarios])
        self.touch, self.seat, self.capture = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
        self.first_stiffness = np.full(n, np.nan)
        self._runs = np.zeros((n, 3), dtype=np.int64)  # readings in a row that said touch, seat, capture
        self._clock = np.zeros(1, dtype=np.int64)

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Take in what was measured at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self._local.update(wrench, pose, twist)
        time, local = float(self._clock[0]) * self.tick, self._local
        enough = int(WINDOW / self.tick)
        _watch(
            time, enough, wrench, self._threshold, local.stiffness[:, AXIAL], local.stiffness_sd[:, AXIAL], local.samples[:, AXIAL],
            self.first_stiffness, self._runs, self.touch, self.seat, self.capture,
        )  # fmt: skip
        self._clock[0] += 1


@njit(cache=True)
def _watch(time, enough, wrench, threshold, stiffness, sd, samples, first, runs, touch, seat, capture):
    for i in range(wrench.shape[0]):
        force = wrench[i, AXIAL]
        runs[i, 0] = runs[i, 0] + 1 if force > threshold[i] else 0
        runs[i, 2] = runs[i, 2] + 1 if force < -threshold[i] else 0
        if math.isnan(first[i]) and samples[i] >= enough and stiffness[i] > 0.0:
            first[i] = stiffness[i]
        rise = stiffness[i] - SEAT_RATIO * first[i]
        runs[i, 1] = runs[i, 1] + 1 if runs[i, 0] > 0 and rise > SEAT_SIGMA * sd[i] else 0
        if math.isnan(touch[i]) and runs[i, 0] == 2:
            touch[i] = time
        if math.isnan(seat[i]) and runs[i, 1] == CONFIRM:
            seat[i] = time
        if math.isnan(capture[i]) and not math.isnan(touch[i]) and runs[i, 2] == CONFIRM:
            capture[i] = time


@dataclass(frozen=True)
class ContactEstimate:
    """k [N/m] and c [N s/m] of one contact, with their standard deviations."""

    stiffness: float
    damping: float
    stiffness_sd: float
    damping_sd: float


@dataclass(frozen=True)
class Wear:
    """Whether a contact departs from those before.

    Attributes:
        alarm: True where the departure is less probable than the false-alarm rate.
        probability: of a departure this large without wear.
        stiffness_change, damping_change: relative, of the contact against the baseline.
    """

    alarm: bool
    probability: float
    stiffness_change: float
    damping_change: float


def wear(baseline: Sequence[ContactEstimate], contact: ContactEstimate, false_alarm_rate: float = 0.01) -> Wear:
    """Compare a contact with a baseline of at least one contact; the baseline is their weighted mean."""
    squares, change = 0.0, {}
    for name in ("stiffness", "damping"):
        values = np.array([getattr(b, name) for b in baseline])
        weights = np.array([getattr(b, f"{name}_sd") for b in baseline]) ** -2.0
        mean, variance = float(np.sum(weights * values) / np.sum(weights)), 1.0 / float(np.sum(weights))
        departure = getattr(contact, name) - mean
        squares += departure**2 / (variance + getattr(contact, f"{name}_sd") ** 2)
        change[name] = departure / mean
    probability = math.exp(-0.5 * squares)  # survival function of chi-squared with two degrees of freedom
    return Wear(probability < false_alarm_rate, probability, change["stiffness"], change["damping"])
