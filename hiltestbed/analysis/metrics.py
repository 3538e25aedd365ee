"""Figures of a run: coefficient of restitution, energy, forces, tracking. Updated tick by tick.

They are running sums instead of a pass over the trace, so that a campaign needs no trace and the
safety limits can use the energy online.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, twist_between
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.scenario import Scenario
from hiltestbed.signals import RunTrace

# of the low-pass, after which the rebound speed is taken: exp(-5) = 0.7 % of the last force remains
SETTLE_TIME_CONSTANTS = 5.0
SETTLE_TICKS = 4  # additional ticks, for the sensor's interpolation and the lead's memory
# chosen: share of the largest force used in a contact, above which a compensation still acts after
# it
STILL_ACTING = 0.02
# chosen: times the largest force used before the contact, which is noise, that such a compensation
# also exceeds
ABOVE_NOISE = 2.0
# chosen: times the contact's duration, for which it is waited for; not at all for one that adds a
# force of its own
LONGEST_WAIT = 2.0
# chosen: share of the approach energy below which energy that a contact makes is not resolved; half
# of it is the share of the coefficient of restitution
RESOLVED = 0.01


@dataclass(frozen=True)
class ContactFigures:
    """The figures of one run.

    Attributes:
        cor: rebound over approach speed along z of the first contact; None if the ports did not
            touch, did not separate before the end,
            or still approach afterwards. cor_normal: the same along the impulse of that contact,
                whatever its direction, see
            :func:`along_impulse`; None if they did not touch, or did not separate before the end.
        energy_made: [J] kinetic energy of the relative motion that the first contact added, beyond
            what ticks resolve, see :func:`energy_made`; 0: none.
    """

    cor: float | None
    cor_normal: float | None
    approach_speed: float | None
    rebound_speed: float | None
    energy_generated: float
    peak_force: float
    contact_duration: float
    contacts: int
    first_contact: float | None
    impulse: float
    tracking_delay: float | None
    tracking_compliance: float | None
    tracking_error: float
    energy_made: float = 0.0


class Tally:
    """Running figures of ``n`` runs.

    Attributes:
        energy: ``(n,)`` [J] that the rig has created so far: the work on the physical side, at the
            rig's actual motion, minus the work of the numerical model, the integral of ``F . v_act
            - F_used . v_cmd``; moments are about A's origin, as is the twist.
            Positive: active.
        peak_force: ``(n,)`` [N] largest physical contact force so far.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n, first = len(scenarios), scenarios[0]
        self.tick = 1.0 / first.rate
        self._settle = np.array([settle_ticks(s) for s in scenarios], dtype=np.int64)
        self._wait = np.array(
            [0.0 if s.compensation.force.adds_force else LONGEST_WAIT for s in scenarios]
        )
        self.energy = np.zeros(n)
        self.peak_force = np.zeros(n)
        self.peak_error = np.zeros(n)
        self.impulse = np.zeros(n)
        self.contact_ticks = np.zeros(n, dtype=np.int64)
        self.contacts = np.zeros(n, dtype=np.int64)
        self.first_tick = np.full(n, -1, dtype=np.int64)
        self._last_tick = np.full(n, -1, dtype=np.int64)
        # twists of the numerical model before the first contact, and after it
        self._speeds = np.full((n, 2, 6), np.nan)
        # of the wrench that was used in the first contact, about A
        self._first_impulse = np.zeros((n, 6))
        self._peak_used = np.zeros((n, 2))  # [N] its largest force before that contact and since
        # of that wrench since the rebound speed was last taken
        self._later_impulse = np.zeros((n, 6))
        self._quiet = np.zeros(n, dtype=np.int64)  # successive ticks in which it no longer acts
        self._settled = np.zeros(n, dtype=bool)
        self._wrench = np.zeros((n, 6))
        self._pose = np.zeros((n, 7))
        self._twist = np.zeros((n, 6))
        self._started = np.zeros(n, dtype=bool)
        self._tracking = np.zeros((n, 5))  # vv, vF, FF, ev, eF along z, in contact
        self._update = Call(
            _update,
            ...,
            self.tick,
            *(GIVEN,) * 7,
            self._settle,
            self._wait,
            self.energy,
            self.peak_force,
            self.peak_error,
            self.impulse,
            self.contact_ticks,
            self.contacts,
            self.first_tick,
            self._last_tick,
            self._speeds,
            self._first_impulse,
            self._peak_used,
            self._later_impulse,
            self._quiet,
            self._settled,
            self._wrench,
            self._pose,
            self._twist,
            self._tracking,
        )

    def start(self, twist: Array) -> None:
        """The numerical model's twist ``(n, 6)`` before the first tick."""
        self._twist[:] = twist

    def taking(
        self,
        rig: tuple[Array, Array, Array, NDArray[np.bool_]],
        pose_before: Array,
        drive: tuple[Array, Array],
    ) -> Callable[[int], None]:
        """The update with tick k: a call with k, bound to arrays with fixed memory.

        Args:
            rig: physical wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)`` and contact ``(n,)``
                at t_k.
            pose_before: ``(n, 7)`` pose that had been commanded for t_k.
            drive: used wrench and new twist of the numerical model, ``(n, 6)`` each.
        """
        return self._update.on(*rig, pose_before, *drive)

    def parted(self, alive: NDArray[np.bool_]) -> bool:
        """Whether the rebound speed of every run in ``alive`` ``(n,)`` is known."""
        return bool(self.rebounded[alive].all())

    @property
    def rebounded(self) -> NDArray[np.bool_]:
        """``(n,)`` runs whose rebound speed is known, and changes no more."""
        return self._settled

    def first_contact(self, i: int) -> tuple[Array, Array, Array]:
        """Of run ``i``: impulse (6,) about A of the first contact; twists before, after; or NaN."""
        return self._first_impulse[i], self._speeds[i, 0], self._speeds[i, 1]

    def figures(self, i: int) -> ContactFigures:
        """The figures of run ``i``."""
        approach, rebound = (None if math.isnan(v) else float(v) for v in self._speeds[i, :, 2])
        delay, compliance = tracking_fit(self._tracking[i])
        return ContactFigures(
            cor=None
            if approach is None or rebound is None or approach <= 0.0 or rebound > 0.0
            else -rebound / approach,
            cor_normal=along_impulse(self._first_impulse[i], *self._speeds[i]),
            approach_speed=approach,
            rebound_speed=rebound,
            energy_generated=float(self.energy[i]),
            peak_force=float(self.peak_force[i]),
            contact_duration=float(self.contact_ticks[i] * self.tick),
            contacts=int(self.contacts[i]),
            first_contact=float(self.first_tick[i] * self.tick)
            if self.first_tick[i] >= 0
            else None,
            impulse=float(self.impulse[i]),
            tracking_delay=delay,
            tracking_compliance=compliance,
            tracking_error=float(self.peak_error[i]),
            energy_made=energy_made(
                self._first_impulse[i], *self._speeds[i], push=self.tick * float(self.peak_force[i])
            ),
        )


def along_impulse(impulse: Array, before: Array, after: Array) -> float | None:
    """Coefficient of restitution along the impulse J of a contact: ``-(J . v_after)/(J .
    v_before)``; None without a contact.

    A contact that is short compared with the motion changes the kinetic energy of the numerical
    model by ``J . (v_before + v_after)/2``: energy is lost if the coefficient is below 1 and gained
    if it is above, whatever the slope of the surface and the lever arm. In a head-on contact it is
    the coefficient along z. W. J. Stronge, "Impact Mechanics", Cambridge 2000, ch. 3 and 4.

    Args:
        impulse: ``(6,)`` of the used wrench, about A's origin. before, after: ``(6,)`` twists of A
            relative to P; NaN for none.
    """
    approach, rebound = float(impulse @ before), float(impulse @ after)
    return -rebound / approach if approach > 0.0 >= rebound else None


def energy_made(impulse: Array, before: Array, after: Array, push: float) -> float:
    """Kinetic energy [J] that a contact adds to the relative motion, ``-J . (v_before +
    v_after)/2`` as in :func:`along_impulse`; 0 if it adds no more than can be resolved.

    A spring k appears and vanishes somewhere within a tick h: up to k (v h)^2/2 of energy is made
    or lost, which is (h F)^2/(2 mu) at the peak force F and the reduced mass mu along J. The
    approach energy is resolved to :data:`RESOLVED`.

    Args:
        impulse, before, after: see :func:`along_impulse`. push: [N s] h F.
    """
    approach, rebound = float(impulse @ before), float(impulse @ after)
    if not approach > 0.0 >= rebound:
        return 0.0
    made, change = -0.5 * (approach + rebound), approach - rebound
    square = float(impulse[:3] @ impulse[:3])
    mass = square / change
    resolved = max(0.5 * push * push / mass, RESOLVED * 0.5 * mass * approach * approach / square)
    return made if made > resolved else 0.0


def settle_ticks(scenario: Scenario) -> int:
    """Ticks from the separation of the ports until the end of the force has reached the numerical
    model.

    While a compensation still acts after that (:data:`STILL_ACTING`), the rebound speed is taken
    again.
    """
    sensor, force = scenario.sensor, scenario.compensation.force
    lowpass = (
        0.0 if sensor.lowpass is None else SETTLE_TIME_CONSTANTS / (2.0 * math.pi * sensor.lowpass)
    )
    lag = SETTLE_TIME_CONSTANTS * force.memory()
    return SETTLE_TICKS + math.ceil((sensor.delay + lowpass + lag) * scenario.rate)


def tracking_fit(sums: Array) -> tuple[float | None, float | None]:
    """Delay [s] and compliance [m/N] of the platform in contact, from ``z_cmd - z_act = delay v +
    compliance F``.

    Args:
        sums: ``(5,)`` sums over the contact of v v, v F, F F, e v, e F along z.
    """
    vv, vf, ff, ev, ef = sums
    det = vv * ff - vf * vf
    if det <= 1e-9 * vv * ff or vv == 0.0:
        return None, None
    return float((ff * ev - vf * ef) / det), float((vv * ef - vf * ev) / det)


def energy_generated(trace: RunTrace, scenario: Scenario) -> Array:
    """``(ticks,)`` [J] made by the rig so far: the integral of F v_act - F_used v_cmd, as
    :class:`Tally` adds it up.
    """
    tick = 1.0 / scenario.rate
    slope = np.zeros_like(trace["twist_act"])
    _slopes(trace["pose_act"], tick, slope)
    # for t_k, when the wrench is used
    commanded = np.concatenate([approach_state(scenario)[None, :7], trace["pose_cmd"][:-1]])
    force, used = (
        _about_A(trace["wrench_true"], trace["pose_act"]),
        _about_A(trace["wrench_comp"], commanded),
    )
    rate = trace["twist_cmd"]
    before = np.concatenate([approach_state(scenario)[None, 7:], rate[:-1]])
    taken = np.zeros(len(trace.t))
    taken[1:] = np.einsum("ij,ij->i", force[1:] + force[:-1], slope[1:])
    return 0.5 * tick * np.cumsum(taken - np.einsum("ij,ij->i", used, rate + before))


def _about_A(wrench: Array, pose: Array) -> Array:
    """``(ticks, 6)`` wrenches at P's origin, with their moments about A's origin, so that they are
    conjugate to A's twist.
    """
    return np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(pose[:, :3], wrench[:, :3])])


@njit(cache=True)
def _slopes(pose, tick, out):
    for k in range(1, pose.shape[0]):
        twist_between(pose[k - 1], pose[k], tick, out[k])


@njit(cache=True)
def about_A(wrench, pose, out):
    """``out``: the wrench (6,) at P's origin with its moment about A's: with a twist of A its power
    is F . v_A + M_A . omega.
    """
    x, y, z = pose[0], pose[1], pose[2]
    out[0], out[1], out[2] = wrench[0], wrench[1], wrench[2]
    out[3] = wrench[3] - (y * wrench[2] - z * wrench[1])
    out[4] = wrench[4] - (z * wrench[0] - x * wrench[2])
    out[5] = wrench[5] - (x * wrench[1] - y * wrench[0])


@njit(cache=True)
def _update(
    k,
    h,
    wrench,
    pose,
    twist,
    contact,
    pose_before,
    used,
    twist_cmd,
    settle,
    wait,
    energy,
    peak_force,
    peak_error,
    impulse,
    contact_ticks,
    contacts,
    first_tick,
    last_tick,
    speeds,
    first_impulse,
    peak_used,
    later_impulse,
    quiet,
    settled,
    wrench_before,
    rig_pose_before,
    twist_before,
    tracking,
):
    slope, felt, paid = np.zeros(6), np.empty(6), np.empty(6)
    for i in range(wrench.shape[0]):
        about_A(wrench[i], pose[i], felt)
        about_A(used[i], pose_before[i], paid)
        square = 0.0
        error = 0.0
        if k > 0:
            twist_between(rig_pose_before[i], pose[i], h, slope)
        for j in range(7):
            rig_pose_before[i, j] = pose[i, j]
        for j in range(6):
            energy[i] += 0.5 * h * (felt[j] + wrench_before[i, j]) * slope[j]
            energy[i] -= 0.5 * h * paid[j] * (twist_cmd[i, j] + twist_before[i, j])
            if j < 3:
                square += wrench[i, j] ** 2
                error += (pose_before[i, j] - pose[i, j]) ** 2
        peak_force[i] = max(peak_force[i], math.sqrt(square))
        peak_error[i] = max(peak_error[i], math.sqrt(error))
        impulse[i] += h * wrench[i, 2]
        if contact[i]:
            if last_tick[i] < 0:
                first_tick[i] = k
                for j in range(6):
                    speeds[i, 0, j] = twist_before[i, j]
            if last_tick[i] < 0 or k - last_tick[i] > settle[i]:
                contacts[i] += 1
                settled[i] = contacts[i] > 1
            last_tick[i] = k
            contact_ticks[i] += 1
            e, v, f = pose_before[i, 2] - pose[i, 2], twist[i, 2], wrench[i, 2]
            tracking[i, 0] += v * v
            tracking[i, 1] += v * f
            tracking[i, 2] += f * f
            tracking[i, 3] += e * v
            tracking[i, 4] += e * f
        force = math.sqrt(paid[0] ** 2 + paid[1] ** 2 + paid[2] ** 2)
        if contacts[i] == 0:
            peak_used[i, 0] = max(peak_used[i, 0], force)
        if contacts[i] == 1 and not settled[i]:
            over = k - last_tick[i] - settle[i]
            peak_used[i, 1] = max(peak_used[i, 1], force)
            acts = wait[i] > 0.0 and force > max(
                STILL_ACTING * peak_used[i, 1], ABOVE_NOISE * peak_used[i, 0]
            )
            quiet[i] = 0 if acts else quiet[i] + 1
            if over == 0 or (over > 0 and acts):
                for j in range(6):
                    speeds[i, 1, j] = twist_cmd[i, j]
                    first_impulse[i, j] += later_impulse[i, j]
                    later_impulse[i, j] = 0.0
            for j in range(6):
                later_impulse[i, j] += h * paid[j]
            settled[i] = over >= 0 and (quiet[i] > settle[i] or over >= wait[i] * contact_ticks[i])
        for j in range(6):
            wrench_before[i, j] = felt[j]
            twist_before[i, j] = twist_cmd[i, j]
