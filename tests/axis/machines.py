"""Machines with known numbers, integrated in fine steps by plain NumPy: no code is shared with the
models that they test.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.axis.models import AxisRun

FINE = 20  # steps of the integration a row


def chirp(seconds: float, rate: float, low: float, high: float, size: float) -> tuple:
    """Times and a sine whose frequency [Hz] rises from ``low`` to ``high``."""
    t = np.arange(int(seconds * rate)) / rate
    return t, size * np.sin(2.0 * np.pi * (low * t + 0.5 * (high - low) / seconds * t**2))


def slid(v: float, push: float, dry: float, h: float, mass: float = 1.0) -> float:
    """Speed after h under a push and dry friction, which holds what rests and reverses nothing."""
    if v == 0.0 and abs(push) <= dry:
        return 0.0
    new = v + h * (push - dry * (np.sign(v) if v != 0.0 else np.sign(push))) / mass
    return 0.0 if v * new < 0.0 else new


def carriage(
    seed: int, mass=42.0, viscous=130.0, coulomb=18.0, offset=4.0, gravity=0.0, swing=1.0
) -> AxisRun:
    """A carriage on a guide under a controller: recorded force and position, 500 Hz.

    At rest the static balance holds it; in motion the Coulomb force is that of the sign of the
    speed, which no step crosses unnoticed. ``gravity``: moment [N m] that follows the sine.
    ``swing``: times the usual travel.
    """
    rng, rate = np.random.default_rng(seed), 500.0
    t, goal = chirp(4.0, rate, 0.2, 0.375, 0.12)
    goal = goal + 0.03 * np.sin(2.0 * np.pi * (0.11 + 0.05 * seed) * t)
    goal *= swing
    h = 1.0 / (rate * FINE)
    x = v = 0.0
    force, place = np.zeros(len(t)), np.zeros(len(t))
    for k in range(len(t) - 1):
        place[k] = x
        slope = (goal[k + 1] - goal[k]) * rate
        force[k] = 4000.0 * (goal[k] - x) + 400.0 * (slope - v)
        # a drive holds its force over a row
        for _ in range(FINE):
            net = force[k] - offset - viscous * v - gravity * np.sin(x)
            v = slid(v, net, coulomb, h, mass)
            x += h * v
    place[-1] = x
    # what a row holds is the force until the next: half a row late, seen from its middle
    return AxisRun(f"run {seed}", t, force, place + 2e-6 * rng.standard_normal(len(t)))


def servo(
    seed: int, bandwidth=6.0, zeta=0.8, delay=0.03, friction=0.0, play=0.0, noise=2e-4
) -> AxisRun:
    """A second-order servo behind a transport delay, 100 Hz, with friction or play [rad]."""
    rng, rate = np.random.default_rng(seed), 100.0
    t, u = chirp(20.0, rate, 0.1, 1.0 + 0.5 * seed, 0.4)
    u = u + 0.1 * np.sign(np.sin(0.7 * (1.0 + 0.3 * seed) * t))
    fine = np.arange(len(t) * FINE) / (rate * FINE)
    goal = np.interp(fine - delay, t, u)
    w, h, x, v, out = 2.0 * np.pi * bandwidth, 1.0 / (rate * FINE), u[0], 0.0, np.zeros(len(t))
    held = x
    for i in range(len(fine)):
        if i % FINE == 0:
            held = min(max(held, x - 0.5 * play), x + 0.5 * play)
            out[i // FINE] = held
        pull = w * w * (goal[i] - x) - 2.0 * zeta * w * v
        v = slid(v, pull, w * w * friction, h)
        x += h * v
    return AxisRun(f"run {seed}", t, u, out + noise * rng.standard_normal(len(t)))


def damper(seed: int, c=800.0, slip=120.0, stiff=4e5, preload=35.0, noise=1.0) -> AxisRun:
    """A damper with dry friction behind a spring and a gas preload, 500 Hz."""
    rng, rate = np.random.default_rng(seed), 500.0
    t, x = chirp(8.0, rate, 0.5, 2.0 + seed, 0.01)
    fine = np.arange(len(t) * FINE) / (rate * FINE)
    y = np.interp(fine, t, x)
    pull, out = 0.0, np.zeros(len(t))
    for i in range(1, len(fine)):
        pull = min(max(pull + stiff * (y[i] - y[i - 1]), -slip), slip)
        if i % FINE == 0:
            out[i // FINE] = pull
    v = np.gradient(x, 1.0 / rate)
    return AxisRun(f"run {seed}", t, x, out + c * v + preload + noise * rng.standard_normal(len(t)))
