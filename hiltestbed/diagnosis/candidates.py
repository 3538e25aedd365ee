"""What may be wrong with a link: each effect of the vocabulary with the parameters to fit, their bounds, and where to start.

Fits of these effects are rough (jumps at whole ticks, clipped and dead ranges, several minima), so that each candidate brings a grid
of starts, scaled by what the data hold: peak force, penetration, rate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hiltestbed.diagnosis.links import AHEAD, FORM
from hiltestbed.effects.vocabulary import AXES, EFFECTS, WRENCH_AXES, ParameterSpec
from hiltestbed.frames import Array

DRIFTS = 3.0  # peak forces that the reading of a sensor may drift over a run
FINE = 20  # instants a tick of a platform that jumps when it must, in place of at the instants of the physics
PRIVATE = ParameterSpec("")  # of a parameter that the vocabulary does not have
HEAVY = 10.0 / (6.0 * math.pi) ** 2  # [s^2] of the contact's stiffness: a frame ten times as stiff that rings at 3 Hz
LATE = 20.0  # ticks: as far as a delay is searched on a slow loop, where that is more than the vocabulary's own range
LAGGING = 50.0  # ticks: likewise the time constant of a filter
SLOW = 500.0  # [Hz] of the loop, below which the responses that are searched slow down with it
DRAGGED = 1e3  # of the secant stiffness: the stiffest spring that drags a slider
LITTLE = 0.01  # of the stiffness believed: what may be left of the spring beside a friction that was taken for it
SWINGS = 0.1  # of the rate of the loop: the fastest appendage that a numerical model of that rate can hold


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect with its free parameters.

    Attributes:
        effect: id. fixed: parameters that are chosen, not fitted. names: free parameters, "force.0" for an item of a list.
        low, high: bounds. log: which are searched by ratio. grid: starts.
        choices: number of siblings that differ in what is fixed: a search among them costs 2 ln(choices).
    """

    effect: str
    names: tuple[str, ...]
    low: Array
    high: Array
    log: np.ndarray
    grid: tuple[tuple[float, ...], ...]
    fixed: dict[str, Any] = field(default_factory=dict)
    choices: int = 1

    @property
    def vector(self) -> bool:
        """Whether the parameters are the components of a vector, whose direction no grid covers."""
        return any("." in name for name in self.names)

    @property
    def key(self) -> tuple:
        """What tells candidates apart."""
        return (self.effect, *self.names, *sorted((k, str(v)) for k, v in self.fixed.items()))

    def public(self, theta: Array) -> dict[str, Any]:
        """Those parameters at theta that the vocabulary has: not the reading of the equation, nor how it is integrated."""
        return {k: v for k, v in self.parameters(theta).items() if k in EFFECTS[self.effect].parameters}

    def parameters(self, theta: Array) -> dict[str, Any]:
        """The effect's parameters at theta, lists put together."""
        out = dict(self.fixed)
        for name, value in zip(self.names, theta, strict=True):
            key, _, item = name.partition(".")
            if item:
                out.setdefault(key, [0.0] * EFFECTS[self.effect].parameters[key].size)[int(item)] = float(value)
            else:
                out[key] = float(value)
        for key, spec in EFFECTS[self.effect].parameters.items():
            if key not in out and spec.default is not None:
                out[key] = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        return out

    def with_effect(self, theta: Array) -> tuple[str, dict[str, Any]]:
        """(id, parameters)."""
        return self.effect, self.parameters(theta)


def candidate(effect: str, grids: Mapping[str, Sequence[float]], choices: int = 1, starts: Sequence[Sequence[float]] | None = None,
              bounds: Mapping[str, tuple[float, float]] | None = None, **fixed: Any) -> Candidate:  # fmt: skip
    """A candidate whose starts are all combinations of `grids` (or `starts`), within `bounds` or the vocabulary's fit bounds."""
    low, high, log = [], [], []
    for name in grids:
        spec = EFFECTS[effect].parameters.get(name.partition(".")[0], PRIVATE)
        a, b = (bounds or {}).get(name, spec.fit)
        low.append(a)
        high.append(b)
        log.append(spec.log and a > 0)
    grid = tuple(tuple(map(float, s)) for s in (starts or itertools.product(*grids.values())))
    return Candidate(effect, tuple(grids), np.array(low, float), np.array(high, float), np.array(log), grid, fixed, choices)


def _readings(*forms: str | float) -> list[dict[str, Any]]:
    """What is fixed in each reading of an effect's equation: nothing in the first, then each of ``forms``."""
    return [{}, *({FORM: form} for form in forms)]


@dataclass(frozen=True)
class Scales:
    """What the data hold, to scale starts and bounds with: peak force [N], largest penetration [m], stiffness [N/m], tick [s], noise [N],
    lowest and highest approach speed [m/s], length of the shortest run [s], highest peaks of the force [N], largest travel that was
    commanded [m]."""

    force: float
    depth: float
    stiffness: float
    tick: float
    noise: float
    slow: float
    fast: float
    duration: float = 1.0
    reading: tuple[float, ...] = ()
    travel: float = 0.0


def contact_candidates(s: Scales, captured: bool, lateral: bool) -> list[Candidate]:
    """Effects of the contact and of the sensor's frame."""
    k, f, x = s.stiffness, s.force, s.depth
    small = [0.01 * f, 0.04 * f, 0.15 * f]
    force_bounds = (0.0, 0.8 * f)
    softer = {"factor": (LITTLE, 3.0)} if captured else None
    gives = {"stiffness": ((LITTLE if captured else 0.3) * k, 3000 * k)}
    powers = [(n, k * x ** (1.0 - n) * g) for n in (1.1, 1.25, 1.5, 1.8) for g in (0.6, 1.0, 1.6)]
    out = [
        candidate("contact.stiffness", {"factor": [0.5, 0.75, 0.92, 1.08, 1.3, 1.8]}, bounds=softer),
        candidate("contact.damping", {"factor": [0.2, 0.6, 1.5, 2.5, 4.0]}),
        candidate("contact.hunt_crossley", {"alpha": [0.2, 1.0, 3.0, 8.0]}),
        candidate("contact.dry_friction", {"force": small}, bounds={"force": force_bounds}),
        candidate("contact.preload", {"force": small}, bounds={"force": force_bounds}),
        candidate("contact.hard_stop", {"position": [x * q for q in (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)], "stiffness": [0.3 * k, k, 4 * k]},
                  bounds={"position": (0.0, x), "stiffness": (0.01 * k, 100 * k)}),
        candidate("contact.relaxation", {"stiffness": [0.1 * k, 0.4 * k], "time_constant": [0.004, 0.02, 0.08, 0.4]},
                  bounds={"stiffness": (0.005 * k, 10 * k), "time_constant": (1e-3, 5.0)}),
        candidate("contact.touch_offset", {"offset": [-0.3 * x, -0.1 * x, -0.02 * x, 0.02 * x, 0.1 * x, 0.3 * x]}),
    ]  # fmt: skip
    for form in _readings("series", "elastic"):
        out.append(candidate("frame.compliance", {"stiffness": [2 * k, 8 * k, 40 * k]}, bounds=gives, **form))
    for form in _readings("undamped"):
        out.append(candidate("contact.power_law", {"exponent": [], "stiffness": []}, starts=powers, **form))
    for form in _readings("reaction"):
        modes = {"frequency": [8, 14, 22, 35, 60], "damping_ratio": [0.03], "mass": [k / 3e4, k / 2e3, k / 300]}
        out.append(candidate("frame.mode", modes, bounds={"mass": (1.0, max(2000.0, HEAVY * k))}, **form))
    for lever in _readings(0.0, 1.0):
        tilts = [(0.2, 0.2), (2.0, 2.0), (-2.0, -2.0)]
        out.append(candidate("contact.misalignment", {"angles_deg.0": [0.0], "angles_deg.1": [0.0]}, starts=tilts, **lever))
        if lateral:
            out.append(candidate("contact.surface_friction", {"coefficient": [0.02, 0.1, 0.3]}, **lever))
    if not captured:
        return [*out, candidate("contact.adhesion", {"force": small}, bounds={"force": force_bounds})]
    drag = {"force": [0.3 * f, 0.8 * f], "stiffness": [q * f / x for q in (2, 8, 30)]}
    slip = {"force": (0.0, f), "stiffness": (0.1 * f / x, DRAGGED * f / x)}
    out.append(candidate("contact.dry_friction", drag, bounds=slip))
    out.append(candidate("contact.backlash", {"width": [0.02 * x, 0.1 * x, 0.3 * x, 0.8 * x]}, bounds={"width": (0.0, 2 * x)}))
    return out


def sensor_candidates(s: Scales, tone: dict[str, tuple[float, float, float]]) -> list[Candidate]:
    """Effects of the sensor; `tone`: axis to frequency [Hz], amplitude [N], phase [rad] of the strongest line of the residual."""
    f, h = s.force, s.tick
    delays = [0.4 * h, 0.8 * h, 1.4 * h, 2.5 * h, 4.5 * h, 8 * h, 13 * h, 20 * h]
    bias = {f"{kind}.{j}": [0.0] for kind in ("force", "torque") for j in range(3)}
    slow = {"time_constant": (1e-4, max(0.05, LAGGING * h))}
    tare = {f"force.{j}": (-max(50.0, 0.3 * f), max(50.0, 0.3 * f)) for j in range(3)}
    out = [
        candidate("sensor.delay", {"delay": delays}, bounds=_late("sensor.delay", h)),
        candidate("sensor.lag", {"time_constant": [0.3 * h, h, 3 * h, 8 * h, 25 * h]}, bounds=slow),
        candidate("sensor.highpass", {"time_constant": [0.05, 0.2, 1.0, 5.0, 25.0]}),
        candidate("sensor.bias", bias, bounds=tare),
        candidate("sensor.deadzone", {"width": list(np.geomspace(s.noise, 0.5 * f, 16))}, bounds={"width": (0.5 * s.noise, 0.7 * f)}),
        candidate("sensor.saturation", {"limit": [q * f for q in (0.25, 0.4, 0.55, 0.7, 0.8, 0.9, 0.97)] + list(s.reading)},
                  bounds={"limit": (0.05 * f, 1.2 * f)}),
    ]  # fmt: skip
    fastest = DRIFTS * f / s.duration
    out += [candidate("sensor.drift", {"rate": [0.0]}, 3, bounds={"rate": (-fastest, fastest)}, axis=a) for a in AXES]
    out += [candidate("sensor.gain", {"factor": [0.9, 1.1]}, 2, axis=a) for a in WRENCH_AXES]
    pairs = [(a, b) for a in WRENCH_AXES for b in WRENCH_AXES if a != b]
    out += [candidate("sensor.crosstalk", {"ratio": [0.0]}, 6, source=a, axis=b) for a, b in pairs]
    return out + [tone_candidate(axis, *line) for axis, line in tone.items()]


def tone_candidate(axis: str, frequency: float, amplitude: float, phase: float) -> Candidate:
    """A hum near a line that was seen: frequency [Hz], amplitude [N], phase [rad]."""
    start = {"frequency": [frequency], "amplitude": [amplitude], "phase": [phase]}
    wide = {"frequency": (max(0.5, frequency - 3.0), frequency + 3.0), "phase": (phase - math.pi, phase + math.pi),
            "amplitude": (0.0, 20 * amplitude + 1.0)}  # fmt: skip
    return candidate("sensor.hum", start, 4, bounds=wide, axis=axis)


def _late(effect: str, h: float) -> dict[str, tuple[float, float]]:
    """Bounds of a delay [s] at a tick of h [s]."""
    low, high = EFFECTS[effect].parameters["delay"].fit
    return {"delay": (low, max(high, LATE * h))}


def skew_candidates(h: float, about: float | None = None) -> list[Candidate]:
    """The record of the force alone stamped late: rows of the record between rows of the loop, or read anew at the later time.

    about: a delay [s] that is known to a tick `h`.
    """
    grid = {"delay": [0.4 * h, 0.8 * h, 1.4 * h, 2.5 * h, 4.5 * h, 8 * h, 13 * h, 20 * h] if about is None else [about]}
    bounds = _late("log.skew", h) if about is None else {"delay": (max(0.0, about - h), about + h)}
    return [candidate("log.skew", grid, bounds=bounds), candidate("log.skew", grid, bounds=bounds, form="continuous")]


def platform_candidates(s: Scales, substeps: int, sticks: dict[int, list[float]]) -> list[Candidate]:
    """Effects of the motion platform, for a tick of s.tick; sticks: instants a tick to starts for stiction [m], where there are any."""
    h = s.tick
    pace = min(1.0, 1.0 / (SLOW * h))
    lags, ahead = {"bandwidth": [pace * f for f in (4, 8, 15, 30, 60, 120, 250)]}, {AHEAD: [0.1 * h]}
    modes = {"frequency": [pace * f for f in (5, 8, 12, 18, 27, 40, 60, 90, 130)], "damping_ratio": [0.02, 0.1]}
    slow = {"bandwidth": (2.0 * pace, 400.0), "frequency": (2.0 * pace, min(400.0, 0.5 / h)), AHEAD: (0.0, h)}
    play = {"width": (0.0, max(2e-3, s.travel))}
    out = [
        candidate("platform.delay", {"delay": [0.3 * h, h, 3 * h, 8 * h, 20 * h]}, bounds=_late("platform.delay", h)),
        candidate("platform.lag", lags, bounds=slow),
        candidate("platform.lag", lags | ahead, bounds=slow, stepwise=True),
        candidate("platform.backlash", {"width": [1e-5, 4e-5, 1.5e-4, 5e-4]}, bounds=play),
        candidate("platform.mode", modes, bounds=slow),
        candidate("platform.mode", modes | ahead, bounds=slow, stepwise=True),
        candidate("platform.speed_limit", {"speed": list(np.geomspace(0.3 * s.slow, 1.05 * s.fast, 8))}),
    ]
    out += [candidate("platform.scale", {"factor": [0.97, 1.03]}, 3, axis=a) for a in AXES]
    few = list(np.geomspace(5e-6, 8e-4, 6))
    out += [candidate("platform.friction", {"stick": sticks.get(m, few)}, form=m) for m in dict.fromkeys((substeps, FINE))]
    return out


def compensation_candidates(s: Scales) -> list[Candidate]:
    """What may happen between the measured wrench and the one used."""
    widths = list(np.geomspace(0.3 * s.noise, 0.3 * s.force, 40))
    bounds = {"width": (0.1 * s.noise, 0.8 * s.force)}
    return [candidate("loop.deadzone", {"width": widths}, bounds=bounds, **form) for form in _readings("after", "magnitude")] + [
        skew_candidates(s.tick)[0]
    ]


def dynamics_candidates(tick: float, max_ticks: int = 12) -> list[Candidate]:
    """Effects of the numerical model, whose step is `tick` [s]."""
    out = [Candidate("dynamics.integrator", (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"scheme": "explicit_euler"})]
    out += [Candidate("dynamics.step_delay", (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"ticks": n}, max_ticks)
            for n in range(1, max_ticks + 1)]  # fmt: skip
    for body in ("chaser", "target"):
        out.append(candidate("dynamics.mass", {"factor": [0.6, 0.9, 1.1, 1.6]}, body=body))
        out.append(candidate("dynamics.inertia", {"factor": [0.7, 1.3]}, body=body))
        offset = {f"offset.{j}": [0.0] for j in range(3)}
        out.append(candidate("dynamics.port_offset", offset, starts=[(0, 0, 0), (0.05, 0.05, 0.05)], body=body))
        swing = {"mass_ratio": [0.05, 0.2], "frequency": [0.15, 0.4, 0.8, 1.5, 3.0, 6.0, 12.0, 24.0], "damping_ratio": [0.02, 0.15]}
        out.append(candidate("dynamics.appendage", swing, bounds={"frequency": (0.05, SWINGS / tick)}, body=body))
    return out
