"""Interfaces of a compensation in the loop, between the measured wrench and the commanded motion of
the rig.

A *drive* turns the measurements at t_k into the motion that the rig is to reach at t_(k+1). Most
methods correct the wrench and drive the numerical model with it: they are a :class:`ForceBlock`,
called by :class:`hiltestbed.compensation.blocks.ForceDrive`. A method that drives the model in
another way (by a delayed model and a predictor) is a drive itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel

# ``(n, 6)`` each: velocity at t_(k+1), acceleration and jerk over the tick
Derivatives = tuple[Array, Array, Array]


class ForceBlock(Protocol):
    """A method that corrects the wrench."""

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench that drives the numerical model."""
        ...


class ForcePath(NamedTuple):
    """What the force methods of ``n`` runs depend on, beside their settings.

    Attributes:
        rate: of the loop [Hz]. delay: (n,) nominal, of the force [s]. mass: (n,) reduced mass of
            the vehicles [kg]. captures: whether the mechanism captures. model: that is driven.
    """

    rate: float
    delay: Array
    mass: Array
    captures: bool
    model: NumericalModel


class KernelBlock:
    """A :class:`ForceBlock` of one kernel: called with readings, what is ``given``, the output."""

    def __init__(self, kernel: Callable[..., None], readings: Sequence[str], *given: Any) -> None:
        """``readings``: of a :class:`Measurement`. given: settings and state, a row a run."""
        self._kernel = partial(kernel)  # no part of the state, in which arrays are sought
        self._readings, self._given = readings, given
        self._output = np.zeros((len(given[0]), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` the wrench that drives the numerical model."""
        readings = (getattr(measurement, name) for name in self._readings)
        self._kernel(*readings, *self._given, self._output)
        return self._output


@runtime_checkable
class Drive(Protocol):
    """From the measurements at t_k to the motion commanded for t_(k+1).

    Attributes:
        pose: ``(n, 7)`` pose of A in P, commanded.
        twist: ``(n, 6)`` its velocity.
        wrench: ``(n, 6)`` the wrench that explains the numerical model's motion over the tick.
    """

    pose: Array
    twist: Array
    wrench: Array

    def advance(self, measurement: Measurement) -> None:
        """Advance by one tick."""
        ...


class PoseBlock(Protocol):
    """A method that changes the commanded pose.

    Attributes:
        rate: ``(n, 6)`` velocity that it adds to the command, or None.
    """

    rate: Array | None

    def command(
        self, pose: Array, derivatives: Derivatives, measurement: Measurement, out: Array
    ) -> None:
        """Write to ``out`` (n, 7) the pose commanded to the platform.

        Args:
            pose: ``(n, 7)`` pose of A in P that is to be reached at t_(k+1).
            measurement: the measurements at t_k.
        """
        ...
