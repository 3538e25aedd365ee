"""The settings of a soft-capture ring on six legs in place of springs and dampers.

The legs are linear actuators between the base and the ring, in pairs (a Stewart platform). Each has
a load cell, and a loop that makes its force follow a command with a lag of the first order (its
bandwidth). The command is that of an impedance, by virtual work: leg forces f and generalised
forces tau of the ring's six joints q satisfy tau = J^T f, with J = dl/dq of the legs' lengths l.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly, refuse
from hiltestbed.frames import Array
from hiltestbed.signals import AXES

RING = "ring"  # the body, and the beginning of the names of its joints, in the active side's file
JOINTS = tuple(f"{RING}_{axis}" for axis in AXES)
LEGS = tuple(f"leg_{k}" for k in range(6))
AXIAL = 2  # z among the axes
# phases that have a law of their own, in their order, and that which ends the last
LAWS = ("capture", "attenuation", "alignment", "retraction")
STAGES = (*LAWS, "hard_capture")

Six = Annotated[tuple[NotNegative, ...], Field(strict=False, min_length=6, max_length=6)]
_AXES = "of x, y, z, rx, ry, rz, 3 x"
_STIFFNESS = f"Virtual stiffness {_AXES} [N/m] and 3 x [N m/rad]"
_DAMPING = f"Virtual damping {_AXES} [N s/m] and 3 x [N m s/rad]"


def _six(default: tuple[float, ...], description: str) -> Any:
    return Field(default=default, description=description)


class RingActuators(Strictly):
    """The six legs. Base and ring have three pairs of joints each, at 0, 120 and 240 deg on the
    base, at 60, 180 and 300 deg on the ring; a leg goes from one of a base's pair to the nearer one
    of the next pair on the ring.
    """

    base_radius: Positive = Field(default=0.60, description="Circle of the joints on the base [m]")
    ring_radius: Positive = Field(default=0.58, description="Circle of the joints on the ring [m]")
    base_half_angle_deg: Annotated[float, Field(gt=0, lt=60)] = Field(
        default=15.0,
        description="Half the angle between the joints of a pair on the base [deg]",
    )
    ring_half_angle_deg: Annotated[float, Field(gt=0, lt=60)] = Field(
        default=15.0,
        description="Half the angle between the joints of a pair on the ring [deg]",
    )
    height: Positive = Field(
        default=0.37, description="Height of the ring's joints over those of the base at rest [m]"
    )
    bandwidth: Positive = Field(
        default=20.0, description="Bandwidth of a leg's force loop [Hz], a lag of the first order"
    )
    force: Positive = Field(
        default=850.0,
        description="Largest force of a leg [N]; beyond it all six are reduced alike, so that the "
        "wrench keeps its direction",
    )
    stroke: Positive = Field(
        default=0.15, description="Stroke of a leg to either side of its length at rest [m]"
    )

    @property
    def joints(self) -> Array:
        """``(2, 6, 3)`` joints on base and ring [m], from the middle of the ring's at rest."""
        side, pair = np.tile([1.0, -1.0], 3), np.repeat([0.0, 120.0, 240.0], 2)
        base = np.radians(pair + side * self.base_half_angle_deg)
        ring = np.radians(pair + side * (60.0 - self.ring_half_angle_deg))
        return np.array(
            [
                [radius * np.cos(at), radius * np.sin(at), np.full(6, height)]
                for radius, at, height in (
                    (self.base_radius, base, -self.height),
                    (self.ring_radius, ring, 0.0),
                )
            ]
        ).transpose(0, 2, 1)

    def lengths(self, along: float = 0.0) -> Array:
        """``(6,)`` lengths [m] of the legs with the ring moved ``along`` its axis [m]."""
        base, ring = self.joints
        return np.linalg.norm(ring - base + np.array([0.0, 0.0, along]), axis=1)


class CaptureLaw(Strictly):
    """Impedance of the ring until the latches have caught: mass x'' + damping x' + stiffness x,
    beside the ring's own inertia; x is its deflection from rest.
    """

    stiffness: Six = _six((1500.0, 1500.0, 2000.0, 250.0, 250.0, 250.0), _STIFFNESS)
    damping: Six = _six((350.0, 350.0, 540.0, 60.0, 60.0, 60.0), _DAMPING)
    mass: Six = Field(
        default=(0.0,) * 6,
        description=f"Virtual inertia beside the ring's own, {_AXES} [kg] and 3 x [kg m^2]; a load "
        "cell behind the ring cannot make it lighter",
    )


class AttenuationLaw(CaptureLaw):
    """Impedance from soft capture until the relative motion has died down."""

    stiffness: Six = _six((300.0, 300.0, 400.0, 60.0, 60.0, 60.0), _STIFFNESS)
    damping: Six = _six((360.0, 360.0, 800.0, 200.0, 200.0, 200.0), _DAMPING)
    timeout: Positive = Field(
        default=60.0, description="Time [s] after which the phase counts as not ended"
    )


class AlignmentLaw(AttenuationLaw):
    """Impedance about a reference that moves to the centre, square to the base."""

    stiffness: Six = _six((4000.0, 4000.0, 4000.0, 1500.0, 1500.0, 1500.0), _STIFFNESS)
    damping: Six = _six((1300.0, 1300.0, 2500.0, 1000.0, 1000.0, 1000.0), _DAMPING)
    speed: Positive = Field(
        default=0.01, description="Highest speed of the reference along x, y and z [m/s]"
    )
    turn_rate_deg: Positive = Field(
        default=0.5, description="Highest rate of the reference about x, y and z [deg/s]"
    )


class RetractionLaw(AlignmentLaw):
    """Impedance about a reference that is drawn in along z, until the hard-capture interface is
    seated; from then on it stands still.
    """

    stiffness: Six = _six((4000.0, 4000.0, 20000.0, 1500.0, 1500.0, 1500.0), _STIFFNESS)
    damping: Six = _six((1300.0, 1300.0, 5600.0, 1000.0, 1000.0, 1000.0), _DAMPING)
    speed: Positive = Field(
        default=0.005, description="Highest speed of the reference along x, y and z [m/s]"
    )
    depth: Positive = Field(
        default=0.11,
        description="Way of the reference from rest [m]; the flanges meet after 0.103 m, the rest "
        "is taken by the stiffness of legs and latches in series, and presses them together",
    )


class ActiveRing(Strictly):
    """An active soft-capture ring. Raises for impedances that would make energy."""

    legs: RingActuators = Field(default=RingActuators(), description="The six legs")
    capture: CaptureLaw = Field(
        default=CaptureLaw(), description="Law from the start until the latches have caught"
    )
    attenuation: AttenuationLaw = Field(
        default=AttenuationLaw(), description="Law until the relative motion has died down"
    )
    alignment: AlignmentLaw = Field(
        default=AlignmentLaw(), description="Law until the ring is centred and square"
    )
    retraction: RetractionLaw = Field(
        default=RetractionLaw(), description="Law until the hard-capture interface is seated"
    )

    @property
    def laws(self) -> tuple[CaptureLaw, ...]:
        """The law of each phase of :data:`LAWS`."""
        return self.capture, self.attenuation, self.alignment, self.retraction

    @model_validator(mode="after")
    def _possible(self) -> ActiveRing:
        refuse(list(self._problems()))
        return self

    def _problems(self) -> Iterator[Problem]:
        legs = self.legs
        rest = legs.lengths()
        if (short := float(rest.min())) <= legs.stroke:
            yield (
                ("legs", "stroke"),
                f"is longer than a leg at rest ({short:.3g} m); allowed is less",
            )
        if legs.base_half_angle_deg + legs.ring_half_angle_deg == 60.0:  # all in radial planes
            yield (
                ("legs", "base_half_angle_deg"),
                "the legs cannot hold the ring in roll; both half-angles together must not be "
                "60 deg",
            )
        way = float((rest - legs.lengths(-self.retraction.depth)).max())
        if way >= legs.stroke:
            yield (
                ("retraction", "depth"),
                f"shortens a leg by {way:.3g} m, its stroke is {legs.stroke:.3g} m; take a longer "
                f"stroke, or a smaller depth",
            )
        # a lag 1/w of the force takes stiffness/w from the damping at low frequencies
        lag = 1.0 / (2.0 * math.pi * self.legs.bandwidth)
        for name, law in zip(LAWS, self.laws, strict=True):
            for j, (k, c) in enumerate(zip(law.stiffness, law.damping, strict=True)):
                if c < k * lag:
                    yield (
                        (name, "damping", j),
                        f"the legs' lag makes energy of so little damping; allowed is at least "
                        f"{k * lag:.4g}, the stiffness over 2 pi legs.bandwidth",
                    )
