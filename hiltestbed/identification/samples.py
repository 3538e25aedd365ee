"""Contact samples: what was felt, beside where the rig was when it was felt.

What is measured at t_k left the contact at t_k - delay, so x and v are taken then, from the history of the pose, and pass the sensor's
own filters: nothing is differentiated and no lead is needed. A sample counts when the axial force is above the noise for a while
before and after it: at touch and at separation the force is clipped, and the filters remember it.

On a plane the six components of the relative pose are the axes of spring and damper. In a mechanism that is latched those of the latched
place are (:mod:`hiltestbed.identification.held`), and nothing counts that was felt before the latch closed. Anywhere else a contact has one
axis only, its normal, which moves with the point that touches: penetration, its rate and normal then follow from the mechanism's geometry
and the pose, and the force is that along the normal, where friction has no part.

A delay that is not known can be estimated from the instant of touch: the pose crosses the nominal touch point at t0, the force rises at
t0 + delay. That is all that tells it: while the contact lasts, c takes up any error of the delay (``c - k d`` fits as well as ``c``, to
first order in w d). It needs a touch point that is known to ``v0 d`` (30 um for a millisecond at 0.03 m/s), and a force that rises by
more than its noise within a tick; the standard deviation that is reported grows where it does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.bound import GIVEN, Call, Joined
from hiltestbed.contact.geometry import ROW, SIDE
from hiltestbed.contact.parameters import LEVER, PARAMETERS
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.wrench import meet_all
from hiltestbed.frames import Array
from hiltestbed.identification.held import HeldPlace, add_moment, referred
from hiltestbed.jit import njit

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

GATE_SIGMA = 5.0  # contact is where the force exceeds this many standard deviations of its noise
GATE_PEAK = 0.02  # and this part of the peak so far
NORMAL = 6  # column of the contact's normal, after the six axes
FILTER_MEMORY = 3.0  # time constants of the low-pass that are left out at both ends of a contact: exp(-3) = 5 % is left
UNKNOWN = 1e15  # [N, N m] 1 sigma of a force that has passed a lead, or stands beside a pose of another time
SPARE = 0.03  # [s] that an estimated delay may be longer than the nominal one


class ContactSamples:
    """Regressors and force on six axes for ``n`` runs.

    Axes are the components of the relative pose (position of A, rotation vector, both in P) against those of the wrench; of a captured
    pair those of the latched place, with the torque about it.

    Attributes:
        ready: ``(n,)`` whether ``sample`` counts; ready_normal: ``(n,)`` whether ``whole[:, NORMAL]`` does.
        noise: ``(n, 2)`` 1 sigma of force [N] and torque [N m]. place: ``(n, 3)`` [m] in P where the latch acts.
        sample: ``(n, 6, 4)`` x, v and 1 as felt, and the force. whole: ``(n, 7, 4)`` the same with the contact's normal.
        delay: ``(n,)`` [s] of the force, as known or as estimated.
        captured: ``(n,)`` bool, whether the latches hold, which a rig's switches tell: then every sample counts, pulled or pushed.
        steps: ``(n,)`` how many phases of capture have begun. held: where it is latched, and how often it has become another mechanism.
    """

    def __init__(self, scenarios: Sequence[Scenario], aligned: bool = True, estimate: bool = False, lead: Sequence[float] = ()) -> None:
        """Samples of `n` runs.

        Args:
            aligned: False takes pose and force of the same tick, as if there were neither delay nor filter.
            lead: of each run, the lag [s] of the phase lead that the force has passed, which :meth:`take` is given beside the reading.
        """
        n, first = len(scenarios), scenarios[0]
        h = 1.0 / first.rate
        self.tick = h
        self.delay = np.array([s.sensor.delay if aligned else 0.0 for s in scenarios])
        self.threshold = np.array([GATE_SIGMA * s.sensor.noise for s in scenarios])
        known = aligned and not lead
        self.noise = np.array([[s.sensor.noise, s.sensor.torque_noise] if known else [UNKNOWN] * 2 for s in scenarios])
        lowpass = np.array([0.0 if s.sensor.lowpass is None else 1.0 / (2.0 * math.pi * s.sensor.lowpass) for s in scenarios]) * aligned
        highpass = np.array([math.inf if s.sensor.time_constant is None or not aligned else s.sensor.time_constant for s in scenarios])
        self._smooth = np.array([1.0 if T == 0.0 else 1.0 - math.exp(-h / T) for T in lowpass])
        self._leak = np.exp(-h / highpass)
        self._held_rate = first.rig.platform.prescribed
        self._estimate = estimate
        spent = FILTER_MEMORY * lowpass
        if lead:  # what is led to t_k has touched from t_k on; that it still does is known a delay later
            spent = np.array([s.sensor.delay for s in scenarios]) + FILTER_MEMORY * np.array(lead)
        self._margin = 1 + np.ceil(spent / h - 1e-9).astype(np.int64)
        self._longest = self.delay.max() + SPARE * estimate
        length = 2 + int(math.ceil(self._longest / h))
        self._x = np.zeros((n, length, 7))
        self._v = np.zeros((n, length, 7))
        self._normal = np.zeros((n, length, 3))
        sides = sides_of(first.mechanism)
        self._known = sides.rigid and len(sides.facets) > 0  # what moves on a side is not seen in the pose
        self._geometry = sides.geometry
        self._flat = np.array([s.mechanism.flat or s.mechanism.captured for s in scenarios])
        self._clock = np.zeros(1, dtype=np.int64)  # ticks seen
        self._filter = np.zeros((n, 7, 3, 2))  # low-passed value; its predecessor's high-passed value
        self._pending = np.zeros((n, int(self._margin.max()) + 1, 7, 4))
        self._gated = np.zeros(n, dtype=np.int64)
        self._peak = np.zeros(n)
        self._felt = np.zeros(n, dtype=np.int64)  # ticks since the capture
        self.held = HeldPlace(scenarios)
        self.captured = np.zeros(n, dtype=bool)
        self._onset = np.full((n, 3), np.nan)  # force and speed at the first contact sample, delay as found then
        self.place = np.zeros((n, 3))
        self.ready, self.ready_normal = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self.whole = np.zeros((n, 7, 4))
        self.sample = self.whole[:, :NORMAL]
        self.steps = np.zeros(n, dtype=np.int64)
        self._taken = Joined(self._taking)
        self._remembered = Call(_remember, ..., GIVEN, GIVEN, self.held.lever, self.held.reference, self._x, self._v)
        self._met = Call(_meet, ..., *self._geometry, GIVEN, GIVEN, self._x, self._v, self._normal)
        self._gate = Call(_gate, GIVEN, self.threshold, GIVEN, self.delay, h, self._felt, self._peak, self._gated)
        self._sampled = Call(
            _sample_and_choose, ..., h, self._gated, self.delay, self._pending, GIVEN, self._x, self._v, self._normal, self._held_rate,
            GIVEN, self.held.origin, self.place, self._smooth, self._leak, self._filter, self._margin, self._felt, self.held.changes,
            self.held.since, self._flat, self._known, self.ready, self.ready_normal, self.whole,
        )  # fmt: skip

    def take(self, wrench: Array, pose: Array, twist: Array, led: Array | None = None) -> None:
        """Take in what was measured at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``; ``led``: the wrench to be explained."""
        k = int(self._clock[0])
        if led is None and not self._estimate:
            self._taken.on(wrench, pose, twist, self.captured, self.steps)(k)
            self._clock[0] = k + 1
            return
        self.held.update(pose, self.captured, self.steps)
        self._remembered.on(pose, twist)(k)
        if self._known:
            self._met.on(pose, twist)(k)
        self._gate.on(wrench, self.captured)()
        if self._estimate:
            _find_delay(k, self.tick, self._longest, wrench, self._x, self._v, self._gated, self.delay, self._onset)
        self._sampled.on(wrench if led is None else led, self.captured)(k)
        self._clock[0] = k + 1

    def _taking(
        self, wrench: Array, pose: Array, twist: Array, captured: NDArray[np.bool_], steps: NDArray[np.int64]
    ) -> list[Callable[..., None]]:
        """The parts of :meth:`take` where the delay is known and nothing led."""
        met = [self._met.on(pose, twist)] if self._known else []
        held, gate = self.held.updating(pose, captured, steps), self._gate.on(wrench, captured)
        return [held, self._remembered.on(pose, twist), *met, gate, self._sampled.on(wrench, captured)]

    def delay_sd(self, stiffness: Array) -> Array:
        """``(n,)`` [s] standard deviation of the estimated delay, given the axial stiffness ``(n,)``; NaN before a touch.

        The touch lies within the tick before the first force; or, where the force rises so slowly that an earlier tick may have been
        below the noise, within the time that the force takes to come out of it.
        """
        force, speed = self._onset[:, 0], self._onset[:, 1]
        hidden = force - stiffness * speed * self.tick <= self.threshold
        slow = np.where(hidden, self.threshold / (stiffness * speed), 0.0)
        return np.hypot(self.tick / math.sqrt(12.0), slow)


@njit(cache=True)
def _remember(k, pose, twist, lever, reference, x, v):
    slot = k % x.shape[1]
    for i in range(pose.shape[0]):
        referred(pose[i], twist[i], lever[i], reference[i], x[i, slot], v[i, slot])
        if k == 0:  # before the start the approach is uniform; no force is felt from then
            for s in range(x.shape[1]):
                x[i, s] = x[i, slot]
                v[i, s] = v[i, slot]


@njit(cache=True)
def _meet(k, index, values, pose, twist, x, v, normal):
    """Penetration, its rate and normal of the deepest contact at t_k, after the six axes."""
    slot, length, count = k % x.shape[1], x.shape[1], index[-1]
    frames, motions, work, p = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7)), np.ones((count, PARAMETERS))
    p[:, LEVER] = 0.5
    frames[1, 6] = 1.0
    depth, rate = np.empty(count), np.empty(count)
    point, across, slip = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    for i in range(pose.shape[0]):
        frames[0], motions[0] = pose[i], twist[i]
        meet_all(index, values, p, frames, motions, work, depth, rate, point, across, slip)
        c = int(np.argmax(depth))
        x[i, slot, NORMAL], v[i, slot, NORMAL] = depth[c], rate[c]
        side = index[c * ROW + SIDE]
        for j in range(3):
            normal[i, slot, j] = side * across[c, j]
        if k == 0:
            for s in range(length):
                x[i, s, NORMAL], v[i, s, NORMAL], normal[i, s] = x[i, slot, NORMAL], v[i, slot, NORMAL], normal[i, slot]


@njit(cache=True)
def _sample_and_choose(
    k, h, gated, delay, pending, wrench, x, v, normal, held_rate, captured, origin, place, smooth, leak, memory, margin, held, changes,
    since, flat, known, ready, ready_normal, sample,
):  # fmt: skip
    """The sample of now into ``pending``, and of those there the one that counts."""
    _sample(k, wrench, x, v, normal, delay, h, held_rate, gated, captured, origin, place, smooth, leak, memory, pending)
    _choose(k, h, delay, margin, gated, held, changes, since, flat, known, pending, ready, ready_normal, sample)


@njit(cache=True)
def _sample(k, wrench, x, v, normal, delay, h, held_rate, gated, captured, origin, place, smooth, leak, memory, pending):
    """x, v and 1 at t_k - delay while in contact, else 0, through the sensor's filters, beside the force read at t_k."""
    length = x.shape[1]
    slot = k % pending.shape[1]
    f = np.empty(6)
    for i in range(wrench.shape[0]):
        ticks = delay[i] / h
        whole = int(math.floor(ticks))
        part = ticks - whole
        late = (k - whole) % length  # the tick that ends at or after t_k - delay
        early = (k - whole - 1) % length
        for j in range(7):
            position = (1.0 - part) * x[i, late, j] + part * x[i, early, j]
            rate = v[i, late, j] if held_rate else (1.0 - part) * v[i, late, j] + part * v[i, early, j]
            if captured[i] and j < 3:
                place[i, j] = position
                position -= origin[i, j]
            for c in range(3):
                u = 0.0 if gated[i] == 0 else position if c == 0 else rate if c == 1 else 1.0
                before = memory[i, j, c, 0]
                memory[i, j, c, 0] += (u - before) * smooth[i]
                if leak[i] < 1.0:
                    memory[i, j, c, 1] = leak[i] * (memory[i, j, c, 1] + memory[i, j, c, 0] - before)
                    pending[i, slot, j, c] = memory[i, j, c, 1]
                else:
                    pending[i, slot, j, c] = memory[i, j, c, 0]
        pending[i, slot, NORMAL, 3] = 0.0
        f[:] = wrench[i]
        if captured[i]:
            add_moment(-1.0, place[i], f)
        for j in range(6):
            pending[i, slot, j, 3] = f[j]
            if j < 3:
                pending[i, slot, NORMAL, 3] += wrench[i, j] * ((1.0 - part) * normal[i, late, j] + part * normal[i, early, j])


@njit(cache=True)
def _choose(k, h, delay, margin, gated, held, changes, since, flat, known, pending, ready, ready_normal, sample):
    """The sample of ``margin`` (n,) ticks ago, which counts when the contact has lasted as long before it and since.

    On the six axes it must have lasted as the mechanism that it is now, and it was felt a delay ago.
    """
    for i in range(gated.shape[0]):
        lasted = gated[i] >= 2 * margin[i] + 1
        same = changes[i] == 0 or since[i] >= 2 * margin[i] + 1 + math.ceil(delay[i] / h)
        ready[i] = lasted and same and (flat[i] or held[i] > 0)
        ready_normal[i] = lasted and known and held[i] == 0
        sample[i] = pending[i, (k - margin[i]) % pending.shape[1]]


@njit(cache=True)
def _gate(wrench, threshold, captured, delay, tick, held, peak, gated):
    for i in range(wrench.shape[0]):
        force = wrench[i, 2]  # pushing is positive; what a high-pass leaves after the contact is negative
        peak[i] = max(peak[i], force)
        held[i] = held[i] + 1 if captured[i] else 0
        felt = held[i] > delay[i] / tick + 1.0  # what is read now left the mechanism after the latches had closed
        gated[i] = gated[i] + 1 if felt or (force > threshold[i] and force > GATE_PEAK * peak[i]) else 0


@njit(cache=True)
def _find_delay(k, h, longest, wrench, x, v, gated, delay, onset):
    """At the first contact sample of a run: by how much the pose had passed the nominal touch point when this force was felt."""
    length = x.shape[1]
    for i in range(wrench.shape[0]):
        if gated[i] != 1 or not np.isnan(onset[i, 0]):
            continue
        for back in range(length - 1):  # the tick within which the pose crossed the touch point
            late, early = x[i, (k - back) % length, 2], x[i, (k - back - 1) % length, 2]
            if early < 0.0 <= late:
                crossed = back + late / (late - early)
                delay[i] = min(max((crossed - 0.5) * h, 0.0), longest)
                onset[i, 0] = wrench[i, 2]
                onset[i, 1] = v[i, (k - back) % length, 2]
                onset[i, 2] = delay[i]
                break
