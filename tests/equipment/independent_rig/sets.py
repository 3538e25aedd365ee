"""Sets of measured data with hidden effects: drawing, generation, and check of their strength."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from numpy.random import Generator

from tests.equipment.independent_rig.docking_facility import SIX, draw_docking_facility
from tests.equipment.independent_rig.facility import Facility, draw_facility, rounded
from tests.equipment.independent_rig.foreign import FOREIGN, IN_DOCKING, foreign_in
from tests.equipment.independent_rig.generation import (
    draw_variants,
    link_of,
    record,
    rig_of,
    stable,
    strength,
)
from tests.equipment.independent_rig.hidden import EFFECTS
from tests.equipment.independent_rig.links import Records
from tests.equipment.independent_rig.log import Log
from tests.equipment.independent_rig.look_alikes import LOOK_ALIKES, Pair, draw_look_alike
from tests.equipment.independent_rig.noise_kinds import NOISE_KINDS
from tests.equipment.independent_rig.nuisances import PLAIN as AS_TODAY
from tests.equipment.independent_rig.nuisances import Nuisances
from tests.equipment.independent_rig.sizes import (
    ACTING,
    DOCKING_SIZES,
    NEEDS,
    SIZES,
    alike,
    drawn,
)

Kind = Literal["healthy", "single", "pair", "triple", "foreign", "alike"]
Design = Literal["bumper", "docking", "mounted", "held"]
FACILITIES = 200  # largest number of draws for a set
STRONG_ENOUGH = 150  # draws after which a weak effect is accepted too


@dataclass(frozen=True)
class HiddenSet:
    """A set and the truth about it.

    Attributes:
        kind: healthy, single, pair, triple, foreign or alike.
        effects: the hidden effects, as in a scenario's `effects`; foreign ones have a kind
            `unknown.*`.
        links: of the effects, in their order.
        strengths: of the effects, in their order: rms change of the link's records by the effect
            during contact, in units of their noise, with the loop opened before the link.
            Unobservable below about 0.3.
        runs: the records of each run, with noise, in the order of the facility's runs; logs: their
            logs, as written to files.
        noise, nuisances: as requested.
    """

    kind: Kind
    facility: Facility
    effects: list[dict[str, Any]]
    links: list[str]
    strengths: list[float]
    runs: list[Records] = field(repr=False)
    logs: list[Log] = field(repr=False, default_factory=list)
    noise: tuple[str, float] | None = None
    nuisances: Nuisances = AS_TODAY


def draw_set(
    rng: Generator,
    kind: Kind,
    names: tuple[str, ...] = (),
    scale: float = 1.0,
    least_strength: float = 3.0,
    *,
    design: Design = "bumper",
    noise: tuple[str, float] | None = None,
    nuisances: Nuisances | None = None,
    pair: Pair | None = None,
) -> HiddenSet:
    """Draw a set with hidden effects.

    Args:
        names: the effects to hide, of the vocabulary or foreign; empty: random ones, according to
            `kind`.
        scale: of the deviations. With a scale other than 1 the strength is not checked.
        least_strength: below it the set is drawn again, with another facility.
        design: bumper (three axes, a plane) | docking (probe and cone) | mounted (the cone on a
            compliant mount) | held (latched).
        noise: kind and strength of `NOISE_KINDS` instead of the white noise. nuisances: of the
            facility's computation.
        pair: for kind alike, the pair of `LOOK_ALIKES`, the first of which is hidden; None: a
            random pair in random order.

    Raises:
        ValueError: an unknown noise, design or pair, or names that do not act in the design.
    """
    _known(names, design, noise, pair)
    how = nuisances or AS_TODAY
    for attempt in range(FACILITIES):
        chosen = names or _names(rng, kind, design, pair)
        facility = (
            draw_facility(rng, _design(rng, chosen))
            if design == "bumper"
            else draw_docking_facility(rng, design)
        )
        if kind == "alike":
            first, second = chosen
            ordered = (first, second) if (first, second) in LOOK_ALIKES else (second, first)
            both = draw_look_alike(rng, ordered, facility, scale)
            effects = [e for e in both if e["kind"] == chosen[0]]
        else:
            effects = draw_effects(rng, chosen, facility, scale)
        variants = draw_variants(rng)
        strengths = [strength(facility, effects, i, variants) for i in range(len(effects))]
        if scale == 1.0 and attempt < STRONG_ENOUGH and any(s < least_strength for s in strengths):
            continue
        rigs = [rig_of(facility, i, effects, variants, how) for i in range(len(facility.runs))]
        runs, logs = record(rng, facility, rigs, how, noise)
        if stable(facility, runs):
            return HiddenSet(
                kind,
                facility,
                effects,
                [link_of(e["kind"]) for e in effects],
                [round(s, 3) for s in strengths],
                runs,
                logs,
                noise,
                how,
            )
    raise RuntimeError(f"no stable set with {names or kind} at scale {scale} in {FACILITIES} draws")


def draw_effects(
    rng: Generator, names: tuple[str, ...], facility: Facility, scale: float = 1.0
) -> list[dict[str, Any]]:
    """The effects `names` at moderate sizes for the facility, times `scale`."""
    in_docking = SIX in facility.design
    sizes = DOCKING_SIZES if in_docking else SIZES
    foreign = IN_DOCKING if in_docking else IN_DOCKING | FOREIGN
    out = []
    for name in names:
        given = drawn(foreign[name].draw if name in foreign else sizes[name], rng, facility, scale)
        short = {k: rounded(v) if isinstance(v, float) else v for k, v in given.items()}
        out.append({"kind": name, **short})
    return out


def acting_in(design: Design) -> tuple[str, ...]:
    """The effects of the vocabulary that can be hidden in a design."""
    return tuple(EFFECTS) if design == "bumper" else ACTING[design]


def _known(
    names: tuple[str, ...], design: Design, noise: tuple[str, float] | None, pair: Pair | None
) -> None:
    if design not in ("bumper", *ACTING):
        raise ValueError(f"unknown design {design!r}; allowed: bumper, {', '.join(ACTING)}")
    idle = [n for n in names if n not in acting_in(design) and n not in foreign_in(design)]
    if idle:
        raise ValueError(f"{', '.join(idle)} cannot be hidden in design {design}")
    if noise is not None and noise[0] not in NOISE_KINDS:
        raise ValueError(f"unknown noise {noise[0]!r}; allowed: {', '.join(NOISE_KINDS)}")
    if pair is not None and pair not in LOOK_ALIKES:
        allowed = ", ".join(" / ".join(p) for p in LOOK_ALIKES)
        raise ValueError(f"unknown pair {pair!r}; allowed: {allowed}")


def _names(rng: Generator, kind: Kind, design: Design, pair: Pair | None) -> tuple[str, ...]:
    if kind == "healthy":
        return ()
    if kind == "alike":
        if pair is not None:
            return pair
        acting = set(acting_in(design))
        pairs = [p for p in LOOK_ALIKES if set(p) <= acting]
        first, second = pairs[int(rng.integers(len(pairs)))]
        return (first, second) if rng.random() < 0.5 else (second, first)
    if kind == "foreign":
        table = FOREIGN if design == "bumper" else foreign_in(design)
        return (str(rng.choice(list(table))),)
    names: tuple[str, ...] = ()
    for _ in range({"single": 1, "pair": 2, "triple": 3}[kind]):
        other = [n for n in acting_in(design) if not any(alike(n, name) for name in names)]
        names += (str(rng.choice(other)),)
    return names


def _design(rng: Generator, names: tuple[str, ...]) -> frozenset[str]:
    """The excitation of the runs: everything that the effects need, and more at random, so that the
    design does not reveal the effects.

    A latch also holds the attitude, which this rig of three axes leaves free: latched runs are
    therefore on the axis.
    """
    design = {"slide"} | ({"offset"} if rng.random() < 0.25 else set())
    if not names and rng.random() < 0.05:
        design |= {"latched"}
    for name in names:
        design |= NEEDS.get(name, frozenset())
    return frozenset(design - {"offset", "slide"} if "latched" in design else design)
