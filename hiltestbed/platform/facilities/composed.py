"""The MuJoCo models of a rig, from the MJCF files in ``models/``: a facility with both sides of a
docking mechanism on it, and the mechanisms alone.

The world frame W has its origin at the nominal position of P, z up along the insertion: a pose in W
is a pose in P while the passive side is at its nominal pose. Site names: ``active_A`` and
``passive_P`` on the two mechanisms.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.composition import (
    ACTIVE,
    FLANGE,
    PASSIVE,
    Structure,
    add_contact,
    add_passive,
    add_side,
    weigh_contact,
)
from hiltestbed.contact.mount import CARRIER
from hiltestbed.frames import Array, rotate_back
from hiltestbed.platform.facilities.bodies import PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT, NOMINAL, TOOL_HOME, Facility, set_steps
from hiltestbed.platform.facilities.motion import carry, load_of

TOOL = ACTIVE + "A"  # the site that follows the command
SENSOR_AXES = np.array([0.0, 0.0, 0.0, 1.0])  # of the load, in which it is known
ROUNDING = 1e-9  # [N], [N m] rounding error of a difference of loads of up to 1e4
# Inputs of the load compensation of a moving sensor: a - g, angular rate and angular acceleration
# of P.
LOAD_SENSORS = (
    ("load_acceleration", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
    ("load_rate", mujoco.mjtSensor.mjSENS_GYRO),
    ("load_turning", mujoco.mjtSensor.mjSENS_FRAMEANGACC),
)


def sensor_columns(model: mujoco.MjModel) -> slice:
    """Columns of force and torque in MuJoCo's sensor data."""
    first = int(model.sensor("force").adr[0])
    return slice(first, first + 6)


def facility_spec(facility: Facility, structure: Structure, timestep: float) -> mujoco.MjSpec:
    """The facility with both sides, loops as stiff as possible; if the passive side moves, with
    sensors for its load compensation.
    """
    spec = facility.spec()
    spec.modelname = f"{facility.kind}-{structure.mechanism.kind}"
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    set_steps(spec, timestep)
    site = spec.site(MOUNT)
    flange, plane = site.parent, np.array(site.pos)
    if flange.name != FLANGE:
        flange = flange.add_body(name=FLANGE, pos=site.pos, quat=site.quat)
        plane = np.zeros(3)
    add_side(spec, structure.mechanism, ACTIVE, flange, plane, TOOL_HOME[:3])
    spec.delete(spec.site(NOMINAL))  # add_passive adds it again, at the same pose
    add_passive(spec, structure, spec.body(CARRIER))
    if isinstance(facility, PhysicalFacility):
        for prefix in (ACTIVE, PASSIVE):
            facility.lighten(spec, prefix)
    if facility.moves_passive:
        for name, kind in LOAD_SENSORS:
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=NOMINAL)
    add_contact(spec, structure)
    return spec


def facility_model(
    facility: Facility, structure: Structure, timestep: float, kept: int = 0
) -> mujoco.MjModel:
    """The composed facility for stepping: without purely visual parts, and with the last ``kept``
    readings of the force sensor in MuJoCo's history.
    """
    spec = facility_spec(facility, structure, timestep)
    spec.compiler.discardvisual = True
    for name in ("force", "torque"):
        spec.sensor(name).nsample = kept
    model = spec.compile()
    weigh_contact(model, FLANGE, structure.held)
    return model


def rest_reading(
    model: mujoco.MjModel, home: Array, columns: slice, body: int, balance: Array, centre: Array
) -> Array:
    """``(6,)`` the sensor's reading at ``home`` (nq,) without contact; the wrench ``balance`` (6,)
    at W's origin supports a mount.

    body, centre: body on which the balance acts, and its centre of mass (3,) in W.
    """
    apart = copy.copy(model)
    apart.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(apart)
    data.qpos[:] = home
    data.xfrc_applied[body, :3] = balance[:3]
    data.xfrc_applied[body, 3:] = balance[3:] - np.cross(centre, balance[:3])
    mujoco.mj_forward(apart, data)
    return np.array(data.sensordata[columns])


def carried_reading(
    model: mujoco.MjModel, home: Array, sensordata: Array, place: Array, wrench_sub: Array
) -> Call:
    """The kernel that writes the reading of a sensor that moves with the passive side, less weight
    and inertia of its rigid load, from ``sensordata`` (n, .) to ``wrench_sub[runs, sub]``.

    The load's wrench (:func:`hiltestbed.platform.facilities.motion.carry`) is computed from an
    accelerometer and gyroscopes at the sensor.

    Args:
        home: (nq,) joint positions at which P is at W's origin with W's attitude. place: (n, 7) of
            P in W.
    """
    force = int(model.sensor("force").adr[0])
    columns = np.array([int(model.sensor(name).adr[0]) for name, _ in LOAD_SENSORS])
    load = carried_load(model, home)
    return Call(_read_carried, force, columns, load, sensordata, place, GIVEN, wrench_sub, ...)


def carried_load(model: mujoco.MjModel, home: Array) -> Array:
    """``(13,)`` of what the sensor carries, about P, with the joints at ``home`` (nq,), as
    :func:`hiltestbed.platform.facilities.motion.load_of`; zeros without mass.
    """
    data, carried = mujoco.MjData(model), {model.body(CARRIER).id}
    data.qpos[:] = home
    mujoco.mj_forward(model, data)
    for b, parent in enumerate(model.body_parentid):  # a parent comes before its children
        if int(parent) in carried:
            carried.add(b)
    bodies = [b for b in sorted(carried) if model.body_mass[b] > 0.0]
    return load_of(model, data, bodies, data.site(NOMINAL).xpos) if bodies else np.zeros(13)


@njit(cache=True)
def _read_carried(force, columns, load, data, place, runs, wrench_sub, sub):
    accel, work, carried = np.empty(6), np.empty((6, 3)), np.empty(6)
    for i in runs:
        copied(data[i, columns[0] : columns[0] + 3], accel[:3])
        # MuJoCo gives it in W
        rotate_back(place[i, 3:7], data[i, columns[2] : columns[2] + 3], accel[3:6])
        carry(load, SENSOR_AXES, data[i, columns[1] : columns[1] + 3], accel, work, carried)
        for j in range(6):
            wrench_sub[i, sub, j] = carried[j] - data[i, force + j]
            # exact zero for equal loads, since a force of zero means that there is no contact
            if abs(wrench_sub[i, sub, j]) < ROUNDING:
                wrench_sub[i, sub, j] = 0.0


BODY = "A_body"  # body of the active side without a platform
PRESCRIBED_MASS = 1e15  # [kg], [kg m^2]
# likewise if other bodies are integrated as well: from 1e12 on MuJoCo's solver makes no progress
INTEGRATED_MASS = 1e8
SOLVED = 1e-12  # tolerance of the solver: forces to nine digits


def ideal_model(structure: Structure, timestep: float) -> mujoco.MjModel:
    """The mechanisms alone: the active one a free body with frame A, placed before each evaluation;
    no gravity.

    The placed body must not yield: its mass makes it immovable (PRESCRIBED_MASS) while the contact
        is scaled by an inverse weight of 1/kg, so that no acceleration enters the force, and
        stiffness and damping are exact at any lever arm.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"ideal-{structure.mechanism.kind}"
    spec.option.cone, spec.option.gravity = mujoco.mjtCone.mjCONE_ELLIPTIC, [0.0, 0.0, 0.0]
    set_steps(spec, timestep)
    add_passive(spec, structure, spec.worldbody.add_body(name=CARRIER))
    body = spec.worldbody.add_body(name=BODY)
    body.add_freejoint(name="A_joint")
    integrated = structure.mounted or structure.sides.moving
    mass = INTEGRATED_MASS if integrated else PRESCRIBED_MASS
    body.mass, body.inertia, body.explicitinertial = mass, np.full(3, mass), True
    add_side(spec, structure.mechanism, ACTIVE, body)
    add_contact(spec, structure)
    model = spec.compile()
    weigh_contact(model, BODY)
    if integrated:
        # The solver scales its progress by the mean inertia, which must be that of the integrated
        # bodies alone: with the prescribed mass it would always appear converged
        first = int(model.joint("A_joint").dofadr[0])
        model.stat.meaninertia = np.delete(model.dof_M0, slice(first, first + 6)).mean()
        model.opt.tolerance = SOLVED
    return model
