"""What a run is: every key of a scenario file, its unit, its default and the checks that refuse what cannot be right.

`load_scenario` reads a file (and `--set` overrides), `dump_scenario` writes the resolved form, in which every default stands.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hiltestbed.effects.vocabulary import EFFECTS
from hiltestbed.validation import Problem, Strictly, Vector2, Vector3, nearest, refuse, validate
from hiltestbed.yaml_source import Source, describe, read_source

WORKSPACE_TRANSLATION = 0.25  # [m] the platform's reach from home, any axis; home is at the nominal first touch
WORKSPACE_ROTATION_DEG = 10.0
UPPER_SPEED = 0.3  # [m/s] up to which the upper platform is clamped before the touch
TICK_LIMIT = 20_000_000  # a trace of this many rows fills 16 GB
MECHANISMS_BUILT = ("bumper", "probe_cone", "latched")  # the kinds that the rig has a model of

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
_ORIGIN = (0.0, 0.0, 0.0)


class Port(Strictly):
    """Pose of a docking port in its body; its z axis points along the insertion."""

    position: Vector3 = Field(default=_ORIGIN, description="origin of the port in the body [m], from the centre of mass")
    attitude_deg: Vector3 = Field(default=_ORIGIN, description="roll, pitch, yaw about the body's fixed x, y, z [deg]")


class Body(Strictly):
    """One vehicle as the numerical model believes it to be."""

    mass: Positive = Field(description="[kg]")
    inertia: Annotated[tuple[float, ...], Field(strict=False, min_length=3, max_length=6)] = Field(
        description="about the centre of mass, body axes [kg m^2]: xx, yy, zz or xx, yy, zz, xy, xz, yz"
    )
    port: Port = Port()

    @model_validator(mode="after")
    def _inertia_is_possible(self) -> Body:
        refuse((("inertia",), message) for message in _inertia_faults(self.inertia))
        return self


def _inertia_faults(inertia: tuple[float, ...]) -> Iterator[str]:
    """A rigid body's principal moments are positive and no one exceeds the sum of the other two."""
    if len(inertia) not in (3, 6):
        yield f"has the wrong length (got {len(inertia)} items); allowed is 3 (the diagonal) or 6 (xx, yy, zz, xy, xz, yz)"
        return
    import numpy as np

    xx, yy, zz, xy, xz, yz = (*inertia, 0.0, 0.0, 0.0)[:6]
    low, mid, high = (float(p) for p in np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    moments = f"principal moments {low:g}, {mid:g}, {high:g}"
    if low <= 0:
        yield f"is not positive definite (got {moments}); allowed are moments > 0"
    elif high > (low + mid) * (1 + 1e-9):
        yield f"breaks the triangle inequality (got {moments}); allowed is no moment above the sum of the other two"


class Spacecraft(Strictly):
    """Both vehicles: the chaser carries the active port A, the target the passive port P."""

    chaser: Body
    target: Body


class Approach(Strictly):
    """Where the active port starts, relative to the passive one, and how it moves."""

    gap: float = Field(default=0.01, description="distance from the nominal first touch along the insertion [m]; the start is at pz = -gap")
    velocity: Vector3 = Field(description="relative velocity of A's origin, in P [m/s]")
    offset: Vector2 = Field(default=(0.0, 0.0), description="lateral start position, px and py [m]")
    attitude_deg: Vector3 = Field(default=_ORIGIN, description="start attitude of A in P: roll, pitch, yaw about fixed x, y, z [deg]")
    rate_deg: Vector3 = Field(default=_ORIGIN, description="angular velocity of A relative to P, in P [deg/s]")


class Contact(Strictly):
    """Contact of the mechanism's surfaces: F = stiffness x + damping v, never pulling in a bumper or a cone."""

    stiffness: Positive = Field(description="[N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    friction: Annotated[float, Field(ge=0, le=2)] = Field(default=0.0, description="Coulomb coefficient [-]")


class Mount(Strictly):
    """Compliance of the passive side between the mechanism and the sensor: x, y, z, rx, ry, rz."""

    stiffness: Annotated[tuple[Positive, ...], Field(strict=False, min_length=6, max_length=6)] = Field(
        description="3 x [N/m], 3 x [N m/rad]"
    )
    damping: Annotated[tuple[NotNegative, ...], Field(strict=False, min_length=6, max_length=6)] = Field(
        default=(0.0,) * 6, description="3 x [N s/m], 3 x [N m s/rad]"
    )


class Latch(Strictly):
    """When the latches of a probe in its cone close: all three hold at once. From then on the mechanism pulls as well as pushes."""

    depth: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.004, description="the tip is within this of the nominal touch, pz >= -depth [m]"
    )
    angle_deg: Annotated[float, Field(gt=0, le=30)] = Field(default=5.0, description="angle between the axes of both sides [deg]")
    speed: Positive = Field(default=0.02, description="relative speed of A's origin [m/s]")


class Mechanism(Strictly):
    """The docking mechanism: what touches what."""

    kind: Literal["bumper", "probe_cone", "latched"] = "bumper"
    contact: Contact
    mount: Mount | None = Field(default=None, description="null: rigid")
    latch: Latch | None = Field(default=None, description="of probe_cone: captures; null: none")

    @model_validator(mode="after")
    def _is_built(self) -> Mechanism:
        if self.latch is not None and self.kind != "probe_cone":
            refuse([(("latch",), f"belongs to a probe_cone (got kind {self.kind!r}); allowed: null")])
        if self.kind not in MECHANISMS_BUILT:
            built = ", ".join(MECHANISMS_BUILT)
            refuse([(("kind",), f"is a mechanism that the rig has no model of yet (got {self.kind!r}); allowed: {built}")])
        return self


class Actuator(Strictly):
    """The drive of each slider of the platform, and the friction that each of its motors works against.

    The numbers are those of a preloaded screw with its guide: 0.5 % of the 40 kN that a drive gives, break-away 1.5 times that, the
    Stribeck speed of oiled steel, and a viscous part that equals the sliding one at 0.5 m/s.
    """

    kind: Literal["ideal", "single", "dual"] = Field(
        default="ideal",
        description="ideal: no friction; single: one motor; dual: two summed by a differential screw, each kept turning by bias_speed",
    )
    coulomb: NotNegative = Field(default=200.0, description="sliding friction [N]")
    stiction: NotNegative = Field(default=300.0, description="break-away [N], at least coulomb")
    stribeck_speed: Positive = Field(default=0.005, description="speed at which the break-away excess has fallen to 1/e [m/s]")
    viscous: NotNegative = Field(default=400.0, description="[N s/m]")
    bias_speed: Positive = Field(default=0.3, description="of each of the two motors at rest, in terms of the slider [m/s]; dual alone")

    @model_validator(mode="after")
    def _breaks_away(self) -> Actuator:
        if self.stiction < self.coulomb:
            refuse([(("stiction",), f"is less than coulomb (got {self.stiction:g} N); allowed is {self.coulomb:g} N and more")])
        return self


class Platform(Strictly):
    """The motion platform and how it follows."""

    kind: Literal["pss33"] = "pss33"
    tracking: Literal["servo", "ideal"] = Field(default="servo", description="ideal: the pose reaches the command exactly, one tick later")
    actuator: Actuator = Field(default=Actuator(), description="with tracking servo")


class UpperPlatform(Strictly):
    """What carries the passive side and the force sensor."""

    kind: Literal["fixed", "prs3"] = Field(
        default="fixed", description="prs3: heave of 2 m and two tilts while the ports are more than 0.19 m apart, clamped below that"
    )
    tracking: Literal["servo", "ideal"] = Field(default="servo", description="of prs3; ideal: it is where it is planned to be")


class Rig(Strictly):
    """The physical side."""

    platform: Platform = Platform()
    upper: UpperPlatform = UpperPlatform()


class Sensor(Strictly):
    """The force and torque sensor below the passive port, in the order of its chain."""

    delay: NotNegative = Field(default=0.0, description="pure delay [s], any length, not only whole ticks")
    lowpass: Positive | None = Field(default=None, description="cut-off of the first-order low-pass [Hz]; null: none")
    time_constant: Positive | None = Field(default=None, description="of the charge amplifier's high-pass [s]; null: none")
    noise: NotNegative = Field(default=0.0, description="1 sigma of each force axis [N]")
    torque_noise: NotNegative = Field(default=0.0, description="1 sigma of each torque axis [N m]")
    drift: Vector3 = Field(default=_ORIGIN, description="linear drift of the force axes [N/s]")
    quantisation: NotNegative = Field(default=0.0, description="step of the force reading [N]; 0: none")
    torque_quantisation: NotNegative = Field(default=0.0, description="step of the torque reading [N m]; 0: none")
    range: Positive | None = Field(default=None, description="each force axis clips here [N]; null: none")
    torque_range: Positive | None = Field(default=None, description="each torque axis clips here [N m]; null: none")


class Safety(Strictly):
    """Limits past which the run stops; null: not watched."""

    stroke: Positive | None = Field(default=0.72, description="of a slider from home [m]; the travel of the 3-3 PSS platform's")
    speed: Positive | None = Field(default=2.0, description="of a slider [m/s]")
    acceleration: Positive | None = Field(default=None, description="of a slider [m/s^2]")
    limb_angle_deg: Positive | None = Field(
        default=50.0, description="between a link and its slider [deg]; past it the drives lose their grip"
    )
    tracking_error: Positive | None = Field(default=None, description="distance between the pose commanded and reached [m]")
    force: Positive | None = Field(default=5.0e4, description="on the sensor [N]")
    torque: Positive | None = Field(default=5.0e4, description="on the sensor, at P's origin [N m]")
    energy: Positive | None = Field(default=None, description="that the rig may create in a run [J]")


class NoForceCompensation(Strictly):
    """The numerical model is driven with the measured wrench as it is."""

    kind: Literal["none"] = "none"


class PhaseLead(Strictly):
    """(T1 s + 1)/(T2 s + 1) on the measured wrench."""

    kind: Literal["phase_lead"] = "phase_lead"
    lead: NotNegative | None = Field(default=None, description="T1 [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 [s]")


class SecondOrderLead(Strictly):
    """The Taylor expansion of exp(delay s) to its second term, over (T2 s + 1)^2."""

    kind: Literal["second_order_lead"] = "second_order_lead"
    lag: Positive = Field(default=0.0005, description="T2 [s]")


class Polynomial(Strictly):
    """Polynomial through the last samples a delay apart, extrapolated by the delay."""

    kind: Literal["polynomial"] = "polynomial"
    order: Annotated[int, Field(ge=1, le=5)] = Field(default=3, description="of the polynomial")


class Reconstruction(Strictly):
    """F_meas + M(x, v) - M(x, v at t - delay), M as identified so far; an axis without an estimate passes the lead."""

    kind: Literal["reconstruction"] = "reconstruction"
    lead: NotNegative | None = Field(default=None, description="T1 of the lead [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]")


class SmithPredictor(Strictly):
    """The same with a contact that is given, along the insertion."""

    kind: Literal["smith_predictor"] = "smith_predictor"
    stiffness: Positive = Field(description="of the contact as predicted [N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    lead_rest: bool = Field(default=False, description="what the prediction does not explain passes the phase lead")
    lead: NotNegative | None = Field(default=None, description="T1 of the lead [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]")


class VirtualContact(Strictly):
    """A virtual spring and damper along the insertion, beside the measured force."""

    kind: Literal["virtual_contact"] = "virtual_contact"
    stiffness: NotNegative = Field(default=0.0, description="[N/m]")
    damping: NotNegative = Field(description="[N s/m]; the contact's stiffness times the delay gives back what the delay takes")


class CorDesigned(Strictly):
    """A virtual damper along the insertion, designed for a desired coefficient of restitution."""

    kind: Literal["cor_designed"] = "cor_designed"
    stiffness: Positive = Field(description="of the contact that it is designed for [N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    cor: Positive | None = Field(default=None, description="desired; null: that of the contact without a delay")


class DeadZone(Strictly):
    """A force below the width is taken as none."""

    kind: Literal["dead_zone"] = "dead_zone"
    width: NotNegative = Field(description="[N]")


class PassivityControl(Strictly):
    """Time-domain passivity observer and controller."""

    kind: Literal["passivity_control"] = "passivity_control"


class NormalisedPassivity(Strictly):
    """Damping by the normalised power that the delay creates."""

    kind: Literal["normalised_passivity"] = "normalised_passivity"
    gain: NotNegative = Field(default=1.0, description="of the damping force; 1 balances the delay to first order")
    smoothing: Positive = Field(default=0.005, description="time constant of the power's low-pass [s]")


class KnownContact(Strictly):
    """A contact that was identified before."""

    stiffness: Positive = Field(description="[N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    touch: float = Field(default=0.0, description="where along the insertion it is touched first [m]")


class Resynchronised(Strictly):
    """The numerical model at t - delay, driven by the measured wrench as what it is, and predicted from there."""

    kind: Literal["resynchronised"] = "resynchronised"
    contact: KnownContact | None = Field(default=None, description="null: nothing is known of it, it is identified as it is met")
    delay: Literal["known", "estimate"] = Field(default="known", description="estimate: correct sensor.delay by the instant of first touch")
    blending: Positive = Field(default=0.002, description="time constant with which a corrected prediction reaches the platform [s]")


class NoMotionCompensation(Strictly):
    """The platform is commanded with the pose alone."""

    kind: Literal["none"] = "none"


class Feedforward(Strictly):
    """Velocity and acceleration feed-forward of the platform's servo."""

    kind: Literal["feedforward"] = "feedforward"


class InverseModel(Strictly):
    """The commanded pose passes the inverse of the platform's response, (1 + T s)(1 + 2 zeta s/w + s^2/w^2), cut after an order."""

    kind: Literal["inverse_model"] = "inverse_model"
    order: Annotated[int, Field(ge=1, le=3)] = Field(default=2, description="highest derivative of the command that is used")
    bandwidth: Positive = Field(default=40.0, description="w/2 pi of the platform [Hz]")
    damping_ratio: Positive = Field(default=1.0, description="zeta of the platform")
    time_constant: NotNegative = Field(default=0.0, description="T, of what makes its response third-order [s]")


class AdaptiveTimeSeries(Strictly):
    """The commanded pose passes a0 x + a1 x' + a2 x'', fitted to what the platform made of its last commands."""

    kind: Literal["adaptive_time_series"] = "adaptive_time_series"
    window: Positive = Field(default=1.0, description="memory of the fit [s]")
    delay: NotNegative = Field(default=0.008, description="of the platform as believed at the start [s]")


class Admittance(Strictly):
    """Feed-forward, and a platform that yields along the insertion where the contact as identified would press harder than a limit."""

    kind: Literal["admittance"] = "admittance"
    limit: Positive = Field(description="of the contact force [N]")
    speed: Positive = Field(default=0.1, description="with which the platform yields at most [m/s]")


class ContactCorrection(Strictly):
    """The force is corrected for where the platform is not: + k (x_cmd - x_act) + c (v_cmd - v_act), k and c as identified."""

    kind: Literal["contact_correction"] = "contact_correction"


ForceCompensation = Annotated[
    NoForceCompensation
    | PhaseLead
    | SecondOrderLead
    | Polynomial
    | Reconstruction
    | SmithPredictor
    | VirtualContact
    | CorDesigned
    | DeadZone
    | PassivityControl
    | NormalisedPassivity
    | Resynchronised,
    Field(discriminator="kind"),
]
MotionCompensation = Annotated[
    NoMotionCompensation | Feedforward | Admittance | InverseModel | AdaptiveTimeSeries | ContactCorrection, Field(discriminator="kind")
]


class Compensation(Strictly):
    """What is done against the delays of the loop."""

    force: ForceCompensation = Resynchronised()
    motion: MotionCompensation = Feedforward()


class NoIdentification(Strictly):
    """Stiffness and damping are not estimated."""

    kind: Literal["none"] = "none"


class Rls(Strictly):
    """Recursive least squares of k and c on each axis, in contact alone, with the pose at the time the force was felt."""

    kind: Literal["rls"] = "rls"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")
    delay: Literal["known", "estimate"] = Field(default="known", description="estimate: sensor.delay is found from the instant of touch")


class RlsRaw(Strictly):
    """The same on the force as it is read, beside the pose of the same tick."""

    kind: Literal["rls_raw"] = "rls_raw"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")


class RlsLead(Strictly):
    """The same on the force after the first-order phase lead."""

    kind: Literal["rls_lead"] = "rls_lead"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]; T1 is sensor.delay + T2")


class Kalman(Strictly):
    """Adaptive Kalman filter of k, c and an intercept that wander, on aligned samples."""

    kind: Literal["kalman"] = "kalman"
    wander: NotNegative = Field(default=1e-6, description="part of an innovation's correction that is taken for wandering")


class HuntCrossley(Strictly):
    """Single-stage fit of F = k x^n (1 + alpha v), on aligned samples."""

    kind: Literal["hunt_crossley"] = "hunt_crossley"


class Instrumental(Strictly):
    """Batch least squares with instrument variables, on aligned samples: the yardstick where the pose is noisy."""

    kind: Literal["instrumental"] = "instrumental"
    lag: Annotated[int, Field(ge=1)] = Field(default=2, description="ticks by which the instruments are older than the samples")


Identification = Annotated[NoIdentification | Rls | RlsRaw | RlsLead | Kalman | HuntCrossley | Instrumental, Field(discriminator="kind")]


class Scenario(Strictly):
    """One run: two vehicles, how they meet, the rig that plays it, and what is done about the rig's faults."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    duration: Positive = Field(default=3.0, description="[s]")
    rate: Annotated[float, Field(gt=0, le=1e6)] = Field(default=2000.0, description="passes of the loop [Hz]")
    physics_rate: Annotated[float, Field(gt=0, le=4e6)] = Field(
        default_factory=lambda given: 2.0 * given["rate"],  # type: ignore[arg-type]
        description="steps of the physics [Hz], a whole multiple of rate; left out: twice rate",
    )
    spacecraft: Spacecraft
    approach: Approach
    mechanism: Mechanism
    rig: Rig = Rig()
    sensor: Sensor = Sensor()
    compensation: Compensation = Compensation()
    identification: Identification = Rls()
    safety: Safety = Safety()
    effects: Annotated[tuple[dict[str, Any], ...], Field(strict=False)] = Field(
        default=(), description="departures from the nominal rig: {kind: ID, parameter: value}"
    )

    @property
    def tick(self) -> float:
        """Time between two passes of the loop [s]."""
        return 1.0 / self.rate

    @property
    def ticks(self) -> int:
        """Passes of the loop in the whole run."""
        return round(self.duration * self.rate)

    @property
    def substeps(self) -> int:
        """Steps of the physics in one tick."""
        return round(self.physics_rate / self.rate)

    @model_validator(mode="before")
    @classmethod
    def _complete_effects(cls, data: Any) -> Any:
        """Each effect with its defaults written out; a faulty one stays as it is, `_is_possible` says why."""
        if not isinstance(data, dict) or not isinstance(data.get("effects"), (list, tuple)):
            return data
        return data | {"effects": [_complete(entry) for entry in data["effects"]]}

    @model_validator(mode="after")
    def _is_possible(self) -> Scenario:
        refuse([*_rate_problems(self), *_delay_problems(self), *_start_problems(self), *_effect_problems(self.effects)])
        return self


def _complete(entry: Any) -> Any:
    spec = EFFECTS.get(str(entry.get("kind"))) if isinstance(entry, dict) else None
    given = {name: value for name, value in entry.items() if name != "kind"} if spec else {}
    if spec is None or spec.faults(given):
        return entry
    resolved = {name: list(value) if isinstance(value, tuple) else value for name, value in spec.complete(given).items()}
    return {"kind": spec.id} | {name: _number(spec.parameters[name].kind, value) for name, value in resolved.items()}


def _number(kind: str, value: Any) -> Any:
    """One way to write a number, so that 1 and 1.0 give the same hash."""
    if kind == "vector":
        return [float(item) for item in value]
    if kind == "number":
        return float(value)
    return int(value) if kind == "integer" else value


def _rate_problems(scenario: Scenario) -> Iterator[Problem]:
    ratio = scenario.physics_rate / scenario.rate
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        near = max(1, round(ratio)) * scenario.rate
        yield (
            ("physics_rate",),
            (
                f"does not divide by rate (got {scenario.physics_rate:g} Hz over {scenario.rate:g} Hz = {ratio:g}); "
                f"allowed is a whole multiple of rate, such as {near:g}"
            ),
        )
    if not 1 <= scenario.duration * scenario.rate <= TICK_LIMIT:
        yield (
            ("duration",),
            (
                f"is out of range (got {scenario.duration:g} s at {scenario.rate:g} Hz = {scenario.duration * scenario.rate:g} ticks); "
                f"allowed are 1 to {TICK_LIMIT} ticks"
            ),
        )


def _delay_problems(scenario: Scenario) -> Iterator[Problem]:
    if scenario.sensor.delay > scenario.duration:
        yield (
            ("sensor", "delay"),
            (f"cannot be held (got {scenario.sensor.delay:g} s in a run of {scenario.duration:g} s); allowed is 0 to the run's duration"),
        )


def _start_problems(scenario: Scenario) -> Iterator[Problem]:
    """The platform reaches WORKSPACE_TRANSLATION and WORKSPACE_ROTATION_DEG around the nominal first touch, and no further."""
    approach, reach, turn = scenario.approach, WORKSPACE_TRANSLATION, WORKSPACE_ROTATION_DEG
    if scenario.rig.upper.kind == "prs3":
        yield from _nine_axis_problems(scenario)
        return
    lowest = -reach if scenario.mechanism.kind == "latched" else 0.0
    limits = [(("approach", "gap"), approach.gap, lowest, reach, "m")]
    limits += [(("approach", "offset", axis), value, -reach, reach, "m") for axis, value in enumerate(approach.offset)]
    limits += [(("approach", "attitude_deg", axis), value, -turn, turn, "deg") for axis, value in enumerate(approach.attitude_deg)]
    for path, value, low, high, unit in limits:
        if not low <= value <= high:
            yield path, f"starts outside the workspace (got {value:g} {unit}); allowed is {low:g} to {high:g} {unit}"


def _nine_axis_problems(scenario: Scenario) -> Iterator[Problem]:
    """With the upper platform the gap may be as long as its heave; the lower platform's part of the start must be in its workspace."""
    import numpy as np

    from hiltestbed.frames import quat_from_attitude_deg, rotation_vectors
    from hiltestbed.rig.allocation import LONGEST, lower_pose

    approach = scenario.approach
    lowest = -WORKSPACE_TRANSLATION if scenario.mechanism.kind == "latched" else 0.0
    if not lowest <= approach.gap <= LONGEST:
        yield ("approach", "gap"), f"starts outside the workspace (got {approach.gap:g} m); allowed is {lowest:g} to {LONGEST:g} m"
        return
    if not abs(approach.velocity[2]) <= UPPER_SPEED:
        yield (
            ("approach", "velocity", 2),
            f"is faster than the upper platform comes to rest before the touch (got {approach.velocity[2]:g} m/s); "
            f"allowed is -{UPPER_SPEED:g} to {UPPER_SPEED:g} m/s",
        )
    pose = np.array([[*approach.offset, -approach.gap, *quat_from_attitude_deg(approach.attitude_deg)]])
    lower = lower_pose(pose)
    place, turn = np.abs(lower[0, :3]), np.degrees(np.abs(rotation_vectors(lower[:, 3:])[0]))
    if not (place.max() <= WORKSPACE_TRANSLATION and turn.max() <= WORKSPACE_ROTATION_DEG):
        where = ", ".join(f"{value:.3g}" for value in lower[0, :3])
        yield (
            ("approach",),
            f"starts outside the workspace (the lower platform would stand at {where} m, turned by up to {turn.max():.3g} deg); allowed "
            f"are {WORKSPACE_TRANSLATION:g} m and {WORKSPACE_ROTATION_DEG:g} deg on each axis: take a smaller offset or attitude_deg",
        )


def _effect_problems(effects: tuple[dict[str, Any], ...]) -> Iterator[Problem]:
    for index, entry in enumerate(effects):
        where = ("effects", index)
        kind = entry.get("kind")
        if kind is None:
            yield (*where, "kind"), "is missing; an effect is {kind: ID, parameter: value}"
        elif not isinstance(kind, str) or kind not in EFFECTS:
            yield (*where, "kind"), f"unknown effect{nearest(str(kind), EFFECTS)} (got {describe(kind)}); allowed: {', '.join(EFFECTS)}"
        else:
            given = {name: value for name, value in entry.items() if name != "kind"}
            yield from (((*where, name), message) for name, message in EFFECTS[kind].faults(given))


def load_scenario(path: str | Path, set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in a YAML file, with dotted keys overridden (`{"approach.velocity.2": 0.05}`). Raises InputError."""
    return scenario_from(read_source(path).with_set(set))


def scenario_from(source: Source | Mapping[str, Any], set: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario in data that is read already: a `Source`, or a plain dict as it would stand in a file. Raises InputError."""
    if not isinstance(source, Source):
        source = Source("scenario", dict(source))
    return validate(Scenario, source.with_set(set), _SPECIMEN)


_BODY = {"mass": 1.0, "inertia": [1.0, 1.0, 1.0]}
_SPECIMEN = {  # holds whatever the other keys are: stands in for what is refused while the rest is checked
    "name": "specimen",
    "duration": 1.0,
    "spacecraft": {"chaser": _BODY, "target": _BODY},
    "approach": {"velocity": [0.0, 0.0, 0.0]},
    "mechanism": {"kind": "bumper", "contact": {"stiffness": 1.0}},
}


def resolved(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain data with every default written out; `scenario_from` gives the same scenario back."""
    return scenario.model_dump(mode="json")


def dump_scenario(scenario: Scenario) -> str:
    """The resolved scenario as YAML text."""
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None  # lists of numbers on one line, mappings below each other
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    text = io.StringIO()
    yaml.dump(resolved(scenario), text)
    return text.getvalue()


def scenario_sha256(scenario: Scenario) -> str:
    """SHA-256 of the resolved form, the same however the file was written."""
    canonical = json.dumps(resolved(scenario), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
