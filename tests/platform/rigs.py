"""Small rigs for the tests: a scenario in numbers, and a plant pressed through a known motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, scenario_from

K, C = 1.0e5, 300.0


def scenario(
    tracking: str = "servo",
    *,
    rate: float = 2000.0,
    physics_rate: float | None = None,
    mechanism: dict[str, Any] | None = None,
    stiffness: float = K,
    damping: float = C,
    friction: float = 0.0,
) -> Scenario:
    """A bumper between two 800 kg bodies; ``mechanism`` adds to or replaces the keys of the
    scenario's own.
    """
    body = {"mass": 800.0, "inertia": [200.0, 200.0, 200.0]}
    contact = {"stiffness": stiffness, "damping": damping, "friction": friction}
    return scenario_from(
        {
            "name": "rig",
            "rate": rate,
            "physics_rate": physics_rate or 2.0 * rate,
            "spacecraft": {"chaser": body, "target": body},
            "approach": {"velocity": [0.0, 0.0, 0.03]},
            "mechanism": {"kind": "bumper", "contact": contact} | (mechanism or {}),
            "rig": {"platform": {"tracking": tracking}},
        }
    )


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, n: int = 1) -> Array:
    """``(n, 7)`` upright poses."""
    return np.tile([x, y, z, 0.0, 0.0, 0.0, 1.0], (n, 1))


class Press:
    """A plant that is driven along pz = -depth cos(2 pi f t) at a fixed place, and what it reads:
    depth, rate and force at t_k.
    """

    def __init__(self, plant: Plant, rate: float, x: float = 0.0, y: float = 0.0) -> None:
        self.plant, self.rate, self.x, self.y = plant, rate, x, y
        self.rows: list[tuple[float, float, Array]] = []

    def run(self, ticks: int, depth: float = 2e-3, frequency: float = 2.5) -> Press:
        w, h, n = 2.0 * math.pi * frequency, 1.0 / self.rate, len(self.plant.pose_act)
        twist, accel = np.zeros((n, 6)), np.zeros((n, 6))
        self.plant.reset(pose(self.x, self.y, -depth, n), twist)
        for k in range(1, ticks + 1):
            t = k * h
            twist[:, 2] = depth * w * math.sin(w * (t - 0.5 * h))
            accel[:, 2] = depth * w * w * math.cos(w * (t - 0.5 * h))
            self.plant.advance(pose(self.x, self.y, -depth * math.cos(w * t), n), twist, accel)
            plant = self.plant
            self.rows.append(
                (plant.pose_act[0, 2], plant.twist_act[0, 2], plant.wrench_sub[0, -1].copy())
            )
        return self

    def columns(self) -> tuple[Array, Array, Array]:
        """Depth (ticks,) [m], rate (ticks,) [m/s] and wrench (ticks, 6)."""
        depth, rate, wrench = zip(*self.rows, strict=True)
        return np.array(depth), np.array(rate), np.array(wrench)


def fitted(depth: Array, rate: Array, force: Array) -> tuple[float, float]:
    """Stiffness and damping by least squares over the samples in contact with a force."""
    touching = (depth > 0.0) & (force > 0.0)
    (k, c), *_ = np.linalg.lstsq(
        np.column_stack([depth, rate])[touching], force[touching], rcond=None
    )
    return float(k), float(c)
