"""A spring and damper as MuJoCo's contact parameters, and the contact of an MJCF pair measured by a
drop.

MuJoCo states a contact by the acceleration -b v - r p that it demands at a penetration p and blends
it, by an impedance d, with the acceleration without the contact. For free bodies of the reduced
mass mu and a constant d the force is K p + C v, whatever d is:

    solref = (-K/mu, -C/mu)         or         solref = (2 mu/C, C/(2 sqrt(K mu)))

as stiffness and damping, or as time constant [s] and damping ratio
(https://mujoco.readthedocs.io/en/stable/modeling.html#solver-parameters). Under a load that is not
the inertia of these bodies the static stiffness is K/(1 - d): with d = 1e-4 both are K, with the
default of 0.9 to 0.95 it is 10 to 20 K. MuJoCo's reduced mass is an estimate where bodies turn or
have joints, and each of several points of a contact has K of its own: hence the drop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from hiltestbed.analysis.spring_damper import SpringDamper, reduced_mass
from hiltestbed.errors import InputError
from hiltestbed.frames import Array

IMPEDANCE = 1e-4  # [-] d: the static stiffness is 1.0001 times the dynamic one
STEPS = 2000  # of a contact: CoR, stiffness and damping are then right to better than 1e-3
PASSES = 6  # of a drop, each with the step for STEPS that the last one showed
LONGEST = 1_000_000  # steps of a drop, after which it is given up
GAP = 1e-6  # [m] between the geoms before the drop
RADIUS = 0.05  # [m] of a ball that meets a plate
# [m] half of the plate, in which the ball stays: 40 t on 1 kN/m at 1 m/s go 6 m deep
THICK = 100.0
# [m] radius of gyration: the drop is one of masses. A contact 0.1 m off the centre of mass then
# sees 1e-4 less of them; much larger ratios of inertia to mass spoil the solver's convergence
GYRATION = 10.0
OF_A_CONTACT = ("solref", "solimp", "margin", "gap")  # of a geom and of a pair alike


@dataclass(frozen=True)
class PairParameters:
    """solref and solimp of a pair; its friction does not change the normal force."""

    solref: tuple[float, float]
    solimp: tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Drop:
    """One bounce as MuJoCo computes it.

    Attributes:
        time, penetration, rate, force: (n,) over the contact: [s] from the touch, [m], [m/s], [N].
        cor: rebound speed over approach speed. step: [s]. contacts: largest number of points.
        stiffness, damping: [N/m], [N s/m] by least squares. misfit: rms of what they leave of the
            force, over the rms of the force: 0 for a spring and damper.
    """

    time: Array
    penetration: Array
    rate: Array
    force: Array
    cor: float
    step: float
    contacts: int
    stiffness: float
    damping: float
    misfit: float


def mujoco_parameters(contact: SpringDamper) -> PairParameters:
    """For an explicit pair between two free bodies, or a free body and the world."""
    inverse = 1.0 / contact.mass
    return PairParameters(
        (-contact.stiffness * inverse, -contact.damping * inverse),
        (IMPEDANCE, IMPEDANCE, 0.001, 0.5, 1.0),
    )


def positive_solref(contact: SpringDamper) -> tuple[float, float] | None:
    """(timeconst [s], dampratio [-]) of the same contact; None without damping."""
    if contact.damping == 0.0:
        return None
    return 2.0 * contact.mass / contact.damping, contact.damping_ratio


def spring_damper_of(solref: tuple[float, float], mass: float) -> SpringDamper:
    """The contact of bodies with the reduced ``mass`` [kg] for a ``solref`` of either form and a
    constant solimp.

    Raises:
        InputError: the numbers are of both forms, or of no spring.
    """
    first, second = solref
    if first < 0.0 and second <= 0.0:
        return SpringDamper(-first * mass, -second * mass, mass)
    if first > 0.0 and second > 0.0:
        return SpringDamper(mass / (first * second) ** 2, 2.0 * mass / first, mass)
    raise InputError(
        f"--solref: is neither two positive numbers, time constant [s] and damping ratio, nor two "
        f"negative ones, stiffness and damping over the reduced mass (got {first:g}, {second:g})"
    )


def bounce_in_mujoco(
    parameters: PairParameters, masses: tuple[float, float], speed: float, step: float | None = None
) -> Drop:
    """A ball's bounce on a plate in steps of ``step`` [s]; None: as small as the contact needs."""
    spec = _bodies(masses)
    first, second = spec.body("a"), spec.body("b")
    first.add_geom(name="a", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0])
    second.add_geom(
        name="b",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[2 * THICK, 2 * THICK, THICK],
        pos=[0, 0, -THICK],
    )
    pair = {"geomname1": "a", "geomname2": "b", "condim": 1, "margin": 0.0, "gap": 0.0}
    spec.add_pair(**pair, solref=parameters.solref, solimp=parameters.solimp)
    if step is None:
        return _dropped(spec, RADIUS, masses, speed)
    spec.option.timestep = step
    return _bounced(spec.compile(), RADIUS, masses, speed)


def pair_in_mjcf(
    file: Path, geoms: tuple[str, str], masses: tuple[float, float] | None, speed: float
) -> tuple[Drop, tuple[float, float]]:
    """The bounce of two geoms of an MJCF file, in their relative attitude and along the line on
    which they are nearest, with the contact parameters that MuJoCo mixes for them; and the masses
    [kg]: those of their moving bodies, unless given.

    Raises:
        InputError: the file does not compile, or has no such geoms, or they cannot touch.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(file))
    except (ValueError, OSError) as error:
        raise InputError(f"{file}: does not compile: {error}") from error
    a, b = (_geom(model, file, name) for name in geoms)
    masses = masses or (_mass(model, a), _mass(model, b))
    if math.isinf(masses[0]) and math.isinf(masses[1]):
        raise InputError(
            f"{file}: neither {geoms[0]!r} nor {geoms[1]!r} is on a body that moves; give "
            f"--masses M1,M2 [kg]"
        )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ends = np.zeros(6)
    apart = mujoco.mj_geomDistance(model, data, a, b, 1e3, ends)
    line = np.sign(apart) * (ends[3:] - ends[:3])
    if not np.linalg.norm(line) > 0.0:
        line = data.geom_xpos[b] - data.geom_xpos[a]
    line = line / np.linalg.norm(line)
    spec = _bodies(masses)
    # what of a model's options shapes its contacts
    for name in ("timestep", "cone", "impratio", "o_margin", "o_solref", "o_solimp", "enableflags"):
        setattr(spec.option, name, getattr(model.opt, name))
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_quatZ2Vec(quaternion, -line)
    mujoco.mju_quat2Mat(matrix, quaternion)
    turn = matrix.reshape(3, 3).T  # `a` lies above `b`: the line is turned to -z
    for body, geom in (("a", a), ("b", b)):
        _copy_geom(spec, body, model, geom, turn @ data.geom_xmat[geom].reshape(3, 3))
    _copy_pair(spec, model, a, b)
    return _dropped(spec, _height(spec.compile()), masses, speed), masses


def _bodies(masses: tuple[float, float]) -> mujoco.MjSpec:
    """Two bodies, ``a`` above ``b``, without gravity; an infinite mass stands still."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, 0.0]
    # by default a heavy body's slow contact counts as converged at once
    spec.option.tolerance = 0.0
    for name, mass in zip("ab", masses, strict=True):
        body = spec.worldbody.add_body(name=name)
        if math.isfinite(mass):
            body.add_freejoint()
            body.explicitinertial = True
            body.mass, body.inertia = mass, [mass * GYRATION**2] * 3
    return spec


def _dropped(spec: mujoco.MjSpec, height: float, masses: tuple[float, float], speed: float) -> Drop:
    """The bounce of ``a`` from the ``height`` [m] of the touch, in steps as small as it needs."""
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    drop = None
    for _ in range(PASSES):
        drop = _bounced(model, height, masses, speed)
        steps = len(drop.time)
        if steps >= STEPS // 2:
            return drop
        model.opt.timestep *= max(steps, 1) / STEPS
    assert drop is not None
    return drop


def _bounced(
    model: mujoco.MjModel, height: float, masses: tuple[float, float], speed: float
) -> Drop:
    """One bounce with the model's step."""
    data = mujoco.MjData(model)
    moving = [math.isfinite(m) for m in masses]
    mass = reduced_mass(*masses)
    # the centre of mass at rest; the upper body moves down, the lower one up
    shares = [mass / m if math.isfinite(m) else 0.0 for m in masses]
    places = [height + GAP, 0.0]
    speeds = [-speed * shares[0], speed * shares[1]]
    adr = 0
    for k in range(2):
        if moving[k]:
            data.qpos[7 * adr + 2], data.qvel[6 * adr + 2] = places[k], speeds[k]
            adr += 1
        else:
            model.body_pos[k + 1, 2] = places[k]
    rows: list[tuple[float, float, float, float, int]] = []
    force = np.zeros(6)
    began = False
    for _ in range(LONGEST):
        mujoco.mj_step1(model, data)
        found = _relative(data, moving, places)
        mujoco.mj_step2(model, data)
        total = 0.0
        for c in range(data.ncon):
            mujoco.mj_contactForce(model, data, c, force)
            total += float(force[0] * abs(data.contact.frame[c][2]))
        if data.ncon:
            began = True
            rows.append((data.time - model.opt.timestep, *found, total, data.ncon))
        elif began:
            break
        if found[1] < 0.0 and found[0] < -height:
            break
    if not rows:
        raise InputError(
            "these geoms do not touch: contype, conaffinity, an exclude or a weld keeps them apart"
        )
    table = np.array(rows)
    table = table[: np.flatnonzero(table[:, 3] > 0.0)[-1] + 1]  # apart, MuJoCo lists them on
    force_n, x, v = table[:, 3], table[:, 1], table[:, 2]
    columns = np.column_stack([x, v])[force_n > 0.0]
    scale = np.abs(columns).max(axis=0)
    fit, *_ = np.linalg.lstsq(columns / scale, force_n[force_n > 0.0], rcond=None)
    left = force_n[force_n > 0.0] - columns / scale @ fit
    return Drop(
        table[:, 0] - table[0, 0],
        x,
        v,
        force_n,
        float(-_relative(data, moving, places)[1] / speed),
        float(model.opt.timestep),
        int(table[:, 4].max()),
        float(fit[0] / scale[0]),
        float(fit[1] / scale[1]),
        float(np.sqrt(np.mean(left**2) / np.mean(force_n**2))),
    )


def _relative(data: mujoco.MjData, moving: list[bool], places: list[float]) -> tuple[float, float]:
    """Penetration [m] and its rate [m/s] along z."""
    at, rates, adr = list(places), [0.0, 0.0], 0
    for k in range(2):
        if moving[k]:
            at[k], rates[k] = float(data.qpos[7 * adr + 2]), float(data.qvel[6 * adr + 2])
            adr += 1
    return (places[0] - GAP - places[1]) - (at[0] - at[1]), rates[1] - rates[0]


def _geom(model: mujoco.MjModel, file: Path, name: str) -> int:
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
    if found < 0:
        names = [model.geom(i).name for i in range(model.ngeom) if model.geom(i).name]
        raise InputError(
            f"{file}: has no geom {name!r}; allowed are {', '.join(names) or 'none: name them'}"
        )
    return found


def _mass(model: mujoco.MjModel, geom: int) -> float:
    """[kg] of the tree of the body that moves with a geom; infinite for the world."""
    body = int(model.body_weldid[model.geom_bodyid[geom]])
    return float(model.body_subtreemass[body]) if body else math.inf


def _copy_geom(
    spec: mujoco.MjSpec, body: str, model: mujoco.MjModel, geom: int, turn: Array
) -> None:
    """The geom of a compiled ``model`` in the middle of a ``body``, with its contact parameters."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).ravel())
    names = ("size", "condim", "priority", "friction", "solmix", *OF_A_CONTACT)
    copied = spec.body(body).add_geom(
        name=body,
        type=mujoco.mjtGeom(int(model.geom_type[geom])),
        quat=quaternion,
        contype=1,
        conaffinity=1,
        **{name: getattr(model, f"geom_{name}")[geom].tolist() for name in names},
    )
    if copied.type == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        spec.add_mesh(
            name=body,
            uservert=model.mesh_vert[start : start + count].ravel(),
            userface=model.mesh_face[first : first + faces].ravel(),
        )
        copied.meshname, copied.size = body, [0, 0, 0]


def _copy_pair(spec: mujoco.MjSpec, model: mujoco.MjModel, a: int, b: int) -> None:
    """The explicit pair of both geoms, if the ``model`` has one: it overrides their parameters."""
    for k in range(model.npair):
        if {int(model.pair_geom1[k]), int(model.pair_geom2[k])} == {a, b}:
            names = ("friction", *OF_A_CONTACT)
            spec.add_pair(
                geomname1="a",
                geomname2="b",
                condim=int(model.pair_dim[k]),
                **{name: getattr(model, f"pair_{name}")[k].tolist() for name in names},
            )


def _height(model: mujoco.MjModel) -> float:
    """[m] by which ``a`` lies above ``b`` where their geoms touch."""
    data = mujoco.MjData(model)
    high = float(model.geom_rbound.sum())
    if not np.isfinite(high) or high == 0.0:
        high = 10.0
    moving = int(model.body_jntnum[1]) > 0
    if moving:
        data.qpos[2] = 2.0 * high
    else:
        model.body_pos[1, 2] = 2.0 * high
    mujoco.mj_forward(model, data)
    return 2.0 * high - float(mujoco.mj_geomDistance(model, data, 0, 1, 1e3, None))
