"""An arm of several joints: the torques that its bodies and joints need for the recorded motion.

The rigid torque of a motion is linear in the inertial parameters of the bodies, ``tau = Y(q, v, a)
pi`` (W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, ch. 12); the
regressor ``Y`` is Pinocchio's. What acts along each joint beside it is the law of a drive.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.axis.effects.base import BodyEffect, RecordScale
from hiltestbed.axis.inverse import InverseRecord, blocks_of, in_motion, rows_of
from hiltestbed.axis.law import (
    COULOMB,
    COULOMB_BACK,
    GAIN,
    OFFSET,
    VISCOUS,
    VISCOUS_BACK,
    ArmNumbers,
    AxisLaw,
)
from hiltestbed.axis.models import AxisModel, AxisRun, along, largest
from hiltestbed.axis.motion import Motion, States, even, motion_of, window_of
from hiltestbed.effects.search import Candidate
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.inference.model import Hypothesis


@dataclass(frozen=True, eq=False)
class Arm:
    """The nominal arm.

    Attributes:
        pinocchio: its model, of the ``joints`` alone, in this order. bodies: name of what each
            joint moves, with all that is fixed to it. joints: number by name to value, ``gain``
            [N m/unit], ``viscous``, ``coulomb``, ``offset``, ``armature``.
    """

    pinocchio: Any
    bodies: tuple[str, ...]
    joints: Mapping[str, Mapping[str, float]]

    @property
    def turns(self) -> dict[str, bool]:
        """Whether a joint turns, or slides, by name."""
        kinds = [j.shortname() for j in list(self.pinocchio.joints)[1:]]
        return {n: "JointModelP" not in k for n, k in zip(self.joints, kinds, strict=True)}

    def numbers(self) -> ArmNumbers:
        """Its numbers, as the owner believes them."""
        laws = {}
        for name, own in self.joints.items():
            laws[name] = law = AxisLaw(1.0, own["gain"])  # of one times the rigid torque
            law.numbers[[VISCOUS, VISCOUS_BACK]] = own["viscous"]
            law.numbers[[COULOMB, COULOMB_BACK]] = own["coulomb"]
            law.numbers[OFFSET] = own["offset"]
        inertial = [i.toDynamicParameters() for i in list(self.pinocchio.inertias)[1:]]
        bodies = dict(zip(self.bodies, inertial, strict=True))
        return ArmNumbers(laws, {n: own["armature"] for n, own in self.joints.items()}, bodies)

    def regressor(self, motions: Sequence[Motion]) -> Array:
        """``(N, J, 10 B)`` Y of the motions of the joints, (N,) each."""
        import pinocchio as pin

        model, data = self.pinocchio, self.pinocchio.createData()
        q, v, a = (np.column_stack([getattr(m, part) for m in motions]) for part in "xva")
        zero = pin.neutral(model)
        return np.array(
            [
                pin.computeJointTorqueRegressor(model, data, pin.integrate(model, zero, x), *of)
                for x, *of in zip(q, v, a, strict=True)
            ]
        )

    def inertia(self, q: Array) -> Array:
        """(J, J) mass matrix at the angles ``q`` (J,)."""
        import pinocchio as pin

        model, data = self.pinocchio, self.pinocchio.createData()
        upper = np.triu(pin.crba(model, data, pin.integrate(model, pin.neutral(model), q)))
        return upper + np.triu(upper, 1).T


def read_arm(path: Path, given: Mapping[str, Mapping[str, float]]) -> Arm:
    """The arm of a URDF or MJCF file, with the joints that were recorded; the others stay at zero.

    Args:
        given: numbers of each recorded joint that the file does not state.

    Raises:
        InputError: the file cannot be read, or lacks a joint.
    """
    import pinocchio as pin

    if not path.is_file():
        raise InputError(f"{path}: is no file; model: takes the URDF or MJCF of the arm")
    try:
        of_urdf = path.suffix.lower() == ".urdf"
        model = pin.buildModelFromUrdf(str(path)) if of_urdf else _from_mjcf(path)
    except (ValueError, RuntimeError) as error:
        why = str(error).strip().splitlines()[-1].strip().removeprefix("message: ")
        raise InputError(
            f"{path}: cannot be read as the model of an arm ({why}); allowed are a URDF (.urdf) "
            f"and MJCF (any other suffix)"
        ) from None
    joints = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
    single = [name for name, joint in joints if joint.nv == 1]
    absent = [n for n in given if n not in single]
    if absent:
        raise InputError(
            f"{path}: has no joint {', '.join(absent)}; its joints of one axis are "
            f"{', '.join(single) or 'none'}"
        )
    other = [i for i, n in enumerate(model.names) if i and n not in given]
    model = pin.buildReducedModel(model, other, pin.neutral(model))
    names = list(model.names)[1:]
    bodies = [
        next((f.name for f in model.frames if f.parentJoint == i and "BODY" in str(f.type)), name)
        for i, name in enumerate(names, 1)
    ]
    stated = zip(
        names,
        model.damping.tolist(),
        model.upperDryFrictionLimit.tolist(),
        model.armature.tolist(),
        strict=True,
    )
    numbers = {
        name: {"gain": 1.0, "viscous": c, "coulomb": f, "offset": 0.0, "armature": a, **given[name]}
        for name, c, f, a in stated
    }
    return Arm(model, tuple(bodies), numbers)


def _from_mjcf(path: Path) -> Any:
    """Pinocchio's reader leaves out gravity, and bodies without names of their own."""
    import mujoco
    import pinocchio as pin

    model, spec = pin.buildModelFromMJCF(str(path)), mujoco.MjSpec.from_file(str(path))
    if len(spec.joints) != model.njoints - 1:
        raise ValueError("give every body and every joint a name of its own")
    model.gravity.linear = spec.option.gravity
    return model


class ArmRun(NamedTuple):
    """One record of an arm: times [s] (N,), positions and torques or currents (N, J) of its
    joints.
    """

    name: str
    t: Array
    q: Array
    u: Array


class _Moved(NamedTuple):
    """The joints that move in a run, by number, with inverse records and regressors (N, 10 B)."""

    joints: list[int]
    inverse: list[InverseRecord]
    regressors: list[Array]


class ArmModel(AxisModel):
    """The torques, or currents, of an arm for its recorded motion. Each joint of each run is a
    record with noise of its own; runs are left out whole.
    """

    kind = "arm"

    def __init__(self, runs: Sequence[ArmRun], arm: Arm, believed: Sequence[Any] = ()) -> None:
        """``believed``: effects that are part of the nominal model."""
        self._arm, self.axes = arm, len(arm.joints)
        # a joint that does not move in a run is no record of it
        moved = [(r, of) for r in runs if (of := self._moved_in(r)).joints]
        self._runs, self._moved = [r for r, _ in moved], [of for _, of in moved]
        everything = range(len(arm.joints))
        each = [(r, of.joints) for r, of in moved] or [(r, everything) for r in runs]
        names = list(arm.joints)
        records = [
            AxisRun(f"{r.name}: {names[j]}", r.t, r.q[:, j], r.u[:, j])
            for r, joints in each
            for j in joints
        ]
        super().__init__(records, {}, believed=believed)

    @property
    def recorded(self) -> tuple[str, ...]:
        return tuple(r.name for r in self._runs)

    def on(self, runs: Sequence[int]) -> ArmModel:
        return ArmModel([self._runs[i] for i in runs], self._arm, self.believed)

    def of_recorded(self) -> list[list[int]]:
        ends = np.cumsum([0, *(len(of.joints) for of in self._moved)])
        return [list(range(a, b)) for a, b in itertools.pairwise(ends)]

    def _prepare(self) -> None:
        self.floors = np.array([x.floor for x in self._inverse])

    def _moved_in(self, r: ArmRun) -> _Moved:
        t, *signals = even(r.t, *r.q.T, *r.u.T)
        count = r.q.shape[1]
        window = min(map(window_of, signals[:count]))
        motions = [motion_of(t, q, window) for q in signals[:count]]
        own = [blocks_of(m) for m in motions]
        joints = [
            j
            for j, (m, b) in enumerate(zip(motions, own, strict=True))
            if in_motion(m)[rows_of(m)].sum() // b.rows >= self.stretches
        ]
        # the torque of a joint takes the accelerations of all that move
        blocks = max((own[j] for j in joints), default=own[0])
        shaken = np.array([m.shaken for m in motions])
        inertia = self._arm.inertia(np.median(r.q, axis=0))
        inverse = [
            InverseRecord.of(m, u, float(np.linalg.norm(row * shaken)) / own["gain"], blocks)
            for m, u, row, own in zip(
                motions, signals[count:], inertia, self._arm.joints.values(), strict=True
            )
        ]
        regressor = self._arm.regressor([x.motion for x in inverse])
        return _Moved(
            joints,
            [inverse[j] for j in joints],
            [np.ascontiguousarray(regressor[:, j]) for j in joints],
        )

    def candidates(self) -> tuple[Candidate, ...]:
        """Every part of every effect on each joint and body."""
        places = zip(self._arm.joints, self._arm.bodies, strict=True)
        out = []
        for number, (joint, body) in enumerate(places):
            if (scale := self._of_joint(number)) is None:
                continue
            for c in self._parts(scale):
                own = {"body": body} if issubclass(c.effect, BodyEffect) else {"joint": joint}
                ways = c.choices * len(self._arm.joints)
                out.append(replace(c, fixed={**c.fixed, **own}, choices=ways))
        return tuple(out)

    def turns(self, cause: Candidate) -> bool:
        return self._arm.turns.get(cause.fixed.get("joint", ""), False)

    def _of_joint(self, joint: int) -> RecordScale | None:
        """The orders of magnitude of a joint; None if it never moves."""
        pairs = [pair for of in self._moved for pair in zip(of.joints, of.inverse, strict=True)]
        own = [x for j, x in pairs if j == joint]
        if not own:
            return None
        gain = list(self._arm.joints.values())[joint]["gain"]
        motions = [x.motion for x in own]
        return self._scale(
            [m.x for m in motions],
            motions,
            force=largest([gain * x.input for x in own]),
            resists=True,
        )

    def _shown(self, of: Hypothesis) -> list[Array]:
        """(N,) input that the motion of each record takes."""
        p = self._arm.numbers()
        acting: list[Any] = [*self.believed, *of.effects()]
        for effect in acting:
            effect.apply_to_arm(p)
        inertial = np.concatenate([p.bodies[name] for name in self._arm.bodies])
        laws, out = list(p.laws.items()), []
        for moved in self._moved:
            for j, x, regressor in zip(*moved, strict=True):
                name, law = laws[j]
                rigid = regressor @ inertial + p.armature[name] * x.motion.a
                out.append(along(x.motion._replace(a=rigid), law) / law.numbers[GAIN])
        return out

    @property
    def _inverse(self) -> list[InverseRecord]:
        return [x for of in self._moved for x in of.inverse]

    def residuals(self, of: Hypothesis) -> list[Array]:
        pairs, late = zip(self._inverse, self._shown(of), strict=True), float(of.nuisances[0])
        return [*(x.left(shown, late) for x, shown in pairs), of.nuisances / self.prior_sigma()]

    def scored(self, of: Hypothesis) -> list[Array]:
        return self.residuals(of)[:-1]

    def states(self) -> list[States]:
        joints, turns = list(self._arm.joints.items()), self._arm.turns
        pairs = [
            (joints[j], x) for of in self._moved for j, x in zip(of.joints, of.inverse, strict=True)
        ]
        return [x.states(own["gain"], turns[name], name) for (name, own), x in pairs]

    def measured(self) -> list[Array]:
        return [x.averaged(x.input) for x in self._inverse]

    def predicted(self, of: Hypothesis) -> list[Array]:
        rows = zip(self.records, self._inverse, self._shown(of), strict=True)
        late = float(of.nuisances[0])
        return [np.interp(r.t + late, x.motion.t, shown) for r, x, shown in rows]

    def tells_nothing(self) -> str | None:
        return super().tells_nothing() if self._moved else "No joint moves."
