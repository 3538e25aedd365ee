"""The physical rig of `n` runs: the platform follows the commanded relative pose, the mechanisms touch, the sensor feels it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.rig.contact import ContactLaw
from hiltestbed.rig.driven import ServoTracking
from hiltestbed.rig.ideal import IdealTracking

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


def structure(scenario: Scenario) -> Hashable:
    """What must be equal in the scenarios of one :class:`Plant`; all other numbers may differ run by run."""
    mechanism = scenario.mechanism
    return (
        scenario.rate,
        scenario.physics_rate,
        mechanism.kind,
        mechanism.contact.friction > 0,
        mechanism.mount is None,
        scenario.rig.platform.kind,
        scenario.rig.platform.tracking,
    )


class Plant:
    """`n` rigs in lockstep. Every array is updated in place: copy what must outlive a tick.

    Attributes, all at t_k:
        pose_act: (n, 7) pose of A in P; twist_act: (n, 6) twist of A relative to P, in P. Ideal tracking: the slope of the pose over
            the tick that ended; servo: the velocity at t_k.
        wrench_sub: (n, m, 6) contact wrench, what the active side exerts on the passive one, in P at P's origin, tared [N, N m],
            at t_(k-1) + (s + 1) dt, s = 0 .. m - 1; the last is at t_k.
        contact: (n,) bool, whether the mechanisms touch.
        slider_cmd, slider_act: (n, 6) the platform's sliders [m], 0 at home.
        diverged: (n,) bool, whether a run has left the finite numbers; it is frozen from then on.
    """

    def __init__(self, scenarios: Sequence[Scenario], nthread: int = 1) -> None:
        if len({structure(s) for s in scenarios}) != 1:
            raise InputError(
                "one Plant takes runs of one structure: the same rate, physics_rate, mechanism.kind, contact.friction > 0 or not, "
                "mechanism.mount given or not, and rig.platform"
            )
        tracking = IdealTracking if scenarios[0].rig.platform.tracking == "ideal" else ServoTracking
        self._tracking = tracking(scenarios, nthread)
        self.pose_act: Array = self._tracking.pose_act
        self.twist_act: Array = self._tracking.twist_act
        self.wrench_sub: Array = self._tracking.wrench_sub
        self.contact: NDArray[np.bool_] = self._tracking.contact_now
        self.slider_cmd: Array = self._tracking.slider_cmd
        self.slider_act: Array = self._tracking.slider_act
        self.diverged: NDArray[np.bool_] = self._tracking.diverged

    @property
    def model(self) -> mujoco.MjModel:
        """The model that is stepped: the bare physics under this plant."""
        return self._tracking.model

    @property
    def contact_law(self) -> ContactLaw | None:
        """A law in place of the linear contact, for all runs; None: F = k x + c v of the scenario."""
        return self._tracking.contact.law

    @contact_law.setter
    def contact_law(self, law: ContactLaw | None) -> None:
        self._tracking.contact.law = law

    def set_friction(self, friction: Array) -> None:
        """Coulomb coefficient ``(n,)`` of each run; the scenarios' own friction must not be zero."""
        self._tracking.contact.set_friction(friction)

    def divergence(self, i: int) -> str:
        """Why run ``i`` diverged: which quantity, and its value."""
        return self._tracking.causes[i]

    def buffers(self) -> dict[str, NDArray[Any]]:
        """The state between two ticks, by name; written back, the rig goes on from there."""
        return self._tracking.buffers() | {"diverged": self.diverged}

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the pose ``(n, 7)`` of A in P with the twist ``(n, 6)``: before t = 0 the approach is uniform."""
        self._tracking.reset(pose, twist)

    def bare_steps(self, count: int) -> None:
        """``count`` steps of the same physics with nothing around them, a call each: what the loop's cost is compared with."""
        self._tracking.bare_steps(count)

    def advance(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """From t_k to t_(k+1): ``pose_cmd`` (n, 7) is to be reached then, with ``twist_cmd`` and ``accel_cmd`` (n, 6)."""
        self._tracking.advance(pose_cmd, twist_cmd, accel_cmd)
