"""The joints of a log of several: the columns whose names differ by a joint alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from hiltestbed.measured.roles import COMMANDED, PUSHES, REACHED, TOKEN, WORDS, Role
from hiltestbed.measured.units import split_unit

# words of a name that say neither what is measured nor where
ANYWHERE = "joint joints state states motor axis sensor robot arm data msg"
FEWEST = 2  # joints of an arm
_NO_PLACE = frozenset(f"{' '.join(WORDS.values())} {COMMANDED} {REACHED} {ANYWHERE}".split())


class Joint(NamedTuple):
    """A joint of a log: its name, and the columns of its position and of what drives it."""

    name: str
    position: Role
    effort: Role


def joints_of(roles: Mapping[str, Role]) -> list[Joint]:
    """The joints of which a log holds position and torque, force or current; none, if fewer than
    two.
    """
    own = [r for r in roles.values() if not r.commanded and not r.part]
    places = _by_place(r for r in own if r.quantity == "position")
    found: list[Joint] = []
    for quantity in PUSHES:
        driven = _by_place(r for r in own if r.quantity == quantity)
        shared = [place for place in places if place and place in driven]
        if len(shared) > max(len(found), FEWEST - 1):
            found = [Joint(_named(p, places[p], driven[p]), places[p], driven[p]) for p in shared]
    return found


def _by_place(roles: Iterable[Role]) -> dict[tuple[str, ...], Role]:
    """Roles by what their names say of the place, the first of each."""
    out: dict[tuple[str, ...], Role] = {}
    for role in roles:
        bare, _ = split_unit(role.column)
        words = [word.lower() for word in TOKEN.findall(bare)]
        if role.unit and len(words) > 1 and words[-1] == role.unit.replace(" ", "").lower():
            words.pop()
        out.setdefault(tuple(w for w in words if w not in _NO_PLACE), role)
    return out


def _named(place: tuple[str, ...], position: Role, effort: Role) -> str:
    """The name of a joint: that in which both columns end, as in a ROS 2 message, or the place."""
    ends = {re.split("[/.]", role.column)[-1] for role in (position, effort)}
    if len(ends) == 1 and (end := ends.pop()).isidentifier():
        return end
    return "_".join(("joint", *place) if place[0].isdigit() else place)
