"""Where the platform's drives take it: the believed servo, replayed on the recorded command under the recorded force.

With `rig.platform.tracking: servo` the platform yields to the force that it bears and follows its command with the servo's own small
errors. That is no departure from what is believed: the platform's link adds it to what its effects make of the command.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.adequacy import BLOCK
from hiltestbed.diagnosis.links import advanced
from hiltestbed.frames import Array, twist_between
from hiltestbed.measured import MeasuredRun
from hiltestbed.rig.driven import ServoTracking
from hiltestbed.rig.model import Structure
from hiltestbed.rig.servo import BANDWIDTH
from hiltestbed.rig.touch import Touch
from hiltestbed.scenario import Scenario
from hiltestbed.spacecraft import approach_state

KNOWN = 0.25  # of the yield that a wrong reading of the force may falsify
LATER = 5e-3  # [s] that the reading may be later than believed
UNFOLLOWED = 0.01  # of a departure: what the drives leave of a jump is not replayed
SETTLING = 10.0 / (2.0 * math.pi * BANDWIDTH)  # [s] ten time constants: where the drives start from is not recorded
ALIKE = 1.0 / BANDWIDTH  # [s] of a yield that count as one: its noise is that of the force, through the drives
LOST = 0.05  # [m] from its command: under the 50 kN at which the sensor overloads these drives yield 1.2 mm
FOLLOWED = ("none", "feedforward", "contact_correction")  # motions whose platform is told the recorded pose itself


def unfollowed(runs: Sequence[MeasuredRun]) -> str | None:
    """Why the platform cannot be replayed: under a servo the record must hold what it was told."""
    for run in runs:
        motion, upper = run.scenario.compensation.motion.kind, run.scenario.rig.upper.kind
        if run.scenario.rig.platform.tracking != "servo":
            continue
        if run.scenario.mechanism.mount is not None:
            return "under a servo, and the force of a compliant mount is not replayed"
        if motion not in FOLLOWED or upper != "fixed":
            return (
                f"under a servo not replayed with compensation.motion {motion} and rig.upper {upper}; allowed: {', '.join(FOLLOWED)}; fixed"
            )
    return None


def yields(run: MeasuredRun, noise: float) -> tuple[Array, Array] | None:
    """(N, 3) by how much the believed servo's pose departs from its command [m], and (N, 3) how well that is known; None where it is lost.

    What is not known takes whole blocks of rows the same way, and is counted like noise that is the larger by their root.
    noise: [N] of the force. The force is read as much earlier as the believed sensor is late; where none was
    measured, the pose tells nothing once A has reached P.
    """
    scenario, command = run.scenario, np.ascontiguousarray(run.record.filled("pose_cmd"))
    wrench = np.zeros((len(command), 6))
    if run.record.has("wrench_meas"):
        wrench = advanced(run.record.filled("wrench_meas"), scenario.sensor.delay / scenario.tick)
    start = approach_state(scenario)[:7]
    told = np.vstack([start, command[:-1]])[:, :3]
    path = followed(scenario, command, wrench)
    if path is None:
        return None
    away = path[:, :3] - told
    departure = np.nanmax(np.abs(run.record.data["pose_act"][:, :3] - told - away), initial=0.0)
    later = advanced(away, -LATER / scenario.tick) - away
    doubt = math.sqrt(BLOCK) * np.sqrt((KNOWN * away) ** 2 + later**2 + (UNFOLLOWED * departure) ** 2)
    doubt[: math.ceil(SETTLING / scenario.tick)] = np.inf
    if not run.record.has("wrench_meas"):
        doubt[np.maximum.accumulate(told[:, 2] > -departure)] = np.inf
    if noise == 0.0:
        return away, doubt
    shaken = wrench.copy()
    shaken[:, :3] += noise * np.random.default_rng(0).standard_normal((len(wrench), 3))
    noisy = followed(scenario, command, shaken)
    passed = float(np.std(noisy[:, :3] - path[:, :3])) if noisy is not None else 0.0
    return away, np.hypot(doubt, passed * math.sqrt(max(1.0, ALIKE / scenario.tick)))


class RecordedWrench(Touch):
    """A wrench (N, 6) on record, a row a tick, in place of a contact; past its end it holds."""

    def __init__(self, scenario: Scenario, wrench: Array) -> None:
        super().__init__([scenario], least_creep=0.0)
        self._record, self._instant, self._substeps = wrench, 0, scenario.substeps

    def reset(self) -> None:
        super().reset()
        self._instant = 0

    def update(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """The wrench of the next physics instant, between rows on a straight line."""
        row = min(self._instant / self._substeps, len(self._record) - 1.0)
        low = math.floor(row)
        high = min(low + 1, len(self._record) - 1)
        self.wrench[0] = self._record[low] + (row - low) * (self._record[high] - self._record[low])
        self._instant += 1


def followed(scenario: Scenario, command: Array, wrench: Array) -> Array | None:
    """(N, 7) poses at t_k of a platform that was told ``command`` (N, 7) for t_(k+1) while it bore ``wrench`` (N, 6) at t_k.

    None where it diverges or is left behind: a record of few rows a second, or a command that it cannot reach.
    """
    start = approach_state(scenario)
    tracking = ServoTracking([scenario], 1, Structure(scenario.mechanism.kind, mounted=False, paired=False))
    tracking.touch = RecordedWrench(scenario, wrench)
    tracking.reset(start[None, :7], start[None, 7:])
    out, twists = np.empty_like(command), np.empty((2, 1, 6))
    twists[0] = start[7:]
    before, told = start[:7], scenario.compensation.motion.kind == "feedforward"
    for k in range(len(command)):
        out[k] = tracking.pose_act[0]
        twist_between(before, command[k], scenario.tick, twists[1, 0])
        acceleration = (twists[1] - twists[0]) / scenario.tick
        tracking.begin(command[k : k + 1], twists[1] * told, acceleration * told)
        tracking.finish()
        if tracking.diverged[0] or np.abs(tracking.pose_act[0, :3] - command[k, :3]).max() > LOST:
            return None
        before, twists[0] = command[k], twists[1]
    return out
