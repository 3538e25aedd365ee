"""The bounce of `hiltestbed contact` in engines other than MuJoCo, which the extra ``engines``
installs.

Drake: point contact in the discrete SAP solver, whose force along the normal is the spring and
damper k x + c v, integrated implicitly (A. Castro et al., "An Unconstrained Convex Formulation of
Compliant Contact", IEEE T-RO 39, 2023): its steps add damping. The near-rigid limit, which would
soften what the step cannot resolve, is off.

Newton: the semi-implicit solver, whose penalty force has the stiffness k, and the damping c while
the bodies approach only: its rebound is faster than that of a spring and damper. In single
precision.
"""

from __future__ import annotations

import math
from importlib import import_module

from hiltestbed.analysis.mujoco_contact import GAP, RADIUS
from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.errors import of_extra

LONGEST = 2.0  # contact times that are simulated, after the touch


def cor_in_drake(
    contact: SpringDamper, masses: tuple[float, float], speed: float, step: float
) -> float:
    """CoR of the bounce in Drake, in steps of ``step`` [s]; an infinite mass stands still.

    Raises:
        MissingExtra: Drake is not installed.
    """
    of_extra("pydrake", "--engine drake", "engines")
    geometry, framework = (import_module(f"pydrake.{n}") for n in ("geometry", "systems.framework"))
    plants, trees = (import_module(f"pydrake.multibody.{n}") for n in ("plant", "tree"))
    transform = import_module("pydrake.math").RigidTransform
    simulator = import_module("pydrake.systems.analysis").Simulator
    builder = framework.DiagramBuilder()
    plant, _ = plants.AddMultibodyPlant(
        plants.MultibodyPlantConfig(
            time_step=step, discrete_contact_approximation="sap", sap_near_rigid_threshold=0.0
        ),
        builder,
    )
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    shapes = (
        (geometry.Sphere(RADIUS), transform([0.0, 0.0, RADIUS])),
        (geometry.HalfSpace(), transform()),
    )
    joints = []
    for name, mass, (shape, pose), sign in zip("ab", masses, shapes, (-1.0, 1.0), strict=True):
        body = plant.world_body()
        if math.isfinite(mass):
            inertia = trees.SpatialInertia(mass, [0.0] * 3, trees.UnitInertia(1.0, 1.0, 1.0))
            body = plant.AddRigidBody(name, inertia)
            slide = trees.PrismaticJoint(
                name, plant.world_frame(), body.body_frame(), [0.0, 0.0, 1.0]
            )
            joints.append((plant.AddJoint(slide), sign, sign * speed * contact.mass / mass))
        material = geometry.ProximityProperties()
        # springs in series, relaxation times in sum: half and half of both bodies
        geometry.AddContactMaterial(
            None, 2.0 * contact.stiffness, plants.CoulombFriction(0.0, 0.0), material
        )
        material.AddProperty(
            "material", "relaxation_time", 0.5 * contact.damping / contact.stiffness
        )
        plant.RegisterCollisionGeometry(body, pose, shape, name, material)
    plant.Finalize()
    simulation = simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulation.get_mutable_context())
    for joint, sign, rate in joints:
        joint.set_translation(context, GAP if sign < 0.0 else 0.0)
        joint.set_translation_rate(context, rate)
    simulation.Initialize()
    simulation.AdvanceTo(_lasts(contact, speed))
    return -sum(sign * joint.get_translation_rate(context) for joint, sign, _ in joints) / speed


def cor_in_newton(
    contact: SpringDamper, masses: tuple[float, float], speed: float, step: float
) -> float:
    """CoR of the bounce in Newton's semi-implicit solver, in steps of ``step`` [s]; an infinite
    mass stands still.

    Raises:
        MissingExtra: Newton is not installed.
    """
    warp = of_extra("warp", "--engine newton", "engines")
    warp.config.log_level = 40  # errors only: standard output is the command's
    newton = of_extra("newton", "--engine newton", "engines")
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    material = newton.ModelBuilder.ShapeConfig(
        density=0.0, ke=contact.stiffness, kd=contact.damping, kf=0.0, mu=0.0, margin=0.0
    )
    moving = []
    for name, mass, height, sign in zip(
        "ab", masses, (RADIUS + GAP, -0.1), (-1.0, 1.0), strict=True
    ):
        place = warp.transform((0.0, 0.0, height), warp.quat_identity())
        body, inside = -1, place
        if math.isfinite(mass):
            body = builder.add_body(xform=place, mass=mass, inertia=warp.mat33(*_sphere(mass)))
            inside = warp.transform_identity()
            moving.append((body, sign, sign * speed * contact.mass / mass))
        if name == "a":
            builder.add_shape_sphere(body, radius=RADIUS, cfg=material, xform=inside)
        else:
            builder.add_shape_box(body, hx=0.5, hy=0.5, hz=0.1, cfg=material, xform=inside)
    model = builder.finalize(device="cpu")
    solver, pipeline = newton.solvers.SolverSemiImplicit(model), newton.CollisionPipeline(model)
    now, following = model.state(), model.state()
    rates = now.body_qd.numpy()
    for body, _, rate in moving:
        rates[body, 2] = rate
    now.body_qd.assign(rates)
    control, touching = model.control(), pipeline.contacts()
    for _ in range(math.ceil(_lasts(contact, speed) / step)):
        now.clear_forces()
        pipeline.collide(now, touching)
        solver.step(now, following, control, touching, step)
        now, following = following, now
    rates = now.body_qd.numpy()
    return float(-sum(sign * rates[body, 2] for body, sign, _ in moving) / speed)


def _lasts(contact: SpringDamper, speed: float) -> float:
    """[s] until the bodies are apart, in an engine that damps more or less as well."""
    half_period = math.pi / contact.frequency
    return GAP / speed + LONGEST * max(contact.contact_time, half_period)


def _sphere(mass: float) -> tuple[float, ...]:
    """An inertia [kg m^2] with a radius of gyration of 1 m, row by row."""
    return (mass, 0.0, 0.0, 0.0, mass, 0.0, 0.0, 0.0, mass)
