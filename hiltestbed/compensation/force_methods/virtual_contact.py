"""A virtual spring and damper in addition to the measured force: ``F = F_meas + k_v x + b_v v``
while pz > 0.

The hybrid contact model of the EPOS rig (M. Zebenay, T. Boge, R. Krenn, D. Choukroun, "Analytical
and experimental stability investigation of a hardware-in-the-loop satellite docking simulator",
Proc. IMechE G 229, 2015; arXiv 1309.3512): a virtual force is superposed on the measured one and
tuned until the contact behaves as desired. To first order a delay acts as a damping -k tau, which
``b_v = k tau`` cancels. The simulated contact is then partly that of the tuning, not of the
hardware.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.frames import Array
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class VirtualContact(ForceMethod):
    """A virtual spring and damper along the insertion, added to the measured force."""

    kind: Literal["virtual_contact"] = "virtual_contact"
    adds_force: ClassVar[bool] = True
    stiffness: NotNegative = Field(default=0.0, description="Stiffness of the virtual spring [N/m]")
    damping: NotNegative = Field(
        description="Damping of the virtual damper [N s/m]; contact stiffness times delay cancels "
        "the delay to first order"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> VirtualContactBlock:
        return VirtualContactBlock(scenarios)

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        # a damper b is equivalent to a lead of b/k
        return {self.kind: self.damping / acting_along_z(scenario)[0]}


class VirtualContactBlock:
    """The virtual force along the insertion, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        force = force_of(scenarios, VirtualContact)
        self._stiffness = np.array([f.stiffness for f in force])
        self._damping = np.array([f.damping for f in force])
        self.output = np.zeros((len(scenarios), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` sum of the measured and the virtual wrench."""
        add_virtual(
            measurement.wrench,
            measurement.pose,
            measurement.twist,
            self._stiffness,
            self._damping,
            self.output,
        )
        return self.output


@njit(cache=True)
def add_virtual(wrench, pose, twist, stiffness, damping, out):
    """``out``: the wrench plus that of a spring and damper (n,) at A's origin along z, in P at P's
    origin, beyond the nominal touch.
    """
    for i in range(wrench.shape[0]):
        for j in range(6):
            out[i, j] = wrench[i, j]
        x = pose[i, 2]
        if x > 0.0:
            force = stiffness[i] * x + damping[i] * twist[i, 2]
            out[i, 2] += force
            out[i, 3] += pose[i, 1] * force
            out[i, 4] -= pose[i, 0] * force
