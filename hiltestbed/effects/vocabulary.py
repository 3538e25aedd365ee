"""The vocabulary of effects: what a rig may do that its nominal model does not.

One table serves the scenario (`effects: [{kind: ID, parameter: value}]`), the simulation and the
diagnosis. It says what an effect is, not how it is computed: the kernels are in the modules named
after the links.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

AXES = ("x", "y", "z")
WRENCH_AXES = ("x", "y", "z", "rx", "ry", "rz")
BODIES = ("chaser", "target")


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of an effect.

    kind: "number", "integer", "vector" (of `size` numbers) or "choice" (one of `choices`).
    low, high: allowed range in `unit`; an open end excludes the value itself.
    fit: range that a diagnosis searches [unit]; `log` says whether it searches by ratio.
    default: None means that the parameter must be given.
    """

    unit: str
    kind: str = "number"
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    fit: tuple[float, float] = (0.0, 0.0)
    log: bool = False
    size: int = 1
    choices: tuple[str, ...] = ()
    default: object = None
    meaning: str = ""

    def allowed(self) -> str:
        """The allowed values in words, for error messages."""
        if self.kind == "choice":
            return "one of " + ", ".join(self.choices)
        what = {"number": "a number", "integer": "a whole number", "vector": f"a list of {self.size} numbers"}[self.kind]
        bounds = []
        if math.isfinite(self.low):
            bounds.append(f"{'>' if self.low_open else '>='} {self.low:g}")
        if math.isfinite(self.high):
            bounds.append(f"{'<' if self.high_open else '<='} {self.high:g}")
        unit = f" [{self.unit}]" if self.unit not in ("", "-") else ""
        return what + (" " + " and ".join(bounds) if bounds else "") + unit

    def fault(self, value: object) -> str | None:
        """Why `value` is not allowed, or None when it is."""
        if self.kind == "choice":
            return None if value in self.choices else f"got {value!r}; allowed: {self.allowed()}"
        values: list[object]
        if self.kind == "vector":
            if not isinstance(value, (list, tuple)) or len(value) != self.size:
                return f"got {value!r}; allowed: {self.allowed()}"
            values = list(value)
        else:
            values = [value]
        return None if all(self._holds(v) for v in values) else f"got {value!r}; allowed: {self.allowed()}"

    def _holds(self, v: object) -> bool:
        if isinstance(v, bool) or not isinstance(v, (int, float)) or not math.isfinite(v):
            return False
        if self.kind == "integer" and v != int(v):
            return False
        above = v > self.low if self.low_open else v >= self.low
        below = v < self.high if self.high_open else v <= self.high
        return above and below


@dataclass(frozen=True)
class EffectSpec:
    """One effect: its link of the loop, its parameters, its equation and where that comes from."""

    id: str
    link: str
    parameters: Mapping[str, ParameterSpec] = field(default_factory=dict)
    equation: str = ""
    source: str = ""
    description: str = ""

    def complete(self, given: Mapping[str, object]) -> dict[str, object]:
        """`given` with defaults filled in; the caller has checked it with `faults`."""
        return {name: given.get(name, spec.default) for name, spec in self.parameters.items()}

    def faults(self, given: Mapping[str, object]) -> list[tuple[str, str]]:
        """(parameter, what is wrong with it) for every fault of `given` (without `kind`)."""
        found = [
            (name, f"unknown parameter of {self.id}; allowed: {', '.join(self.parameters) or 'none'}")
            for name in given
            if name not in self.parameters
        ]
        for name, spec in self.parameters.items():
            if name not in given or given[name] is None:
                if spec.default is None:
                    found.append((name, f"missing from {self.id}; allowed: {spec.allowed()}"))
                continue
            fault = spec.fault(given[name])
            if fault:
                found.append((name, fault))
        return found


def _positive(unit: str, fit: tuple[float, float], log: bool = True, meaning: str = "", high: float = math.inf) -> ParameterSpec:
    return ParameterSpec(unit, low=0.0, low_open=True, high=high, fit=fit, log=log, meaning=meaning)


def _size(unit: str, fit: tuple[float, float], meaning: str = "", high: float = math.inf) -> ParameterSpec:
    return ParameterSpec(unit, low=0.0, high=high, fit=fit, meaning=meaning)


def _choice(choices: tuple[str, ...], default: str, meaning: str = "") -> ParameterSpec:
    return ParameterSpec("", "choice", choices=choices, default=default, meaning=meaning)


_factor = _positive("-", (0.3, 3.0), meaning="true value over the one believed")
_body = _choice(BODIES, "chaser", "the body concerned")
_textbook = "standard form"

_TABLE = (
    EffectSpec(
        "sensor.delay", "sensor", {"delay": _size("s", (0.0, 0.03), "added to the nominal delay", 1.0)},
        "w_meas(t) = w(t - delay_nominal - delay)", _textbook,
        "The force reading is late by a fixed time.",
    ),
    EffectSpec(
        "sensor.lag", "sensor", {"time_constant": _positive("s", (1e-4, 0.05))},
        "y_k = y_(k-1) + (u_k - y_(k-1)) (1 - exp(-h/T))", _textbook,
        "The force reading passes a first-order low-pass.",
    ),
    EffectSpec(
        "sensor.highpass", "sensor", {"time_constant": _positive("s", (0.02, 100.0))},
        "y_k = exp(-h/T) (y_(k-1) + u_k - u_(k-1))", "charge amplifier, s T/(1 + s T)",
        "The charge leaks away: a steady force fades, an undershoot follows the contact.",
    ),
    EffectSpec(
        "sensor.drift", "sensor",
        {"rate": ParameterSpec("N/s", fit=(-20.0, 20.0)), "axis": _choice(AXES, "z", "force axis")},
        "f_axis += rate t", "charge-amplifier leakage current",
        "One force axis drifts linearly from the start of the run.",
    ),
    EffectSpec(
        "sensor.bias", "sensor",
        {
            "force": ParameterSpec("N", "vector", size=3, fit=(-50.0, 50.0), default=(0.0, 0.0, 0.0)),
            "torque": ParameterSpec("N m", "vector", size=3, fit=(-20.0, 20.0), default=(0.0, 0.0, 0.0)),
        },
        "w += (force, torque)", "tare error",
        "A constant offset on the wrench.",
    ),
    EffectSpec(
        "sensor.gain", "sensor", {"factor": _factor, "axis": _choice(WRENCH_AXES, "z", "axis of the wrench")},
        "w_axis *= factor", "calibration error",
        "One axis of the wrench is scaled.",
    ),
    EffectSpec(
        "sensor.crosstalk", "sensor",
        {
            "ratio": ParameterSpec("-", low=-1.0, high=1.0, fit=(-0.3, 0.3)),
            "source": _choice(WRENCH_AXES, "z", "axis that leaks"),
            "axis": _choice(WRENCH_AXES, "x", "axis on which it shows"),
        },
        "w_axis += ratio w_source", "calibration-matrix error",
        "A fraction of one axis shows on another.",
    ),
    EffectSpec(
        "sensor.deadzone", "sensor", {"width": _positive("N", (0.2, 60.0))},
        "f_axis = 0 where |f_axis| < width", _textbook,
        "Force axes read zero below a threshold.",
    ),
    EffectSpec(
        "sensor.saturation", "sensor", {"limit": _positive("N", (5.0, 5000.0))},
        "f_axis = min(max(f_axis, -limit), limit)", _textbook,
        "Force axes clip.",
    ),
    EffectSpec(
        "sensor.hum", "sensor",
        {
            "frequency": _positive("Hz", (1.0, 400.0)),
            "amplitude": _size("N", (0.0, 20.0)),
            "phase": ParameterSpec("rad", fit=(-math.pi, math.pi), default=0.0),
            "axis": _choice((*AXES, "all"), "z", "force axis, or all three"),
        },
        "f_axis += amplitude sin(2 pi frequency t + phase)", "mains pick-up or a structural tone",
        "A tone on the force reading, contact or not.",
    ),
    EffectSpec(
        "sensor.jitter", "sensor", {"sigma": _size("s", (0.0, 0.005), "standard deviation of the delay", 0.1)},
        "w_meas(t_k) = w(t_k - delay - sigma n_k), n_k standard normal, total delay >= 0", "sampling jitter",
        "The delay of the reading varies from sample to sample.",
    ),
    EffectSpec(
        "contact.stiffness", "contact", {"factor": _factor},
        "k -> factor k", _textbook, "The contact spring is stiffer or softer than believed.",
    ),
    EffectSpec(
        "contact.damping", "contact", {"factor": ParameterSpec("-", low=0.0, fit=(0.0, 6.0), meaning="true value over the one believed")},
        "c -> factor c", _textbook, "The contact damper is stronger or weaker than believed.",
    ),
    EffectSpec(
        "contact.power_law", "contact",
        {"exponent": _positive("-", (1.02, 2.5), False, high=5.0), "stiffness": _positive("N/m^n", (1e3, 1e10))},
        "F = stiffness x^exponent + c v", "Hertz for exponent 1.5",
        "The elastic force follows a power of the penetration, whatever spring is fitted.",
    ),
    EffectSpec(
        "contact.hunt_crossley", "contact", {"alpha": _size("s/m", (0.0, 30.0))},
        "F = k x (1 + alpha v)", "Hunt and Crossley 1975",
        "The damping grows with the penetration: no force step at touch.",
    ),
    EffectSpec(
        "contact.dry_friction", "contact",
        {
            "force": _size("N", (0.0, 300.0)),
            "stiffness": ParameterSpec("N/m", low=0.0, fit=(1e2, 1e9), log=True, default=0.0, meaning="before it slips; 0: rigid"),
        },
        "F += force tanh(v/2e-4); with a stiffness F += f, f' = stiffness v while |f| < force", "Coulomb; Jenkins 1962 with a stiffness",
        "Dry friction in the buffer: a loop whose width depends on neither speed nor stroke.",
    ),
    EffectSpec(
        "contact.preload", "contact", {"force": _size("N", (0.0, 300.0))},
        "F += force while x > 0", "preloaded buffer spring",
        "A force step at touch that does not depend on the speed.",
    ),
    EffectSpec(
        "contact.hard_stop", "contact",
        {"position": _size("m", (0.0, 0.05)), "stiffness": _positive("N/m", (1e3, 1e8))},
        "F += stiffness (x - position) while x > position", "bilinear buffer",
        "A second spring past a position.",
    ),
    EffectSpec(
        "contact.relaxation", "contact",
        {"stiffness": _positive("N/m", (1e2, 1e7)), "time_constant": _positive("s", (1e-3, 10.0))},
        "F += z, z' = stiffness v - z/time_constant", "Maxwell branch of the standard linear solid",
        "The contact is stiffer when fast and relaxes when held.",
    ),
    EffectSpec(
        "contact.adhesion", "contact", {"force": _size("N", (0.0, 300.0))},
        "F may fall to -force while x > 0", "magnet or latch pull",
        "The contact pulls at separation.",
    ),
    EffectSpec(
        "contact.surface_friction", "contact", {"coefficient": _size("-", (0.0, 1.0), "the true coefficient", 10.0)},
        "F_t = coefficient |F| v_t/sqrt(v_t^2 + (1e-4)^2)", "Coulomb, regularised",
        "The tangential friction coefficient is not the one believed.",
    ),
    EffectSpec(
        "contact.touch_offset", "contact", {"offset": ParameterSpec("m", fit=(-2e-3, 2e-3), meaning="positive: touches later")},
        "x = pz - offset", _textbook, "The mechanisms touch later (or earlier) than believed.",
    ),
    EffectSpec(
        "contact.backlash", "contact", {"width": _size("m", (0.0, 5e-3), "whole play")},
        "x = pz outside +-width/2 less the half play, 0 within; friction that gives before it slips carries its play along", _textbook,
        "Play in a captured mechanism: no force within it.",
    ),
    EffectSpec(
        "contact.misalignment", "contact",
        {"angles_deg": ParameterSpec("deg", "vector", size=2, low=-45.0, high=45.0, fit=(-8.0, 8.0), meaning="about x, about y")},
        "surface normal n = R_y R_x e_z", _textbook,
        "The passive port is tilted: the contact force tilts with it.",
    ),
    EffectSpec(
        "frame.compliance", "contact", {"stiffness": _positive("N/m", (1e5, 1e9))},
        "x = pz - F/stiffness", "springs in series",
        "The frame of the sensor gives way, quasi-statically.",
    ),
    EffectSpec(
        "frame.mode", "contact",
        {
            "frequency": _positive("Hz", (3.0, 200.0)),
            "damping_ratio": _positive("-", (0.002, 0.3), high=1.0),
            "mass": _positive("kg", (1.0, 2000.0)),
        },
        "m q'' + 2 zeta w m q' + w^2 m q = F, x = pz - q, measured: w^2 m q + 2 zeta w m q'", "single structural mode",
        "The frame of the sensor rings: it moves under the contact force, and the sensor reads the frame.",
    ),
    EffectSpec(
        "platform.delay", "platform", {"delay": _size("s", (0.0, 0.05), high=1.0)},
        "x(t) = x_cmd(t - delay)", _textbook, "Transport delay of the motion platform.",
    ),
    EffectSpec(
        "platform.lag", "platform", {"bandwidth": _positive("Hz", (2.0, 400.0))},
        "x'' = w^2 (x_cmd - x) - 1.4 w x', w = 2 pi bandwidth", _textbook,
        "Second-order response of the platform, damping ratio 0.7.",
    ),
    EffectSpec(
        "platform.backlash", "platform", {"width": _size("m", (0.0, 2e-3), "whole play")},
        "x = min(max(x, x_cmd - width/2), x_cmd + width/2)", "play operator",
        "Play that is crossed at each reversal.",
    ),
    EffectSpec(
        "platform.friction", "platform", {"stick": _size("m", (0.0, 1e-3))},
        "x holds until |x_cmd - x| > stick, then x = x_cmd, and holds again", "stiction",
        "The platform moves in jumps.",
    ),
    EffectSpec(
        "platform.mode", "platform", {"frequency": _positive("Hz", (2.0, 400.0)), "damping_ratio": _positive("-", (0.002, 0.5), high=1.0)},
        "x'' = w^2 (x_cmd - x) + 2 zeta w (x_cmd' - x')", "base-excited structural mode",
        "A lightly damped mode between drive and port.",
    ),
    EffectSpec(
        "platform.scale", "platform", {"factor": _positive("-", (0.8, 1.25)), "axis": _choice(AXES, "z", "axis of translation")},
        "x_axis = factor x_cmd_axis", "geometric calibration error", "One axis of translation is scaled.",
    ),
    EffectSpec(
        "platform.speed_limit", "platform", {"speed": _positive("m/s", (1e-3, 1.0))},
        "|x'| <= speed", "actuator limit", "Each axis follows no faster than a limit.",
    ),
    EffectSpec(
        "dynamics.mass", "dynamics", {"factor": _factor, "body": _body},
        "m -> factor m in the numerical model", _textbook, "The numerical model's mass is not the one believed.",
    ),
    EffectSpec(
        "dynamics.inertia", "dynamics", {"factor": _factor, "body": _body},
        "I -> factor I in the numerical model", _textbook, "The numerical model's inertia is not the one believed.",
    ),
    EffectSpec(
        "dynamics.port_offset", "dynamics",
        {"offset": ParameterSpec("m", "vector", size=3, low=-10.0, high=10.0, fit=(-0.5, 0.5)), "body": _body},
        "port position += offset (body axes) in the numerical model", _textbook,
        "The numerical model has the port in another place: a wrong lever arm.",
    ),
    EffectSpec(
        "dynamics.appendage", "dynamics",
        {
            "mass_ratio": _positive("-", (0.005, 0.6), high=1.0),
            "frequency": _positive("Hz", (0.05, 20.0)),
            "damping_ratio": ParameterSpec("-", low=0.0, high=1.0, fit=(0.001, 0.5), log=True),
            "body": _body,
        },
        "m_a q'' = -k_a q - d_a q' - m_a a_body, m_a = mass_ratio m, k_a = m_a (2 pi f)^2", "slosh or flexible panel, pendulum model",
        "A part of the body's mass hangs on a spring.",
    ),
    EffectSpec(
        "dynamics.step_delay", "dynamics", {"ticks": ParameterSpec("-", "integer", low=0.0, high=100.0, fit=(1.0, 12.0))},
        "pose_cmd is `ticks` rows late", "loop transport", "Whole ticks of extra transport in the numerical model.",
    ),
    EffectSpec(
        "dynamics.integrator", "dynamics", {"scheme": _choice(("explicit_euler",), "explicit_euler", "first-order scheme")},
        "pose with the old twist, then the twist", "explicit Euler", "The integrator adds energy: it acts as one step of delay.",
    ),
    EffectSpec(
        "loop.deadzone", "compensation", {"width": _positive("N", (0.2, 60.0))},
        "f_axis = 0 where |f_axis| < width, before the compensation", "guard against drift of the numerical model",
        "Small forces are not passed on to the numerical model.",
    ),
    EffectSpec(
        "log.skew", "log", {"delay": _size("s", (0.0, 0.03), high=1.0)},
        "logged w_meas(t) = w_meas(t - delay)", _textbook,
        "The force record is stamped late; the loop itself is untouched.",
    ),
)  # fmt: skip

EFFECTS: dict[str, EffectSpec] = {spec.id: spec for spec in _TABLE}
