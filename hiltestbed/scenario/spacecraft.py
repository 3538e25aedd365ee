"""The vehicles of a scenario and how they meet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, model_validator

from hiltestbed.validation import Positive, Strictly, Vector2, Vector3, refuse

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
