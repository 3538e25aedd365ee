"""The facilities that a scenario may name, and their interface to the plant.

A facility is the motion platform of a rig with its drives: models in ``models/<kind>``, settings
with unit, default and source, kinematics, drives, limits, nominal response. Its settings build it
(:mod:`hiltestbed.platform.shipped`, one file each); no other code names it.

Before a run
    facility.problems(rate)                settings that are invalid in a loop of this rate: (path,
    message) facility.complaints(pose, tool)        why A cannot reach a pose in P: out of reach, a
    joint's travel, a singularity, with the pose facility.alike()                       what must be
    equal in one batch; parameters of the drives may differ between runs facility.response(rate,
    feed)          nominal bandwidth, damping ratio, delay: `late(axis)` for a delay ledger, `at(f,
    axis)`
    facility.axes                          driven joints: travel, speed, acceleration, force
    (monitored by :class:`limits.Watch`) facility.physical, moves_passive       whether the bodies
    move freely; whether the passive side moves

Model: ``facility.spec()`` is an MjSpec in W with the site `mount`, for the active mechanism, and
the body `passive_carrier` with the site `P_nominal`, for force sensor and passive mechanism; its
gravity may have any direction (horizontal insertion: along -y). The plant attaches both mechanisms,
sets the time step and stiffens the loops (:func:`facility.stiffen`).

Drives: ``d = facility.drives(model, settings, tick, substeps, feed, tool="active_A")``, arrays (n,
...) updated in place:

    d.settle(pose, twist, qpos, qvel)      joints and drives in a uniform motion to `pose` (A in P)
    d.aim(pose_cmd, twist_cmd, accel_cmd)  one tick's references; the commands are relative, in P
    d.push(sub, qpos, qvel, ctrl)          the actuators' inputs for a step, from the current state
    d.arrive()                             completes the tick: d.reference is that of t_(k+1)
    d.observe(qpos, qvel, limit, diverged) d.pose, d.twist of A relative to P, in P; in W
                                           place_A, motion_A, place_P, motion_P; d.joints
    d.follow(pose, twist)                  joints under exact tracking (ideal tracking)
    d.state()                              arrays that are saved and restored together
    d.missed                               distance by which the last command was out of reach

A tick of a driven rig, with the contact wrench applied to both sides before every step:

    d.aim(pose_cmd, twist_cmd, accel_cmd)
    for s in range(substeps):
        # xfrc_applied of both mechanisms
        wrench at d.place_A, d.motion_A, d.place_P, d.motion_P
        d.push(s, qpos, qvel, ctrl)
        batch.step(stage=VEL)
        d.observe(qpos, qvel, limit, diverged)
    d.arrive()

Freely moving bodies (`facility.physical`) replace numerical model and drives:

    facility.stand(chaser, target)         places the spacecraft in the hall; must be called first
    facility.lighten(spec, prefix)         removes a mechanism's mass: part of its spacecraft's
    b = facility.bodies(model, settings, step, tool)
    b.settle, b.observe, b.state           as for drives; b.pose, b.twist, b.place_A, ... likewise
    b.push(qpos, qvel, qfrc_applied)       forces of bearings and cables, before every step

There is no command: the recorded commanded pose is the reached one, the force used is the physical
one.

Any kind can be replaced by a massless response model: :class:`response.ResponsePath`, with ideal
tracking of its output.
"""
