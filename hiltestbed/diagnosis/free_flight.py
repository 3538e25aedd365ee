"""Stage "layout": free flight in the recorded force: the rows before the first touch and between
contacts, where a sensor reads nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import theilslopes

from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.diagnosis.settings import LINK_MEMORY
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import MAD_TO_SIGMA

TOUCH_MARGIN_ROWS = 2  # chosen: before the first touch, that are not counted as free
# chosen: robust standard deviations of free flight, from which a force that rises before a contact
# is one
RISEN_SIGMA = 8.0
RISING_SIGMA = 2.0  # chosen: down to which it is followed back
LINE_ROWS = 200  # chosen: to which the line of free flight is fitted
MIN_LINE_ROWS = 20  # chosen: from which its scatter is known well enough
RINGING = 7.0  # time constants of a mount after which its swing has fallen to a thousandth


def first_touch(run: MeasuredRun) -> int:
    """Rows before the first touch: by the contacts that were found, or by the force where it rises
    directly before them, since the bodies may meet earlier than believed.
    """
    if not run.survey.contacts:
        return run.record.ticks
    end = max(0, run.survey.contacts[0].start - TOUCH_MARGIN_ROWS)
    if not run.record.has("wrench_meas"):
        return end
    risen = _risen(run.record.data["wrench_meas"][:end, :3])
    return max(0, end - risen - TOUCH_MARGIN_ROWS) if risen else end


def _risen(forces: Array) -> int:
    """The most last rows of a channel that depart from the line of its others, if far enough."""
    most, rows = 0, np.arange(len(forces), dtype=float)
    for x in forces.T:
        known = np.flatnonzero(np.isfinite(x))
        few = known[:: max(1, len(known) // LINE_ROWS)]
        if len(few) < MIN_LINE_ROWS:
            continue
        line: Any = theilslopes(x[few], rows[few])  # a quarter of the rows may depart from it
        far = np.abs(x - line.intercept - line.slope * rows)
        sigma = MAD_TO_SIGMA * float(np.median(far[known]))
        count = int(np.argmin((far > RISING_SIGMA * sigma)[::-1]))
        if count and sigma > 0.0 and far[len(x) - count :].max() > RISEN_SIGMA * sigma:
            most = max(most, count)
    return most


def free_readings(run: MeasuredRun) -> Array:
    """(n, 6) readings before the first touch, in rows where no measured channel is missing."""
    record = run.record
    if not record.has("wrench_meas"):
        return np.zeros((0, 6))
    values = record.data["wrench_meas"][: first_touch(run)]
    there = np.isfinite(values).any(axis=0)
    return np.where(there, values, 0.0)[np.isfinite(values[:, there]).all(axis=1)]


def readings_apart(run: MeasuredRun, columns: Sequence[int]) -> tuple[Array, Array]:
    """Rows (M,) away from contacts, and the readings (M, C) there."""
    if not run.record.has("wrench_meas"):
        return np.zeros(0), np.zeros((0, len(columns)))
    values = run.record.data["wrench_meas"][:, columns]
    mount, first = MountDynamics.of([run.scenario.mechanism]), first_touch(run)
    ringing = 0.0 if mount is None else RINGING * mount.slowest()
    settling = (run.scenario.sensor.delay + LINK_MEMORY + ringing) * run.scenario.rate
    apart = ~run.survey.touching(len(values), round(min(settling, len(values))))
    apart[first : run.survey.contacts[0].start if run.survey.contacts else first] = False
    apart &= np.isfinite(values).all(axis=1)
    return np.flatnonzero(apart).astype(float), values[apart]


def straightened(free: Sequence[Array], columns: Sequence[int]) -> tuple[list[Array], Array]:
    """Readings less straight lines of one slope in all runs; their values at the start (R, C)."""
    readings = [x[:, columns] for x in free]
    rows = [np.arange(len(x), dtype=float) for x in readings]
    about = [t - 0.5 * (len(t) - 1) for t in rows]
    along = sum(t @ x for t, x in zip(about, readings, strict=True))
    slope = np.asarray(along) / sum(float(t @ t) for t in about)
    start = np.zeros((len(free), len(columns)))
    for i, x in enumerate(readings):
        if len(x):
            start[i] = x.mean(axis=0) - slope * 0.5 * (len(x) - 1)
    each = zip(rows, readings, start, strict=True)
    return [x - s - t[:, None] * slope for t, x, s in each], start


def shows_noise(free: Sequence[Array], j: int) -> bool:
    """Whether a channel was measured, and does not read zero below a threshold."""
    return all(np.median(np.abs(np.diff(x[:, j]))) > 0.0 for x in free if len(x) > 10)
