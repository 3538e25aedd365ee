"""The numerical model on a recorded force along one axis: :mod:`hiltestbed.replay.numerical_model`,
reduced to motion along z.

A force along z through both centres of mass causes no rotation. The step is the same, with a state
of four numbers instead of twenty-six, and a thousand rows take 0.1 ms; a drive logged at 1 kHz for
half a minute can be fitted in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.numerical_model.kernels import CHASER, TARGET
from hiltestbed.numerical_model.parameters import DAMPING, RATIO, STIFFNESS
from hiltestbed.numerical_model.resistance import AXIS, BETWEEN, BODY, resisting
from hiltestbed.replay.numerical_model import Departing

Z = 2


def replay_axis(
    model: Departing, force: Array, place: Array, speed: Array, run: np.ndarray, rows: Sequence[int]
) -> Array:
    """``(L, N)`` pz of numerical models that are driven along z by recorded forces ``(R, N)``; row
    k is commanded at t_k.

    Args:
        place, speed: ``(R,)`` pz [m] in row 0, and its rate at the start [m/s], with the target at
            rest.
        rows: number of valid rows of each run; later rows of a lane are meaningless.

    A row is delayed by the model's ``late`` ticks and the log's ``stamp``, interpolated linearly
    between ticks.
    """
    d = model.departures
    out = np.zeros((len(run), force.shape[1]))
    laws = d.appendage, d.force, d.explicit, d.late + d.stamp / model.tick
    scratch = np.zeros((*d.appendage.shape[1:3], 2)), np.zeros(force.shape[1] + 1)
    starts, masses = (np.asarray(place), np.asarray(speed)), (model.whole, model.rigid)
    lanes = np.asarray(run), np.asarray(rows)
    _replay_axis(force, lanes, starts, masses, laws, model.tick, scratch, out)
    return out


@njit(cache=True)
def _replay_axis(force, lanes, starts, masses, laws, h, scratch, out):
    """``lanes``: (L,) run and (R,) rows. ``starts``: (R,) each. ``laws``: (L, ...) appendages,
    resistances, whether the old twist moves the pose, and delay [ticks].
    """
    (run, rows), (place, speed), (whole, rigid), (swing, way) = lanes, starts, masses, scratch
    appendages, resistances, explicit, late = laws
    v, tau = np.empty(2), np.empty(2)
    for i in range(len(run)):
        r, n, at_start = run[i], rows[run[i]], speed[run[i]]
        f, law, part = force[r], resistances[i], appendages[i]
        mass, rigid_mass, old = whole[i], rigid[i], explicit[i]
        gain_c, gain_t = h / rigid_mass[CHASER], h / rigid_mass[TARGET]
        resists, swings = law.shape[0] > 0, part.shape[1] > 0
        v[CHASER], v[TARGET] = at_start, 0.0
        swing[:] = 0.0
        way[0] = 0.0
        for k in range(n):
            tau[CHASER], tau[TARGET] = -f[k], f[k]
            if resists:
                _resist(law, v, rigid_mass, h, tau)
            if swings:
                _swing(part, mass, rigid_mass, h, swing, tau)
            before = v[CHASER] - v[TARGET]
            v[CHASER] += gain_c * tau[CHASER]
            v[TARGET] += gain_t * tau[TARGET]
            way[k + 1] = way[k] + h * (before if old else v[CHASER] - v[TARGET])
        gone, shown = way[: n + 1], out[i]
        first = _at(gone, 1.0 - late[i], at_start * h)
        for k in range(n):
            shown[k] = place[r] + _at(gone, k + 1.0 - late[i], at_start * h) - first


@njit(cache=True, inline="always")
def _at(way, index, uniform):
    """``way`` interpolated between its rows; uniform motion before the first row, linear
    extrapolation after the last.
    """
    if index <= 0.0:
        return index * uniform
    low = min(int(index), len(way) - 2)
    return way[low] + (index - low) * (way[low + 1] - way[low])


@njit(cache=True)
def _resist(laws, v, mass, h, tau):
    for f in range(laws.shape[0]):
        if laws[f, BODY] == BETWEEN and laws[f, AXIS] == Z:
            gain = h * (1.0 / mass[CHASER] + 1.0 / mass[TARGET])
            free = (
                v[CHASER]
                - v[TARGET]
                + h * (tau[CHASER] / mass[CHASER] - tau[TARGET] / mass[TARGET])
            )
            given = resisting(laws, f, v[CHASER] - v[TARGET], free, gain)
            tau[CHASER] -= given
            tau[TARGET] += given
    for f in range(laws.shape[0]):
        if (laws[f, BODY] == CHASER or laws[f, BODY] == TARGET) and laws[f, AXIS] == Z:
            b = int(laws[f, BODY])
            gain = h / mass[b]
            tau[b] -= resisting(laws, f, v[b], v[b] + gain * tau[b], gain)


@njit(cache=True)
def _swing(appendage, whole, rigid, h, swing, tau):
    """The loads of the appendages on their bodies, as in
    :func:`hiltestbed.numerical_model.model.swing`; swing: (2, S, 2).
    """
    for b in range(2):
        for s in range(appendage.shape[1]):
            a = appendage[b, s]
            tau[b] += (
                a[RATIO] * whole[b] * (a[STIFFNESS] * swing[b, s, 0] + a[DAMPING] * swing[b, s, 1])
            )
        for s in range(appendage.shape[1]):
            a = appendage[b, s]
            if a[RATIO] > 0.0:
                swing[b, s, 1] -= h * (
                    a[STIFFNESS] * swing[b, s, 0] + a[DAMPING] * swing[b, s, 1] + tau[b] / rigid[b]
                )
                swing[b, s, 0] += h * swing[b, s, 1]
