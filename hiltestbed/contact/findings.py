"""Faults in a mechanism's files, and remarks on its contacts before a run."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from hiltestbed.config.models import model_of, stamp
from hiltestbed.contact.active_ring import JOINTS
from hiltestbed.contact.composition import ACTIVE, PASSIVE, PREFIXES, Structure, add_side, drawn
from hiltestbed.contact.legs import divergent
from hiltestbed.contact.phases import actuators_of, dropped_by, joints_of
from hiltestbed.contact.sides import Pair, Sides, sides_of
from hiltestbed.contact.touch import BEYOND, Meeting, nothing_met
from hiltestbed.errors import InputError
from hiltestbed.frames import quat_from_attitude_deg, quat_to_mujoco

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism
    from hiltestbed.scenario.like import ScenarioLike

OVERLAP = 1e-6  # [m] overlap of geoms that is tolerated at the start
LISTED = 6


def faults(scenario: ScenarioLike) -> Iterator[str]:
    """Why the mechanism cannot run: its files, its phases, geoms that overlap at the start."""
    mechanism = scenario.mechanism
    try:
        sides = sides_of(mechanism)
        model = _both(mechanism)
    except InputError as error:
        yield str(error)
        return
    if (ring := mechanism.actuated()) is not None:
        dofs = [int(model.joint(ACTIVE + name).dofadr[0]) for name in JOINTS]
        yield from divergent(ring, model.dof_M0[dofs], scenario.tick / scenario.substeps)
    for phase in mechanism.phases():
        for find in (joints_of, actuators_of):
            try:
                find(phase, model)
            except InputError as error:
                yield str(error)
        lost = [pattern for pattern in phase.drop_contacts if not dropped_by(sides, [pattern]).size]
        if lost:
            yield (
                f"phase {phase.name!r}: no geom of the active side that may touch is "
                f"called {', '.join(lost)}"
            )
    if scenario.approach.gap > 0.0 and not mechanism.captured:
        yield from _overlaps(scenario, sides, model)


def _overlaps(scenario: ScenarioLike, sides: Sides, model: mujoco.MjModel) -> Iterator[str]:
    approach = scenario.approach
    pose = np.array(
        [*approach.offset, -approach.gap, *quat_from_attitude_deg(approach.attitude_deg)]
    )
    data = mujoco.MjData(model)
    at = int(model.joint("A_joint").qposadr[0])
    data.qpos[at : at + 3], data.qpos[at + 3 : at + 7] = pose[:3], quat_to_mujoco(pose[3:7])
    mujoco.mj_kinematics(model, data)
    depths: list[tuple[float, Pair]] = []
    if sides.facets:
        meeting = Meeting(sides)
        for k, (side, name) in enumerate(sides.frames):
            body = data.body(PREFIXES[side] + name)
            meeting.frames[2 + k] = [*body.xpos, *body.xquat[[1, 2, 3, 0]]]
        meeting.deepest(pose)
        depths += zip(map(float, meeting.depth), sides.facets, strict=True)
    for pair in sides.native:
        ends = [
            model.geom(prefix + name).id
            for prefix, name in ((ACTIVE, pair.active), (PASSIVE, pair.passive))
        ]
        depths.append((-mujoco.mj_geomDistance(model, data, *ends, 0.1, None), pair))
    deep = [item for item in depths if item[0] > OVERLAP]
    if deep:
        deep.sort(key=lambda item: -item[0])
        named = "; ".join(
            f"{pair.active} and {pair.passive} by {1e3 * depth:.3g} mm"
            for depth, pair in deep[:LISTED]
        )
        yield (
            f"geoms overlap at the start: {named}; start farther away (approach.gap), or "
            f"leave the pair out"
        )


def _both(mechanism: Mechanism) -> mujoco.MjModel:
    stamps = tuple(stamp(f) for f in mechanism.files())
    return _compiled(drawn(mechanism), stamps)


@lru_cache(maxsize=16)
def _compiled(structure: Structure, stamps: tuple[str, ...]) -> mujoco.MjModel:
    """Both sides alone, the active one on a free body. Raises InputError."""
    spec = mujoco.MjSpec()
    add_side(spec, structure.mechanism, PASSIVE, spec.worldbody.add_body(name="P_body"))
    body = spec.worldbody.add_body(
        name="A_body", mass=1.0, inertia=[1.0, 1.0, 1.0], explicitinertial=True
    )
    body.add_freejoint(name="A_joint")
    add_side(spec, structure.mechanism, ACTIVE, body)
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(
            f"{', '.join(map(str, structure.mechanism.files()))}: MuJoCo cannot compile both "
            f"sides: {error}"
        ) from error


def remarks(scenario: ScenarioLike) -> list[str]:
    """On a mechanism's contacts: what may touch and how, an approach that misses, meshes."""
    mechanism = scenario.mechanism
    sides = sides_of(mechanism)
    contacts, out = mechanism.contacts(), []
    for what, pairs in (("nearest point", sides.facets), ("MuJoCo's own collision", sides.native)):
        for k, contact in enumerate(contacts):
            found = [f"{p.active} - {p.passive}" for p in pairs if p.rule == k]
            if found:
                out.append(
                    f"can meet ({what}; {contact.stiffness:g} N/m, {contact.damping:g} N s/m, "
                    f"friction {contact.friction:g}): {_listed(found)}"
                )
    if nothing_met(scenario.impact):
        out.append(
            f"nothing touches on the straight way along z from the start to {1e3 * BEYOND:g} mm "
            f"beyond the nominal touch: look where the sites A and P stand (at the foremost points "
            f"of their sides, z of both along the insertion), at the offset and at the attitude"
        )
    shared = [p for p in sides.native if not p.single]
    if shared:
        out.append(
            f"{len(shared)} pairs of flat or convex parts divide their stiffness among the points "
            f"that MuJoCo finds: exact if all have the "
            "same penetration, up to 8 % too stiff if parts roll on an edge"
        )
    if sides.apart:
        shown = _listed([" - ".join(pair) for pair in sides.apart])
        out.append(
            f"geoms of one side do not touch each other unless a <pair> in its file says "
            f"so; these would in MuJoCo: {shown}"
        )
    for file in mechanism.files():
        if unused := model_of(file).settings():
            out.append(
                f"{file}: {', '.join(unused)}: without effect; the rig and the scenario decide"
            )
    out += [f"mesh of the geom {name!r}: {finding.message}" for name, finding in sides.findings]
    return out


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more
