"""Both sides of a mechanism, from their MJCF: which geoms may touch, and the contact geometry.

A rule of the mechanism names geoms of both sides; without rules a geom may touch if MuJoCo would
let it collide (``contype`` and ``conaffinity`` not both 0). A pair of geoms that may touch is one
of two kinds:

- *facet*: a ball against any surface, a rod (capsule) against a cylinder, an ellipsoid or a mesh.
  The nearest point of the surface is computed (for a mesh of revolution exactly from its profile,
  for any other mesh from its triangles), and MuJoCo gets a facet in the tangent plane there
  (:mod:`hiltestbed.contact.engagement`);
- *native*: any other pair of convex geoms. MuJoCo's own collision detection is used, and the
  stiffness is divided among the points that it finds. A pair that is neither is refused.

Geoms of one side touch each other only in a ``pair`` of its file, with MuJoCo's own softness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.config.models import stamp
from hiltestbed.contact import geometry as geo
from hiltestbed.contact.description import Rule, matching
from hiltestbed.contact.geometry import Geometry, Placed, Round, packed
from hiltestbed.contact.side import Frames, Side, quaternion
from hiltestbed.contact.surfaces import surface as surf
from hiltestbed.contact.surfaces.soundness import MeshFault
from hiltestbed.errors import InputError
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

# on a plane or a box a rod touches at both ends, which MuJoCo handles
ROD_FACETS = (surf.CYLINDER, surf.ELLIPSOID, surf.MESH)
# closed form against a ball
EXACT = {surf.PLANE, surf.SPHERE, surf.CAPSULE, surf.BOX}
MOST_PAIRS = 4000


@dataclass(frozen=True)
class Pair:
    """Two geoms that may touch.

    Attributes:
        active, passive: their names. rule: number of their rule.
        single: whether they touch at one point at most.
    """

    active: str
    passive: str
    rule: int
    single: bool = False


@dataclass(frozen=True, eq=False)
class Sides:
    """The contents of a mechanism's MJCF.

    Attributes:
        facets: pairs with facets; geometry: theirs, in the same order. native: pairs for which
            MuJoCo's collision detection is used.
        frames: of each frame beyond A and S, the port of its side and the name of its body.
        sites: of each site in a phase of capture, by port and name, the number of its frame and its
            pose (7,) in it.
        exact: whether MuJoCo's own collision detection has a closed form and one point for every
            pair, including those with facets.
        ports: (2, 7) pose of A in the file of the active side, of P in that of the passive one.
        moving: whether a side has joints. releases: whether a side can release energy: it has
            actuators, or springs that are not at rest at the start. findings: on the meshes that
            may touch, with the name of the geom. apart: pairs of geoms of one side that do not
            touch, though MuJoCo would let them.
    """

    facets: tuple[Pair, ...]
    geometry: Geometry
    native: tuple[Pair, ...]
    frames: tuple[tuple[str, str], ...]
    sites: dict[tuple[str, str], tuple[int, Array]]
    exact: bool
    ports: Array
    moving: bool
    releases: bool
    findings: tuple[tuple[str, MeshFault], ...]
    apart: tuple[tuple[str, str], ...]

    @property
    def rules(self) -> tuple[int, ...]:
        """Number of the rule of each facet, then of each native pair."""
        return tuple(pair.rule for pair in (*self.facets, *self.native))

    def candidate(self, k: int) -> tuple[int, int, float]:
        """Of facet ``k``: frames of the round and of the surface, radius of the round [m]."""
        row = self.geometry.index[k * geo.ROW :]
        radius = self.geometry.values[k * geo.VALUES + geo.RADIUS]
        return int(row[geo.ROUND_FRAME]), int(row[geo.SURFACE_FRAME]), float(radius)

    @property
    def rigid(self) -> bool:
        """Whether the wrench follows from A's pose in S: facets on geoms fixed to their side."""
        return not self.native and not self.frames and not self.moving


def sides_of(mechanism: Mechanism) -> Sides:
    """The contacts of a mechanism, from its MJCF. Raises InputError."""
    stamps = tuple((str(f), stamp(f)) for f in mechanism.files())
    sites = {site for phase in mechanism.phases() for site in phase.sites()}
    return _sides(stamps, mechanism.rules(), tuple(sorted(sites)), mechanism.captured)


@lru_cache(maxsize=32)
def _sides(
    stamps: tuple[tuple[str, str], ...],
    rules: tuple[Rule, ...],
    sites: tuple[tuple[str, str], ...],
    captured: bool,
) -> Sides:
    active, passive = (Side(file, site) for (file, _), site in zip(stamps, ("A", "P"), strict=True))
    pairs = (
        []
        if captured
        else [(a, p, k) for k, rule in enumerate(rules) for a, p in _meeting(active, passive, rule)]
    )
    if not pairs and not captured:
        reason = (
            "no pair of geoms is within the reach of its class; give a longer reach"
            if any(rule.active for rule in rules)
            else "no geom of one can touch one of the other; a geom may touch if contype and "
            'conaffinity are not 0: give at least one geom of each side contype="1" '
            'conaffinity="1"'
        )
        raise InputError(f"{active.file}, {passive.file}: {reason}")
    if len(pairs) > MOST_PAIRS:
        raise InputError(
            f"{active.file}, {passive.file}: {len(pairs)} pairs of geoms may touch (at most "
            f"{MOST_PAIRS}); name only those that do, "
            "or give a class of pairs a reach"
        )
    facets, native, candidates = [], [], []
    frames: Frames = {}
    for a, p, k in pairs:
        names = active.name(a), passive.name(p)
        if _facets(active.type(a), passive.type(p)):
            facets.append(Pair(*names, k))
            candidates.append(_candidate(active, a, passive, p, frames))
        elif _facets(passive.type(p), active.type(a)):
            facets.append(Pair(*names, k))
            candidates.append(_candidate(passive, p, active, a, frames))
        else:
            for side, geom in ((active, a), (passive, p)):
                if (reason := side.not_convex(geom)) is not None:
                    raise InputError(
                        f"{side.file}: the pair {' - '.join(names)} has no exact contact: {reason}"
                    )
            native.append(Pair(*names, k))
    placed = {
        (port, name): (active if port == "A" else passive).site(name, frames)
        for port, name in sites
    }
    exact = not native and all(
        surf.SPHERE in types and EXACT.issuperset(types)
        for types in ((active.type(a), passive.type(p)) for a, p, _ in pairs)
    )
    moving = bool(active.model.njnt or passive.model.njnt)
    findings = (*active.findings.items(), *passive.findings.items())
    return Sides(
        tuple(facets),
        packed(candidates),
        tuple(native),
        tuple(frames),
        placed,
        exact and not moving,
        np.array([[*s.origin, *quaternion(s.axes)] for s in (active, passive)]),
        moving,
        active.releases() or passive.releases(),
        tuple((name, f) for name, found in findings for f in found),
        (*active.apart(), *passive.apart()),
    )


def _facets(round_: int, surface: int) -> bool:
    return (round_ == surf.SPHERE and (surface in surf.KINDS or surface == surf.MESH)) or (
        round_ == surf.CAPSULE and surface in ROD_FACETS
    )


def _candidate(
    one: Side, round_: int, other: Side, surface: int, frames: Frames
) -> tuple[Round, Placed]:
    frame_a, ends = one.in_frame(round_, frames)
    half = one.model.geom_size[round_, 1] if one.type(round_) == surf.CAPSULE else 0.0
    along = ends[1][:, 2] * half
    places = np.array([ends[0] + along, ends[0] - along])
    frame_p, (position, turn) = other.in_frame(surface, frames)
    place = np.concatenate([position, quaternion(turn)])
    return Round(float(one.model.geom_size[round_, 0]), places, frame_a), Placed(
        other.surface(surface), place, frame_p, other.port == "P"
    )


def _meeting(active: Side, passive: Side, rule: Rule) -> list[tuple[int, int]]:
    """Pairs of geom numbers that a rule selects."""
    chosen = []
    for side, pattern in ((active, rule.active), (passive, rule.passive)):
        if pattern is None:
            chosen.append(side.touching())
        else:
            names = [side.name(g) for g in range(side.model.ngeom)]
            if not matching(pattern, names):
                raise InputError(
                    f"{side.file}: no geom is called {pattern!r}; its geoms are "
                    f"{', '.join(names[:20])}"
                )
            chosen.append([names.index(name) for name in matching(pattern, names)])
    pairs = [(a, p) for a in chosen[0] for p in chosen[1]]
    if rule.reach is None:
        return pairs
    apart = [active.ends(a)[:, None] - passive.ends(p)[None] for a, p in pairs]
    lateral = [np.linalg.norm(way, axis=2).min() for way in apart]
    return [pair for pair, away in zip(pairs, lateral, strict=True) if away < rule.reach]
