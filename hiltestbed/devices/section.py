"""The section ``devices`` of a scenario: mounting of a real sensor and a real platform, and their
limits.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Strictly, Vector3
from hiltestbed.devices.watch import CommunicationLimits

_NONE = (0.0, 0.0, 0.0)


class PlacedPose(Strictly):
    """A pose; the key states of which frame, in which frame."""

    position: Vector3 = Field(default=_NONE, description="Origin [m]")
    attitude_deg: Vector3 = Field(
        default=_NONE,
        description="Attitude [deg]: rotations about the fixed x, then y, then z axis",
    )


class SensorDevice(Strictly):
    """Mounting and taring of the force sensor."""

    position: Vector3 = Field(
        default=_NONE, description="Position of the sensor's own frame in P [m]"
    )
    attitude_deg: Vector3 = Field(
        default=_NONE,
        description="Attitude of the sensor's own frame in P [deg]: rotations about the fixed x, "
        "then y, then z axis",
    )
    sign: Literal[1, -1] = Field(
        default=1,
        description="Sign of the reading. 1: wrench of the active side on the passive side; -1: "
        "the reaction",
    )
    tare: NotNegative = Field(
        default=0.25, description="Averaging time of the tare before the start [s]"
    )


class PlatformDevice(Strictly):
    """Mounting of the platform, and its motion to the start of a run."""

    base: PlacedPose = Field(
        default=PlacedPose(), description="Pose of the platform's base frame in P"
    )
    tool: PlacedPose = Field(
        default=PlacedPose(), description="Pose of A in the platform's tool frame"
    )
    travel_speed: Positive = Field(
        default=0.05, description="Highest speed on the way to the start [m/s]"
    )
    travel_rate_deg: Positive = Field(
        default=5.0, description="Highest angular velocity on the way to the start [deg/s]"
    )
    run_up: Annotated[float, Field(gt=0, le=10)] = Field(
        default=0.5,
        description="Time to accelerate to the approach velocity before the start, and to "
        "decelerate after the end [s]",
    )


class MotionLimits(Strictly):
    """Limits on every commanded pose; null: no limit."""

    position: Positive | None = Field(
        default=0.5,
        description="Largest distance from the nominal touch, per axis [m]; null: no limit",
    )
    angle_deg: Positive | None = Field(
        default=30.0, description="Largest rotation of A in P [deg]; null: no limit"
    )
    speed: Positive | None = Field(
        default=0.5, description="Highest speed of A's origin [m/s]; null: no limit"
    )
    rate_deg: Positive | None = Field(
        default=45.0, description="Highest angular velocity of A [deg/s]; null: no limit"
    )
    acceleration: Positive | None = Field(
        default=20.0, description="Highest acceleration of A's origin [m/s^2]; null: no limit"
    )
    time_offset: Positive | None = Field(
        default=0.02,
        description="Largest difference between model time and wall time in any cycle, since the "
        "platform was armed [s]; null: 1 s. A clock that is 100 ppm off needs 200 s for the "
        "default",
    )


class StopBehaviour(Strictly):
    """Behaviour of the platform when a run is stopped."""

    kind: Literal["hold", "retract", "stop"] = Field(
        default="hold",
        description="Kind of stop. hold: keeps the last commanded pose; retract: moves back along "
        "-z of P; stop: the device's own stop",
    )
    distance: Positive = Field(default=0.02, description="Distance of the retraction [m]")
    speed: Positive = Field(default=0.05, description="Highest speed of the retraction [m/s]")


class DeviceWatchdog(Strictly):
    """The watchdog process, which holds or stops the platform when the loop no longer responds."""

    timeout: Annotated[float, Field(ge=0.005, le=10.0)] = Field(
        default=0.1, description="Time without a heartbeat after which it acts [s]"
    )
    action: Literal["hold", "stop"] = Field(
        default="hold", description="Command that it sends to the platform"
    )


class Devices(Strictly):
    """Real devices in place of the simulated rig, for ``live``, ``emulate`` and ``commission``."""

    sensor: SensorDevice = Field(default=SensorDevice(), description="The force sensor")
    platform: PlatformDevice = Field(default=PlatformDevice(), description="The motion platform")
    limits: MotionLimits = Field(
        default=MotionLimits(), description="Limits on every commanded pose"
    )
    communication: CommunicationLimits = Field(
        default=CommunicationLimits(), description="Limits on lost, late and faulty records"
    )
    on_stop: StopBehaviour = Field(
        default=StopBehaviour(), description="Behaviour of the platform when a run is stopped"
    )
    watchdog: DeviceWatchdog | None = Field(
        default=DeviceWatchdog(),
        description="Watchdog process, which acts when the loop no longer responds; null: none",
    )
