"""Reference point and reference attitude of a latch, for which the spring and damper of a captured
pair decouple into six axes.

A latch exerts K (r - r_hold) + C r' at the point r where it holds the active side, and a torque K
radius^2 times the rotation since it closed (:mod:`hiltestbed.contact.latches`). About P's origin
the same force has a lever arm, which moves with r; at another point of the active side, rotation
also causes translation. So pose and wrench are referred to the latch's point before anything is
fitted:

- translation and velocity are those of the latch's site on the active side, rotation is measured
  from the attitude in which it closed;
- the torque is about the position of the site when the force acted.

A site on a moving part of the active side is taken at its position when the latch closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import ACTIVE, PASSIVE
from hiltestbed.frames import Array, quat_mul_conj, rotate, rotate_back, rotation_vector

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

# reference point of a latch: A itself, a site of the active side, or one of the passive side
AT_A, ON_ACTIVE, ON_PASSIVE = 0, 1, 2
NONE = -1
UNTURNED = np.array([0.0, 0.0, 0.0, 1.0])


class _Latches(NamedTuple):
    # the closure that holds, by the number of phases that have begun; NONE: a latch without phases
    acts: NDArray[np.int64]
    places: Array  # (K, 2, 7) of the sites of each closure
    kinds: NDArray[np.int64]  # (K,)
    together: NDArray[np.bool_]  # (K,)


class _Now(NamedTuple):
    held: NDArray[np.bool_]  # (n,) whether captured, and phases begun, at the tick before
    before: NDArray[np.int64]
    lever: Array  # these as in HeldPlace
    origin: Array
    reference: Array
    since: NDArray[np.int64]
    changes: NDArray[np.int64]


class HeldPlace:
    """The latches' reference points of ``n`` runs.

    Attributes:
        lever: ``(n, 3)`` [m] from A to the reference point, in A; 0 before capture. origin: ``(n,
            3)`` [m] in P, from which its translation is measured; reference: ``(n, 4)`` attitude of
            A in P from which rotation is measured. since: ``(n,)`` ticks since the mechanism
        last changed (a capture, a release, a phase). changes: ``(n,)`` number of such changes.
        latches, now: for :func:`update_held`.
    """

    def __init__(self, mechanisms: Sequence[Mechanism]) -> None:
        """``mechanisms``: of each run; all have the same sites and phases."""
        from hiltestbed.contact.sides import sides_of  # not MuJoCo with the settings

        n = len(mechanisms)
        sites = sides_of(mechanisms[0]).sites
        closing, acts, places, kinds, together = NONE, [], [], [], []
        for phase in mechanisms[0].phases():
            if phase.close is not None:
                closing += 1
                (a, at_a) = sites["A", phase.close.active]
                (p, at_p) = sites["P", phase.close.passive]
                places.append((at_a, at_p))
                kinds.append(ON_ACTIVE if a == ACTIVE else ON_PASSIVE if p == PASSIVE else AT_A)
                together.append(phase.close.hold == "together" and kinds[-1] != AT_A)
            acts.append(closing)
        self.latches = _Latches(
            np.array([NONE, *acts], dtype=np.int64),
            np.array(places).reshape(len(kinds), 2, 7),
            np.array(kinds, dtype=np.int64),
            np.array(together, dtype=bool),
        )
        self.lever = np.zeros((n, 3))
        self.origin = np.zeros((n, 3))
        self.reference = np.tile(UNTURNED, (n, 1))
        self.since, self.changes = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.now = _Now(
            np.array([m.captured for m in mechanisms]),
            np.zeros(n, dtype=np.int64),
            self.lever,
            self.origin,
            self.reference,
            self.since,
            self.changes,
        )


@njit(cache=True)
def update_held(pose, captured, steps, latches, now):
    """A tick at pose ``(n, 7)``, for whether it is captured and phases begun ``(n,)``."""
    acts, places, kinds, together = latches
    held, before, lever, origin, reference, since, changes = now
    v, q = np.empty(3), np.empty(4)
    for i in range(pose.shape[0]):
        since[i] += 1
        if captured[i] == held[i] and steps[i] == before[i]:
            continue
        held[i], before[i] = captured[i], steps[i]
        since[i] = 0
        changes[i] += 1
        if not captured[i]:
            for j in range(3):
                lever[i, j] = origin[i, j] = 0.0
            for j in range(4):
                reference[i, j] = UNTURNED[j]
            continue
        for j in range(4):
            reference[i, j] = pose[i, 3 + j]
        for j in range(3):
            lever[i, j] = 0.0
            origin[i, j] = pose[i, j]
        c = acts[min(steps[i], acts.shape[0] - 1)]
        if c == NONE:
            continue
        if kinds[c] == ON_ACTIVE:
            for j in range(3):
                lever[i, j] = places[c, 0, j]
        elif kinds[c] == ON_PASSIVE:
            for j in range(3):
                v[j] = places[c, 1, j] - pose[i, j]
            rotate_back(pose[i, 3:7], v, lever[i])
        rotate(pose[i, 3:7], lever[i], v)
        for j in range(3):
            origin[i, j] += v[j]
        if together[c]:
            quat_mul_conj(places[c, 1, 3:7], places[c, 0, 3:7], q)
            for j in range(4):
                reference[i, j] = q[j]


@njit(cache=True)
def referred(pose, twist, lever, reference, position, velocity):
    """Position with rotation vector from ``reference``, and velocity (6,), of the point, in P."""
    v, q = np.empty(3), np.empty(4)
    rotate(pose[3:7], lever, v)
    for j in range(3):
        position[j] = pose[j] + v[j]
        velocity[3 + j] = twist[3 + j]
    velocity[0] = twist[0] + twist[4] * v[2] - twist[5] * v[1]
    velocity[1] = twist[1] + twist[5] * v[0] - twist[3] * v[2]
    velocity[2] = twist[2] + twist[3] * v[1] - twist[4] * v[0]
    quat_mul_conj(pose[3:7], reference, q)
    rotation_vector(q, position[3:6])
