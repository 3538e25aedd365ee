"""Inserts both sides of a mechanism into a rig's MJCF, with everything that MuJoCo needs for
contacts and latches.

Names in the composed model begin with ``active_`` and ``passive_``. The sites ``active_A`` and
``passive_P`` are the ports. Every contact is an explicit pair, ``facet_<k>`` or ``native_<k>``; a
latch is a weld or ball-joint (``connect``) equality that is switched on.

Stiffness [N/m] and damping [N s/m] are MuJoCo's contact parameters: with a direct ``solref = (-K A,
-C A)``, a constant impedance d = 1e-4 and elliptic cones, its soft contact gives F = K x + C v,
never negative, for penetration x and its rate v at the start of the step. A [1/kg] is the sum of
the inverse weights of the two bodies that carry the geoms, ``body_invweight0``, with a correction
(:func:`inverse_mass`). This is for contacts that push only along the normal; for friction, other
laws and other surfaces see :mod:`hiltestbed.contact.engagement`.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.contact import mount
from hiltestbed.contact.geometry import ACTIVE as A
from hiltestbed.contact.geometry import FRAMES
from hiltestbed.contact.geometry import PASSIVE as S
from hiltestbed.contact.parameters import DAMPING, STIFFNESS, acting_contacts
from hiltestbed.contact.sides import Sides, sides_of
from hiltestbed.contact.wrench import LATCH_RADIUS
from hiltestbed.effects.table import by_link
from hiltestbed.frames import Array, quat_to_mujoco

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism
    from hiltestbed.effects.base import Effect

ACTIVE, PASSIVE = "active_", "passive_"
PREFIXES = {"A": ACTIVE, "P": PASSIVE}  # by the port of a side
FLANGE = ACTIVE + "flange"  # the body that carries the active side
LATCH = "latch"
IMPEDANCE = 1e-4  # d: contact that is a spring and a damper needs a small, constant one
NO_DAMPING = -1e-12  # [1/s] MuJoCo reads a solref as direct only when both numbers are negative
INVERSE_WEIGHT = 1.0  # [1/kg], [1/(kg m^2)] of the active side, as used by contacts and latches
CONTACT_SOLIMP = (IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 1.0)
# [m] half sizes, so large that the facet's face is nearest even to a ball deeper than its radius
FACET = (0.2, 0.2, 0.25)
AWAY = 1e3  # [m] position at which an unused facet is parked
ORIGIN = np.zeros(3)
SITE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # pose of coincident sites
# any position but the body's origin, where MuJoCo would short-cut the geom's kinematics
PROXY = np.array([0.0, 0.0, -0.1])
_UNALIGNED = (0.9, 0.1, 0.2, 0.3)  # likewise any attitude but the body's
# Readings of the sensor of a native pair: number of points; of the deepest point distance,
# position, normal, velocity in its frame.
_READ = (
    mujoco.mjtConDataField.mjCONDATA_FOUND,
    mujoco.mjtConDataField.mjCONDATA_DIST,
    mujoco.mjtConDataField.mjCONDATA_POS,
    mujoco.mjtConDataField.mjCONDATA_NORMAL,
    mujoco.mjtConDataField.mjCONDATA_LINVEL,
)
# offset of each in the reading, and the reading's length
FOUND, DIST, POS, NORMAL, LINVEL, READ = 0, 1, 2, 5, 8, 11
IMMOVABLE = 1e8  # [kg], [kg m^2] armature that keeps a joint from moving
DEEPEST = 1  # the sensor's reduction "mindist"
_UNSEEN = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 5}


@dataclass(frozen=True)
class Structure:
    """The structure of a rig's model as given by the mechanism, apart from numerical parameters:
    runs of one structure go in lockstep.

    Attributes:
        shape: of the mechanism. mounted: whether the passive side is on a compliant mount.
        constant: whether all contacts are springs and dampers without friction, which MuJoCo's own
            collision computes exactly: nothing is written between steps.
        rubs: whether there is friction. latched: whether the sides may be latched. touches: whether
            the sides touch; otherwise an external wrench is applied. held: whether moving parts are
            kept fixed to their side.
        mechanism: one of this shape.
    """

    shape: Hashable
    mechanism: Mechanism = field(compare=False)
    mounted: bool = False
    constant: bool = True
    rubs: bool = False
    latched: bool = False
    touches: bool = True
    held: bool = False

    @property
    def sides(self) -> Sides:
        """The contents of the mechanism's MJCF."""
        return sides_of(self.mechanism)


@dataclass(frozen=True)
class ComposedClosure:
    """One of a mechanism's closures.

    Attributes:
        name: of MuJoCo's equality. frames: of the active and of the passive site; places: (2, 7)
            poses of the sites in them. radius: [m]; stiffness [N/m], damping [N s/m]; None: those
            of the contact. turns: whether it resists rotation. law: whether the contact's law acts
            along z. together: whether it makes the sites coincide; otherwise it holds the relative
            pose at which it closes.
    """

    name: str
    frames: tuple[int, int]
    places: Array
    radius: float
    stiffness: float | None = None
    damping: float | None = None
    turns: bool = True
    law: bool = False
    together: bool = False


def closures_of(structure: Structure) -> list[ComposedClosure]:
    """The closures of a mechanism."""
    found = []
    if structure.latched:
        found.append(ComposedClosure(LATCH, (A, S), np.array([SITE, SITE]), LATCH_RADIUS, law=True))
    sites = structure.sides.sites
    for phase in structure.mechanism.phases():
        if (close := phase.close) is not None:
            (a, at_a), (p, at_p) = sites["A", close.active], sites["P", close.passive]
            found.append(
                ComposedClosure(
                    phase.name,
                    (a, p),
                    np.array([at_a, at_p]),
                    close.radius or 0.0,
                    close.stiffness,
                    close.damping,
                    turns=close.kind == "weld",
                    together=close.hold == "together",
                )
            )
    return found


def structure_of(mechanism: Mechanism, effects: Iterable[Effect]) -> Structure:
    """The structure of a mechanism's model, with the ``effects`` on its contacts."""
    acting = by_link(effects, "contact")
    rubs = any(c.friction > 0.0 for c in acting_contacts(mechanism, acting)[:-1])
    mounted = mechanism.mount is not None
    latched = mechanism.captured or mechanism.latch is not None
    constant = (
        not (acting or rubs or mounted or latched or mechanism.phases())
        and sides_of(mechanism).exact
    )
    return Structure(mechanism.shape(), mechanism, mounted, constant, rubs, latched)


def drawn(mechanism: Mechanism) -> Structure:
    """A mechanism on a rigid mount without contacts, for drawing or weighing."""
    return Structure(mechanism.shape(), mechanism, touches=False)


def add_passive(spec: mujoco.MjSpec, structure: Structure, carrier: mujoco.MjsBody) -> None:
    """Attach the passive side, with its compliant mount if any, and the six-axis force sensor to
    ``carrier``; P at the carrier's origin.

    The carrier gets the site ``P_nominal``, at which the sensor is.
    """
    carrier.add_site(name="P_nominal")
    body = carrier
    if structure.mounted:
        body = carrier.add_body(name=mount.MOUNTED)
        mount.add_joints(body)
    add_side(spec, structure.mechanism, PASSIVE, body)
    for sensor, name in (
        (mujoco.mjtSensor.mjSENS_FORCE, "force"),
        (mujoco.mjtSensor.mjSENS_TORQUE, "torque"),
    ):
        spec.add_sensor(
            name=name, type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="P_nominal"
        )


def add_contact(spec: mujoco.MjSpec, structure: Structure) -> None:
    """Add all contacts and latches, once both sides are in ``spec``."""
    for prefix in (ACTIVE, PASSIVE):
        for geom in spec.geoms:
            if geom.name.startswith(prefix):
                geom.contype = geom.conaffinity = 0
    if not structure.touches:
        return
    sides = structure.sides
    if structure.constant:
        for k, pair in enumerate((*sides.facets, *sides.native)):
            _pair(spec, f"native_{k}", ACTIVE + pair.active, PASSIVE + pair.passive, rubs=False)
    else:
        _add_facets(spec, sides, structure.rubs)
        _add_native(spec, sides, structure.rubs)
    for closure in closures_of(structure):  # none is active
        active, passive = (body_of(spec, sides, frame) for frame in closure.frames)
        spec.add_equality(
            name=closure.name,
            type=mujoco.mjtEq.mjEQ_WELD if closure.turns else mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=passive,
            name2=active,
            active=False,
            solimp=CONTACT_SOLIMP,
        )


def add_side(
    spec: mujoco.MjSpec,
    mechanism: Mechanism,
    prefix: str,
    body: mujoco.MjsBody,
    plane: Array = ORIGIN,
    height: Array = ORIGIN,
) -> None:
    """Attach a side to ``body``, its port at ``plane`` + ``height`` (3,) [m], axes alike."""
    which = (ACTIVE, PASSIVE).index(prefix)
    port = sides_of(mechanism).ports[which]
    back, offset = quat_to_mujoco(port[3:7] * [-1.0, -1.0, -1.0, 1.0]), np.zeros(3)
    mujoco.mju_rotVecQuat(offset, port[:3], back)
    spec.attach(
        mechanism.sides()[which],
        prefix=prefix,
        frame=body.add_frame(pos=plane + (height - offset), quat=back),
    )


def weigh_contact(model: mujoco.MjModel, carrier: str, held: bool = False) -> None:
    """Make contacts and latches of a compiled ``model`` exert K x + C v, whatever the acceleration
    of the active side's ``carrier``.

    MuJoCo's soft force is f = (a_ref - a)/R with R = A (1 - d)/d. A is the sum of both bodies'
    ``body_invweight0``, a the acceleration at the contact: f is d a/A less than K x + C v. If A is
    MuJoCo's estimate of y, the carrier's
        acceleration per newton, the error is a fraction d of the force along the normal, and
        several times that across it. Here A is set to 1/kg, so that the fraction is d y, 3e-7 on a
        platform of 334 kg. Only contacts and latches use this weight: the carrier is a separate
        body, to which no joint or loop of the rig is attached.

    ``held``: parts that move on the carrier are kept fixed.
    """
    fixed, parts = carried_by(model, carrier)
    model.body_invweight0[fixed] = INVERSE_WEIGHT
    # The parts have weights (for friction, limits and contacts) as if their carrier were fixed;
    # MuJoCo's own include the joints of the rig, which would make a sticking joint's friction creep
    dofs = np.flatnonzero(np.isin(model.dof_bodyid, parts))
    if not dofs.size:
        return
    data, mass, jac = mujoco.MjData(model), np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    yields = np.linalg.inv(mass[np.ix_(dofs, dofs)])
    for joint in np.unique(model.dof_jntid[dofs]):
        own = model.dof_jntid[dofs] == joint
        _put(model.dof_invweight0, dofs[own], np.diag(yields)[own].mean())
    for body in parts:
        # at the centre of all that is welded together: it does not depend on the division in bodies
        welded = model.body_weldid == model.body_weldid[body]
        centre = np.average(data.xipos[welded], axis=0, weights=model.body_mass[welded])
        mujoco.mj_jac(model, data, jac[:3], jac[3:], centre, body)
        moved = np.diag(jac[:, dofs] @ yields @ jac[:, dofs].T).reshape(2, 3).mean(axis=1)
        # else it cannot move in that way
        _put(model.body_invweight0, body, np.where(moved > mujoco.mjMINVAL, moved, INVERSE_WEIGHT))
    if held:
        model.dof_armature[dofs] = IMMOVABLE


def carried_by(model: mujoco.MjModel, carrier: str) -> tuple[list[int], list[int]]:
    """Numbers of the bodies fixed to the ``carrier``, with itself, and of those moving on it."""
    body = model.body(carrier).id
    fixed, parts = [body], []
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in parts:
            parts.append(other)
        elif model.body_parentid[other] in fixed:
            (fixed if model.body_weldid[other] == model.body_weldid[body] else parts).append(other)
    return fixed, parts


def _put(weights: Array, at: NDArray[np.int_] | int, value: Array | float) -> None:
    """Write ``value``, unless MuJoCo's own differs by the motion of a very heavy carrier only."""
    weights[at] = np.where(np.isclose(weights[at], value, rtol=1e-6, atol=0.0), weights[at], value)


def inverse_mass(model: mujoco.MjModel, bodies: NDArray[np.int_]) -> Array:
    """``(k,)`` factor of a stiffness [N/m] between ``bodies`` (2, k) in a direct solref [1/kg].

    A - d w: A the sum of both inverse weights, w that of the active side (:func:`weigh_contact`),
    compared with which its true mobility is small. A moving part has MuJoCo's inverse weight, close
    to its true mobility: the resulting error, d of the force, is not corrected.
    """
    weight = model.body_invweight0[bodies, 0]
    carries = (
        model.body_weldid[bodies]
        == model.body_weldid[model.site_bodyid[model.site(ACTIVE + "A").id]]
    )
    return np.asarray(weight.sum(axis=0) - IMPEDANCE * np.where(carries, weight, 0.0).sum(axis=0))


def _pair(spec: mujoco.MjSpec, name: str, active: str, passive: str, rubs: bool) -> None:
    spec.add_pair(
        name=name,
        geomname1=active,
        geomname2=passive,
        condim=3 if rubs else 1,
        solimp=CONTACT_SOLIMP,
    )


def body_of(spec: mujoco.MjSpec, sides: Sides, frame: int) -> str:
    """The body to which a frame is fixed: that of the port's site, or a moving part."""
    if frame < FRAMES:
        site = (ACTIVE + "A", PASSIVE + "P")[frame]
        return spec.site(site).parent.name
    port, body = sides.frames[frame - FRAMES]
    return PREFIXES[port] + body


def _add_facets(spec: mujoco.MjSpec, sides: Sides, rubs: bool) -> None:
    """A box in the frame of each surface, a ball in that of its round."""
    box, ball = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    away = {"size": FACET, "pos": [0.0, 0.0, AWAY], "quat": _UNALIGNED}
    for k in range(len(sides.facets)):
        rounds, surfaces, radius = sides.candidate(k)
        surface, body = (spec.body(body_of(spec, sides, f)) for f in (surfaces, rounds))
        surface.add_geom(name=f"facet_{k}", type=box, **away, **_UNSEEN)
        body.add_geom(name=f"ball_{k}", type=ball, size=[radius, 0.0, 0.0], pos=PROXY, **_UNSEEN)
        _pair(spec, f"facet_{k}", f"ball_{k}", f"facet_{k}", rubs)


def _add_native(spec: mujoco.MjSpec, sides: Sides, rubs: bool) -> None:
    """Pairs for MuJoCo's own collision detection, each with a sensor of its deepest point."""
    geom = mujoco.mjtObj.mjOBJ_GEOM
    for k, pair in enumerate(sides.native):
        active, passive = ACTIVE + pair.active, PASSIVE + pair.passive
        _pair(spec, f"native_{k}", active, passive, rubs)
        sensor = spec.add_sensor(
            name=f"native_{k}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=geom,
            objname=active,
            reftype=geom,
            refname=passive,
        )
        sensor.intprm = [sum(1 << int(part) for part in _READ), DEEPEST, 1]


def set_linear(batch: Batch, laws: Array) -> None:
    """Set the pairs of a ``constant`` structure from their ``laws`` (n, T + 1, PARAMETERS)."""
    m, count = batch.model, laws.shape[1] - 1
    pairs = [m.pair(f"native_{k}").id for k in range(count)]
    geoms = np.stack([m.pair_geom1, m.pair_geom2])[:, pairs]
    gain, solref = inverse_mass(m, m.geom_bodyid[geoms]), batch.expand("pair_solref")
    solref[:, pairs, 0] = -laws[:, :-1, STIFFNESS] * gain
    solref[:, pairs, 1] = np.minimum(-laws[:, :-1, DAMPING] * gain, NO_DAMPING)
