"""The physical rig of `n` runs: the platform follows the commanded relative pose, the mechanisms touch, the sensor feels it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hiltestbed.effects.access import effects_of
from hiltestbed.effects.contact import FRICTION, TILT_X, TILT_Y, ContactForce
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.rig.contact import ContactLaw
from hiltestbed.rig.driven import ServoTracking
from hiltestbed.rig.ideal import IdealTracking
from hiltestbed.rig.latch import LatchCondition
from hiltestbed.rig.model import Structure
from hiltestbed.rig.nine_axes import NineAxes
from hiltestbed.rig.touch import Touch

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


def structure(scenario: Scenario, law: bool = False) -> Structure:
    """What the rig of a scenario is made of; ``law``: a contact law of its own acts in place of the linear contact."""
    mechanism = scenario.mechanism
    mounted = mechanism.mount is not None
    plain = mechanism.kind == "bumper" and mechanism.contact.friction == 0.0 and not effects_of(scenario, "contact")
    return Structure(mechanism.kind, mounted, paired=plain and not mounted and not law)


def alike(scenario: Scenario) -> Hashable:
    """What must be equal in the scenarios of one :class:`Plant`; all other numbers may differ run by run."""
    platform, upper = scenario.rig.platform, scenario.rig.upper
    above = (upper.kind, upper.tracking if upper.kind != "fixed" else None)
    return (scenario.rate, scenario.physics_rate, structure(scenario), platform.kind, platform.tracking, above)


class Plant:
    """`n` rigs in lockstep. Every array is updated in place: copy what must outlive a tick.

    Attributes, all at t_k:
        pose_act: (n, 7) pose of A in P; twist_act: (n, 6) twist of A relative to P, in P. Ideal tracking: the slope of the pose over
            the tick that ended; servo: the velocity at t_k.
        wrench_sub: (n, m, 6) contact wrench, what the active side exerts on the passive one, in P at P's origin, tared [N, N m],
            at t_(k-1) + (s + 1) dt, s = 0 .. m - 1; the last, at t_k, may stand only after :meth:`begin` where a run is `late`.
        contact: (n,) bool, whether the mechanisms touch. captured: (n,) bool, whether they are latched to each other.
        slider_cmd, slider_act: (n, 6) the platform's sliders [m], 0 at home. upper_cmd, upper_act: (n, 3) those of the upper one.
        pose_W: (n, 7) pose of A in W, which is P without an upper platform.
        diverged: (n,) bool, whether a run has left the finite numbers; it is frozen from then on.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        nthread: int = 1,
        contact_law: ContactLaw | None = None,
        late: NDArray[np.bool_] | None = None,
    ) -> None:
        """The rigs of `n` runs.

        Args:
            contact_law: in place of the scenarios' own contact along the normal, their effects included.
            late: (n,) runs that do not need the wrench at t_k before the tick begins there, which costs less; none by default.
        """
        if len({alike(s) for s in scenarios}) != 1:
            raise InputError(
                "one Plant takes runs of one structure: the same rate, physics_rate, rig.platform, rig.upper and mechanism.kind; "
                "mechanism.mount, contact.friction > 0 and effects of the contact in all or in none"
            )
        above, made_of = scenarios[0].rig.upper.kind == "prs3", structure(scenarios[0], contact_law is not None)
        lower: IdealTracking | ServoTracking
        if scenarios[0].rig.platform.tracking == "ideal":
            lower = IdealTracking(scenarios, nthread, made_of)
        else:
            lower = ServoTracking(scenarios, nthread, made_of, late)
        self._tracking = NineAxes(scenarios, lower, nthread) if above else lower
        self.pose_W: Array = lower.pose_act
        self._law: ContactForce | None = None
        self._latch: LatchCondition | None = None
        if self._tracking.touch is not None:
            self._set_law(scenarios, contact_law)
            if any(s.mechanism.latch for s in scenarios):
                self._latch = LatchCondition(scenarios)
        self.pose_act: Array = self._tracking.pose_act
        self.twist_act: Array = self._tracking.twist_act
        self.wrench_sub: Array = self._tracking.wrench_sub
        self.contact: NDArray[np.bool_] = self._tracking.contact_now
        touch = self._tracking.touch
        self.captured: NDArray[np.bool_] = touch.latched if touch is not None else np.zeros(len(scenarios), dtype=bool)
        self.slider_cmd: Array = self._tracking.slider_cmd
        self.slider_act: Array = self._tracking.slider_act
        still = np.zeros((len(scenarios), 3))
        self.upper_cmd: Array = self._tracking.upper_cmd if isinstance(self._tracking, NineAxes) else still
        self.upper_act: Array = self._tracking.upper_act if isinstance(self._tracking, NineAxes) else still
        self.diverged: NDArray[np.bool_] = self._tracking.diverged

    @property
    def model(self) -> mujoco.MjModel:
        """The model that is stepped: the bare physics under this plant."""
        return self._tracking.model

    def _set_law(self, scenarios: Sequence[Scenario], contact_law: ContactLaw | None) -> None:
        """The given law, or that of the scenarios' effects; their friction and the tilt of the passive port with it."""
        touch = self._tracking.touch
        assert touch is not None
        touch.law = contact_law
        law = ContactForce(scenarios)
        if contact_law is None and law.active:
            touch.law = self._law = law
            touch.friction[:] = law.parameters[:, FRICTION]
            tilts = Rotation.from_euler("xyz", np.column_stack([law.parameters[:, [TILT_X, TILT_Y]], np.zeros(len(scenarios))]))
            self._tracking.mount.tilt[:, 3:] = tilts.as_quat()

    def contacts(self) -> Touch:
        """Where tip and rod touch; of a plain bumper there is no more to know than the force."""
        if self._tracking.touch is None:
            raise InputError("a bumper without friction, mount or effects of the contact touches in MuJoCo's own contact")
        return self._tracking.touch

    def payload_left(self, i: int) -> dict[str, float] | None:
        """What of the passive side's weight and inertia has been left in the reading of run ``i``; None where it has not moved."""
        return self._tracking.payload_left(i) if isinstance(self._tracking, NineAxes) else None

    def divergence(self, i: int) -> str:
        """Why run ``i`` diverged: which quantity, and its value."""
        return self._tracking.causes[i]

    def buffers(self) -> dict[str, NDArray[Any]]:
        """The state between two ticks, by name; written back, the rig goes on from there."""
        law = {f"law_{name}": array for name, array in self._law.buffers().items()} if self._law else {}
        return self._tracking.buffers() | law | {"diverged": self.diverged}

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the pose ``(n, 7)`` of A in P with the twist ``(n, 6)``: before t = 0 the approach is uniform."""
        self._tracking.reset(pose, twist)

    def bare_steps(self, count: int) -> None:
        """``count`` steps of the same physics with nothing around them, a call each: what the loop's cost is compared with."""
        self._tracking.bare_steps(count)

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Set out from t_k for t_(k+1): ``pose_cmd`` (n, 7) is to be reached then, with ``twist_cmd`` and ``accel_cmd`` (n, 6).

        All attributes stay those at t_k; from here on the wrench at t_k stands for every run.
        """
        self._tracking.begin(pose_cmd, twist_cmd, accel_cmd)

    def finish(self) -> None:
        """Arrive at t_(k+1)."""
        self._tracking.finish()
        if self._latch is not None and self._tracking.touch is not None:
            self._latch.close(self._tracking.touch)

    def advance(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """A whole tick: :meth:`begin` and :meth:`finish`."""
        self.begin(pose_cmd, twist_cmd, accel_cmd)
        self.finish()
