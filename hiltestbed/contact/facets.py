"""MuJoCo's inputs for one contact: stiffness and damping in ``solref``, and the poses of a facet
and its ball.
"""

from __future__ import annotations

import math

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.composition import FACET
from hiltestbed.contact.parameters import DAMPING, STIFFNESS
from hiltestbed.contact.solref import NO_DAMPING
from hiltestbed.frames import quat_mul, rotate, rotate_back

# columns of a contact's results; the first two are penetration and rate
POINT, NORM, SLIP, PUSH, DRAG, MET = 2, 5, 8, 11, 12, 13
NO_FRICTION = -1e-9  # [1/s^2] tangential stiffness over A: practically none


@njit(cache=True)
def spring(linear, row, push, drag, show, g, solref, friction):
    """MuJoCo's solref for a contact that it sees ``show`` [m] deep, for a normal force ``push`` [N]
    and friction ``drag`` [N s/m].
    """
    if linear:
        solref[0] = -row[STIFFNESS] * g
        solref[1] = min(-row[DAMPING] * g, NO_DAMPING)
    else:
        solref[0] = min(-push * g / show, NO_DAMPING)
        solref[1] = NO_DAMPING
    friction[0] = NO_FRICTION * g
    friction[1] = min(-drag * g, NO_DAMPING)


@njit(cache=True)
def outwards(point, normal, slip, place, side, out):
    """Point, normal and slip in W, with the normal as the direction of the force on the passive
    side, the slip that of the active side.
    """
    rotate(place[3:7], point, out[POINT : POINT + 3])
    rotate(place[3:7], normal, out[NORM : NORM + 3])
    rotate(place[3:7], slip, out[SLIP : SLIP + 3])
    for j in range(3):
        out[POINT + j] += place[j]
        out[NORM + j] *= side
        out[SLIP + j] *= side


@njit(cache=True)
def pose_facet(
    point, normal, show, radius, frames, carry, surface, round_, ids, geom_pos, geom_quat, work
):
    """Place the facet in the tangent plane and the ball ``show`` [m] into it, so that MuJoCo's
    contact is at ``point`` (3,).
    """
    at, turn = work[0], work[1]
    for j in range(3):
        at[j] = point[j] + normal[j] * (FACET[2] - 0.5 * show)
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
    out = geom_quat[ids[1]]
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
