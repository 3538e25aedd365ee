"""Where the tip of the active mechanism stands against the passive surface, in closed form."""

from __future__ import annotations

from numba import njit

TIP_RADIUS = 0.02  # [m] of the ball whose foremost point is A's origin


@njit(cache=True)
def tip_against_plane(pose, twist, depth, rate):
    """Penetration ``depth`` (n,) [m] of the tip's ball into the plane z = 0 of P, and its ``rate`` (n,) [m/s].

    ``pose`` (n, 7) of A in P; ``twist`` (n, 6) of A relative to P. The ball's centre is TIP_RADIUS behind A's origin.
    """
    for i in range(pose.shape[0]):
        qx, qy, qz, qw = pose[i, 3], pose[i, 4], pose[i, 5], pose[i, 6]
        zx, zy = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx)
        zz = 1.0 - 2.0 * (qx * qx + qy * qy)
        depth[i] = pose[i, 2] + TIP_RADIUS * (1.0 - zz)
        rate[i] = twist[i, 2] - TIP_RADIUS * (twist[i, 3] * zy - twist[i, 4] * zx)
