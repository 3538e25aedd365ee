"""Every effect of the vocabulary in a size that shows."""

from __future__ import annotations

from typing import Any

EXAMPLES: dict[str, dict[str, Any]] = {
    "sensor.delay": {"delay": 0.0033},
    "sensor.lag": {"time_constant": 0.004},
    "sensor.highpass": {"time_constant": 0.3},
    "sensor.drift": {"rate": 4.0, "axis": "x"},
    "sensor.bias": {"force": [1.0, -2.0, 3.0], "torque": [0.1, 0.2, -0.3]},
    "sensor.gain": {"factor": 1.1, "axis": "z"},
    "sensor.crosstalk": {"ratio": 0.05, "source": "z", "axis": "ry"},
    "sensor.rotation": {"angles_deg": [1.0, -3.0, 5.0]},
    "sensor.deadzone": {"width": 8.0},
    "sensor.saturation": {"limit": 60.0},
    "sensor.hum": {"frequency": 50.0, "amplitude": 2.0, "phase": 0.4, "axis": "all"},
    "sensor.jitter": {"sigma": 0.0005},
    "contact.stiffness": {"factor": 1.3},
    "contact.damping": {"factor": 0.4},
    "contact.power_law": {"exponent": 1.5, "stiffness": 3.0e6},
    "contact.hunt_crossley": {"alpha": 3.0},
    "contact.dry_friction": {"force": 20.0, "stiffness": 5.0e4},
    "contact.preload": {"force": 15.0},
    "contact.hard_stop": {"position": 2.0e-4, "stiffness": 3.0e5},
    "contact.relaxation": {"stiffness": 4.0e4, "time_constant": 0.02},
    "contact.adhesion": {"force": 30.0},
    "contact.surface_friction": {"coefficient": 0.3},
    "contact.touch_offset": {"offset": -3.0e-4},
    "contact.backlash": {"width": 1.0e-4},
    "contact.misalignment": {"angles_deg": [2.0, -3.0]},
    "frame.compliance": {"stiffness": 5.0e6},
    "frame.mode": {"frequency": 60.0, "damping_ratio": 0.02, "mass": 80.0},
    "platform.delay": {"delay": 0.0033},
    "platform.lag": {"bandwidth": 30.0},
    "platform.backlash": {"width": 1.0e-4},
    "platform.friction": {"stick": 5.0e-5},
    "platform.mode": {"frequency": 25.0, "damping_ratio": 0.05},
    "platform.scale": {"factor": 1.05, "axis": "z"},
    "platform.speed_limit": {"speed": 0.02},
    "platform.drive": {
        "bandwidth": 20.0,
        "damping_ratio": 0.6,
        "friction": 5.0e-5,
        "offset": 1.0e-4,
        "acceleration_limit": 1.0,
    },
    "platform.response": {"step": [[0.0, 0.1], [0.004, 0.6], [0.012, 1.15], [0.03, 1.0]]},
    "dynamics.mass": {"factor": 1.2, "body": "target"},
    "dynamics.inertia": {"factor": 1.4, "body": "chaser"},
    "dynamics.port_offset": {"offset": [0.02, -0.03, 0.01], "body": "chaser"},
    "dynamics.appendage": {
        "mass_ratio": 0.2,
        "frequency": 1.5,
        "damping_ratio": 0.05,
        "body": "target",
    },
    "dynamics.force": {
        "viscous": 40.0,
        "coulomb": 0.5,
        "offset": 0.3,
        "static": 0.8,
        "stribeck_speed": 0.002,
    },
    "dynamics.step_delay": {"ticks": 3},
    "dynamics.integrator": {"scheme": "explicit_euler"},
    "loop.deadzone": {"width": 8.0},
    "log.skew": {"delay": 0.0012},
    "contact.map": {
        "penetration": [[0.0, 0.0], [1.0e-4, 2.0], [3.0e-4, 15.0]],
        "rate": [[-0.02, -30.0], [0.02, 40.0]],
        "stretch": [[-1.0e-5, -6.0], [0.0, 0.0], [1.0e-5, 6.0]],
        "spring": [[0.0, 0.1], [1.0e-4, -0.05], [3.0e-4, 0.1]],
        "spring_rate": [[-0.02, -0.1], [0.0, 0.0], [0.02, 0.1]],
    },
    "sensor.map": {
        "reading": [[-100.0, -100.0], [0.0, 0.0], [50.0, 49.0], [100.0, 90.0]],
        "axis": "z",
    },
}


def example(kind: str) -> dict[str, Any]:
    """An effect as it stands in a scenario."""
    return {"kind": kind} | EXAMPLES[kind]
