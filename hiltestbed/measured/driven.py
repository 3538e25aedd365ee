"""Whether a record is of an axis driven by a force: of a machine for which only position and force
were measured.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.measured.momentum import centred
from hiltestbed.measured.record import Record
from hiltestbed.measured.survey import extent
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

PLACE, FORCE = "pose_cmd.pz", "wrench_comp.fz"
STILL_FREE = 20  # rows at the start of a run in which an approaching spacecraft feels no force
# of the approach speed: largest change by the force in these rows that counts as free flight
UNDRIVEN = 0.01


def is_driven(record: Record, scenario: Scenario) -> bool:
    """Whether the record has one position only, and a force that drives it from the start."""
    if not (record.has(PLACE) and record.has(FORCE) and centred(scenario)):
        return False
    if record.has("pose_act") or record.has("wrench_meas"):
        return False
    groups = {*GROUPS["pose_cmd"].columns, *GROUPS["wrench_comp"].columns} - {PLACE, FORCE}
    beside = [record.column(name) for name in groups if record.has(name)]
    return not any(extent(v) for v in beside) and not _begins_in_free_flight(record, scenario)


def _begins_in_free_flight(record: Record, scenario: Scenario) -> bool:
    speed, craft = abs(scenario.approach.velocity[2]), scenario.spacecraft
    chaser, target = craft.chaser.mass, craft.target.mass
    impulse = float(np.sum(np.abs(record.filled("wrench_comp")[:STILL_FREE, 2]))) * scenario.tick
    return speed > 0.0 and impulse * (chaser + target) / (chaser * target) < UNDRIVEN * speed
