"""The limits section of a scenario: conditions of the first contact and loads on the interface,
with which a run is compared. A run beyond them goes on; what stops one is `safety`.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from hiltestbed.config.validation import Strictly
from hiltestbed.measured.units import UNITS, unit_named

PARTS = ("approach", "soft_capture", "hard_capture")
LEAST = "closing_speed_min"  # the only limit that a value must not be below

# International Docking System Standard, Interface Definition Document, Rev. F: initial contact
# conditions and largest docking loads, as far as they are known here. The force of soft capture is
# that of its tension, taken for both directions; shear and torsion have none.
STANDARDS: dict[str, dict[str, dict[str, str]]] = {
    "idss": {
        "approach": {
            "closing_speed_min": "0.05 m/s",
            "closing_speed_max": "0.10 m/s",
            "lateral_speed": "0.04 m/s",
            "pitch_yaw_rate": "0.20 deg/s",
            "roll_rate": "0.20 deg/s",
            "lateral_offset": "0.10 m",
            "pitch_yaw": "4 deg",
            "roll": "4 deg",
        },
        "soft_capture": {"compression": "3900 N", "tension": "3900 N", "bending": "2800 N m"},
        "hard_capture": {"compression": "17700 N", "tension": "17700 N", "bending": "68700 N m"},
    }
}


def in_si(text: str, si: str) -> float | None:
    """``text``, a number with a unit, in the unit ``si``; None if it is not.

    >>> in_si("3.9 kN", "N"), in_si("3900", "N")
    (3900.0, None)
    """
    found = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*)", text)
    factor = found and UNITS[si].get(unit_named(found[2]) or "")
    try:
        return float(found[1]) * factor if found and factor else None
    except ValueError:  # 1.2.3
        return None


def _limit(si: str, value: Any) -> str:
    size = in_si(value, si) if isinstance(value, str) else None
    if size is None:
        allowed = f"a number with its unit, such as 1 {si}; units: {', '.join(UNITS[si])}"
        raise PydanticCustomError(
            "unit", "is no number with a unit of this quantity; allowed is {it}", {"it": allowed}
        )
    if size <= 0.0:
        raise PydanticCustomError(
            "sign",
            "is no magnitude; allowed is > 0: its direction is in the name of the key, "
            "compression pushes and tension pulls",
        )
    return value


Speed = Annotated[str, BeforeValidator(partial(_limit, "m/s"))]
Length = Annotated[str, BeforeValidator(partial(_limit, "m"))]
Angle = Annotated[str, BeforeValidator(partial(_limit, "rad"))]
Rate = Annotated[str, BeforeValidator(partial(_limit, "rad/s"))]
Force = Annotated[str, BeforeValidator(partial(_limit, "N"))]
Torque = Annotated[str, BeforeValidator(partial(_limit, "N m"))]


def _bound(what: str) -> Any:
    return Field(default=None, description=f"{what}, with its unit")


class ApproachLimits(Strictly):
    """Limits of pose and motion of A in P at the first contact."""

    closing_speed_min: Speed | None = _bound("Lowest speed along the insertion")
    closing_speed_max: Speed | None = _bound("Highest speed along the insertion")
    lateral_speed: Speed | None = _bound("Highest speed across the insertion")
    pitch_yaw_rate: Rate | None = _bound("Highest angular rate across the insertion")
    roll_rate: Rate | None = _bound("Highest angular rate about the insertion")
    lateral_offset: Length | None = _bound("Largest distance of A from the z axis of P")
    pitch_yaw: Angle | None = _bound("Largest angle between the z axes of A and P")
    roll: Angle | None = _bound("Largest angle about the insertion")


class LoadLimits(Strictly):
    """Limits of the physical wrench at P's origin."""

    compression: Force | None = _bound("Largest force that pushes along the insertion")
    tension: Force | None = _bound("Largest force that pulls along the insertion")
    shear: Force | None = _bound("Largest force across the insertion")
    bending: Torque | None = _bound("Largest torque across the insertion")
    torsion: Torque | None = _bound("Largest torque about the insertion")


UNIT = dict.fromkeys(ApproachLimits.model_fields, "m/s") | {
    "pitch_yaw_rate": "rad/s",
    "roll_rate": "rad/s",
    "lateral_offset": "m",
    "pitch_yaw": "rad",
    "roll": "rad",
    "compression": "N",
    "tension": "N",
    "shear": "N",
    "bending": "N m",
    "torsion": "N m",
}


class DockingLimits(Strictly):
    """Limits of the approach and of the loads on the interface, for a verdict on the run."""

    standard: Literal["idss"] | None = Field(
        default=None,
        description="Limits of a standard, which those given below replace one by one: idss, the "
        "International Docking System Standard; null: only those given",
    )
    approach: ApproachLimits = Field(
        default=ApproachLimits(), description="At the first contact; null: no limit"
    )
    soft_capture: LoadLimits = Field(
        default=LoadLimits(),
        description="Loads until the structural latches close; null: no limit",
    )
    hard_capture: LoadLimits = Field(
        default=LoadLimits(),
        description="Loads from then on: the last latch of a mechanism that closes several, or "
        "captured from the start; null: no limit",
    )

    def each(self) -> dict[tuple[str, str], float]:
        """Part and quantity of every limit that is set, to its value in the unit of `UNIT`."""
        texts = {
            (part, name): getattr(getattr(self, part), name)
            or STANDARDS.get(self.standard or "", {}).get(part, {}).get(name)
            for part in PARTS
            for name in type(getattr(self, part)).model_fields
        }
        sizes = {key: in_si(text, UNIT[key[1]]) for key, text in texts.items() if text}
        return {key: size for key, size in sizes.items() if size is not None}
