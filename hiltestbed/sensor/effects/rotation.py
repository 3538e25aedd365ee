"""The sensor is mounted with a rotation error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, Strict

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.frames import quat_exp, rotation_matrix
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.sensor.parameters import SensorParameters

Angles = Annotated[
    tuple[Annotated[float, Field(ge=-180.0, le=180.0)], ...],
    Strict(False),
    Field(min_length=3, max_length=3),
]
LATERAL = ("angles_deg.0", "angles_deg.1")
ALL = (*LATERAL, "angles_deg.2")


@register
class SensorRotation(Effect):
    """The sensor's frame is rotated against its nominal attitude: force and torque are read along
    other axes.
    """

    kind: Literal["sensor.rotation"] = "sensor.rotation"
    angles_deg: Angles = quantity(
        "deg",
        "Rotation vector of the sensor's true frame in the nominal frame, x, y, z",
        search=(-10.0, 10.0),
    )
    link = "sensor"
    equation = "f = R^T f and tau = R^T tau, R = exp([angles]_x), before gain and crosstalk"
    reference = "mounting error"
    resembles = ("sensor.crosstalk", "contact.misalignment", "contact.surface_friction")
    repeats = True
    leading = "angles_deg"

    def apply(self, p: SensorParameters) -> None:
        quaternion = np.empty(4)
        quat_exp(np.radians(np.array(self.angles_deg, dtype=float)), quaternion)
        p.calibration[:] = p.calibration @ np.kron(np.eye(2), rotation_matrix(quaternion).T)

    @classmethod
    def hypothesis(cls, variant: Mapping[str, Any], **values: Any) -> Self:
        """Angles that are not searched are zero."""
        return super().hypothesis(variant, angles_deg=(*values["angles_deg"], 0.0, 0.0, 0.0)[:3])

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """About the lateral axes, and about all three: a rotation about z shows only in lateral
        loads and must justify its parameter.
        """
        return (candidate(cls, {name: [0.0] for name in names}) for names in (LATERAL, ALL))
