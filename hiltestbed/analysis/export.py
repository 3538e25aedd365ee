"""The extended model of a diagnosis as MJCF: what MuJoCo can say of it, and what it cannot.

Of one axis see :mod:`hiltestbed.axis.mjcf`, of an arm :mod:`hiltestbed.axis.arm_mjcf`. Of a docking
rig both vehicles float, a ball on a plate stands for the mechanism with its stiffness, damping and
friction as solref and solimp, and a platform that departs from its nominal response is an axis of
its own beside them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from hiltestbed.analysis.mujoco_contact import RADIUS, mujoco_parameters
from hiltestbed.analysis.spring_damper import SpringDamper, reduced_mass
from hiltestbed.axis.arm_mjcf import arm_mjcf
from hiltestbed.axis.dataset import ArmDataset, AxisDataset, arm_of, is_axis
from hiltestbed.axis.mjcf import axis_mjcf, axis_model, listed, mjcf_text, number
from hiltestbed.build import runnable_from
from hiltestbed.config.validation import validate
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.errors import InputError
from hiltestbed.platform.effects.response import LAG_DAMPING
from hiltestbed.scenario.spacecraft import Approach

DIAGNOSIS, EXTENDED = "diagnosis.json", "extended.yaml"
LIGHT = 1e-6  # [kg] of the active port, on which the sensor reads the force
STEPS = 200  # of a contact: its CoR is then right to 1e-3
# effects on the platform that are those of a servo, by the parameters that they share
ON_PLATFORM = {
    "platform.delay": ("delay",),
    "platform.lag": ("bandwidth",),
    "platform.drive": (
        "bandwidth",
        "damping_ratio",
        "friction",
        "offset",
        "acceleration_limit",
        "integral_time",
        "static",
    ),
    "platform.backlash": ("width",),
    "platform.scale": ("factor",),
    "platform.speed_limit": ("speed",),
}


@dataclass(frozen=True)
class Exported:
    """An MJCF file: its text, what it says of the extended model, and what it cannot say."""

    text: str
    said: tuple[str, ...]
    unsaid: tuple[str, ...]


def export_mjcf(folder: Path, file: Path) -> Exported:
    """Write the extended model of a diagnosis folder to an MJCF file.

    Raises InputError if the folder is no diagnosis, names no cause, or the file exists.
    """
    if file.exists():
        raise InputError(f"{file}: exists already; choose another name")
    found = exported(folder)
    try:
        with file.open("x", encoding="utf-8") as opened:
            opened.write(found.text)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from error
    return found


def exported(folder: Path) -> Exported:
    """The extended model of a diagnosis folder. Raises InputError."""
    missing = [name for name in (DIAGNOSIS, EXTENDED) if not (folder / name).is_file()]
    if missing:
        raise InputError(
            f"{folder}: is no diagnosis (it lacks {' and '.join(missing)}); allowed is a folder "
            f"that `hiltestbed diagnose` has written"
        )
    try:
        about = json.loads((folder / DIAGNOSIS).read_text(encoding="utf-8"))
        extended, verdict = about["extended_scenario"], about["verdict"]
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"{folder / DIAGNOSIS}: is not that of a diagnosis ({error})") from error
    if not extended:
        raise InputError(
            f"{folder}: names no cause (verdict {verdict}), so that there is no extended model"
        )
    head = [f"Extended model of the diagnosis {about.get('name', '')}, written by hiltestbed."]
    source = read_source(folder / EXTENDED)
    if is_axis(source):
        if source.data["axis"] == "arm":
            spec = validate(ArmDataset, source)
            found = arm_mjcf(arm_of(spec, source), spec.effects, head)
        else:
            found = axis_mjcf(validate(AxisDataset, source), head)
        text, said, unsaid = found
        return Exported(text, tuple(said), tuple(unsaid))
    return _rig(source, head)


def _rig(source: Source, head: Sequence[str]) -> Exported:
    s, said, unsaid, servo = runnable_from(source), [], [], []
    factors = {"k": 1.0, "c": 1.0}
    mass = {"chaser": s.spacecraft.chaser.mass, "target": s.spacecraft.target.mass}
    inertia = {b: [*getattr(s.spacecraft, b).inertia, 0.0, 0.0, 0.0][:6] for b in mass}
    ports = {b: list(getattr(s.spacecraft, b).port.position) for b in mass}
    friction, delay, limit = s.mechanism.contact.friction, s.sensor.delay, None
    for e in s.effects:
        kind, p = e.kind, e.model_dump()
        if kind in ("contact.stiffness", "contact.damping"):
            factors["k" if kind.endswith("stiffness") else "c"] *= p["factor"]
        elif kind == "contact.surface_friction":
            friction = p["coefficient"]
        elif kind == "dynamics.mass":
            mass[p["body"]] *= p["factor"]
        elif kind == "dynamics.inertia":
            inertia[p["body"]] = [p["factor"] * i for i in inertia[p["body"]]]
        elif kind == "dynamics.port_offset":
            moved = zip(ports[p["body"]], p["offset"], strict=True)
            ports[p["body"]] = [a + b for a, b in moved]
        elif kind == "sensor.delay":
            delay += p["delay"]
        elif kind == "sensor.saturation":
            limit = p["limit"] if limit is None else min(limit, p["limit"])
        elif kind in ON_PLATFORM and p.get("axis", "all") in ("all", "z"):
            given = {name: p[name] for name in ON_PLATFORM[kind]}
            lag = {"kind": "platform.drive", "damping_ratio": LAG_DAMPING}  # that of a servo
            servo.append((lag if kind == "platform.lag" else {"kind": kind}) | given)
        else:
            unsaid.append(f"{_stated(e)}. {EFFECTS[e.kind].meaning()}")
            continue
        said.append(_stated(e))
    contact = SpringDamper(
        factors["k"] * s.mechanism.contact.stiffness,
        factors["c"] * s.mechanism.contact.damping,
        reduced_mass(mass["chaser"], mass["target"]),
    )
    step = min(1.0 / s.physics_rate, contact.contact_time / STEPS)
    # what is believed of the rig and is not in the file
    unsaid.append(f"the surfaces of the {s.mechanism.kind}: a ball on a plate stands for them")
    unsaid += ["the compliance of the mount"] if s.mechanism.mount is not None else []
    unsaid.append(f"the nominal drives of the platform {s.rig.platform.kind}, and the compensation")
    turned = [b for b in mass if any(getattr(s.spacecraft, b).port.attitude_deg)]
    turned += ["approach"] if any((*s.approach.attitude_deg, *s.approach.rate_deg)) else []
    unsaid += [f"the attitude of {', '.join(turned)}"] if turned else []
    if s.sensor.lowpass or s.sensor.time_constant:
        unsaid.append("the nominal filter of the sensor")
    platform = None
    if servo:
        spec = {"axis": "servo", "runs": [{"file": "-"}], "effects": servo}
        platform = axis_model(AxisDataset.model_validate(spec))
        step = min(step, platform.step)
        said += [f"platform: {text}" for text in platform.said]
        unsaid += [f"platform: {text}" for text in platform.unsaid]
    vehicles = [
        _vehicle(name, mass[name], inertia[name], ports[name], part)
        for name, part in (("chaser", _ball()), ("target", _plate()))
    ]
    sections = {
        "worldbody": [*vehicles, *(platform.body() if platform else ())],
        "contact": [_pair(contact, friction, vehicles)],
        "tendon": platform.tendons if platform else [],
        "actuator": platform.actuators if platform else [],
        "sensor": [_sensor(delay, limit, step), *([platform.sensor()] if platform else ())],
        "keyframe": [_start(s.approach, ports, 1 + len(platform.bodies) if platform else 0)],
    }
    option = f'<option timestep="{number(step)}" integrator="implicitfast" gravity="0 0 0"/>'
    return Exported(mjcf_text(option, sections, head, said, unsaid), tuple(said), tuple(unsaid))


def _stated(e: Effect) -> str:
    given = e.model_dump(exclude={"kind"}, exclude_none=True)
    return f"{e.kind}: {', '.join(f'{name} {value}' for name, value in given.items())}"


def _vehicle(
    name: str, mass: float, inertia: Sequence[float], port: Sequence[float], part: str
) -> str:
    """A vehicle that floats; ``port`` [m] from its centre of mass, six of ``inertia`` [kg m^2]."""
    inertial = f'mass="{number(mass)}" fullinertia="{listed(inertia)}"'
    return (
        f'<body name="{name}"><freejoint/><inertial pos="0 0 0" {inertial}/>'
        f'<body name="{name}_port" pos="{listed(port)}">{part}</body></body>'
    )


def _ball() -> str:
    """The foremost point of the ball is the origin of A, at which the sensor is."""
    light = f'mass="{LIGHT}" diaginertia="{LIGHT} {LIGHT} {LIGHT}"'
    return (
        f'<inertial pos="0 0 0" {light}/><geom name="A" type="sphere" size="{RADIUS}" '
        f'pos="0 0 -{RADIUS}" contype="0" conaffinity="0"/><site name="A"/>'
    )


def _plate() -> str:
    """The face of the plate holds the origin of P."""
    return (
        f'<geom name="P" type="box" size="0.5 0.5 {RADIUS}" pos="0 0 {RADIUS}" mass="0" '
        f'contype="0" conaffinity="0"/>'
    )


def _pair(contact: SpringDamper, friction: float, vehicles: Sequence[str]) -> str:
    """The contact for the mass that MuJoCo takes for the reduced one: of bodies off the centre of
    mass it is an estimate, by which solref is multiplied.
    """
    text = mjcf_text("", {"worldbody": vehicles}, (), (), ())
    model = mujoco.MjModel.from_xml_string(text)
    inverse = sum(float(model.body_invweight0[model.geom(g).bodyid[0], 0]) for g in "AP")
    taken = SpringDamper(contact.stiffness, contact.damping, 1.0 / inverse)
    given = mujoco_parameters(taken)
    slides = f' condim="3" friction="{friction} {friction}"' if friction else ' condim="1"'
    return (
        f'<pair geom1="A" geom2="P" solref="{listed(given.solref)}" '
        f'solimp="{listed(given.solimp)}"{slides}/>'
    )


def _sensor(delay: float, limit: float | None, step: float) -> str:
    """The force of the active on the passive side: MuJoCo's is that of a body on its child."""
    late = ""
    if delay:
        count = math.ceil(delay / step) + 1
        late = f' delay="{number(delay)}" nsample="{count}" interp="linear"'
    cut = "" if limit is None else f' cutoff="{number(limit)}"'
    return f'<force name="wrench" site="A"{late}{cut}/>'


def _start(approach: Approach, ports: dict[str, list[float]], joints: int) -> str:
    """The approach: P at the origin, A before it; ``joints`` of the platform at zero."""
    here = (*approach.offset, -approach.gap)
    chaser = [a - b for a, b in zip(here, ports["chaser"], strict=True)]
    upright, rest = [1.0, 0.0, 0.0, 0.0], [0.0] * joints
    target = [-x for x in ports["target"]]
    place = listed([*chaser, *upright, *target, *upright, *rest])
    speed = listed([*approach.velocity, *[0.0] * 9, *rest])
    return f'<key name="approach" qpos="{place}" qvel="{speed}"/>'
