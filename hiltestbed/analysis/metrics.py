"""Figures of a run: coefficient of restitution, energy, forces, tracking. Updated tick by tick.

They are running sums instead of a pass over the trace, so that a campaign needs no trace and the
safety limits can use the energy online.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compensation.settings import ForceMethod
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, twist_between
from hiltestbed.sensor.settings import Sensor
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
            touch, did not separate before the end, or still approach afterwards.
        cor_normal: the same along the impulse of that contact, whatever its direction, see
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


class Sums(NamedTuple):
    """Running sums of ``n`` runs, which :func:`take_figures` adds to; a tick is -1 before one."""

    tick: float  # [s]
    settle: NDArray[np.int64]  # (n,) see :func:`settle_ticks`
    wait: Array  # (n,) times the contact's duration that is waited for what still acts
    energy: Array  # (n,) [J]
    peak_force: Array  # (n,) [N]
    peak_error: Array  # (n,) [m]
    impulse: Array  # (n,) [N s]
    contact_ticks: NDArray[np.int64]  # (n,) of all contacts
    contacts: NDArray[np.int64]  # (n,)
    first_tick: NDArray[np.int64]  # (n,)
    last_tick: NDArray[np.int64]  # (n,)
    speeds: Array  # (n, 2, 6) twists of the numerical model before the first contact, and after it
    first_impulse: Array  # (n, 6) of the wrench used in the first contact, about A
    peak_used: Array  # (n, 2) [N] largest force used before that contact and since
    later_impulse: Array  # (n, 6) of the wrench since the rebound speed was last taken
    quiet: NDArray[np.int64]  # (n,) successive ticks in which the compensation no longer acts
    settled: NDArray[np.bool_]  # (n,) whether the rebound speed is known
    wrench_before: Array  # (n, 6) of the tick before
    pose_before: Array  # (n, 7)
    twist_before: Array  # (n, 6)
    tracking: Array  # (n, 5) sums of v v, v F, F F, e v, e F along z, in contact


class Tally:
    """Running figures of ``n`` runs.

    Attributes:
        energy: ``(n,)`` [J] that the rig has created so far: the work on the physical side, at the
            rig's actual motion, minus the work of the numerical model, the integral of ``F . v_act
            - F_used . v_cmd``; moments are about A's origin, as is the twist. Positive: active.
        peak_force: ``(n,)`` [N] largest physical contact force so far.
        impulse: ``(n,)`` [N s] of the physical contact force along z so far.
        contacts, first_tick: ``(n,)`` contacts so far, and tick of the first; -1: none.
        sums: for :func:`take_figures`.
    """

    def __init__(
        self, rate: float, sensors: Sequence[Sensor], forces: Sequence[ForceMethod]
    ) -> None:
        """``rate``: [Hz]. sensors, forces: nominal sensor and compensation of each run."""
        n, pairs = len(sensors), zip(sensors, forces, strict=True)
        settle = [settle_ticks(sensor, force, rate) for sensor, force in pairs]
        sums = Sums(
            tick=1.0 / rate,
            settle=np.array(settle, dtype=np.int64),
            wait=np.array([0.0 if f.adds_force else LONGEST_WAIT for f in forces]),
            energy=np.zeros(n),
            peak_force=np.zeros(n),
            peak_error=np.zeros(n),
            impulse=np.zeros(n),
            contact_ticks=np.zeros(n, dtype=np.int64),
            contacts=np.zeros(n, dtype=np.int64),
            first_tick=np.full(n, -1, dtype=np.int64),
            last_tick=np.full(n, -1, dtype=np.int64),
            speeds=np.full((n, 2, 6), np.nan),
            first_impulse=np.zeros((n, 6)),
            peak_used=np.zeros((n, 2)),
            later_impulse=np.zeros((n, 6)),
            quiet=np.zeros(n, dtype=np.int64),
            settled=np.zeros(n, dtype=bool),
            wrench_before=np.zeros((n, 6)),
            pose_before=np.zeros((n, 7)),
            twist_before=np.zeros((n, 6)),
            tracking=np.zeros((n, 5)),
        )
        self.sums = sums
        self.energy, self.peak_force, self.impulse = sums.energy, sums.peak_force, sums.impulse
        self.contacts, self.first_tick = sums.contacts, sums.first_tick

    def start(self, twist: Array) -> None:
        """The numerical model's twist ``(n, 6)`` before the first tick."""
        self.sums.twist_before[:] = twist

    def parted(self, alive: NDArray[np.bool_]) -> bool:
        """Whether the rebound speed of every run in ``alive`` ``(n,)`` is known."""
        return bool(self.rebounded[alive].all())

    @property
    def rebounded(self) -> NDArray[np.bool_]:
        """``(n,)`` runs whose rebound speed is known, and changes no more."""
        return self.sums.settled

    def first_contact(self, i: int) -> tuple[Array, Array, Array]:
        """Of run ``i``: impulse (6,) about A of the first contact; twists before, after; or NaN."""
        return self.sums.first_impulse[i], *self.sums.speeds[i]

    def figures(self, i: int) -> ContactFigures:
        """The figures of run ``i``."""
        sums = self.sums
        tick, first, peak = sums.tick, int(sums.first_tick[i]), float(sums.peak_force[i])
        approach, rebound = (None if math.isnan(v) else float(v) for v in sums.speeds[i, :, 2])
        delay, compliance = tracking_fit(sums.tracking[i])
        cor = None
        if approach is not None and rebound is not None and approach > 0.0 >= rebound:
            cor = -rebound / approach
        before, after = sums.speeds[i]
        return ContactFigures(
            cor=cor,
            cor_normal=along_impulse(sums.first_impulse[i], before, after),
            approach_speed=approach,
            rebound_speed=rebound,
            energy_generated=float(sums.energy[i]),
            peak_force=peak,
            contact_duration=float(sums.contact_ticks[i] * tick),
            contacts=int(sums.contacts[i]),
            first_contact=first * tick if first >= 0 else None,
            impulse=float(sums.impulse[i]),
            tracking_delay=delay,
            tracking_compliance=compliance,
            tracking_error=float(sums.peak_error[i]),
            energy_made=energy_made(sums.first_impulse[i], before, after, push=tick * peak),
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


def settle_ticks(sensor: Sensor, force: ForceMethod, rate: float) -> int:
    """Ticks at a ``rate`` [Hz] from the separation of the ports until the end of the force has
    reached the numerical model.

    While a compensation still acts after that (:data:`STILL_ACTING`), the rebound speed is taken
    again.
    """
    lowpass = (
        0.0 if sensor.lowpass is None else SETTLE_TIME_CONSTANTS / (2.0 * math.pi * sensor.lowpass)
    )
    lag = SETTLE_TIME_CONSTANTS * force.memory()
    return SETTLE_TICKS + math.ceil((sensor.delay + lowpass + lag) * rate)


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


def energy_generated(trace: RunTrace, start: Array, tick: float) -> Array:
    """``(ticks,)`` [J] made by the rig so far: the integral of F v_act - F_used v_cmd, as
    :class:`Tally` adds it up.

    Args:
        start: ``(13,)`` pose and twist of A in P before the first tick. tick: [s].
    """
    # for t_k, when the wrench is used
    commanded = np.concatenate([start[None, :7], trace["pose_cmd"][:-1]])
    rate, made = trace["twist_cmd"], np.zeros(len(trace.t))
    rates = rate + np.concatenate([start[None, 7:], rate[:-1]])
    acts = trace["wrench_true"], trace["pose_act"]
    _made(tick, *acts, trace["wrench_comp"], commanded, rates, made)
    return np.cumsum(made)


@njit(cache=True)
def _made(h, wrench, pose, used, pose_before, rates, out):
    slope, felt, paid, earlier = np.zeros(6), np.empty(6), np.empty(6), np.zeros(6)
    for k in range(len(out)):
        if k > 0:
            twist_between(pose[k - 1], pose[k], h, slope)
        about_A(wrench[k], pose[k], felt)
        about_A(used[k], pose_before[k], paid)
        for j in range(6):
            out[k] += 0.5 * h * ((felt[j] + earlier[j]) * slope[j] - paid[j] * rates[k, j])
            earlier[j] = felt[j]


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
def take_figures(k, wrench, pose, twist, contact, pose_before, used, twist_cmd, sums):
    h = sums.tick
    slope, felt, paid = np.zeros(6), np.empty(6), np.empty(6)
    for i in range(wrench.shape[0]):
        about_A(wrench[i], pose[i], felt)
        about_A(used[i], pose_before[i], paid)
        square = 0.0
        error = 0.0
        if k > 0:
            twist_between(sums.pose_before[i], pose[i], h, slope)
        for j in range(7):
            sums.pose_before[i, j] = pose[i, j]
        for j in range(6):
            sums.energy[i] += 0.5 * h * (felt[j] + sums.wrench_before[i, j]) * slope[j]
            sums.energy[i] -= 0.5 * h * paid[j] * (twist_cmd[i, j] + sums.twist_before[i, j])
            if j < 3:
                square += wrench[i, j] ** 2
                error += (pose_before[i, j] - pose[i, j]) ** 2
        sums.peak_force[i] = max(sums.peak_force[i], math.sqrt(square))
        sums.peak_error[i] = max(sums.peak_error[i], math.sqrt(error))
        sums.impulse[i] += h * wrench[i, 2]
        if contact[i]:
            if sums.last_tick[i] < 0:
                sums.first_tick[i] = k
                for j in range(6):
                    sums.speeds[i, 0, j] = sums.twist_before[i, j]
            if sums.last_tick[i] < 0 or k - sums.last_tick[i] > sums.settle[i]:
                sums.contacts[i] += 1
                sums.settled[i] = sums.contacts[i] > 1
            sums.last_tick[i] = k
            sums.contact_ticks[i] += 1
            e, v, f = pose_before[i, 2] - pose[i, 2], twist[i, 2], wrench[i, 2]
            sums.tracking[i, 0] += v * v
            sums.tracking[i, 1] += v * f
            sums.tracking[i, 2] += f * f
            sums.tracking[i, 3] += e * v
            sums.tracking[i, 4] += e * f
        force = math.sqrt(paid[0] ** 2 + paid[1] ** 2 + paid[2] ** 2)
        if sums.contacts[i] == 0:
            sums.peak_used[i, 0] = max(sums.peak_used[i, 0], force)
        if sums.contacts[i] == 1 and not sums.settled[i]:
            over = k - sums.last_tick[i] - sums.settle[i]
            sums.peak_used[i, 1] = max(sums.peak_used[i, 1], force)
            acts = sums.wait[i] > 0.0 and force > max(
                STILL_ACTING * sums.peak_used[i, 1], ABOVE_NOISE * sums.peak_used[i, 0]
            )
            sums.quiet[i] = 0 if acts else sums.quiet[i] + 1
            if over == 0 or (over > 0 and acts):
                for j in range(6):
                    sums.speeds[i, 1, j] = twist_cmd[i, j]
                    sums.first_impulse[i, j] += sums.later_impulse[i, j]
                    sums.later_impulse[i, j] = 0.0
            for j in range(6):
                sums.later_impulse[i, j] += h * paid[j]
            sums.settled[i] = over >= 0 and (
                sums.quiet[i] > sums.settle[i] or over >= sums.wait[i] * sums.contact_ticks[i]
            )
        for j in range(6):
            sums.wrench_before[i, j] = felt[j]
            sums.twist_before[i, j] = twist_cmd[i, j]
