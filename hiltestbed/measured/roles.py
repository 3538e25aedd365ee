"""What a column of a log may be, by its name and the unit that the file or the name states; without
a name, by its numbers; and the joints of a log of several.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.ratio import correlation
from hiltestbed.measured.units import UNITS, split_unit, unit_named

# what words in a name stand for; of several, the last one counts
# ("current_position" is a position), and a letter only alone
WORDS = {
    "time": "t time times timestamp timestamps stamp clock elapsed zeit tijd temps",
    "position": "position positions pos q x angle angles theta phi displacement disp stroke travel "
    "encoder path weg winkel place deflection",
    "velocity": "velocity velocities vel speed omega dq qd v",
    "acceleration": "acceleration accel acc ddq qdd",
    "force": "force forces f load kraft",
    "torque": "torque torques tau effort efforts moment drehmoment trq",
    "current": "current currents iq i strom amps",
    "other": "temperature temp voltage volt volts stiffness damping est estimate true",
}
COMMANDED = "cmd command commanded commands des desired ref reference setpoint sp target goal soll"
REACHED = "act actual achieved measured meas reached feedback fb ist"
ANGULAR = (
    "angle angles theta phi q winkel joint joints rad deg roll pitch yaw servo rotation elbow "
    "shoulder wrist"
)
PUSHES = ("torque", "force", "current")  # what drives an axis, the likeliest first
COMPENSATED = "comp compensated used numerical"
# tokens at the end of a name that are its unit: "force_N", "time_ms"
SUFFIXES = {
    token.replace(" ", "").replace("/", "").lower(): unit
    for si in ("s", "m", "rad", "N", "N m")
    for token in UNITS[si]
    if token not in ("d", "h", "min", "in")
    for unit in (token,)
} | {"sec": "s", "seconds": "s", "degrees": "deg", "degree": "deg", "a": "A", "ma": "mA", "v": "V"}
ALIKE = 0.9  # correlation of two columns without names, from which one follows the other
BARE = (
    "guessed by the numbers: the time rises evenly; of two columns of one size that move alike, "
    "the earlier is the command and the later what was reached"
)
NO_MECHANICAL = {"A": "current", "mA": "current", "V": "other", "mV": "other"}
QUANTITY_OF = {"s": "time", "m": "position", "rad": "position", "N": "force", "N m": "torque"}
ANGLES = {"roll": "rx", "pitch": "ry", "yaw": "rz", "rx": "rx", "ry": "ry", "rz": "rz"}
_ARROW = {"force": "f", "torque": "t", "position": "p"}
TOKEN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°|µ")


# words of a name that say neither what is measured nor where
ANYWHERE = "joint joints state states motor axis sensor robot arm data msg"
FEWEST = 2  # joints of an arm


class Role(NamedTuple):
    """What a column may be.

    Attributes:
        quantity: a key of :data:`WORDS`, "" if its name says nothing. commanded: whether it is a
            command; None: the name does not say. angular: whether its name is that of an angle.
        part: of a pose or a wrench, such as fz, pz, qw or rx; "". unit: that is stated; "".
    """

    column: str
    quantity: str
    commanded: bool | None
    angular: bool
    part: str
    unit: str


def role_of(column: str, stated: str = "") -> Role:
    """The role of a ``column`` whose unit the file has ``stated``."""
    bare, unit = split_unit(column)
    tokens = [found.lower() for found in TOKEN.findall(bare)]
    unit = stated.strip("[]() ") or unit
    unit = unit if unit in NO_MECHANICAL else unit_named(unit) or unit if unit else ""
    after = re.search(r"[_ ]([A-Za-z]+)$", bare)
    if not unit and after and after[1].lower() in SUFFIXES:
        unit = SUFFIXES[after[1].lower()]
        tokens = [found.lower() for found in TOKEN.findall(bare[: after.start()])]
    words = set(tokens)
    by_length = sorted(reversed(tokens), key=lambda token: len(token) == 1)
    named = (q for token in by_length for q, known in _KNOWN.items() if token in known)
    quantity = next(named, "")
    si = next((si for si, known in UNITS.items() if unit in known), "")
    if unit in NO_MECHANICAL:
        quantity = NO_MECHANICAL[unit]
    elif si in QUANTITY_OF and (not quantity or quantity != QUANTITY_OF[si]):
        quantity = QUANTITY_OF[si] if quantity in ("", "position", "force", "torque") else ""
    commanded = True if words & _COMMANDED else False if words & _REACHED else None
    if "header" in words:  # of a message, not of the machine
        quantity = ""
    angular = bool(words & _ANGULAR) or si == "rad"
    return Role(column, quantity, commanded, angular, _part(tokens, quantity), unit)


def _part(tokens: list[str], quantity: str) -> str:
    tokens = [token for token in tokens if token not in _COMMANDED | _REACHED | _COMPENSATED]
    last = "".join(tokens[-1:])
    if last in ANGLES:
        return ANGLES[last]
    if re.fullmatch(r"[fpt][xyz]|q[xyzw]|m[xyz]", last):
        return last.replace("m", "t")
    if last in tuple("xyzw"):
        before = set(tokens[:-1])
        if before & {"orientation", "quaternion", "quat", "rotation"}:
            return f"q{last}"
        words = {q for token in before for q, known in _KNOWN.items() if token in known}
        for found in ("torque", "force", "position"):
            if found in words and last != "w":
                return _ARROW[found] + last
        return "" if last == "w" or words or quantity not in ("", "position") else f"p{last}"
    return ""


def channel_of(role: Role, part: str) -> str:
    """The channel of the trace that a column with this ``part`` of a pose or a wrench may be."""
    if part[:1] in ("f", "t"):
        used = _COMPENSATED.intersection(re.findall("[a-z]+", role.column.lower()))
        return f"{'wrench_comp' if used else 'wrench_meas'}.{part}"
    return f"{'pose_cmd' if role.commanded else 'pose_act'}.{part}"


def _set(words: str) -> frozenset[str]:
    return frozenset(words.split())


_KNOWN: Mapping[str, frozenset[str]] = {q: _set(words) for q, words in WORDS.items()}
_COMMANDED, _REACHED, _ANGULAR = _set(COMMANDED), _set(REACHED), _set(ANGULAR)
_COMPENSATED = _set(COMPENSATED)
_NO_PLACE = _set(f"{' '.join(WORDS.values())} {COMMANDED} {REACHED} {ANYWHERE}")


def by_values(data: Mapping[str, Array]) -> dict[str, Role]:
    """Roles of columns without names, as :data:`BARE` says; the rest is open."""
    roles = {name: Role(name, "other", None, False, "", "") for name in data}
    for name, values in data.items():
        steps = np.diff(finite(values))
        if steps.min() > 0.0 and np.ptp(steps) < np.mean(steps):
            roles[name] = roles[name]._replace(quantity="time")
            break
    rest = [name for name, role in roles.items() if role.quantity != "time"]
    pairs = [
        (correlation(data[a], data[b]), a, b)
        for a, b in combinations(rest, 2)
        if 0.5 < np.ptp(finite(data[a])) / np.ptp(finite(data[b])) < 2.0
    ]
    alike, a, b = max(pairs, default=(0.0, "", ""))
    if alike > ALIKE:
        # b(t) = a(t - tau): the sum of (a - b)(a + b)' is tau times that of the slopes' squares
        both = np.stack([data[a], data[b]])[:, np.isfinite(data[a] + data[b])]
        leads = np.sum((both[0] - both[1]) * np.gradient(both[0] + both[1])) >= 0.0
        for name, commanded in ((a, leads), (b, not leads)):
            roles[name] = Role(name, "position", bool(commanded), False, "", "")
    return roles


def finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def time_unit(t: Array) -> tuple[str, str]:
    """The unit of stamps ``(rows,)`` that state none, and why: the one in which the sample rate
    lies between 10 Hz and 20 kHz, the largest where several do.
    """
    known = finite(t)
    step = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    for unit, rate in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if step > 0.0 and 10.0 <= rate / step <= 2e4:
            return unit, f"by its steps of {step:.4g}, {rate / step:.4g} Hz"
    return "s", f"its steps of {step:.4g} fit none"


def angle_unit(values: Array, most: float = 6.0 * np.pi) -> tuple[str, str]:
    """The unit of angles that state none, and why: degrees from ``most`` on, three turns in rad."""
    largest = float(np.nanmax(np.abs(values)))
    return "rad" if largest < most else "deg", f"by its size, up to {largest:.3g}"


def length_unit(values: Array) -> tuple[str, str]:
    """The unit of a position that states none, and why: a travel above 2 m is taken for mm."""
    travel = float(np.ptp(finite(values)))
    return ("m" if travel < 2.0 else "mm"), f"by its travel of {travel:.3g}"


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
