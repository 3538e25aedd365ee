"""The physical rig of `n` runs: the platform tracks the commanded relative pose, and the sensor
measures the contact of the mechanisms.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.contact.engagement import Engagement
from hiltestbed.contact.jacobian import held_pair
from hiltestbed.contact.phases import LatchCondition, Phases
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.platform.driven import ServoTracking
from hiltestbed.platform.ideal import IdealTracking
from hiltestbed.platform.nine_axes import NineAxes
from hiltestbed.platform.parameters import RigParameters

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import AppliedForce


class Plant:
    """`n` rigs in lockstep. Every array is updated in place: copy what is needed after a tick.

    Attributes, all at t_k:
        pose_act: (n, 7) pose of A in P; twist_act: (n, 6) twist of A relative to P, in P. Ideal
            tracking: the slope of the pose over the tick that ended; servo: the velocity at t_k.
        wrench_sub: (n, m, 6) contact wrench, what the active side exerts on the passive one, in P
            at P's origin, tared [N, N m], at t_(k-1) + (s + 1) dt, s = 0 .. m - 1; the last, at
            t_k, is valid only after :meth:`begin` for a run that is `late`.
        contact: (n,) bool, whether the mechanisms touch. captured: (n,) bool, whether they are
            latched to each other.
        slider_cmd, slider_act: (n, J) the platform's driven joints [units], 0 at home; J = 0 if
            nothing is driven. upper_cmd, upper_act: (n, 3) those of the upper platform. units: (J,)
            "m" or "rad".
        phases: of capture, if the mechanism has them. pose_W: (n, 7) pose of A in W, which is P
            without an upper platform.
        physical: whether the bodies move freely: commands are ignored, and the reached pose is the
            actual one.
        diverged: (n,) bool, whether a run has diverged; it is frozen from then on.
    """

    def __init__(
        self,
        parameters: RigParameters,
        nthread: int = 1,
        late: NDArray[np.bool_] | None = None,
        force: AppliedForce | None = None,
        held: bool = False,
    ) -> None:
        """The rigs of `n` runs.

        Args:
            force: replaces the contact; the mechanisms then pass through each other.
            held: whether moving parts of the active side are kept fixed to it; needs ``force``.
            late: (n,) whether a run does not need the wrench at t_k before the tick that begins
                there, which is cheaper; none by default.
        """
        made_of, runs, n = parameters.structure, parameters.runs, len(parameters.start)
        if force is not None:
            made_of = replace(made_of, constant=True, latched=False, touches=False, held=held)
            parameters = parameters._replace(structure=made_of)
        lower: IdealTracking | ServoTracking
        self.physical = runs.settings[0].physical
        if runs.settings[0].prescribed:
            lower = IdealTracking(parameters, nthread, force)
        else:
            lower = ServoTracking(parameters, nthread, late, force)
        self._driven = lower if isinstance(lower, ServoTracking) else None
        above = None if parameters.upper is None else NineAxes(parameters, lower, nthread)
        tracking = lower if above is None else above
        self.units, self._lower, self._above, self._tracking = lower.units, lower, above, tracking
        self._batch, self._made_of = lower.batch, made_of
        latches = force is None and made_of.mechanism.latch is not None
        self._latch = LatchCondition(parameters.mechanism.closing) if latches else None
        self.phases: Phases | None = None
        if force is None and made_of.mechanism.phases():
            legs = lower.contacts.engagement.legs
            self.phases = Phases(lower.batch, made_of, runs.tick, n, legs)
        self.pose_W: Array = lower.pose_act
        self.pose_act: Array = tracking.pose_act
        self.twist_act: Array = tracking.twist_act
        self.wrench_sub: Array = tracking.wrench_sub
        self.contact: NDArray[np.bool_] = lower.contact_now
        self.captured: NDArray[np.bool_] = lower.contacts.latched
        self.slider_cmd: Array = lower.slider_cmd
        self.slider_act: Array = lower.slider_act
        still = np.zeros((n, 3))
        self.upper_cmd: Array = above.upper_cmd if above else still
        self.upper_act: Array = above.upper_act if above else still
        self.diverged: NDArray[np.bool_] = lower.diverged

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model that this plant steps while the ports touch."""
        return self._lower.model

    def contacts(self) -> Engagement:
        """Contact points and their forces; not of springs and dampers without friction."""
        return self._lower.contacts.engagement

    def watch(self, field: str, parts: int) -> Array:
        """A live view of a field of MuJoCo's data: (n, bodies, parts)."""
        return self._batch.bind(field).reshape(len(self.pose_act), -1, parts)

    def held_pair(self, i: int) -> tuple[Array, Array] | None:
        """Stiffness and damping (6, 6) of the latches of run ``i``; None without phases."""
        if self.phases is None:
            return None
        return held_pair(self.contacts(), self._batch, self._made_of, i)

    def joint_limit_passed(self) -> bool:
        """Whether a joint has exceeded a limit of its facility, or a command its reach."""
        return self._driven is not None and self._driven.joint_limit_passed()

    def joint_limit(self, i: int) -> str | None:
        """The limit that run ``i`` has exceeded, in words; None if there is none."""
        return self._driven.joint_limit(i) if self._driven else None

    def payload_left(self, i: int) -> dict[str, float] | None:
        """Residual of a moving passive side's load in the reading of run ``i``, or None."""
        return self._above.payload_left(i) if self._above else None

    def divergence(self, i: int) -> str:
        """Why run ``i`` diverged: the quantity and its value."""
        return self._lower.causes[i]

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at ``pose`` (n, 7) of A in P, approached uniformly with ``twist`` (n, 6)."""
        self._tracking.reset(pose, twist)
        if self.phases is not None:
            self.phases.reset()

    def bare_steps(self, count: int) -> None:
        """``count`` steps of the same physics alone: the reference for the loop's cost."""
        self._lower.bare_steps(count)

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick from t_k to t_(k+1): ``pose_cmd`` (n, 7) is to be reached then, with
        ``twist_cmd`` and ``accel_cmd`` (n, 6).

        All attributes stay those at t_k; after this call the wrench at t_k is valid for every run.
        """
        self._tracking.begin(pose_cmd, twist_cmd, accel_cmd)

    def finish(self) -> None:
        """Complete the tick: all attributes become those at t_(k+1)."""
        self._tracking.finish()
        self._conclude()

    def _conclude(self) -> None:
        if self._latch is not None:
            self._latch.close(self.contacts())
        if self.phases is not None:
            self.phases.look(self.contacts())

    def advance(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """A whole tick: :meth:`begin` and :meth:`finish`."""
        self.begin(pose_cmd, twist_cmd, accel_cmd)
        self.finish()

    def carry(self, poses: Array, twists: Array) -> None:
        """A whole tick of a rig under ideal tracking through ``poses`` (m, n, 7) with ``twists``
        (m, n, 6) at its m physics instants.

        Each twist is the slope of the step that ends there.
        """
        assert isinstance(self._tracking, IdealTracking)
        self._tracking.carry(poses, twists)
        self._conclude()


class FreeMotion:
    """The motion of `n` pairs of bodies: the recorded commanded pose is the actual one, the wrench
    used is the physical one.

    That wrench is a view of the plant's array, which may be filled only after the tick has begun.
    """

    def __init__(self, start: Array, pose: Array, twist: Array, wrench_sub: Array) -> None:
        """``start``: (n, 13) initial pose and twist of A relative to P, in P; then arrays of the
        plant.
        """
        self.pose: Array = start[:, :7].copy()
        self.twist: Array = start[:, 7:].copy()
        self.wrench: Array = wrench_sub[:, -1]
        self._bodies = pose, twist

    def advance(self, measurement: Measurement) -> None:
        """Copy pose and twist of the bodies at t_k."""
        self.pose[:], self.twist[:] = self._bodies


WRITERS = {
    ".mjb": lambda model, name: mujoco.mj_saveModel(model, name, None),
    ".txt": mujoco.mj_printModel,
}


def write_model(model: mujoco.MjModel, file: Path) -> Path:
    """Write a model that the loop steps, and return ``file``: .mjb in MuJoCo's binary form, .txt
    with every body, joint and pair.

    Raises:
        InputError: another suffix, or the file cannot be written.
    """
    write = WRITERS.get(file.suffix)
    if write is None:
        raise InputError(
            f"--model: no such format (got {file.name}); allowed are {', '.join(WRITERS)}"
        )
    try:
        file.write_bytes(b"")  # MuJoCo itself does not say why it cannot write
        write(model, str(file))
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); choose another") from None
    return file
