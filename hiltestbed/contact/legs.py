"""The legs of an active ring, in the mechanism's MJCF and in the loop: at each physics step the
impedance of the present phase commands their forces, and what they do is recorded.

The ring, and the load cells in its legs, are parts of the docking mechanism and not of the
facility: what the legs measure is the force between ring and base, before any sensor of the rig.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.active_ring import (
    AXIAL,
    JOINTS,
    LAWS,
    LEGS,
    RING,
    STAGES,
    ActiveRing,
    AlignmentLaw,
    RetractionLaw,
)
from hiltestbed.contact.composition import ACTIVE
from hiltestbed.frames import Array

FAULTS = ("force", "stroke", "timeout")  # what the legs, or a phase, can fail in
GUIDED = LAWS.index("alignment")  # from here on the reference moves
FORCE, STROKE, TIMEOUT = range(len(FAULTS))
PEAK, SHORTEST, LONGEST, ABSORBED, USED = 0, 1, 2, 3, 4  # columns of what the legs have done
NOW, SINCE = 0, 1  # [s] of the run, and of the phase
DONE = len(LAWS)  # the stage after the last
# of an eigenvalue of a step: a double one is found no better
ROUNDING = math.sqrt(np.finfo(float).eps)


def stand_on_legs(side: mujoco.MjSpec, ring: ActiveRing) -> None:
    """Replace springs, dampers and actuator of the ring in ``side`` by tendons with actuators."""
    body, legs, rest = side.body(RING), ring.legs, ring.legs.lengths()
    for joint in body.joints:
        joint.stiffness[:], joint.damping[:] = 0.0, 0.0
    for actuator in list(side.actuators):
        side.delete(actuator)
    for name, base, end, length in zip(LEGS, *legs.joints, rest, strict=True):
        body.parent.add_site(name=f"{name}_base", pos=body.pos + base)
        body.add_site(name=f"{name}_ring", pos=end)
        span = [length - legs.stroke, length + legs.stroke]
        tendon = side.add_tendon(name=name, limited=True, range=span)
        tendon.wrap_site(f"{name}_base")
        tendon.wrap_site(f"{name}_ring")
        motor = side.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_TENDON, target=name)
        motor.set_to_motor()
        # exact, and with the command of the step itself: a lag far shorter than a step is none
        motor.dyntype, motor.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, True
        motor.dynprm[0] = 1.0 / (2.0 * math.pi * legs.bandwidth)


def divergent(ring: ActiveRing, inertia: Array, dt: float) -> Iterator[str]:
    """Laws whose eigenvalue in steps of ``dt`` [s], with ``inertia`` (6,) of the joints, is beyond
    1.
    """
    follows = _follows(ring, dt)
    for name, law in zip(LAWS, ring.laws, strict=True):
        numbers = zip(JOINTS, law.stiffness, law.damping, law.mass, inertia, strict=True)
        for joint, stiffness, damping, mass, own in numbers:
            # of deflection, rate, lagged rate and force
            added = mass * follows / dt
            force = follows * np.array([-stiffness, -damping - added, added, -1.0])
            force[3] += 1.0
            speed = np.array([0.0, 1.0, 0.0, 0.0]) + dt / own * force
            lagged = np.array([0.0, follows, 1.0 - follows, 0.0])
            moved = np.array([1.0, 0.0, 0.0, 0.0]) + dt * speed
            most = np.abs(np.linalg.eigvals(np.array([moved, speed, lagged, force]))).max()
            if most > 1.0 + ROUNDING:
                yield (
                    f"active_ring.{name}: {joint} diverges in steps of {1e3 * dt:.3g} ms; raise "
                    f"physics_rate, or lower the damping, the stiffness, the mass or the bandwidth"
                )


def _follows(ring: ActiveRing, dt: float) -> float:
    """Share of a change that the lag of the legs passes on in ``dt`` [s]."""
    return 1.0 - math.exp(-2.0 * math.pi * ring.legs.bandwidth * dt)


class _LegNumbers(NamedTuple):
    laws: Array  # (4, 3, 6) stiffness, damping, inertia of each phase
    guides: Array  # (4, 2, 6) goal and highest rate of the reference in each phase
    timeouts: Array  # (4,) [s]
    rest: Array  # (6,) lengths at rest [m]
    limits: Array  # force [N], stroke [m]
    steps: Array  # step [s], share that the lag passes on in it
    at: NDArray[np.int64]  # (5, 6) in qpos, qvel, ctrl, act; of the tendons
    entries: NDArray[np.int64]  # (6, 6) of leg and joint in a row of ten_J


class _LegState(NamedTuple):
    reference: Array  # (n, 6)
    trailing: Array  # (n, 6) rates of the joints, lagged
    length: Array  # (n, 6) of the legs at the step before [m]
    clock: Array  # (n, 2)
    stage: NDArray[np.int64]  # (n,)
    fresh: NDArray[np.bool_]  # (n,) whether a phase has just begun
    used: Array  # (n, USED)
    faults: Array  # (n, 3, 2) time [s] and phase of the first of each of FAULTS; -1: none


class RingLegs:
    """The legs of `n` rings.

    Attributes:
        joints: (6,) numbers of the ring's joints in MuJoCo's model. state: what they keep.
    """

    def __init__(self, batch: Batch, ring: ActiveRing, n: int, dt: float) -> None:
        """``dt`` [s] between two calls of :meth:`push`."""
        m = batch.model
        self.joints = np.array([m.joint(ACTIVE + name).id for name in JOINTS], dtype=np.int64)
        legs = [m.actuator(ACTIVE + name).id for name in LEGS]
        tendons = [m.tendon(ACTIVE + name).id for name in LEGS]
        dofs = m.jnt_dofadr[self.joints]
        rows = [range(a, a + c) for a, c in zip(m.ten_J_rowadr, m.ten_J_rownnz, strict=True)]
        entries = [
            [next(e for e in rows[t] if m.ten_J_colind[e] == d) for d in dofs] for t in tendons
        ]
        at = np.array([m.jnt_qposadr[self.joints], dofs, legs, m.actuator_actadr[legs], tendons])
        guides = np.zeros((len(LAWS), 2, 6))
        for guide, law in zip(guides, ring.laws, strict=True):
            if isinstance(law, AlignmentLaw):
                guide[1, :3], guide[1, 3:] = law.speed, math.radians(law.turn_rate_deg)
            if isinstance(law, RetractionLaw):
                guide[0, AXIAL] = -law.depth
        self._numbers = _LegNumbers(
            np.array([[law.stiffness, law.damping, law.mass] for law in ring.laws]),
            guides,
            np.array([getattr(law, "timeout", math.inf) for law in ring.laws]),
            ring.legs.lengths(),
            np.array([ring.legs.force, ring.legs.stroke]),
            np.array([dt, _follows(ring, dt)]),
            at.astype(np.int64),
            np.array(entries, dtype=np.int64),
        )
        self.state = _LegState(
            np.zeros((n, 6)),
            np.zeros((n, 6)),
            np.zeros((n, 6)),
            np.zeros((n, 2)),
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=bool),
            np.zeros((n, USED)),
            np.zeros((n, len(FAULTS), 2)),
        )
        fields = "qpos", "qvel", "act", "ten_length", "ten_J", "ctrl"
        arrays = tuple(batch.bind(field) for field in fields)
        self.push = bound(_push, self._numbers, self.state, *arrays)
        self.reset()

    def reset(self) -> None:
        """Return to the start: at rest, in the law of capture."""
        for array in self.state:
            array[:] = 0
        self.state.length[:] = self._numbers.rest
        self.state.clock[:] = -self._numbers.steps[0]  # the first call is at 0 s
        self.state.faults[:] = -1.0

    def begin(self, phase: str, which: NDArray[np.bool_]) -> None:
        """Take the law of a ``phase`` in the runs ``which`` (n,); one without a law changes
        nothing.
        """
        if phase in STAGES:
            self.state.stage[which], self.state.fresh[which] = STAGES.index(phase), True

    def law(self, i: int) -> tuple[Array, Array]:
        """Stiffness and damping (6,) of the ring's joints in run ``i`` at present."""
        stiffness, damping, _ = self._numbers.laws[min(self.state.stage[i], len(LAWS) - 1)]
        return stiffness, damping

    def summary(self, i: int) -> dict[str, Any]:
        """What the legs of run ``i`` did: force [N], travel [m], energy [J], faults with phase,
        time.
        """
        peak, shortest, longest, absorbed = map(float, self.state.used[i])
        found = zip(FAULTS, self.state.faults[i], strict=True)
        return {
            "leg_force": peak,
            "leg_travel": [shortest, longest],
            "energy_absorbed": absorbed,
            "faults": [
                {"what": what, "phase": LAWS[int(phase)], "at": float(time)}
                for what, (time, phase) in found
                if time >= 0.0
            ],
        }


@njit(cache=True)
def _push(numbers, state, qpos, qvel, act, lengths, jacobians, ctrl):
    """Command the forces of the legs, and record what they did in the step before."""
    dt, follows = numbers.steps
    jac, tau = np.empty((6, 6)), np.empty(6)
    for i in range(qpos.shape[0]):
        stage = state.stage[i]
        k = min(stage, DONE - 1)
        clock, used, length = state.clock[i], state.used[i], state.length[i]
        clock += dt
        reference, trailing = state.reference[i], state.trailing[i]
        begins, state.fresh[i] = state.fresh[i], False
        if begins:
            clock[SINCE] = 0.0
        stiffness, damping, inertia = numbers.laws[k]
        for j in range(6):
            q, v = qpos[i, numbers.at[0, j]], qvel[i, numbers.at[1, j]]
            if begins and stage == GUIDED:  # from where the ring is: no jump of its force
                reference[j] = q
            if stage < DONE:
                step = numbers.guides[k, 1, j] * dt
                way = numbers.guides[k, 0, j] - reference[j]
                reference[j] += min(max(way, -step), step)
            tau[j] = stiffness[j] * (reference[j] - q) - damping[j] * v
            # exact at constant acceleration
            tau[j] -= inertia[j] * follows / dt * (v - trailing[j])
            trailing[j] += follows * (v - trailing[j])
            for leg in range(6):
                jac[j, leg] = jacobians[i, numbers.entries[leg, j]]
        if not (np.isfinite(tau).all() and np.isfinite(jac).all()):
            continue  # diverged: the loop ends it
        force = np.linalg.solve(jac, tau)
        most = np.abs(force).max()
        if most > numbers.limits[0]:
            force *= numbers.limits[0] / most
            _note(state.faults[i, FORCE], clock[NOW], k)
        for leg in range(6):
            now, exerted = lengths[i, numbers.at[4, leg]], act[i, numbers.at[3, leg]]
            moved = now - numbers.rest[leg]
            used[PEAK] = max(used[PEAK], abs(exerted))
            used[SHORTEST] = min(used[SHORTEST], moved)
            used[LONGEST] = max(used[LONGEST], moved)
            used[ABSORBED] -= exerted * (now - length[leg])
            length[leg] = now
            ctrl[i, numbers.at[2, leg]] = force[leg]
            if abs(moved) >= numbers.limits[1]:
                _note(state.faults[i, STROKE], clock[NOW], k)
        if stage < DONE and clock[SINCE] > numbers.timeouts[k]:
            _note(state.faults[i, TIMEOUT], clock[NOW], k)


@njit(cache=True)
def _note(fault, time, phase):
    """Keep the time and the phase of the first ``fault`` (2,) of its kind."""
    if fault[0] < 0.0:
        fault[0], fault[1] = time, phase
