"""Parameters of a contact, of its force law and its surfaces, from the settings and the effects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiltestbed.config.piecewise import PACKED, packed
from hiltestbed.effects.base import Effect, LinkParameters
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Contact, Latch, Mechanism


@dataclass
class ContactParameters(LinkParameters):
    """One contact; an inactive term of the law has a neutral value.

    Attributes:
        stiffness [N/m], damping [N s/m], friction [-]: of k x + c v and of Coulomb's law.
        power_stiffness [N/m^n], exponent: k x^n in place of k x if power_stiffness is positive.
        alpha: [s/m] of Hunt-Crossley damping, in place of the linear damper if not negative.
        dry: [N] dry friction; drag: [N/m] of the spring in series with its slider, 0: rigid.
        preload: [N]. stop [m], stop_stiffness [N/m]: a second spring beyond a penetration.
            branch_stiffness [N/m], branch_time [s]: of a Maxwell branch. adhesion: [N] largest
            pulling force.
        frame: [N/m] of the sensor's frame in series; 0: rigid. offset: [m] by which the touch comes
            later.
        play: [m] in a captured mechanism.
            mode [rad/s], mode_damping [-], mode_mass [kg]: of the frame's mode; reaction: 1 if the
            sensor reads the frame's reaction.
        tilt_x, tilt_y: [rad] of the passive port. lever: point of application of the force, 0 at
            the undeformed surface, 1 at the tip.
        side_stiffness, side_damping: [-] of a captured mechanism across the insertion and about
            each axis, relative to those along it.
        ring: [-] radius at which a latch resists rotation, over LATCH_RADIUS; 0: it does not.
        blunt: 1 if the ball of the tip touches; 0 if its foremost point does (this differs on a
            tilted plane).
        over_penetration, over_rate, over_stretch: (PACKED,) curves of an added force [N] over
            penetration [m], its rate [m/s] and the stretch [m] of a slider, which slips where the
            stretch would leave the curve's range.
        spring_over_penetration, spring_over_rate: (PACKED,) curves of a fraction [-] of the elastic
        force that is added.
    """

    link = "contact"
    stiffness: float
    damping: float = 0.0
    power_stiffness: float = 0.0
    exponent: float = 0.0
    alpha: float = -1.0
    dry: float = 0.0
    preload: float = 0.0
    stop: float = np.inf
    stop_stiffness: float = 0.0
    branch_stiffness: float = 0.0
    branch_time: float = 0.0
    adhesion: float = 0.0
    frame: float = 0.0
    offset: float = 0.0
    play: float = 0.0
    mode: float = 0.0
    mode_damping: float = 0.0
    mode_mass: float = 0.0
    friction: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    lever: float = 0.5
    reaction: float = 0.0
    drag: float = 0.0
    blunt: float = 1.0
    side_stiffness: float = 1.0
    side_damping: float = 1.0
    ring: float = 1.0
    over_penetration: Array = field(default_factory=lambda: packed(()))
    over_rate: Array = field(default_factory=lambda: packed(()))
    over_stretch: Array = field(default_factory=lambda: packed(()))
    spring_over_penetration: Array = field(default_factory=lambda: packed(()))
    spring_over_rate: Array = field(default_factory=lambda: packed(()))

    @classmethod
    def believed(cls, contact: Contact) -> ContactParameters:
        """The nominal contact: the settings of a scenario, without effects."""
        return cls(contact.stiffness, contact.damping, friction=contact.friction)

    def after_capture(self) -> ContactParameters:
        """Without what belongs to a touch, in place, for a latch that closed during a run."""
        self.offset = self.preload = self.stop_stiffness = 0.0
        self.stop = np.inf
        self.over_penetration = packed(())
        self.spring_over_penetration = packed(())
        return self

    def row(self) -> Array:
        """``(PARAMETERS,)`` row for the kernels."""
        numbers = np.array([getattr(self, name) for name in NUMBERS], dtype=float)
        return np.concatenate([numbers, *(getattr(self, name) for name in CURVES)])


def believed_contacts(mechanism: Mechanism) -> list[ContactParameters]:
    """The nominal contact of each rule of a mechanism, and last of its latch, without effects."""
    contacts = (*mechanism.contacts(), mechanism.contact)
    return [ContactParameters.believed(c) for c in contacts]


def acting_contacts(mechanism: Mechanism, effects: Iterable[Effect]) -> list[ContactParameters]:
    """As :func:`believed_contacts`, with ``effects``."""
    acting = list(effects)
    return [c.with_effects(acting) for c in believed_contacts(mechanism)]


def contact_rows(
    contacts: Sequence[ContactParameters], rules: Sequence[int], captured: bool
) -> Array:
    """``(T + 1, PARAMETERS)`` rows of each pair, which belongs to one of the ``rules`` (T,), and
    last of the latch.

    ``contacts``: of each rule and of the latch, effects included. captured: whether the latch is
        closed from the start.
    """
    latch = contacts[-1] if captured else copy(contacts[-1]).after_capture()
    rows = np.array([c.row() for c in (*contacts[:-1], latch)])
    return rows[[*rules, len(rows) - 1]]


def mounts_of(mechanisms: Sequence[Mechanism]) -> tuple[Array, Array] | None:
    """``(n, 6)`` stiffness and damping [N/m, N m/rad, ...] of mounts; None if they are rigid."""
    if mechanisms[0].mount is None:
        return None
    mounts = [m.mount for m in mechanisms if m.mount is not None]
    return np.array([m.stiffness for m in mounts]), np.array([m.damping for m in mounts])


def latch_limits(latches: Iterable[Latch | None]) -> Array:
    """``(n, 3)`` limits of latches: depth [m], least cosine of the axes, speed [m/s]; or never."""
    never = (-np.inf, 2.0, 0.0)
    return np.array(
        [(la.depth, np.cos(np.radians(la.angle_deg)), la.speed) if la else never for la in latches]
    )


class MechanismParameters(NamedTuple):
    """The numbers of `n` mechanisms of one structure.

    Attributes:
        laws: (n, T + 1, PARAMETERS) see :func:`contact_rows`. mounts: see :func:`mounts_of`.
            closing: (n, 3) see :func:`latch_limits`.
    """

    laws: Array
    mounts: tuple[Array, Array] | None
    closing: Array


def mechanism_parameters(
    mechanisms: Sequence[Mechanism], effects: Iterable[Iterable[Effect]], rules: Sequence[int]
) -> MechanismParameters:
    """Those of ``mechanisms`` under ``effects``; ``rules`` (T,) as for :func:`contact_rows`."""
    laws = [
        contact_rows(acting_contacts(m, acting), rules, m.captured)
        for m, acting in zip(mechanisms, effects, strict=True)
    ]
    closing = latch_limits(m.latch for m in mechanisms)
    return MechanismParameters(np.array(laws), mounts_of(mechanisms), closing)


# The columns of a row, named after the fields; a curve takes PACKED columns, the first of which is
# its number of knots.
NAMES = tuple(f.name for f in fields(ContactParameters))
CURVES = tuple(f.name for f in fields(ContactParameters) if f.type == "Array")
NUMBERS = tuple(name for name in NAMES if name not in CURVES)
(
    STIFFNESS,
    DAMPING,
    POWER_STIFFNESS,
    EXPONENT,
    ALPHA,
    DRY,
    PRELOAD,
    STOP,
    STOP_STIFFNESS,
    BRANCH_STIFFNESS,
    BRANCH_TIME,
    ADHESION,
    FRAME,
    OFFSET,
    PLAY,
    MODE,
    MODE_DAMPING,
    MODE_MASS,
    FRICTION,
    TILT_X,
    TILT_Y,
    LEVER,
    REACTION,
    DRAG,
    BLUNT,
    SIDE_STIFFNESS,
    SIDE_DAMPING,
    RING,
    OVER_PENETRATION,
) = range(len(NUMBERS) + 1)
OVER_RATE, OVER_STRETCH, SPRING_OVER_PENETRATION, SPRING_OVER_RATE, PARAMETERS = (
    OVER_PENETRATION + i * PACKED for i in range(1, 6)
)
# terms that make a law non-linear, beside curves
NON_LINEAR = "power_stiffness", "alpha", "dry", "stop_stiffness", "branch_stiffness", "play", "mode"
# columns that are neutral if only a linear spring and damper act along the normal
LINEAR = [NUMBERS.index(name) for name in (*NON_LINEAR, "preload", "adhesion", "frame", "offset")]
LINEAR += range(OVER_PENETRATION, PARAMETERS, PACKED)
