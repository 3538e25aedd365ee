"""Stiffness and damping that an identification ought to find on each axis, where the mechanism gives them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltestbed.contact.wrench import LATCH_RADIUS

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

Pair = tuple[float, float]


def in_series(first: Pair, second: Pair) -> Pair:
    """Stiffness and damping, at frequencies well below k/c, of two springs with dampers one behind the other."""
    (k1, c1), (k2, c2) = first, second
    total = k1 + k2
    return k1 * k2 / total, (c1 * k2 * k2 + c2 * k1 * k1) / (total * total)


def axis_truth(scenario: Scenario, captured: bool = False) -> list[Pair | None]:
    """Stiffness [N/m], [N m/rad] and damping of x, y, z, rx, ry, rz; None where no linear law holds along the axis.

    A bumper has one along z. Latches hold on all six; a mount lies behind whatever acts. Where a mechanism is captured in phases, springs
    in parts of its own lie in between, and no number of its files is that of an axis.

    Args:
        captured: whether latches have closed in the course of the run.
    """
    mechanism = scenario.mechanism
    k, c = float(mechanism.contact.stiffness), float(mechanism.contact.damping)
    turning = LATCH_RADIUS**2
    if mechanism.captured or (captured and not mechanism.phases()):
        latch = mechanism.latch_contact()
        k, c = float(latch.stiffness), float(latch.damping)
        front: list[Pair | None] = [*[(k, c)] * 3, *[(k * turning, c * turning)] * 3]
    else:
        front = [None, None, (k, c) if mechanism.flat else None, None, None, None]
    if mechanism.mount is None:
        return front
    behind = list(zip(mechanism.mount.stiffness, mechanism.mount.damping, strict=True))
    return [None if f is None else in_series(f, b) for f, b in zip(front, behind, strict=True)]


def normal_truth(scenario: Scenario) -> Pair | None:
    """Stiffness [N/m] and damping [N s/m] along the normal of a contact; None where several laws act, or a mount gives way too."""
    contacts = {(c.stiffness, c.damping) for c in scenario.mechanism.contacts()}
    return contacts.pop() if len(contacts) == 1 and scenario.mechanism.mount is None else None
