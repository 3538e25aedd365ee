"""True stiffness and damping of each axis, as the reference for an identification, where the
mechanism defines them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hiltestbed.contact.parameters import ContactParameters, believed_contacts
from hiltestbed.contact.wrench import LATCH_RADIUS

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

Pair = tuple[float, float]
# terms that make a law non-linear
NON_LINEAR = (
    "power_stiffness",
    "alpha",
    "dry",
    "stop_stiffness",
    "branch_stiffness",
    "play",
    "mode",
)


def in_series(first: Pair, second: Pair) -> Pair:
    """Stiffness and damping, at frequencies well below k/c, of two springs with dampers in
    series.
    """
    (k1, c1), (k2, c2) = first, second
    total = k1 + k2
    return k1 * k2 / total, (c1 * k2 * k2 + c2 * k1 * k1) / (total * total)


def axis_truth(scenario: Scenario, captured: bool = False) -> list[Pair | None]:
    """Stiffness [N/m], [N m/rad] and damping of x, y, z, rx, ry, rz, effects included; None on axes
    without a linear law.

    A bumper has one along z; latches act on all six; a mount is in series with them. If a mechanism
    is captured in phases, springs
    of its own parts are in series as well: see :mod:`hiltestbed.contact.jacobian`.

    Args:
        captured: whether latches have closed during the run.
    """
    mechanism = scenario.mechanism
    contact, *_, latch = [c.with_effects(scenario.effects) for c in believed_contacts(mechanism)]
    turning = LATCH_RADIUS**2
    if mechanism.captured or (captured and not mechanism.phases()):
        # the lateral axes stay linear: no effect changes their law
        k, c = latch.stiffness, latch.damping
        held = latch if mechanism.captured else replace(latch).after_capture()
        front: list[Pair | None] = [*[(k, c)] * 2, _linear(held), *[(k * turning, c * turning)] * 3]
    else:
        front = [None, None, _linear(contact) if mechanism.flat else None, None, None, None]
    if mechanism.mount is None:
        return front
    behind = list(zip(mechanism.mount.stiffness, mechanism.mount.damping, strict=True))
    return [None if f is None else in_series(f, b) for f, b in zip(front, behind, strict=True)]


def normal_truth(scenario: Scenario) -> Pair | None:
    """Stiffness [N/m] and damping [N s/m] along the normal of a contact, effects included.

    None if several different laws or a non-linear law act, or if the mount is compliant.
    """
    laws = {
        _linear(c.with_effects(scenario.effects))
        for c in believed_contacts(scenario.mechanism)[:-1]
    }
    return laws.pop() if len(laws) == 1 and scenario.mechanism.mount is None else None


def _linear(law: ContactParameters) -> Pair | None:
    """Stiffness and damping of a linear law, wherever its touch is, in series with the frame's
    compliance; None if it is non-linear.
    """
    neutral = ContactParameters(1.0)
    if any(getattr(law, name) != getattr(neutral, name) for name in NON_LINEAR):
        return None
    own = (float(law.stiffness), float(law.damping))
    return in_series(own, (float(law.frame), 0.0)) if law.frame > 0.0 else own
