"""True stiffness and damping of each axis, as the reference for an identification, where the
mechanism defines them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hiltestbed.contact.acting import Pair, acting_contacts, in_series, linear_law
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.touch import first_touch
from hiltestbed.contact.wrench import LATCH_RADIUS

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


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
    contact, *_, latch = acting_contacts(scenario)
    turning = LATCH_RADIUS**2
    if mechanism.captured or (captured and not mechanism.phases()):
        # the lateral axes stay linear: no effect changes their law
        k, c = latch.stiffness, latch.damping
        held = latch if mechanism.captured else replace(latch).after_capture()
        front: list[Pair | None] = [
            *[(k, c)] * 2,
            linear_law(held),
            *[(k * turning, c * turning)] * 3,
        ]
    else:
        front = [None, None, linear_law(contact) if mechanism.flat else None, None, None, None]
    if mechanism.mount is None:
        return front
    behind = list(zip(mechanism.mount.stiffness, mechanism.mount.damping, strict=True))
    return [None if f is None else in_series(f, b) for f, b in zip(front, behind, strict=True)]


def normal_truth(scenario: Scenario, at_once: int) -> Pair | None:
    """Stiffness [N/m] and damping [N s/m] along the normal of a contact, effects included: the
    contact's own while one at a time touches, otherwise those of the first touch, of all its
    contacts and of the springs of moving parts in series.

    None if several different laws or a non-linear law act, if the mount is compliant, or if more
    contacts than in the first touch acted at once.

    Args:
        at_once: largest number of contacts that touched at the same time; 0 if it is not known.
    """
    laws = {linear_law(c) for c in acting_contacts(scenario)[:-1]}
    if len(laws) != 1 or None in laws or scenario.mechanism.mount is not None:
        return None
    if at_once <= 1 and sides_of(scenario.mechanism).rigid:
        return laws.pop()
    touch = first_touch(scenario)
    if touch is None or touch.contacts < at_once:
        return None
    return touch.stiffness, touch.damping
