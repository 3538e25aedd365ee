"""Poses and forces that are late only in the record, as opposed to a late platform or a late
sensor.

With a late platform the contact is late as well: the force agrees in time with the recorded pose.
If the pose was stamped late, the force precedes it, which nothing between contact and sensor can
cause. A late sensor delays the reaction of the loop. If the force was stamped
late, the loop reacts before the recorded force: free-floating bodies have moved by then.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from hiltestbed.contact.latch import latch_limits
from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.contact.parameters import believed_contacts, contact_rows
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects.log import log_parameters
from hiltestbed.frames import Array, pose_step
from hiltestbed.measured.record import Record
from hiltestbed.measured.survey import Survey
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.replay import Felt, creep_of, replay_wrench
from hiltestbed.replay.wrench import Lane
from hiltestbed.scenario import Scenario
from hiltestbed.sensor.parameters import SensorParameters

FURTHEST = 40  # largest shift that is searched [rows]
REMAINDER = 0.1  # part of the misfit that may remain once the shift is removed
CLEAR = 20.0  # least decrease of the misfit, over all rows together, in noise floors of the force
# rows; pose and force are smoothed in the same way, so that the fitted contact is consistent
SMOOTHING = 11


def force_leads(record: Record, found: Survey, scenario: Scenario) -> int:
    """Whole rows by which the contact in wrench_meas precedes that of the recorded pose; 0 if it
    does not, or if it cannot be determined.

    Stiffness and damping are fitted: more damping also makes the force lead, but not before the
        touch.
    """
    if not (found.contacts and record.whole("pose_act") and record.has("wrench_meas.fz")):
        return 0
    if not sides_of(scenario.mechanism).rigid or record.ticks < 4 * FURTHEST:
        return 0
    spring, both = _felt(record, scenario)
    names = [
        i for i, part in enumerate(("fx", "fy", "fz")) if f"wrench_meas.{part}" in record.columns()
    ]
    shown = _smooth(np.nan_to_num(record.data["wrench_meas"][:, names]))
    shown = shown - np.median(shown[: max(found.free, 1)], axis=0)
    columns = np.stack([_smooth(spring[:, names]), _smooth((both - spring)[:, names])])
    inner = slice(0, record.ticks - FURTHEST)
    left = []
    for rows in range(FURTHEST):
        basis = columns[:, rows : rows + record.ticks - FURTHEST].reshape(2, -1).T
        rest = shown[inner].ravel()
        left.append(
            float(np.sum((rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]) ** 2))
        )
    best = int(np.argmin(left))
    noise = max(found.noise["wrench_meas.fz"].white, 1e-9)
    worth = left[0] - left[best] > (CLEAR * noise) ** 2
    return best if worth and left[best] < REMAINDER * left[0] and best < FURTHEST - 1 else 0


def _smooth(values: Array) -> Array:
    return np.asarray(savgol_filter(values, SMOOTHING, 2, axis=0))


def _felt(record: Record, scenario: Scenario) -> tuple[Array, Array]:
    """The believed sensor's reading for the recorded pose, twice (ticks, 6): without and with the
    damping of the contact.
    """
    mechanism, path = scenario.mechanism, record.filled("pose_act")
    path[:, :3] = _smooth(path[:, :3])
    before = np.empty(7)
    pose_step(path[0], approach_state(scenario)[7:], -scenario.tick, before)
    felt = Felt(
        path[None],
        before[None],
        scenario.tick,
        sides_of(mechanism).geometry,
        np.array([mechanism.captured]),
        latch_limits([scenario]),
        MountDynamics.of([scenario]),
        scenario.substeps,
        least_creep=creep_of(scenario),
    )
    contacts = [
        replace(c, damping=c.damping or c.stiffness * scenario.tick)
        for c in believed_contacts(mechanism)
    ]
    lanes = []
    for given in ([replace(c, damping=0.0) for c in contacts], contacts):
        rows = contact_rows(given, sides_of(mechanism).rules, mechanism.captured)
        lanes.append(
            Lane(
                0,
                rows,
                SensorParameters.believed(scenario.sensor),
                log_parameters(()),
            )
        )
    spring, both = replay_wrench(felt, lanes)
    return spring, both
