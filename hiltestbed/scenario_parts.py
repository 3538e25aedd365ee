"""The hardware of a scenario and how it meets: vehicles, approach, mechanism, rig, sensor, limits; every key with unit and default."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from hiltestbed.validation import NotNegative, Positive, Strictly, Vector2, Vector3, refuse

MECHANISMS_BUILT = ("bumper", "probe_cone", "latched")  # the kinds that the rig has a model of
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
