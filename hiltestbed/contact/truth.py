"""Stiffness and damping that an identification ought to find on each axis, where the mechanism gives them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hiltestbed.contact.parameters import ContactParameters, believed_contacts
from hiltestbed.contact.wrench import LATCH_RADIUS

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

Pair = tuple[float, float]
BENT = ("power_stiffness", "alpha", "dry", "stop_stiffness", "branch_stiffness", "play", "mode")  # what makes a law that is not linear


def in_series(first: Pair, second: Pair) -> Pair:
    """Stiffness and damping, at frequencies well below k/c, of two springs with dampers one behind the other."""
    (k1, c1), (k2, c2) = first, second
    total = k1 + k2
    return k1 * k2 / total, (c1 * k2 * k2 + c2 * k1 * k1) / (total * total)


def axis_truth(scenario: Scenario, captured: bool = False) -> list[Pair | None]:
    """Stiffness [N/m], [N m/rad] and damping of x, y, z, rx, ry, rz, effects included; None where no linear law holds along the axis.

    A bumper has one along z. Latches hold on all six; a mount lies behind whatever acts. Where a mechanism is captured in phases, springs
    in parts of its own lie in between: their axes are those of :mod:`hiltestbed.contact.jacobian`.

    Args:
        captured: whether latches have closed in the course of the run.
    """
    mechanism = scenario.mechanism
    contact, *_, latch = [c.with_effects(scenario.effects) for c in believed_contacts(mechanism)]
    turning = LATCH_RADIUS**2
    if mechanism.captured or (captured and not mechanism.phases()):
        k, c = latch.stiffness, latch.damping  # across, no effect makes another law of them
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

    None where several laws act, or one that is not linear, or a mount gives way too.
    """
    laws = {_linear(c.with_effects(scenario.effects)) for c in believed_contacts(scenario.mechanism)[:-1]}
    return laws.pop() if len(laws) == 1 and scenario.mechanism.mount is None else None


def _linear(law: ContactParameters) -> Pair | None:
    """Stiffness and damping of a law that is a spring and a damper, wherever it begins, on a frame that may give; else None."""
    neutral = ContactParameters(1.0)
    if any(getattr(law, name) != getattr(neutral, name) for name in BENT):
        return None
    own = (float(law.stiffness), float(law.damping))
    return in_series(own, (float(law.frame), 0.0)) if law.frame > 0.0 else own
