"""Links with records made by themselves: a bounce on a bumper, read by a sensor or reached by a
platform, with noise of known size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hiltestbed.diagnosis.explain import Explanation, explain
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import LinkRun, ModelLink, PlatformLink, WrenchLink
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario, scenario_from

H = 1e-3  # [s]
STIFFNESS = 1e5  # [N/m]
NOISE = 0.1  # [N]
POSE_NOISE = 2e-6  # [m]
SCALES = Scales(300.0, 3e-3, STIFFNESS, H, NOISE, slow=0.02, fast=0.1, duration=0.5, substeps=4)


def effect(kind: str, variant: dict[str, Any] | None = None, **parameters: Any) -> Effect:
    """An effect as a search makes it."""
    return EFFECTS[kind].hypothesis(variant or {}, **parameters)


def candidates(*kinds: str) -> tuple[Candidate, ...]:
    """The hypotheses of some effects."""
    return tuple(c for kind in kinds for c in EFFECTS[kind].candidates(SCALES))


def explained(link: ModelLink, *kinds: str) -> Explanation:
    """The explanation of a link by some effects."""
    return explain(LinkModel(link), candidates(*kinds))


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
    same = WrenchLink(runs, link.paths, link.jumps, link.rates)
    return same.interpreted(**link.reads._asdict())


def link_run(
    s: Scenario,
    measured: Array | int,
    sigma: float | Array = 1.0,
    touching: np.ndarray | None = None,
) -> LinkRun:
    """A run of a link; measured: (N, 6), or N rows of zeros; sigma: (N, 6), or one for all samples;
    touching: (N,), by default everywhere.
    """
    measured = np.zeros((measured, 6)) if isinstance(measured, int) else measured
    inside = np.ones(len(measured), dtype=bool) if touching is None else touching
    return LinkRun(s, measured, np.broadcast_to(sigma, measured.shape).copy(), inside)


def noisy(
    runs: Sequence[LinkRun], shown: Sequence[Array], noise: float, seed: int | None
) -> list[LinkRun]:
    """The runs with what is ``shown`` (N, C) as measured, and white noise; none without a seed."""
    rng = np.random.default_rng(seed)
    added = [0.0 if seed is None else noise * rng.standard_normal(m.shape) for m in shown]
    return [replace(r, measured=m + a) for r, m, a in zip(runs, shown, added, strict=True)]


def sweeps(
    effects: Sequence[Effect], fastest: Sequence[float], rows: int, noise: float, seed: int
) -> PlatformLink:
    """Runs of a platform with ``effects`` at 100 Hz: sweeps of 2 mm on x from 0.2 Hz up to the
    ``fastest`` [Hz], of which nothing else is measured.
    """
    h, body = 0.01, {"mass": 500.0, "inertia": [200.0, 180.0, 150.0]}
    told = {"duration": rows * h, "rate": 1 / h, "physics_rate": 4 / h, "name": "sweeps"}
    s = scenario_from(
        told
        | {
            "spacecraft": {"chaser": body, "target": body},
            "approach": {"velocity": [0, 0, 0], "gap": 0.1},
            "mechanism": {"contact": {"stiffness": 1e5, "damping": 0.0}},
            "rig": {"platform": {"tracking": "ideal"}},
        }
    )
    t, commands = (np.arange(rows) + 1) * h, [np.zeros((rows, 7)) for _ in fastest]
    for command, last in zip(commands, fastest, strict=True):
        command[:, 2], command[:, 6] = -0.1, 1.0
        command[:, 0] = 2e-3 * np.sin(2 * np.pi * (0.2 + 0.5 * (last - 0.2) * t / t[-1]) * t)
    sigma = np.full((rows, 6), np.inf)
    sigma[1:, 0] = noise
    runs = [link_run(s, rows, sigma, np.zeros(rows, dtype=bool)) for _ in commands]
    still = [np.zeros((rows, 6)) for _ in commands]
    shown = PlatformLink(runs, commands, still).shown_in_all(effects)
    return PlatformLink(noisy(runs, shown, noise, seed), commands, still)


def contact_link(
    effects: Sequence[Effect] = (), seed: int | None = 1, speeds: Sequence[float] = (0.03,)
) -> WrenchLink:
    """Readings of contacts with `effects` in them, with noise; without any where seed is None."""
    paths, s = [bounce(speed=v) for v in speeds], scenario()
    clean = WrenchLink([link_run(s, len(p), NOISE, p[:, 2] > 0.0) for p in paths], paths)
    runs = noisy(clean.runs, clean.shown_in_all(effects), NOISE, seed)
    return reread(clean, [run.measured for run in runs])


def platform_link(
    effects: Sequence[Effect] = (), speeds: Sequence[float] = (0.03, 0.06)
) -> PlatformLink:
    """Poses of a platform with `effects`, with noise."""
    commands, s = [bounce(speed=v)[1:] for v in speeds], scenario()
    runs = [link_run(s, len(c), POSE_NOISE) for c in commands]
    still = [np.zeros((len(c), 6)) for c in commands]
    shown = PlatformLink(runs, commands, still).shown_in_all(effects)
    return PlatformLink(noisy(runs, shown, POSE_NOISE, 2), commands, still)
