"""Links with records made by themselves: a bounce on a bumper, read by a sensor or reached by a
platform, with noise of known size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hiltestbed.diagnosis.links import LinkRun, PlatformLink, WrenchLink
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario, scenario_from

H = 1e-3  # [s]
STIFFNESS = 1e5  # [N/m]
NOISE = 0.1  # [N]
POSE_NOISE = 2e-6  # [m]


def effect(kind: str, variant: dict[str, Any] | None = None, **parameters: Any) -> Effect:
    """An effect as a search makes it."""
    return EFFECTS[kind].hypothesis(variant or {}, **parameters)


def scenario(delay: float = 0.005) -> Scenario:
    body = {"mass": 500.0, "inertia": [200.0, 180.0, 150.0], "port": {"position": [0, 0, 1.0]}}
    return scenario_from(
        {
            "name": "made",
            "duration": 0.5,
            "rate": 1 / H,
            "physics_rate": 4 / H,
            "spacecraft": {"chaser": body, "target": body},
            "approach": {"velocity": [0.0, 0.0, 0.03], "gap": 0.003},
            "mechanism": {"contact": {"stiffness": STIFFNESS, "damping": 400.0}},
            "rig": {"platform": {"tracking": "ideal"}},
            "sensor": {"delay": delay, "noise": NOISE},
        }
    )


def bounce(rows: int = 500, speed: float = 0.03) -> Array:
    """(N, 7) approach from 0.1 s before the touch, half a sine of 0.3 s in contact, rebound."""
    t = np.arange(rows) * H - 0.1 - 0.3 * H
    inside = speed * 0.3 / math.pi * np.sin(math.pi * np.clip(t, 0.0, 0.3) / 0.3)
    path = np.zeros((rows, 7))
    path[:, 2] = np.where(t < 0.0, speed * t, np.where(t < 0.3, inside, -speed * (t - 0.3)))
    path[:, 6] = 1.0
    return path


def reread(link: WrenchLink, measured: Sequence[Array]) -> WrenchLink:
    """The same link with other readings."""
    runs = [replace(run, measured=m) for run, m in zip(link.runs, measured, strict=True)]
    return WrenchLink(runs, link.paths, link.jumps, link.rates).interpreted(
        link.lever, link.grid, exact=link.exact
    )


def contact_link(
    effects: Sequence[Effect] = (), seed: int | None = 1, speeds: Sequence[float] = (0.03,)
) -> WrenchLink:
    """Readings of contacts with `effects` in them, with noise; without any where seed is None."""
    paths, s, rng = [bounce(speed=v) for v in speeds], scenario(), np.random.default_rng(seed)
    runs = [
        LinkRun(s, np.zeros((len(p), 6)), np.full((len(p), 6), NOISE), p[:, 2] > 0.0) for p in paths
    ]
    clean = WrenchLink(runs, paths)
    shown = clean.predict([(i, effects) for i in range(len(runs))])
    return reread(
        clean, [m if seed is None else m + NOISE * rng.standard_normal(m.shape) for m in shown]
    )


def platform_link(
    effects: Sequence[Effect] = (), speeds: Sequence[float] = (0.03, 0.06)
) -> PlatformLink:
    """Poses of a platform with `effects`, with noise."""
    commands, s, rng = [bounce(speed=v)[1:] for v in speeds], scenario(), np.random.default_rng(2)
    runs = [
        LinkRun(
            s, np.zeros((len(c), 6)), np.full((len(c), 6), POSE_NOISE), np.ones(len(c), dtype=bool)
        )
        for c in commands
    ]
    still = [np.zeros((len(c), 6)) for c in commands]
    shown = PlatformLink(runs, commands, still).predict([(i, effects) for i in range(len(runs))])
    runs = [
        replace(run, measured=m + POSE_NOISE * rng.standard_normal(m.shape))
        for run, m in zip(runs, shown, strict=True)
    ]
    return PlatformLink(runs, commands, still)
