"""The facilities that a scenario may name, and their interface to the plant.

A facility is the motion platform of a rig with its drives: models in ``models/<kind>``, settings
with unit, default and source (:mod:`hiltestbed.platform.shipped`), kinematics, drives and limits.
:mod:`hiltestbed.platform.build` makes it from its settings; no other code names it.

Before a run
    facility.complaints(pose, tool)  why A cannot reach a pose in P: out of reach, a joint's travel,
                                     a singularity, with the pose
    facility.alike()                 what must be equal in one batch
    facility.axes                    driven joints with their limits (:class:`limits.Watch`)
    facility.moves_passive           whether the passive side moves

Model: ``facility.spec()`` is an MjSpec in W with the site `mount`, for the active mechanism, and
the body `passive_carrier` with the site `P_nominal`, for force sensor and passive mechanism; its
gravity may have any direction (horizontal insertion: along -y). The plant attaches both mechanisms,
sets the time step and stiffens the loops (:func:`facility.set_steps`).

Drives: ``d = facility.drives(model, runs, tool="active_A")``, arrays (n, ...) updated in place
(:class:`facility.Mover`). A tick, with the contact wrench applied to both sides before every step:

    d.aim(pose_cmd, twist_cmd, accel_cmd)  # relative, in P
    for s in range(substeps):
        # xfrc_applied of both mechanisms
        wrench at d.place_A, d.motion_A, d.place_P, d.motion_P
        d.push(s, qpos, qvel, inputs)
        batch.step(stage=VEL)
        d.observing(qpos, qvel, limit, diverged)()
    d.arrive()                             # d.reference is that of t_(k+1)

Freely moving bodies replace numerical model and drives (:class:`bodies.PhysicalFacility`, which
``stand(chaser, target)`` gives its spacecraft): there is no command, the recorded commanded pose is
the reached one, the force used is the physical one.

Any kind can be replaced by a massless response model: :class:`response.ResponsePath`, with ideal
tracking of its output.
"""
