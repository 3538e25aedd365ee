"""The methods that the benchmark of the coefficient of restitution compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from hiltestbed import plugins
from hiltestbed.compensation.settings import FORCE_METHODS, ForceMethod

BEST = "resynchronised"


class Briefing(NamedTuple):
    """What a method may be told: k [N/m], c [N s/m], peak force [N] and nominal delay [s]."""

    stiffness: float
    damping: float
    peak: float
    believed_delay: float


@dataclass(frozen=True)
class Contender:
    """A method in the benchmark.

    Attributes:
        contact: first: nothing is known about the contact; known: its k and c are given.
        force: its section of the scenario for a contact. own: whether it comes from a plugin of the
            user.
    """

    name: str
    contact: str
    force: Callable[[Briefing], dict[str, Any]]
    own: bool = False


def _model(c: Briefing, off: float = 1.0) -> dict[str, float]:
    return {"stiffness": off * c.stiffness, "damping": c.damping}


CONTENDERS = (
    Contender("none", "first", lambda c: {"kind": "none"}),
    Contender("dead_zone", "first", lambda c: {"kind": "dead_zone", "width": 0.02 * c.peak}),
    Contender("phase_lead", "first", lambda c: {"kind": "phase_lead"}),
    Contender("second_order_lead", "first", lambda c: {"kind": "second_order_lead"}),
    Contender("polynomial_1", "first", lambda c: {"kind": "polynomial", "order": 1}),
    Contender("polynomial_3", "first", lambda c: {"kind": "polynomial", "order": 3}),
    Contender("kalman", "first", lambda c: {"kind": "kalman"}),
    Contender("passivity_control", "first", lambda c: {"kind": "passivity_control"}),
    Contender("normalised_passivity", "first", lambda c: {"kind": "normalised_passivity"}),
    Contender("reconstruction", "first", lambda c: {"kind": "reconstruction"}),
    Contender(BEST, "first", lambda c: {"kind": BEST}),
    Contender(
        "virtual_contact",
        "known",
        lambda c: {"kind": "virtual_contact", "damping": c.stiffness * c.believed_delay},
    ),
    Contender("cor_designed", "known", lambda c: {"kind": "cor_designed", **_model(c)}),
    Contender("smith_predictor", "known", lambda c: {"kind": "smith_predictor", **_model(c)}),
    Contender(
        "smith_predictor_10pct_off",
        "known",
        lambda c: {"kind": "smith_predictor", **_model(c, 1.1)},
    ),
    Contender(
        "smith_predictor_lead_10pct_off",
        "known",
        lambda c: {"kind": "smith_predictor", **_model(c, 1.1), "lead_rest": True},
    ),
    Contender(BEST, "known", lambda c: {"kind": BEST, "contact": _model(c)}),
    Contender(f"{BEST}_delay_known", "first", lambda c: {"kind": BEST, "delay": "known"}),
)


def contenders() -> tuple[Contender, ...]:
    """The built-in methods, and those of plugins."""
    plugins.load()
    users = [cls for cls in FORCE_METHODS.values() if plugins.is_users(cls)]
    return (*CONTENDERS, *map(_user, users))


def _user(method: type[ForceMethod]) -> Contender:
    kind = str(plugins.kind_of(method))
    knows = bool(method.contest(1.0, 0.0, 0.0))
    return Contender(
        kind,
        "known" if knows else "first",
        lambda c: {"kind": kind, **method.contest(c.stiffness, c.damping, c.believed_delay)},
        own=True,
    )
