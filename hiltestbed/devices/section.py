"""The section ``devices`` of a scenario: how a real sensor and a real platform are mounted, and what is allowed of them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hiltestbed.devices.watch import CommunicationLimits
from hiltestbed.validation import NotNegative, Positive, Strictly, Vector3

_NONE = (0.0, 0.0, 0.0)


class Placed(Strictly):
    """A pose, of what and in what the key says."""

    position: Vector3 = Field(default=_NONE, description="Origin [m]")
    attitude_deg: Vector3 = Field(default=_NONE, description="Attitude [deg]: turns about the fixed x, then y, then z axis")


class SensorDevice(Strictly):
    """How the force sensor is mounted, and how it is tared."""

    position: Vector3 = Field(default=_NONE, description="Origin of the sensor's own frame, in P [m]")
    attitude_deg: Vector3 = Field(
        default=_NONE, description="Attitude of the sensor's own frame in P [deg]: turns about the fixed x, then y, then z axis"
    )
    sign: Literal[1, -1] = Field(
        default=1, description="Sign of the reading. 1: what the active side exerts on the passive one; -1: the reaction"
    )
    tare: NotNegative = Field(default=0.25, description="Time over which its reading is averaged and taken for zero before the start [s]")


class PlatformDevice(Strictly):
    """How the platform is mounted, and how it is brought to the start of a run."""

    base: Placed = Field(default=Placed(), description="Pose of the platform's base frame in P")
    tool: Placed = Field(default=Placed(), description="Pose of A in the platform's tool frame")
    travel_speed: Positive = Field(default=0.05, description="Highest speed on the way to the start [m/s]")
    travel_rate_deg: Positive = Field(default=5.0, description="Highest angular velocity on the way to the start [deg/s]")
    run_up: Annotated[float, Field(gt=0, le=10)] = Field(
        default=0.5, description="Time in which it gains the approach velocity before the start, and loses its velocity after the end [s]"
    )


class MotionLimits(Strictly):
    """Limits on every commanded pose; null: not watched."""

    position: Positive | None = Field(default=0.5, description="Farthest position from the nominal touch, each axis [m]; null: not watched")
    angle_deg: Positive | None = Field(default=30.0, description="Largest turn of A in P [deg]; null: not watched")
    speed: Positive | None = Field(default=0.5, description="Highest speed of A's origin [m/s]; null: not watched")
    rate_deg: Positive | None = Field(default=45.0, description="Highest angular velocity of A [deg/s]; null: not watched")
    acceleration: Positive | None = Field(default=20.0, description="Highest acceleration of A's origin [m/s^2]; null: not watched")


class StopBehaviour(Strictly):
    """What the platform is told when a run is stopped."""

    kind: Literal["hold", "retract", "stop"] = Field(
        default="hold",
        description="What it does. hold: the last command stands; retract: backs out along -z of P; stop: the device's own stop",
    )
    distance: Positive = Field(default=0.02, description="Distance of the retraction [m]")
    speed: Positive = Field(default=0.05, description="Highest speed of the retraction [m/s]")


class DeviceWatchdog(Strictly):
    """The process that holds or stops the platform where the loop falls silent."""

    timeout: Annotated[float, Field(ge=0.005, le=10.0)] = Field(default=0.1, description="Silence after which it acts [s]")
    action: Literal["hold", "stop"] = Field(default="hold", description="What it tells the platform")


class Devices(Strictly):
    """Real devices in the place of the simulated rig: for ``live``, ``emulate`` and ``commission``."""

    sensor: SensorDevice = Field(default=SensorDevice(), description="The force sensor")
    platform: PlatformDevice = Field(default=PlatformDevice(), description="The motion platform")
    limits: MotionLimits = Field(default=MotionLimits(), description="Limits on every commanded pose")
    communication: CommunicationLimits = Field(default=CommunicationLimits(), description="Limits on lost, late and faulty records")
    on_stop: StopBehaviour = Field(default=StopBehaviour(), description="What the platform is told when a run is stopped")
    watchdog: DeviceWatchdog | None = Field(
        default=DeviceWatchdog(), description="The process that acts where the loop falls silent; null: none"
    )
