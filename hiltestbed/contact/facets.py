"""The contacts of `n` runs at an instant: their forces, and MuJoCo's inputs that make it exert them
(:mod:`hiltestbed.contact.engagement`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import njit
from hiltestbed.contact import composition as co
from hiltestbed.contact.geometry import RADIUS, ROUND_FRAME, ROW, SIDE, SURFACE_FRAME, VALUES, unmet
from hiltestbed.contact.law import touches
from hiltestbed.contact.parameters import DAMPING, OFFSET, STIFFNESS
from hiltestbed.contact.wrench import add_at, add_contact, law_of, meet_all
from hiltestbed.frames import Array, quat_mul, rotate, rotate_back

# columns of a contact's results; the first two are penetration and rate
POINT, NORM, SLIP, PUSH, DRAG, MET = 2, 5, 8, 11, 12, 13
NO_FRICTION = -1e-9  # [1/s^2] tangential stiffness over A: practically none
LEAST = 1e-9  # [m] penetration that MuJoCo is given if a law pushes without penetration


class Laws(NamedTuple):
    """The laws of T contacts; ``dt``, ``least_creep``: see ``Engagement``."""

    dt: float
    least_creep: float
    parameters: Array  # (n, T + 1, PARAMETERS)
    linear: NDArray[np.bool_]  # (n, T)
    live: NDArray[np.bool_]  # (n, T) whether it is not switched off
    gain: Array  # (n, T) g [1/kg]


class CarriedFrames(NamedTuple):
    """The frames to which geoms and sites are fixed: A, S and moving parts."""

    frames: Array  # (n, F, 7) poses in W
    motions: Array  # (n, F, 6) twists in W
    carry: Array  # (n, F, 7) pose of each in the MuJoCo body that carries it


class Inputs(NamedTuple):
    """MuJoCo's arrays of the same names, per run."""

    ids: NDArray[np.int64]  # (T, 3) numbers of each contact's pair, facet and ball; -1: none
    geom_pos: Array  # (n, ngeom, 3) [m] in the geom's body
    geom_quat: Array  # (n, ngeom, 4), w first
    solref: Array  # pair_solref (n, npair, 2)
    friction: Array  # pair_solreffriction (n, npair, 2)


class FacetState(NamedTuple):
    """State and results, as in :class:`~hiltestbed.contact.engagement.Engagement`."""

    state: Array  # (n, T + 1, STATES) of the laws
    met: Array
    wrench: Array
    pull: Array
    touching: NDArray[np.bool_]


@njit(cache=True)
def spring(linear, row, push, drag, show, g, solref, friction):
    """MuJoCo's solref of a contact seen ``show`` [m] deep for ``push`` [N] and ``drag`` [N s/m]."""
    if linear:
        solref[0] = -row[STIFFNESS] * g
        solref[1] = min(-row[DAMPING] * g, co.NO_DAMPING)
    else:
        solref[0] = min(-push * g / show, co.NO_DAMPING)
        solref[1] = co.NO_DAMPING
    friction[0] = NO_FRICTION * g
    friction[1] = min(-drag * g, co.NO_DAMPING)


@njit(cache=True)
def pose_facet(i, c, show, geometry, bodies, inputs, point, normal, work):
    """Place facet ``c`` in the tangent plane, its ball ``show`` [m] in it, at ``point`` (3,)."""
    index, values = geometry
    surface, round_ = index[c * ROW + SURFACE_FRAME], index[c * ROW + ROUND_FRAME]
    radius, ids = values[c * VALUES + RADIUS], inputs.ids[c]
    frames, carry, geom_pos = bodies.frames[i], bodies.carry[i], inputs.geom_pos[i]
    at, turn = work[0], work[1]
    for j in range(3):
        at[j] = point[j] + normal[j] * (co.FACET[2] - 0.5 * show)
    rotate(carry[surface, 3:7], at[0:3], at[0:3])
    for j in range(3):
        geom_pos[ids[1], j] = at[j] + carry[surface, j]
    # turns z to -normal
    turn[0], turn[1], turn[2], turn[3] = normal[1], -normal[0], 0.0, 1.0 - normal[2]
    length = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[3] ** 2)
    if length > 1e-9:
        turn[0], turn[1], turn[3] = turn[0] / length, turn[1] / length, turn[3] / length
    else:
        turn[0], turn[1], turn[3] = 1.0, 0.0, 0.0
    whole = work[2]
    quat_mul(carry[surface, 3:7], turn[0:4], whole[0:4])
    out = inputs.geom_quat[i, ids[1]]
    out[0], out[1], out[2], out[3] = whole[3], whole[0], whole[1], whole[2]
    for j in range(3):
        at[j] = point[j] - normal[j] * (radius - 0.5 * show)
    rotate(frames[surface, 3:7], at[0:3], at[0:3])
    for j in range(3):
        at[j] += frames[surface, j] - frames[round_, j]
    rotate_back(frames[round_, 3:7], at[0:3], at[0:3])
    rotate(carry[round_, 3:7], at[0:3], at[0:3])
    for j in range(3):
        geom_pos[ids[2], j] = at[j] + carry[round_, j]


@njit(cache=True)
def touch_facets(geometry, laws, bodies, inputs, felt):
    """Facets, springs and friction of each run from the poses of its sides."""
    index = geometry[0]
    dt, least_creep, p, linear, live, gain = laws
    frames, motions, ids, geom_pos = bodies.frames, bodies.motions, inputs.ids, inputs.geom_pos
    solref, friction = inputs.solref, inputs.friction
    state, met, wrench, pull, touching = felt
    count = index[-1]
    meeting, work, f = unmet(count), np.empty((9, 7)), np.empty(6)
    depth, rate, point, normal, slip = meeting
    for i in range(met.shape[0]):
        wrench[i], pull[i] = 0.0, 0.0
        touching[i] = False
        meet_all(geometry, p[i], frames[i], motions[i], work, meeting)
        for c in range(count):
            row, out, at, n, v = p[i, c], met[i, c], point[c], normal[c], slip[c]
            out[0], out[1], out[PUSH], out[DRAG] = depth[c], rate[c], 0.0, 0.0
            if not live[i, c]:
                geom_pos[i, ids[c, 1], 2] = co.AWAY
                continue
            push, drag = law_of(dt, least_creep, row, state[i, c], depth[c], rate[c], v)
            if depth[c] <= row[OFFSET] and push == 0.0:
                geom_pos[i, ids[c, 1], 2] = co.AWAY
                continue
            touching[i] |= touches(depth[c], push, row)
            out[PUSH], out[DRAG] = push, drag
            place, side = frames[i, index[c * ROW + SURFACE_FRAME]], index[c * ROW + SIDE]
            rotate(place[3:7], at, out[POINT : POINT + 3])
            rotate(place[3:7], n, out[NORM : NORM + 3])
            rotate(place[3:7], v, out[SLIP : SLIP + 3])
            for j in range(3):
                out[POINT + j] += place[j]
                out[NORM + j] *= side
                out[SLIP + j] *= side
            add_contact(push, drag, at, n, v, place, side, f, wrench[i])
            if push < 0.0:
                add_contact(push, drag, at, n, v, place, side, f, pull[i])
                geom_pos[i, ids[c, 1], 2] = co.AWAY
                continue
            show, k = max(depth[c] - row[OFFSET], LEAST), ids[c, 0]
            pose_facet(i, c, show, geometry, bodies, inputs, at, n, work)
            spring(linear[i, c], row, push, drag, show, gain[i, c], solref[i, k], friction[i, k])


@njit(cache=True)
def touch_natively(facets, reading, laws, inputs, felt):
    """Springs and friction of native pairs, from their sensors' readings of the deepest points."""
    dt, least_creep, p, linear, live, gain = laws
    ids, solref, friction = inputs.ids, inputs.solref, inputs.friction
    state, met, wrench, pull, touching = felt
    f, slip = np.empty(6), np.zeros(3)
    for i in range(met.shape[0]):
        for native in range(ids.shape[0] - facets):
            c, said = facets + native, reading[i, native * co.READ : (native + 1) * co.READ]
            row, out, points = p[i, c], met[i, c], said[co.FOUND]
            out[:] = 0.0
            out[0] = -said[co.DIST] if points > 0.0 else -1.0
            if points == 0.0:
                if not linear[i, c]:
                    law_of(dt, least_creep, row, state[i, c], -1.0, 0.0, slip)
                continue
            depth, out[1] = out[0], -said[co.LINVEL]
            slip[0], slip[1] = said[co.LINVEL + 1], said[co.LINVEL + 2]
            push, drag = 0.0, 0.0
            if live[i, c]:
                push, drag = law_of(dt, least_creep, row, state[i, c], depth, out[1], slip)
            show, k = max(depth + max(-row[OFFSET], 0.0), LEAST), ids[c, 0]
            plain, g = linear[i, c] and live[i, c], gain[i, c] / points
            spring(plain, row, max(push, 0.0), drag, show, g, solref[i, k], friction[i, k])
            if push == 0.0 and depth <= 0.0:
                continue
            touching[i] |= live[i, c] and touches(depth, push, row)
            out[PUSH], out[DRAG] = push, drag
            for j in range(3):
                out[POINT + j], out[NORM + j] = said[co.POS + j], said[co.NORMAL + j]
                f[j] = push * said[co.NORMAL + j]
            add_at(out[POINT : POINT + 3], f, wrench[i])
            if push < 0.0:
                add_at(out[POINT : POINT + 3], f, pull[i])
