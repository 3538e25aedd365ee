"""Contact samples: the measured force, aligned with the rig's pose at the time the force acted.

The force measured at t_k acted at t_k - delay, so x and v are taken at that time, from the history
of the pose, and pass a model of the sensor's filters: nothing is differentiated and no lead is
needed. A sample is used if the axial force is above the noise for some time before and after it: at
touch and at separation the force is clipped, and the filters have a memory of that.

On a plane the spring and damper act along the six components of the relative pose. In a captured
mechanism they act along those of the latch's reference point
(:mod:`hiltestbed.identification.held`), and only forces that acted after the latch closed are used.
Otherwise a contact has a single axis, its normal, which moves with the contact point: penetration,
its rate and the normal then follow from the mechanism's geometry and the pose, and the force is the
component along the normal, which contains no friction.

An unknown delay can be estimated from the instant of touch: the pose crosses the nominal touch
point at t0, the force rises at t0 + delay. Nothing else determines it: during the contact, c
absorbs any error of the delay (``c - k d`` fits as well as ``c``, to first order in w d). The
estimate needs a touch point that is known to ``v0 d`` (30 um for a millisecond at 0.03 m/s), and a
force that rises by more than its noise within a tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import ROW, SIDE, unmet
from hiltestbed.contact.parameters import LEVER, PARAMETERS
from hiltestbed.contact.wrench import meet_all
from hiltestbed.frames import Array, add_moment
from hiltestbed.identification.held import HeldPlace, referred, update_held
from hiltestbed.sensor.chain import FILTERED, filtered, filters_of, high_pass, low_pass
from hiltestbed.signals import AXES

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism
    from hiltestbed.scenario.like import ScenarioLike
    from hiltestbed.sensor.settings import Sensor

# a sample is in contact if the force exceeds this many standard deviations of its noise
GATE_SIGMA = 5.0
GATE_PEAK = 0.02  # and this fraction of the peak so far
NORMAL = len(AXES)  # column of the contact normal, after the six axes
# time constants of the low-pass that are skipped at both ends of a contact: exp(-3) = 5 % remains
FILTER_MEMORY = 3.0
# [N, N m] 1 sigma of a force that has passed a lead, or is paired with a pose of another time
UNKNOWN = 1e15
SPARE = 0.03  # [s] by which an estimated delay may exceed the nominal one


class SampleParameters(NamedTuple):
    """What the samples of ``n`` runs depend on.

    Attributes:
        rate: of the loop [Hz]. sensors: nominal ones. mechanisms: of the same structure.
        held_rate: whether the rig's velocity is constant over a tick.
    """

    rate: float
    sensors: Sequence[Sensor]
    mechanisms: Sequence[Mechanism]
    held_rate: bool

    @classmethod
    def of(cls, scenarios: Sequence[ScenarioLike]) -> Self:
        """Those of ``scenarios``."""
        sensors, mechanisms = [s.sensor for s in scenarios], [s.mechanism for s in scenarios]
        return cls(scenarios[0].rate, sensors, mechanisms, scenarios[0].rig.platform.prescribed)


class _Given(NamedTuple):
    """The numbers of the runs."""

    tick: float  # [s]
    threshold: Array  # (n,) [N] of the axial force
    smooth: Array  # (n, 2) weights per tick of the sensor's low-pass
    leak: Array  # (n, 2) factors per tick of its high-pass
    margin: NDArray[np.int64]  # (n,) ticks that are skipped at both ends of a contact
    flat: NDArray[np.bool_]  # (n,) whether the contact acts along the six axes
    held_rate: bool  # whether the rate is constant over a tick
    known: bool  # whether the contact follows from the pose


class _Past(NamedTuple):
    """What the samples remember."""

    x: Array  # (n, L, 7) of six axes and the normal, tick k at slot k modulo L
    v: Array
    normal: Array  # (n, L, 3)
    filter: Array  # (n, 7, 3, FILTERED)
    pending: Array  # (n, margin, 7, 4) samples of the last ticks
    gated: NDArray[np.int64]  # (n,) ticks in contact
    peak: Array  # (n,) [N]
    felt: NDArray[np.int64]  # (n,) ticks since the capture


class Samples(NamedTuple):
    """The sample that is to be used: attributes of :class:`ContactSamples`."""

    ready: NDArray[np.bool_]
    ready_normal: NDArray[np.bool_]
    place: Array
    whole: Array


class ContactSamples:
    """Regressors and force on six axes for ``n`` runs.

    Axes are the components of the relative pose (position of A, rotation vector, both in P) against
    those of the wrench; of a captured pair those of the latch's reference point, with the torque
    about it.

    Attributes:
        ready: ``(n,)`` whether ``sample`` is to be used; ready_normal: ``(n,)`` whether ``whole[:,
            NORMAL]`` is.
        noise: ``(n, 2)`` 1 sigma of force [N] and torque [N m]. place: ``(n, 3)`` [m] in P of the
            latch's reference point.
        sample: ``(n, 6, 4)`` x, v and 1 when the force acted, and the force. whole: ``(n, 7, 4)``
            the same, plus the contact normal.
        delay: ``(n,)`` [s] of the force, known or estimated.
        captured: ``(n,)`` bool, from the rig's switches: after capture every sample is used,
            whether it pulls or pushes.
        at_once: ``(n,)`` largest number of surfaces penetrated at the same tick; 0 if the pose does
            not show it.
        captures: whether the mechanism has latches. steps: ``(n,)`` number of phases of capture
            begun. held: the latch's reference point, and the changes of the mechanism.
    """

    def __init__(
        self,
        parameters: SampleParameters,
        aligned: bool = True,
        estimate: bool = False,
        lead: Sequence[float] = (),
    ) -> None:
        """Samples of `n` runs.

        Args:
            aligned: False pairs pose and force of the same tick, as if there were neither delay nor
                filter.
            lead: of each run, the lag [s] of the phase lead that the force passes; :meth:`take`
                then needs ``led``.
        """
        from hiltestbed.contact.sides import sides_of  # not MuJoCo with the settings

        rate, sensors, mechanisms, held_rate = parameters
        n, first = len(sensors), mechanisms[0]
        self.tick = h = 1.0 / rate
        self.delay = np.array([s.delay if aligned else 0.0 for s in sensors])
        self.threshold = np.array([GATE_SIGMA * s.noise for s in sensors])
        known = aligned and not lead
        self.noise = np.array(
            [[s.noise, s.torque_noise] if known else [UNKNOWN] * 2 for s in sensors]
        )
        lowpass, highpass = filters_of(sensors) if aligned else (np.zeros(n), np.full(n, np.inf))
        spent = FILTER_MEMORY * lowpass
        # the led force is that at t_k; whether the contact still lasts is known only a delay later
        if lead:
            spent = np.array([s.delay for s in sensors]) + FILTER_MEMORY * np.array(lead)
        margin = 1 + np.ceil(spent / h - 1e-9).astype(np.int64)
        longest = float(self.delay.max() + SPARE * estimate)
        length = 2 + int(math.ceil(longest / h))
        sides = sides_of(first)
        given = _Given(
            h,
            self.threshold,
            low_pass(lowpass, h),
            high_pass(highpass, h),
            margin,
            np.array([m.flat or m.captured for m in mechanisms]),
            held_rate,
            # the pose does not show moving parts of a side
            sides.rigid and len(sides.facets) > 0,
        )
        # on a plane nothing is estimated along the normal
        self._known = given.known and not given.flat[0]
        self._clock = np.zeros(1, dtype=np.int64)  # ticks seen
        self._past = past = _Past(
            np.zeros((n, length, 7)),
            np.zeros((n, length, 7)),
            np.zeros((n, length, 3)),
            np.zeros((n, 7, 3, FILTERED)),
            np.zeros((n, int(margin.max()) + 1, 7, 4)),
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
            np.zeros(n, dtype=np.int64),
        )
        self.held = held = HeldPlace(mechanisms)
        self.captures = first.captures
        self.captured, self.steps = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.int64)
        self._touched = np.zeros(n, dtype=bool)  # whether there was a contact sample
        self.found = Samples(
            np.zeros(n, dtype=bool), np.zeros(n, dtype=bool), np.zeros((n, 3)), np.zeros((n, 7, 4))
        )
        self.ready, self.ready_normal, self.place, self.whole = self.found
        self.sample = self.whole[:, :NORMAL]
        self.at_once = np.zeros(n, dtype=np.int64)
        self._met = Call(_meet, ..., sides.geometry, GIVEN, GIVEN, past, self.at_once)
        onset = (longest, self._touched) if estimate else None
        latches = held.latches if self.captures else None
        parts = (given, past, self.delay, latches, held.now, onset, self.found)
        self._taken = Call(_take, ..., (GIVEN,) * 6, *parts)

    def take(self, wrench: Array, pose: Array, twist: Array, led: Array | None = None) -> None:
        """Process wrench ``(n, 6)``, pose ``(n, 7)``, twist at t_k; ``led``: the wrench after a
        lead.
        """
        k = int(self._clock[0])
        force = wrench if led is None else led
        if self._known:
            self._met.on(pose, twist)(k)
        self._taken.on(wrench, force, pose, twist, self.captured, self.steps)(k)
        self._clock[0] = k + 1


@njit(cache=True)
def _meet(k, geometry, pose, twist, past, at_once):
    """Depth, rate and normal of the deepest contact at t_k, and how many there are at once."""
    index, x, v, normal = geometry.index, past.x, past.v, past.normal
    slot, length, count = k % x.shape[1], x.shape[1], index[-1]
    frames = np.zeros((2, 7))
    motions = np.zeros((2, 6))
    work = np.empty((9, 7))
    p = np.ones((count, PARAMETERS))
    for c in range(count):
        p[c, LEVER] = 0.5
    frames[1, 6] = 1.0
    met = unmet(count)
    depth, rate, across = met.depth, met.rate, met.normal
    for i in range(pose.shape[0]):
        for j in range(7):
            frames[0, j] = pose[i, j]
        for j in range(6):
            motions[0, j] = twist[i, j]
        meet_all(geometry, p, frames, motions, work, met)
        c, together = 0, 0
        for other in range(count):
            together += depth[other] > 0.0
            if depth[other] > depth[c]:
                c = other
        at_once[i] = max(at_once[i], together)
        x[i, slot, NORMAL], v[i, slot, NORMAL] = depth[c], rate[c]
        side = index[c * ROW + SIDE]
        for j in range(3):
            normal[i, slot, j] = side * across[c, j]
        if k == 0:
            for s in range(length):
                x[i, s, NORMAL], v[i, s, NORMAL] = x[i, slot, NORMAL], v[i, slot, NORMAL]
                for j in range(3):
                    normal[i, s, j] = normal[i, slot, j]


@njit(cache=True)
def _take(k, rig, given, past, delay, latches, held, onset, found):
    """Store the current sample in ``pending``, and select the pending sample to be used.
    ``latches``: None without any. ``onset``: None for a delay that is known.
    """
    wrench, force, pose, twist, captured, steps = rig
    x, v, gated, peak, felt = past.x, past.v, past.gated, past.peak, past.felt
    length, slot = x.shape[1], k % x.shape[1]
    if latches is not None:
        update_held(pose, captured, steps, latches, held)
    for i in range(pose.shape[0]):
        referred(pose[i], twist[i], held.lever[i], held.reference[i], x[i, slot], v[i, slot])
        if k == 0:  # the values before the start do not matter: no force acted then
            for s in range(length):
                for j in range(x.shape[2]):
                    x[i, s, j] = x[i, slot, j]
                    v[i, s, j] = v[i, slot, j]
        # pushing is positive; a high-pass leaves a negative undershoot after the contact
        axial = wrench[i, 2]
        peak[i] = max(peak[i], axial)
        felt[i] = felt[i] + 1 if captured[i] else 0
        # the force read now acted after the latches had closed
        acted = felt[i] > delay[i] / given.tick + 1.0
        pressed = axial > given.threshold[i] and axial > GATE_PEAK * peak[i]
        gated[i] = gated[i] + 1 if acted or pressed else 0
        if onset is None or gated[i] != 1 or onset[1][i]:
            continue
        # at a run's first contact sample: delay as the time since the nominal touch was crossed
        for back in range(length - 1):  # the tick within which the pose crossed the touch point
            late, early = x[i, (k - back) % length, 2], x[i, (k - back - 1) % length, 2]
            if early < 0.0 <= late:
                crossed = back + late / (late - early)
                delay[i] = min(max((crossed - 0.5) * given.tick, 0.0), onset[0])
                onset[1][i] = True
                break
    f, pending, now, place = np.empty(6), past.pending, k % past.pending.shape[1], found.place
    for i in range(pose.shape[0]):
        # x, v and 1 at t_k - delay in contact, else 0, through the sensor's filters; the force read
        ticks = delay[i] / given.tick
        whole = int(math.floor(ticks))
        part = ticks - whole
        late = (k - whole) % length  # the tick that ends at or after t_k - delay
        early = (k - whole - 1) % length
        for j in range(7):
            position = (1.0 - part) * x[i, late, j] + part * x[i, early, j]
            rate = (
                v[i, late, j]
                if given.held_rate
                else (1.0 - part) * v[i, late, j] + part * v[i, early, j]
            )
            if captured[i] and j < 3:
                place[i, j] = position
                position -= held.origin[i, j]
            for c in range(3):
                u = 0.0 if gated[i] == 0 else position if c == 0 else rate if c == 1 else 1.0
                memory = past.filter[i, j, c]
                pending[i, now, j, c] = filtered(u, given.smooth[i], given.leak[i], memory)
        pending[i, now, NORMAL, 3] = 0.0
        for j in range(6):
            f[j] = force[i, j]
        if captured[i]:
            add_moment(-1.0, place[i], f)
        for j in range(6):
            pending[i, now, j, 3] = f[j]
            if j < 3:
                pending[i, now, NORMAL, 3] += force[i, j] * (
                    (1.0 - part) * past.normal[i, late, j] + part * past.normal[i, early, j]
                )
        # The sample of ``margin`` ticks ago is used if the contact lasted for as many ticks before
        # and after it. On the six axes the mechanism must not have changed in that time, counted
        # from when the force acted.
        margin = given.margin[i]
        needed = 2 * margin + 1
        lasted = gated[i] >= needed
        same = held.changes[i] == 0 or (held.since[i] >= needed + math.ceil(delay[i] / given.tick))
        found.ready[i] = lasted and same and (given.flat[i] or felt[i] > 0)
        found.ready_normal[i] = lasted and given.known and felt[i] == 0
        then = (k - margin) % pending.shape[1]
        for j in range(7):
            for c in range(4):
                found.whole[i, j, c] = pending[i, then, j, c]
