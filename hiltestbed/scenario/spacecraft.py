"""The vehicles of a scenario and their approach."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, model_validator

from hiltestbed.config.validation import Positive, Strictly, Vector2, Vector3, refuse

_ORIGIN = (0.0, 0.0, 0.0)


class Port(Strictly):
    """Pose of a docking port in its body; its z axis points along the insertion."""

    position: Vector3 = Field(
        default=_ORIGIN,
        description="Position of the port relative to the body's centre of mass [m], body axes",
    )
    attitude_deg: Vector3 = Field(
        default=_ORIGIN,
        description="Attitude of the port in the body [deg]: roll, pitch, yaw about the body's "
        "fixed x, y, z",
    )


class Body(Strictly):
    """One vehicle, with its nominal parameters in the numerical model."""

    mass: Positive = Field(description="Mass of the vehicle [kg]")
    inertia: Annotated[tuple[float, ...], Field(strict=False, min_length=3, max_length=6)] = Field(
        description="Moments of inertia about the centre of mass, body axes [kg m^2]: xx, yy, zz "
        "or xx, yy, zz, xy, xz, yz"
    )
    port: Port = Field(
        default=Port(),
        description="Docking port in the body; its z axis points along the insertion",
    )

    @model_validator(mode="after")
    def _inertia_is_possible(self) -> Body:
        refuse((("inertia",), message) for message in _inertia_faults(self.inertia))
        return self


def _inertia_faults(inertia: tuple[float, ...]) -> Iterator[str]:
    """A rigid body's principal moments are positive and no one exceeds the sum of the other two."""
    if len(inertia) not in (3, 6):
        yield (
            f"has the wrong length (got {len(inertia)} items); allowed is 3 (the "
            f"diagonal) or 6 (xx, yy, zz, xy, xz, yz)"
        )
        return
    import numpy as np

    xx, yy, zz, xy, xz, yz = (*inertia, 0.0, 0.0, 0.0)[:6]
    tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    low, mid, high = (float(p) for p in np.linalg.eigvalsh(tensor))
    moments = f"principal moments {low:g}, {mid:g}, {high:g}"
    if low <= 0:
        yield f"is not positive definite (got {moments}); allowed are moments > 0"
    elif high > (low + mid) * (1 + 1e-9):
        yield (
            f"breaks the triangle inequality (got {moments}); allowed is no moment above "
            f"the sum of the other two"
        )


class Spacecraft(Strictly):
    """Both vehicles: the chaser carries the active port A, the target the passive port P."""

    chaser: Body = Field(description="The vehicle that approaches; it carries the active port A")
    target: Body = Field(
        description="The vehicle that is approached; it carries the passive port P"
    )


class Approach(Strictly):
    """Initial pose and velocity of the active port relative to the passive port."""

    gap: float = Field(
        default=0.01,
        description="Initial distance from the nominal first touch, along the insertion [m]: pz = "
        "-gap",
    )
    velocity: Vector3 = Field(
        description="Initial velocity of A's origin relative to P, in P [m/s]"
    )
    offset: Vector2 = Field(
        default=(0.0, 0.0), description="Initial lateral position, px and py [m]"
    )
    attitude_deg: Vector3 = Field(
        default=_ORIGIN,
        description="Initial attitude of A in P [deg]: roll, pitch, yaw about fixed x, y, z",
    )
    rate_deg: Vector3 = Field(
        default=_ORIGIN, description="Initial angular velocity of A relative to P, in P [deg/s]"
    )
