"""From the force and torque sensor's reading to the wrench that the active side exerts on the passive one."""

from __future__ import annotations

from numba import njit


@njit(cache=True)
def read_wrench(reading, tare, wrench_sub, sub):
    """``wrench_sub[:, sub] = tare - reading``, both ``(n, 6)``.

    MuJoCo's sensors give what the parent exerts on the child: weight carried reads positive, a push of the active side reads
    negative (tests/rig/test_sensor_sign.py hangs a known weight on it).
    """
    for i in range(reading.shape[0]):
        for j in range(6):
            wrench_sub[i, sub, j] = tare[i, j] - reading[i, j]
