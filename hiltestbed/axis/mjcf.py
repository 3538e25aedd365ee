"""One axis as a small MuJoCo model: what MuJoCo can say of its extended model, and what it cannot.

A drive is a joint with damping, dry friction, a spring and gravity under a motor. A servo is a
joint of unit mass under a position controller (`pid` where it integrates or its speed is limited)
whose control is delayed and filtered by the actuator; play is a second joint behind it. A damper
is a joint whose motion is given. For an arm see :mod:`hiltestbed.axis.arm_mjcf`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.axis import law as of
from hiltestbed.axis import servo
from hiltestbed.axis.dataset import AxisDataset, nominal_of
from hiltestbed.axis.law import AxisLaw
from hiltestbed.axis.models import damper_law, drive_law, servo_numbers
from hiltestbed.frames import Array

STEP = 2.5e-4  # [s] of the simulation, at most
STEPS_A_RADIAN = 50.0  # steps per radian of the fastest response
GRAVITY = 9.81  # [m/s^2] of the model; the moments are exact with any
# [-] impedance of friction and limits: a joint creeps by 1e-4 of the speed that its force would
# give it within a step
HARD = 0.9999
LIGHT = 1e-6  # of the moved mass: of what follows through play
OVERDAMPED = 0.01  # of a step: time in which the mass between a spring and a damper comes to rest


@dataclass
class MjcfModel:
    """A model of one joint under construction.

    Attributes:
        rotates: whether the joint is a hinge. name: of the joint. prefix: of the names of its
            actuators and its sensor. direction: (3,) of the joint in its body's frame. inertia: of
            the joint [kg] or [kg m^2]. pos: centre of mass [m] in the body's frame, for the moment
            of gravity. joint: its attributes. actuators, bodies, tendons: elements. output: joint
            that is the position. mass: of the axis's body [kg]. step: [s]. gravity: [m/s^2], along
            -z. said: what MuJoCo says, and how; unsaid: what it cannot, and why.
    """

    rotates: bool
    name: str = "axis"
    prefix: str = ""
    direction: Sequence[float] = ()
    inertia: float = 1.0
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint: dict[str, float | str] = field(default_factory=dict)
    actuators: list[str] = field(default_factory=list)
    bodies: list[str] = field(default_factory=list)
    tendons: list[str] = field(default_factory=list)
    output: str = ""
    mass: float = 1.0
    step: float = STEP
    gravity: float = 0.0
    said: list[str] = field(default_factory=list)
    unsaid: list[str] = field(default_factory=list)

    def body(self) -> list[str]:
        """The bodies: the axis, and what follows it."""
        about = self.inertia if self.rotates else 1.0
        joint = self.joint_text(self.name, self.joint)
        return [_body(self.name, joint, self.pos, self.mass, about), *self.bodies]

    def option(self) -> str:
        return (
            f'<option timestep="{number(self.step)}" integrator="implicitfast" '
            f'gravity="0 0 {number(-self.gravity or 0.0)}"/>'
        )

    def sensor(self) -> str:
        return f'<jointpos name="{self.prefix}position" joint="{self.output or self.name}"/>'

    def joint_text(self, name: str, attributes: Mapping[str, float | str]) -> str:
        """A joint of the axis's kind; its friction is nearly hard."""
        direction = listed(self.direction or ((0.0, 1.0, 0.0) if self.rotates else (1.0, 0.0, 0.0)))
        kind = f'type="{"hinge" if self.rotates else "slide"}" axis="{direction}"'
        given = {k: number(v) for k, v in attributes.items() if v}
        if "frictionloss" in given:
            given |= {"solreffriction": f"{number(2.0 * self.step)} 1"}
            given |= {"solimpfriction": f"{HARD} {HARD} 0.001"}
        text = " ".join(f'{k}="{v}"' for k, v in given.items())
        return f'<joint name="{name}" {kind} {text}/>'

    def follower(self, name: str, damping: float, inertia: float) -> None:
        """A light body with a joint beside the axis."""
        joint = self.joint_text(name, {"damping": damping})
        self.bodies.append(_body(name, joint, (0.0, 0.0, 0.0), inertia, inertia))

    def motor(self, gain: float) -> None:
        """What drives the joint: its control is the input."""
        self.actuators.append(
            f'<motor name="{self.prefix}input" joint="{self.name}" gear="{number(gain)}"/>'
        )
        self.said.append(
            f"input of the drive: control of the motor, held from row to row, gear {gain:.6g}"
        )

    def load(self, force: float) -> None:
        """A constant force in the positive direction."""
        if force:
            self.actuators.append(
                f'<general name="{self.prefix}load" joint="{self.name}" gainprm="0" '
                f'biastype="affine" biasprm="{number(force)} 0 0"/>'
            )


def _body(name: str, joint: str, pos: Sequence[float], mass: float, about: float) -> str:
    inertial = f'pos="{listed(pos)}" mass="{number(mass)}" diaginertia="{listed([about] * 3)}"'
    return f'<body name="{name}">{joint}<inertial {inertial}/></body>'


def mjcf_text(
    option: str,
    sections: Mapping[str, Sequence[str]],
    head: Sequence[str],
    said: Sequence[str],
    unsaid: Sequence[str],
) -> str:
    """An MJCF file of an option and sections of elements, with a comment at its top: ``head``, what
    the file says, and what it cannot say.
    """
    notes = [*head, "In MuJoCo:", *(f"- {s}" for s in said)]
    notes += ["What MuJoCo cannot say:" if unsaid else "Nothing is left out."]
    notes += [f"- {s}" for s in unsaid]
    lines = ["<!--"]
    # two strokes would end the comment
    lines += ["  " + re.sub("-(?=-)", "- ", note).rstrip("-") for note in notes]
    lines += ["-->", '<mujoco model="extended">', '  <compiler angle="radian"/>', f"  {option}"]
    for name, elements in sections.items():
        if elements:
            lines += [f"  <{name}>", *(f"    {e}" for e in elements), f"  </{name}>"]
    return "\n".join([*lines, "</mujoco>"]) + "\n"


def axis_mjcf(spec: AxisDataset, head: Sequence[str] = ()) -> tuple[str, list[str], list[str]]:
    """The model of an axis as MJCF, what it says, and what it cannot."""
    model = axis_model(spec)
    sections = {
        "worldbody": model.body(),
        "tendon": model.tendons,
        "actuator": model.actuators,
        "sensor": [model.sensor()],
    }
    text = mjcf_text(model.option(), sections, head, model.said, model.unsaid)
    return text, model.said, model.unsaid


def axis_model(spec: AxisDataset) -> MjcfModel:
    """The elements of an axis."""
    model, nominal = MjcfModel(spec.rotates), nominal_of(spec)
    if spec.axis == "servo":
        _servo(model, servo_numbers(nominal, spec.effects))
    elif spec.axis == "drive":
        law = drive_law(nominal, spec.effects)
        n = law.numbers
        model.motor(n[of.GAIN])
        _inertia(model, n[of.MASS], n[of.GRAVITY_SIN], n[of.GRAVITY_COS])
        resistance(model, law)
    else:
        _damper(model, damper_law(nominal, spec.effects))
    return model


def resistance(model: MjcfModel, law: AxisLaw) -> None:
    """Damping, friction, spring and a constant force: of a drive, a damper, a joint of an arm."""
    n = law.numbers
    forward, back = n[of.VISCOUS], n[of.VISCOUS_BACK]
    power = round(n[of.POWER]) if n[of.POWER] in (1.0, 2.0, 3.0) else 1
    if forward or back:
        mean = 0.5 * (forward + back)
        zeros = "0 " * (power - 1)
        model.joint["damping"] = mean if power == 1 else f"{zeros}{number(mean)}"
        model.said.append(f"viscous friction: joint damping {mean:.6g}")
        if forward != back:
            model.unsaid.append(
                f"viscous friction that differs with the direction ({forward:.6g} and {back:.6g}): "
                f"their mean is used"
            )
        if n[of.POWER] != power:
            model.unsaid.append(f"damping with the power {n[of.POWER]:.4g} of the speed: linear")
    ahead, behind = n[of.COULOMB], n[of.COULOMB_BACK]
    if ahead or behind:
        model.joint["frictionloss"] = 0.5 * (ahead + behind)
        model.said.append(f"dry friction: joint frictionloss {0.5 * (ahead + behind):.6g}")
        if ahead != behind:
            model.said.append("dry friction that differs with the direction: its half in the load")
    if n[of.SPRING]:
        model.joint |= {"stiffness": n[of.SPRING], "springref": n[of.REST]}
        model.said.append(f"spring: joint stiffness {n[of.SPRING]:.6g}")
    constant = n[of.OFFSET] + 0.5 * (ahead - behind)
    if constant:
        model.load(-constant)
        model.said.append(f"constant force {-constant:.6g}: the actuator named load")
    for amount, what in (
        (n[of.RISE], "static friction (Stribeck)"),
        (n[of.LOAD], "friction that grows with the transmitted force"),
        (n[of.WAVE], "friction that varies with the position"),
        (n[of.COG], "cogging"),
        (n[of.FADE], "friction that changes with time"),
        (n[of.RAMP], "a force that drifts"),
        (n[of.LAG], "dissipative force that lags (oil column)"),
        (n[of.PLAY], "play in series with a slider"),
        (float(np.isfinite(n[of.KNEE])), "a knee of the damping"),
    ):
        if amount:
            model.unsaid.append(f"{what}: left out")


def _inertia(model: MjcfModel, inertia: float, sine: float, cosine: float) -> None:
    """The moved mass; a weight on a hinge is an eccentric one, of half the inertia."""
    what = "inertia" if model.rotates else "mass"
    model.inertia, model.said = inertia, [*model.said, f"{what}: {inertia:.6g}"]
    model.mass = 1.0 if model.rotates else inertia
    moment = math.hypot(sine, cosine)
    if not moment:
        return
    if not model.rotates:
        model.unsaid.append("gravity that follows the angle, on an axis that slides: left out")
        return
    arm = 0.5 * inertia * GRAVITY / moment
    model.mass, model.gravity = moment / (GRAVITY * arm), GRAVITY
    model.inertia = 0.5 * inertia
    model.pos = (-arm * cosine / moment, 0.0, -arm * sine / moment)
    model.said.append(f"gravity: a centre of mass {arm:.4g} m off the hinge")


def _servo(model: MjcfModel, p: Array) -> None:
    """A unit mass under a position controller, in the coordinate of the output."""
    scale, w = p[servo.SCALE], p[servo.BANDWIDTH]
    first, second, zeta, delay = p[servo.POLE], p[servo.SECOND_POLE], p[servo.ZETA], p[servo.DELAY]
    if w > 0.0:
        model.step = min(STEP, 1.0 / (STEPS_A_RADIAN * w * max(1.0, zeta)))
        square, damping = w * w, 2.0 * zeta * w
        model.said.append(f"controller: {w / (2.0 * math.pi):.6g} Hz on a unit mass")
        if second:
            model.unsaid.append(f"the second pole before a controller ({second:.4g} s): left out")
    else:
        follow = 2.0 * model.step  # the fastest pole that the steps resolve
        one, two = first or follow, second or 0.01 * model.step
        square, damping = 1.0 / (one * two), (one + two) / (one * two)
        first = 0.0
        model.said.append(f"poles of {one:.4g} and {two:.4g} s: a controller on a unit mass")
        if p[servo.POLE] == 0.0:
            model.unsaid.append(f"following without any lag: it lags {min(one, 1.0):.2g} s more")
            if delay >= one:
                delay, model.unsaid[-1:] = delay - one, []
    common = 'name="command" joint="axis"'
    if delay:
        count = math.ceil(delay / model.step) + 1
        common += f' delay="{number(delay)}" nsample="{count}" interp="linear"'
        model.said.append(f"delay: {delay:.6g} s of the actuator's control")
    limit = p[servo.ACCELERATION] * scale * scale
    if math.isfinite(limit):
        common += f' forcerange="{number(-limit)} {number(limit)}"'
        model.said.append("limit of the acceleration: the actuator's forcerange")
    slew, integral, gain = p[servo.SPEED], p[servo.INTEGRAL], square * scale * scale
    gear = f' gear="{number(1.0 / scale)}"' if scale != 1.0 else ""
    if math.isfinite(slew) or math.isfinite(integral):
        if first:
            model.unsaid.append(f"the pole before the controller ({first:.4g} s): left out")
        more = f' slewmax="{number(slew)}"' if math.isfinite(slew) else ""
        more += f' ki="{number(gain / integral)}"' if math.isfinite(integral) else ""
        model.actuators.append(f'<pid {common} input="pos" kp="{number(gain)}"{more}{gear}/>')
        model.said.append("speed limit or integral action: a pid actuator, slewmax and ki")
        if p[servo.OFFSET]:
            model.unsaid.append(
                f"an offset beside a pid actuator: add {p[servo.OFFSET]:.6g} to the position"
            )
    else:
        lag = f' dyntype="filterexact" dynprm="{number(first)}"' if first else ""
        bias = f"{number(gain * p[servo.OFFSET] / scale)} {number(-gain)} 0"
        model.actuators.append(
            f'<general {common}{lag}{gear} gainprm="{number(gain)}" biastype="affine" '
            f'biasprm="{bias}"/>'
        )
        if first:
            model.said.append(f"pole of {first:.4g} s before the controller: filterexact")
        if p[servo.OFFSET]:
            model.said.append(f"offset {p[servo.OFFSET]:.6g}: the actuator's bias")
    if scale != 1.0:
        model.said.append(f"scale {scale:.6g}: the actuator's gear")
    if p[servo.AHEAD] and w > 0.0:
        push = damping * p[servo.AHEAD] * scale
        late = common.partition("forcerange")[0].replace("command", "command_speed").rstrip()
        model.actuators.append(f'<motor {late} gear="{number(push)}"/>')
        model.said.append("feed-forward: a second control, command_speed, the command's speed")
    model.joint["damping"] = damping
    if w > 0.0:
        model.joint["frictionloss"] = square * p[servo.FRICTION] * abs(scale)
        model.load(square * p[servo.LOAD] * scale)
        if p[servo.FRICTION]:
            model.said.append("dry friction: joint frictionloss")
        if p[servo.STATIC] > p[servo.FRICTION]:
            model.unsaid.append("static above dry friction: left out")
    if p[servo.STICK]:
        model.unsaid.append("steps of stiction: left out")
    if p[servo.PLAY]:
        _play(model, p[servo.PLAY] * abs(scale))


def _play(model: MjcfModel, width: float) -> None:
    model.follower("output", LIGHT / (2.0 * model.step), LIGHT)
    half = number(0.5 * width)
    hard = f'solreflimit="{number(2.0 * model.step)} 1" solimplimit="{HARD} {HARD} 0.001"'
    model.tendons.append(
        f'<fixed name="play" range="-{half} {half}" {hard}><joint joint="output" coef="1"/>'
        f'<joint joint="axis" coef="-1"/></fixed>'
    )
    model.output = "output"
    model.said.append(f"play of {width:.6g}: a second joint, output, held by a limited tendon")


def _damper(model: MjcfModel, law: AxisLaw) -> None:
    mass = law.numbers[of.MASS]
    model.said.append(
        "its motion is given: set qpos and qvel of the joint axis at each step, and read the force "
        "as -(qfrc_passive + qfrc_constraint + qfrc_actuator), and the mass times qacc"
    )
    if mass:
        _inertia(model, mass, 0.0, 0.0)
    resistance(model, law)
    for level, stiffness, shape in law.sliders:
        if level:
            model.joint["frictionloss"] = float(model.joint.get("frictionloss", 0.0)) + float(level)
            model.said.append(f"dry friction: joint frictionloss {level:.6g}")
            round_ = "its round corner, exponent" if shape else "the spring in series with it,"
            model.unsaid.append(f"{round_} {shape or stiffness:.4g}: it slips at once")
    for k, (stiffness, relaxed) in enumerate(law.branches):
        if stiffness:
            damping = float(stiffness * relaxed)
            model.follower(f"branch_{k}", damping, OVERDAMPED * damping * model.step)
            model.tendons.append(
                f'<fixed name="branch_{k}" stiffness="{number(stiffness)}">'
                f'<joint joint="axis" coef="1"/><joint joint="branch_{k}" coef="-1"/></fixed>'
            )
            model.said.append(f"relaxation: a tendon to the second joint branch_{k}")


def number(value: float | str) -> str:
    """A number as an attribute."""
    return value if isinstance(value, str) else f"{float(value):.9g}"


def listed(values: Iterable[float]) -> str:
    """Numbers as an attribute."""
    return " ".join(map(number, values))
