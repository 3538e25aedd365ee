"""From the force and torque sensor's reading to the wrench that the active side exerts on the
passive one.
"""

from __future__ import annotations

from hiltestbed.compiled.jit import njit


@njit(cache=True)
def read_wrench(reading, tare, runs, wrench_sub, sub):
    """``wrench_sub[runs, sub] = tare - reading``, both ``(n, 6)``, for the ``runs`` (r,).

    MuJoCo's sensors give the wrench that the parent exerts on the child: a carried weight reads
    positive, a push of the active side negative (tests/sensor/test_force_sensor.py hangs a known
    weight on the sensor).
    """
    for i in runs:
        for j in range(6):
            wrench_sub[i, sub, j] = tare[i, j] - reading[i, j]


@njit(cache=True)
def read_history(history, tare, wrench_sub):
    """Fill ``wrench_sub[:, :-1]`` from the histories of the two sensors, the last m readings of
    each.

    A tick's m steps leave readings at t_k, t_k + dt, ..; the first is already in the wrench of the
    tick before. MuJoCo keeps one ring
    buffer per sensor: user value, cursor of the newest, m times, m values of 3.
    """
    m = wrench_sub.shape[1]
    size = 2 + 4 * m
    for i in range(history.shape[0]):
        for part in range(2):
            start = part * size
            newest = int(history[i, start + 1])
            for s in range(m - 1):
                slot = (newest - (m - 2 - s)) % m
                for j in range(3):
                    wrench_sub[i, s, 3 * part + j] = (
                        tare[i, 3 * part + j] - history[i, start + 2 + m + 3 * slot + j]
                    )
