"""Puts both sides of a mechanism into a rig's MJCF, with all that MuJoCo needs to let them touch and latch.

Names in the composed model begin with ``active_`` and ``passive_``. The sites ``active_A`` and ``passive_P`` are the ports. Every contact
is an explicit pair, ``facet_<k>`` or ``native_<k>``; a latch is a weld or a ball joint (``connect``) that is switched on.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact import mount
from hiltestbed.contact.sides import Pair, Sides, sides_of
from hiltestbed.frames import Array, quat_to_mujoco

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

ACTIVE, PASSIVE = "active_", "passive_"
FLANGE = ACTIVE + "flange"  # the body that carries the active side
LATCH = "latch"
# Contact that is a spring and a damper in N/m and N s/m (hiltestbed.contact.solref) needs a small, constant impedance.
IMPEDANCE = 1e-4
INVERSE_WEIGHT = 1.0  # [1/kg], [1/(kg m^2)] of the active side, as contact and latch take it
CONTACT_SOLIMP = (IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 1.0)
FACET = (0.2, 0.2, 0.25)  # [m] half sizes: a ball that is deeper than its radius still finds the facet's face nearest
AWAY = 1e3  # [m] where a facet is parked that nothing is near to
ORIGIN = np.zeros(3)
PROXY = np.array([0.0, 0.0, -0.1])  # somewhere, and not at the body's own origin: MuJoCo would take a short cut when it moves
_UNALIGNED = (0.9, 0.1, 0.2, 0.3)  # likewise for attitudes
# What the sensor of a native pair says of its deepest point: how many points there are; distance; place; normal; velocity across it.
_READ = (
    mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_DIST, mujoco.mjtConDataField.mjCONDATA_POS,
    mujoco.mjtConDataField.mjCONDATA_NORMAL, mujoco.mjtConDataField.mjCONDATA_LINVEL,
)  # fmt: skip
FOUND, DIST, POS, NORMAL, LINVEL, READ = 0, 1, 2, 5, 8, 11  # where each stands in what it says
IMMOVABLE = 1e8  # [kg], [kg m^2] of a joint's own inertia
DEEPEST = 1  # the sensor's reduction "mindist"
_UNSEEN = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 5}


@dataclass(frozen=True)
class Structure:
    """What a rig's model depends on as far as the mechanism goes, apart from numbers: runs of one structure go in lockstep.

    Attributes:
        shape: of the mechanism. mounted: the passive side is on a compliant mount.
        constant: springs and dampers without friction, which MuJoCo's own collision computes exactly: nothing is written between steps.
        rubs: there is friction. latched: the sides may be latched to each other. touches: the sides touch at all; else a wrench is
            applied from outside. held: parts that move on a side stand still on it.
        mechanism: one of this shape.
    """

    shape: Hashable
    mounted: bool
    constant: bool
    rubs: bool
    latched: bool
    mechanism: Mechanism = field(compare=False)
    touches: bool = True
    held: bool = False

    @property
    def sides(self) -> Sides:
        """The mechanism as its MJCF has it."""
        return sides_of(self.mechanism)


def structure_of(mechanism: Mechanism, departs: bool, rubs: bool) -> Structure:
    """What a mechanism's model is made of.

    Args:
        departs: effects change the law. rubs: friction acts, by the mechanism's numbers or by an effect.
    """
    mounted = mechanism.mount is not None
    latched = mechanism.captured or mechanism.latch is not None
    constant = not (departs or rubs or mounted or latched or mechanism.phases()) and sides_of(mechanism).exact
    return Structure(mechanism.shape(), mounted, constant, rubs, latched, mechanism)


def drawn(mechanism: Mechanism) -> Structure:
    """A mechanism on a rigid mount that does not touch: to be looked at, or to be weighed."""
    return Structure(mechanism.shape(), mounted=False, constant=True, rubs=False, latched=False, mechanism=mechanism, touches=False)


def add_active(spec: mujoco.MjSpec, structure: Structure, body: mujoco.MjsBody, plane: Array, height: Array) -> None:
    """Put the active side on ``body`` so that A stands ``height`` (3,) above ``plane`` (3,) [m] in it, its axes along the body's."""
    add_side(spec, structure.mechanism, ACTIVE, body, plane, height)


def add_passive(spec: mujoco.MjSpec, structure: Structure, carrier: mujoco.MjsBody) -> None:
    """Put the passive side, on its mount if it has one, on ``carrier`` behind the six-axis force sensor; P at the carrier's origin.

    The carrier gets the site ``P_nominal``, where the sensor is.
    """
    carrier.add_site(name="P_nominal")
    body = carrier
    if structure.mounted:
        body = carrier.add_body(name=mount.MOUNTED)
        mount.add_joints(body)
    add_side(spec, structure.mechanism, PASSIVE, body)
    for sensor, name in ((mujoco.mjtSensor.mjSENS_FORCE, "force"), (mujoco.mjtSensor.mjSENS_TORQUE, "torque")):
        spec.add_sensor(name=name, type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="P_nominal")


def add_contact(spec: mujoco.MjSpec, structure: Structure) -> None:
    """Everything that touches and latches, once both sides are in ``spec``."""
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
        for k, pair in enumerate(sides.facets):
            _facet(spec, k, pair, structure.rubs)
        for k, pair in enumerate(sides.native):
            _native(spec, k, pair, structure.rubs)
    _latches(spec, structure)


def add_side(
    spec: mujoco.MjSpec, mechanism: Mechanism, prefix: str, body: mujoco.MjsBody, plane: Array = ORIGIN, height: Array = ORIGIN
) -> None:
    """The active or the passive side, as the ``prefix`` says, on ``body`` so that its port stands ``height`` above ``plane``, unturned."""
    which = (ACTIVE, PASSIVE).index(prefix)
    port = sides_of(mechanism).ports[which]
    back, offset = quat_to_mujoco(port[3:7] * [-1.0, -1.0, -1.0, 1.0]), np.zeros(3)
    mujoco.mju_rotVecQuat(offset, port[:3], back)
    spec.attach(mechanism.sides()[which], prefix=prefix, frame=body.add_frame(pos=plane + (height - offset), quat=back))


def weigh_contact(model: mujoco.MjModel, carrier: str, held: bool = False) -> None:
    """Have contact and latch of a compiled ``model`` push with K x + C v, however the ``carrier`` of the active side accelerates.

    MuJoCo's soft force is f = (a_ref - a)/R with R = A (1 - d)/d. A is the sum of both bodies' ``body_invweight0``, a the acceleration at
    the contact: f lacks d a/A of K x + C v. Where a newton accelerates the carrier by y, and MuJoCo's own estimate of y is all that A is,
    that is d of the force along the normal, and several times that across it. Here A is 1/kg, so that it is d y, 3e-7 on a platform of
    334 kg. Only contact and latch ask for this weight: the carrier is a body of its own, no joint or loop of the rig is fastened to it.

    ``held``: what moves by itself on the carrier is kept from it.
    """
    fixed, parts = carried_by(model, carrier)
    _weigh_parts(model, parts, held)
    model.body_invweight0[fixed] = INVERSE_WEIGHT


def carried_by(model: mujoco.MjModel, carrier: str) -> tuple[list[int], list[int]]:
    """Numbers of the bodies that are fixed to the ``carrier``, itself among them, and of those that move on it."""
    body = model.body(carrier).id
    fixed, parts = [body], []
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in parts:
            parts.append(other)
        elif model.body_parentid[other] in fixed:
            (fixed if model.body_weldid[other] == model.body_weldid[body] else parts).append(other)
    return fixed, parts


def _weigh_parts(model: mujoco.MjModel, parts: list[int], held: bool) -> None:
    """Have the ``parts`` rub, stop and push as if what carries them stood still.

    The joints of the rig count in MuJoCo's own inverse weights, by which a joint's friction creeps while it sticks.
    """
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
        mujoco.mj_jacBodyCom(model, data, jac[:3], jac[3:], body)
        moved = np.diag(jac[:, dofs] @ yields @ jac[:, dofs].T).reshape(2, 3).mean(axis=1)
        _put(model.body_invweight0, body, np.where(moved > mujoco.mjMINVAL, moved, INVERSE_WEIGHT))  # else it is fixed in that way
    if held:
        model.dof_armature[dofs] = IMMOVABLE


def _put(weights: Array, at: NDArray[np.int_] | int, value: Array | float) -> None:
    """Write ``value`` where MuJoCo's own differs by more than what so heavy a carrier as one that is placed yields."""
    weights[at] = np.where(np.isclose(weights[at], value, rtol=1e-6, atol=0.0), weights[at], value)


def inverse_mass(model: mujoco.MjModel, bodies: NDArray[np.int_]) -> Array:
    """``(k,)`` what a stiffness [N/m] between ``bodies`` (2, k) is multiplied with in a direct solref [1/kg].

    A - d w: A the sum of both inverse weights, w that of the active side (:func:`weigh_contact`), beside which it hardly yields. A part
    that moves by itself has the inverse weight that MuJoCo finds, and yields by about as much: d of the force, which is left in.
    """
    weight = model.body_invweight0[bodies, 0]
    carries = model.body_weldid[bodies] == model.body_weldid[model.site_bodyid[model.site(ACTIVE + "A").id]]
    return np.asarray(weight.sum(axis=0) - IMPEDANCE * np.where(carries, weight, 0.0).sum(axis=0))


def _pair(spec: mujoco.MjSpec, name: str, active: str, passive: str, rubs: bool) -> None:
    spec.add_pair(name=name, geomname1=active, geomname2=passive, condim=3 if rubs else 1, solimp=CONTACT_SOLIMP)


def _facet(spec: mujoco.MjSpec, k: int, pair: Pair, rubs: bool) -> None:
    """A box on the body of the surface, and on that of the round a ball: of a rod it stands where the rod is nearest."""
    one, other = spec.geom(ACTIVE + pair.active), spec.geom(PASSIVE + pair.passive)
    round_, surface = (other, one) if pair.swapped else (one, other)
    box, ball = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    surface.parent.add_geom(name=f"facet_{k}", type=box, size=FACET, pos=[0.0, 0.0, AWAY], quat=_UNALIGNED, **_UNSEEN)
    round_.parent.add_geom(name=f"ball_{k}", type=ball, size=[round_.size[0], 0.0, 0.0], pos=PROXY, **_UNSEEN)
    _pair(spec, f"facet_{k}", f"ball_{k}", f"facet_{k}", rubs)


def _native(spec: mujoco.MjSpec, k: int, pair: Pair, rubs: bool) -> None:
    """A pair of MuJoCo's own, and a sensor of how many points it has, how deep the deepest is, and where."""
    active, passive = ACTIVE + pair.active, PASSIVE + pair.passive
    _pair(spec, f"native_{k}", active, passive, rubs)
    geom = mujoco.mjtObj.mjOBJ_GEOM
    sensor = spec.add_sensor(
        name=f"native_{k}", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=geom, objname=active, reftype=geom, refname=passive
    )
    sensor.intprm = [sum(1 << int(part) for part in _READ), DEEPEST, 1]


def _latches(spec: mujoco.MjSpec, structure: Structure) -> None:
    """Between the bodies that carry the sites of each closure; none is on."""
    closures = [(LATCH, "weld", "A", "P")] if structure.latched else []
    closures += [(p.name, p.close.kind, p.close.active, p.close.passive) for p in structure.mechanism.phases() if p.close is not None]
    for name, kind, active, passive in closures:
        bodies = [site.parent.name for site in (spec.site(PASSIVE + passive), spec.site(ACTIVE + active))]
        type_ = mujoco.mjtEq.mjEQ_WELD if kind == "weld" else mujoco.mjtEq.mjEQ_CONNECT
        spec.add_equality(
            name=name, type=type_, objtype=mujoco.mjtObj.mjOBJ_BODY, name1=bodies[0], name2=bodies[1], active=False, solimp=CONTACT_SOLIMP
        )  # fmt: skip
