"""A facility as stepped by the plant: its composed model, and its drives or bodies with the
interface that the plant uses for any rig.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.contact.composition import Structure
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import Bodies, PhysicalFacility
from hiltestbed.platform.facilities.composed import TOOL, CarriedLoad, facility_model, rest_reading
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.hall import facility_of
from hiltestbed.platform.facilities.limits import Watch

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import Contacts
    from hiltestbed.scenario.like import ScenarioLike as Scenario


class Mover(Protocol):
    """The common interface of :class:`Drives` and :class:`Bodies`."""

    pose: Array
    twist: Array
    place_A: Array
    motion_A: Array
    place_P: Array
    motion_P: Array
    kinematics: Any

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None: ...
    def observe(
        self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]
    ) -> bool: ...
    def observing(
        self, qpos: Array, qvel: Array, limit: float, diverged: NDArray[np.bool_]
    ) -> Callable[[], bool]: ...


class FacilityRig:
    """The rigs of `n` runs on one facility.

    Attributes:
        model: as it is stepped. keeps_history: whether the sensor's readings within a tick are in
            MuJoCo's history; not if each of them needs the load's compensation.
        moves_passive: see :class:`Facility`. load: compensation of the sensor's load if the passive
            side moves. target: (n, J) commanded
            positions of the driven joints at t_k, from home. units: (J,) of them. watch: monitor of
            their limits.
    """

    def __init__(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> None:
        self.facility = facility_of(scenarios[0])
        self.moves_passive = self.facility.moves_passive
        self.keeps_history = not self.moves_passive
        kept = scenarios[0].substeps if self.keeps_history else 0
        self.model = facility_model(self.facility, structure, dt, kept)
        self.units = tuple(axis.unit for axis in self.facility.axes)
        self.target = np.zeros((len(scenarios), len(self.units)))
        self.watch: Watch | None = None
        self.load: CarriedLoad | None = None

    def start(self, batch: Batch, scenarios: Sequence[Scenario], dt: float) -> FacilityRig:
        """Bind drives, or bodies, to the batch of the model."""
        facility, first = self.facility, scenarios[0]
        settings = [s.rig.platform for s in scenarios]
        self.batch = batch
        self._applied, self._drives = batch.bind("qfrc_applied"), None
        self.mover: Mover
        if isinstance(facility, PhysicalFacility):
            self.mover = self._bodies = facility.bodies(self.model, settings, dt, TOOL)
        else:
            feed = np.array([s.compensation.motion.feeds for s in scenarios])
            self.mover = self._drives = facility.drives(
                self.model, settings, first.tick, first.substeps, feed, TOOL
            )
            self.target = self._drives.reference
            if first.rig.platform.states_limits:
                self.watch = self._watch(scenarios, self._drives)
            self._forces = batch.bind("qfrc_actuator")
        if self.moves_passive:
            self.load = CarriedLoad(self.model, self.mover.kinematics.home)
        return self

    def _watch(self, scenarios: Sequence[Scenario], drives: Drives) -> Watch:
        """Monitor of the limits that no run's safety section switches off."""
        watched = [
            [s.safety.stroke, s.safety.speed, s.safety.acceleration, True, True] for s in scenarios
        ]
        return Watch(
            self.facility.axes,
            drives.kinematics.joints_home,
            len(scenarios),
            drives.tick,
            np.array(watched, dtype=object) != None,  # noqa: E711
        )

    def tare(self, contacts: Contacts, reading: Array, columns: slice) -> Array:
        """``(n, 6)`` the sensor's reading at rest; zero if the sensor moves, whose load is then
        subtracted from every reading instead.
        """
        if self.moves_passive:
            return np.zeros_like(reading)
        mount = contacts.mount
        return np.array(
            [
                rest_reading(
                    self.model, self.mover.kinematics.home, columns, mount.body, balance, centre
                )
                for balance, centre in zip(mount.balance, mount.centre, strict=True)
            ]
        )

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        """Initialise joints and drives in the uniform motion through ``pose`` (n, 7) with ``twist``
        (n, 6).
        """
        qpos[:] = self.mover.kinematics.home
        self.mover.settle(pose, twist, qpos, qvel)

    def aim(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Plan one tick, at whose end ``pose_cmd`` (n, 7) is to be reached; freely moving bodies
        have no command.
        """
        if self._drives is not None:
            self._drives.aim(pose_cmd, twist_cmd, accel_cmd)

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        """Write the inputs for step ``sub`` of the tick."""
        if self._drives is not None:
            self._drives.push(sub, qpos, qvel, ctrl)
        else:
            self._bodies.push(qpos, qvel, self._applied)

    def arrive(self) -> None:
        """Complete the tick."""
        if self._drives is not None:
            self._drives.arrive()

    def observe(
        self,
        qpos: Array,
        qvel: Array,
        limit: float,
        pose: Array,
        twist: Array,
        joints: Array,
        diverged: NDArray[np.bool_],
    ) -> bool:
        """Read relative pose, twist and driven joints; returns whether a run just exceeded
        ``limit``, and marks it in ``diverged``.
        """
        lost = self.mover.observe(qpos, qvel, limit, diverged)
        if self.mover.pose is not pose:
            pose[:], twist[:] = self.mover.pose, self.mover.twist
        if self._drives is not None and self._drives.joints is not joints:
            joints[:] = self._drives.joints
        return lost

    def observing(
        self,
        qpos: Array,
        qvel: Array,
        limit: float,
        shown: tuple[Array, Array, Array],
        diverged: NDArray[np.bool_],
    ) -> Callable[[], bool] | None:
        """:meth:`observe` bound to reused arrays, those of :meth:`shown`; None for drives that
        override it.
        """
        mover, whole = self.mover, Bodies if self._drives is None else Drives
        if type(mover).observe is not whole.observe or shown[0] is not mover.pose:
            return None
        return mover.observing(qpos, qvel, limit, diverged)

    def shown(self) -> tuple[Array, Array, Array]:
        """The arrays that :meth:`observe` fills: poses (n, 7), twists (n, 6) and driven joints (n,
        J), those of drives or bodies.
        """
        joints = self.target[:, :0] if self._drives is None else self._drives.joints
        return self.mover.pose, self.mover.twist, joints

    def passed(self) -> bool:
        """Whether a run has exceeded a limit of its joints at this tick."""
        if self.watch is None or self._drives is None:
            return False
        d = self._drives
        return self.watch.passed(d.joints, d.joint_rates, self._forces, d.missed, d.kinematics.v)


class FacilityFollower:
    """The joints of `n` runs on a facility under exact tracking.

    Attributes:
        units: (J,) of the driven joints.
    """

    def __init__(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> None:
        first, self.facility = scenarios[0], facility_of(scenarios[0])
        self.model = facility_model(self.facility, structure, dt)
        self.units = tuple(axis.unit for axis in self.facility.axes)
        settings = [s.rig.platform for s in scenarios]
        self._drives = self.facility.drives(
            self.model,
            settings,
            first.tick,
            first.substeps,
            np.zeros(len(scenarios), dtype=bool),
            TOOL,
        )

    def follow(self, pose: Array, twist: Array, joints: Array) -> None:
        """Write the driven ``joints`` (n, J), from home, at the poses (n, 7) of A in P with the
        twists (n, 6).
        """
        self._drives.follow(pose, twist)
        joints[:] = self._drives.joints
