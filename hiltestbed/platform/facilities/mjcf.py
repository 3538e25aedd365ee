"""The user's own rig, from an MJCF file.

Required in the file: a site `mount`, where the active mechanism is attached with its z along the
insertion, and position actuators on
at least six joints that move it. Optional: a site `passive`, which carries the passive side (it may
move, but is not driven), a keyframe `home`, loops closed by equality constraints, actuators of
other kinds, which are ignored.

Home is the keyframe, or the model's reference configuration. The rig is placed in W so that the
mount's home is that of every facility or, with a site `passive`, so that this site is P; gravity is
rotated with it. Everything else is measured on the model: reach, response, modes.

The drives are MuJoCo's position actuators, commanded by positions: the force of one is kp (ctrl -
s) - kv s'. With feed-forward its only input also includes the planned velocity, ctrl = s_r +
(kv/kp) s_r', so that the damping does not cause a lag; acceleration and weight are not fed forward,
as in a plain position servo. The deflection of the servos under the weight at the start is
compensated in the references.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import interpreted
from hiltestbed.config.models import model_of
from hiltestbed.config.part import named
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, rotate
from hiltestbed.platform.facilities.drives import Drives, drive_inputs, mass_matrix
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    UPRIGHT,
    Facility,
    Runs,
    add_carrier,
    compiled,
)
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.tree import compose, inverse_pose, site_pose
from hiltestbed.platform.shipped.mjcf import MjcfSettings

PREFIX = "rig/"  # prefix of all names of the file in the composed model
PASSIVE = "passive"
HOME = "home"
TRIES = 6  # other configurations that are tried if home is singular
# their largest distance from home, as a fraction of the travel or, if that is larger, of 2 m or rad
NEARBY = 0.1
SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


class MjcfFacility(Facility):
    """A rig from an MJCF file."""

    settings: MjcfSettings

    def __init__(self, settings: MjcfSettings) -> None:
        """Raises InputError for an unreadable file, one without `mount`, or too few drives."""
        super().__init__(settings)
        own = model_of(self.settings.file()).spec().compile()
        names = [own.site(s).name for s in range(own.nsite)]
        if MOUNT not in names:
            raise self._fault(
                f"has no site {MOUNT!r}, where the active mechanism is attached (sites: "
                f"{', '.join(filter(None, names)) or 'none'}); add one"
            )
        self._passive = PASSIVE in names
        self._sites = {
            name: np.concatenate([own.site(name).pos, own.site(name).quat[[1, 2, 3, 0]]])
            for name in (MOUNT, PASSIVE)[: 1 + self._passive]
        }
        self._gravity = own.opt.gravity.copy()
        self._axes = tuple(self._driven(own))
        self._home, self._into = self._placed(own)
        self._check_motions()

    def _fault(self, message: str) -> InputError:
        return InputError(f"{self.settings.model}: {message}")

    def _driven(self, own: mujoco.MjModel) -> Iterator[Axis]:
        """The joints with position actuators, with their limits from the file."""
        for a in range(own.nu):
            if not _is_position_servo(own, a):
                continue
            joint = own.joint(int(own.actuator_trnid[a, 0]))
            slides = own.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_SLIDE
            limited = own.jnt_limited[joint.id]
            low, high = own.jnt_range[joint.id] if limited else (-math.inf, math.inf)
            if own.actuator_ctrllimited[a]:
                ratio = own.actuator_gear[a, 0]
                span = sorted(own.actuator_ctrlrange[a] / ratio)
                low, high = max(low, span[0]), min(high, span[1])
            force = math.inf
            if own.actuator_forcelimited[a]:
                ratio = abs(own.actuator_gear[a, 0])
                force = float(np.abs(own.actuator_forcerange[a]).min()) * ratio
            s = self.settings
            unit, speed = ("m", s.speed) if slides else ("rad", s.spin)
            name = PREFIX + joint.name
            yield Axis(name, unit, float(low), float(high), speed, s.acceleration, force)

    def _placed(self, own: mujoco.MjModel) -> tuple[dict[str, Array], Array]:
        """Home positions by joint, in the file's world, and the pose (7,) of that world in W."""
        data = mujoco.MjData(own)
        keys = [k for k in range(own.nkey) if own.key(k).name == HOME]
        if keys:
            mujoco.mj_resetDataKeyframe(own, data, keys[0])
        mujoco.mj_kinematics(own, data)
        site, at = (PASSIVE, UPRIGHT) if self._passive else (MOUNT, MOUNT_HOME)
        into = compose(at, inverse_pose(site_pose(own, data, site)))
        home = {}
        for j in range(own.njnt):
            start, width = own.jnt_qposadr[j], {0: 7, 1: 4}.get(int(own.jnt_type[j]), 1)
            home[own.joint(j).name] = data.qpos[start : start + width].copy()
        return home, into

    def _check_motions(self) -> None:
        """Raise InputError unless the drives move the mount in six axes, at home or near it."""
        model = compiled(self.spec())
        kinematics = self.kinematics(model)
        found, rng = kinematics.lost_motion(kinematics.home), np.random.default_rng(1)
        if found is None:
            return
        for _ in range(TRIES):
            q = kinematics.home.copy()
            step = np.array([NEARBY * min(axis.high - axis.low, 2.0) for axis in self._axes])
            q[kinematics.q] += step * rng.uniform(-1.0, 1.0, len(step))
            if kinematics.lost_motion(kinematics.closed(q)) is None:
                return  # only home is singular: the start is checked separately
        others = "; actuators that are not position servos do not count"
        raise self._fault(
            f"its {len(self._axes)} position actuators do not move {MOUNT!r} in six axes: {found}; "
            f"add what is missing, or drive it by position actuators"
            + (others if model.nu != len(self._axes) else "")
        )

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self._axes

    def spec(self) -> mujoco.MjSpec:
        spec, into, gravity = mujoco.MjSpec(), self._into, np.empty(3)
        interpreted(rotate)(into[3:7], self._gravity, gravity)
        spec.attach(
            named(self.settings.file()),
            prefix=PREFIX,
            frame=spec.worldbody.add_frame(pos=into[:3], quat=[into[6], *into[3:6]]),
        )
        spec.option.gravity = gravity
        place = self._sites[MOUNT]
        spec.site(PREFIX + MOUNT).parent.add_site(
            name=MOUNT, pos=place[:3], quat=place[[6, 3, 4, 5]]
        )
        if self._passive:
            add_carrier(spec.site(PREFIX + PASSIVE).parent, self._sites[PASSIVE])
        else:
            add_carrier(spec.worldbody)
        return spec

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> Kinematics:
        home = model.qpos0.copy()
        for name, value in self._home.items():
            if name:
                start = int(model.joint(PREFIX + name).qposadr[0])
                home[start : start + len(value)] = _carried(self._into, value)
        return Kinematics(model, [tool], self._axes, home=home)

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> Drives:
        return PositionActuators(model, self.kinematics(model, tool), runs)

    def bandwidth(self) -> float:
        """That of the slowest servo, from its kp and its effective mass alone, at home."""
        model = compiled(self.spec())
        stiffness = _stiffness(model, drive_inputs(model, [axis.joint for axis in self._axes]))
        moved = np.diag(mass_matrix(self.kinematics(model), model))
        return float(np.sqrt(stiffness / moved).min()) / (2.0 * math.pi)

    def alike(self) -> Hashable:
        return (self.kind, self.settings.model)


def _is_position_servo(m: mujoco.MjModel, a: int) -> bool:
    joint = int(m.actuator_trnid[a, 0])
    acts = m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT and int(m.jnt_type[joint]) in SCALAR
    linear = (
        m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
        and m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
    )
    kp = m.actuator_gainprm[a, 0]
    return bool(acts and linear and kp > 0.0 and abs(m.actuator_biasprm[a, 1] + kp) <= 1e-9 * kp)


def _carried(into: Array, value: Array) -> Array:
    """A joint's position in W: the pose of a free joint moves with the file's world."""
    if len(value) != 7:
        return value
    pose = compose(into, np.concatenate([value[:3], value[[4, 5, 6, 3]]]))
    return np.concatenate([pose[:3], pose[[6, 3, 4, 5]]])


def _stiffness(m: mujoco.MjModel, inputs: NDArray[np.int64]) -> Array:
    """``(J,)`` of position actuators, at their joints."""
    return np.asarray(m.actuator_gainprm[inputs, 0] * m.actuator_gear[inputs, 0] ** 2)


class PositionActuators(Drives):
    """Position servos of `n` runs of a user's rig.

    Attributes:
        bent: (n, J) compensated deflection.
    """

    def __init__(self, model: mujoco.MjModel, kinematics: Kinematics, runs: Runs) -> None:
        super().__init__(model, kinematics, runs)
        inputs = self._inputs
        self._ratio = model.actuator_gear[inputs, 0].copy()
        self._lead = -model.actuator_biasprm[inputs, 2] / model.actuator_gainprm[inputs, 0]
        self.bent = np.zeros_like(self.load)

    def rest(self, qpos: Array, qvel: Array) -> None:
        self.bent[:] = self.load / _stiffness(self.model, self._inputs)

    def push(self, sub: int, qpos: Array, qvel: Array, inputs: Array) -> None:
        place, rate, _ = np.moveaxis(self.plan.steps[:, sub], 1, 0)
        inputs[:, self._inputs] = self._ratio * (place + self._lead * rate + self.bent)
