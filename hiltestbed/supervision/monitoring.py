"""Process monitoring during a docking and from one docking to the next, by the identified stiffness
and damping.

- *touch*: the axial force exceeds five standard deviations of its noise in two successive readings.
  By noise alone this has a probability of (2.9e-7)^2 per tick: once in 4e5 years at 2 kHz.
- *seat*: the stiffness over the last samples exceeds a multiple (``seat_ratio``) of the initial
  one: the probe is in its socket, or a buffer on its stop. Reported if the excess is above
  ``SEAT_SIGMA`` of its standard deviations in ``CONFIRM`` successive readings.
- *capture*: the axial force pulls, beyond five standard deviations, in ``CONFIRM`` successive
  readings, which a contact alone cannot do.
- *wear*: k and c of a contact compared with those of earlier contacts, by Hotelling's T^2 with the
  covariances that the identification reports: an alarm if the chi-squared probability with two
  degrees of freedom is below ``false_alarm_rate`` (D. C. Montgomery, Introduction to Statistical
  Quality Control, 7th ed. 2012, chapter 11). The rate is correct if the reported standard
  deviations are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.active_ring import AXIAL
from hiltestbed.frames import Array
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.identification.samples import ContactSamples, SampleParameters
from hiltestbed.scenario.monitoring import ContactEstimate, Monitoring

CONFIRM = 5  # successive readings
SEAT_SIGMA = 5.0


class ProcessMonitor:
    """Touch, seat and capture of ``n`` runs, from the signals that the rig measures.

    Attributes:
        touch, seat, capture: ``(n,)`` time [s] of each event, NaN before it.
        first_stiffness: ``(n,)`` [N/m] at the beginning of the first contact, NaN before it is
            estimated.
    """

    def __init__(
        self, parameters: SampleParameters, monitored: Sequence[Monitoring | None]
    ) -> None:
        """``monitored``: of each run; one without is watched with the defaults, for no summary."""
        n, self.tick, self._settings = len(monitored), 1.0 / parameters.rate, tuple(monitored)
        settings = [m or Monitoring() for m in monitored]
        windows = np.array([m.window for m in settings])
        self._ratio = np.array([m.seat_ratio for m in settings])
        self._enough = (windows / self.tick).astype(np.int64)
        samples = ContactSamples(parameters)
        self._local = RecursiveLeastSquares(samples, list(np.exp(-self.tick / windows)))
        self._threshold = samples.threshold
        self.touch, self.seat, self.capture, self.first_stiffness = np.full((4, n), np.nan)
        # successive readings that indicate touch, seat, capture
        self._runs = np.zeros((n, 3), dtype=np.int64)
        self._clock = np.zeros(1, dtype=np.int64)

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Update at t_k with wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        self._local.update(wrench, pose, twist)
        time, local = float(self._clock[0]) * self.tick, self._local
        axial = local.stiffness[:, AXIAL], local.stiffness_sd[:, AXIAL], local.samples[:, AXIAL]
        settings = self._enough, self._ratio, self._threshold
        events = self.first_stiffness, self._runs, self.touch, self.seat, self.capture
        _watch(time, wrench, axial, settings, events)
        self._clock[0] += 1

    def summary(self, i: int, contact: ContactEstimate | None) -> dict[str, Any] | None:
        """Events of run ``i`` [s] or None; wear if there are a baseline and a ``contact``."""
        settings = self._settings[i]
        if settings is None:
            return None
        events = {
            name: _number(getattr(self, name)[i])
            for name in ("touch", "seat", "capture", "first_stiffness")
        }
        judged = (
            wear(settings.baseline, contact, settings.false_alarm_rate)
            if settings.baseline and contact
            else None
        )
        return {**events, "wear": None if judged is None else asdict(judged)}


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


@njit(cache=True)
def _watch(time, wrench, axial, settings, events):
    stiffness, sd, samples = axial
    enough, ratio, threshold = settings
    first, runs, touch, seat, capture = events
    for i in range(wrench.shape[0]):
        force = wrench[i, AXIAL]
        runs[i, 0] = runs[i, 0] + 1 if force > threshold[i] else 0
        runs[i, 2] = runs[i, 2] + 1 if force < -threshold[i] else 0
        if math.isnan(first[i]) and samples[i] >= enough[i] and stiffness[i] > 0.0:
            first[i] = stiffness[i]
        rise = stiffness[i] - ratio[i] * first[i]
        runs[i, 1] = runs[i, 1] + 1 if runs[i, 0] > 0 and rise > SEAT_SIGMA * sd[i] else 0
        if math.isnan(touch[i]) and runs[i, 0] == 2:
            touch[i] = time
        if math.isnan(seat[i]) and runs[i, 1] == CONFIRM:
            seat[i] = time
        if math.isnan(capture[i]) and not math.isnan(touch[i]) and runs[i, 2] == CONFIRM:
            capture[i] = time


@dataclass(frozen=True)
class Wear:
    """Whether a contact deviates from earlier ones.

    Attributes:
        alarm: True if the deviation is less probable than the false-alarm rate.
        probability: of a deviation this large without wear.
        stiffness_change, damping_change: relative change of the contact from the baseline; None
            from a damping of zero.
    """

    alarm: bool
    probability: float
    stiffness_change: float
    damping_change: float | None


def wear(
    baseline: Sequence[ContactEstimate], contact: ContactEstimate, false_alarm_rate: float = 0.01
) -> Wear:
    """Compare a contact with a baseline, the weighted mean of one or more contacts."""
    squares, change = 0.0, dict[str, float | None]()
    for name in ("stiffness", "damping"):
        values = np.array([getattr(b, name) for b in baseline])
        weights = np.array([getattr(b, f"{name}_sd") for b in baseline]) ** -2.0
        variance = 1.0 / float(np.sum(weights))
        mean = float(np.sum(weights * values) / np.sum(weights))
        departure = getattr(contact, name) - mean
        squares += departure**2 / (variance + getattr(contact, f"{name}_sd") ** 2)
        change[name] = departure / mean if mean > 0.0 else None
    # survival function of chi-squared with two degrees of freedom
    probability = math.exp(-0.5 * squares)
    assert change["stiffness"] is not None  # a stiffness is positive
    return Wear(probability < false_alarm_rate, probability, change["stiffness"], change["damping"])
