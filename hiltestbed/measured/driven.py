"""Whether a record is of an axis driven by a force: of a machine for which only position and force
were measured.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.momentum import centred
from hiltestbed.measured.record import Record
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

PLACE, FORCE = "pose_cmd.pz", "wrench_comp.fz"
STILL_FREE = 20  # rows at the start of a run in which an approaching spacecraft feels no force
# of the approach speed: largest change by the force in these rows that counts as free flight
UNDRIVEN = 0.01


def is_driven(record: Record, scenario: Scenario) -> bool:
    """Whether the record contains only one position, and a force that drives it from the first row
    on.
    """
    given = set(record.columns())
    if (
        not {PLACE, FORCE} <= given
        or record.has("pose_act")
        or record.has("wrench_meas")
        or not centred(scenario)
    ):
        return False
    beside = [
        c
        for group in ("pose_cmd", "wrench_comp")
        for c in GROUPS[group].columns
        if c in given and c not in (PLACE, FORCE)
    ]
    return all(_stands(record.column(c)) for c in beside) and not _begins_in_free_flight(
        record, scenario
    )


def _stands(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return not len(known) or float(np.ptp(known)) == 0.0


def _begins_in_free_flight(record: Record, scenario: Scenario) -> bool:
    speed, (chaser, target) = (
        abs(scenario.approach.velocity[2]),
        (scenario.spacecraft.chaser.mass, scenario.spacecraft.target.mass),
    )
    impulse = float(np.sum(np.abs(record.filled("wrench_comp")[:STILL_FREE, 2]))) * scenario.tick
    return speed > 0.0 and impulse * (chaser + target) / (chaser * target) < UNDRIVEN * speed
