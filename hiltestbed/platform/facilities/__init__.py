"""The facilities that a scenario may name, each of which describes itself, and what the plant asks of them.

A facility is the motion platform of a rig with its drives: models in ``models/<kind>``, settings with unit, default and source, kinematics,
drives, limits, nominal response. Its settings build it (:mod:`hiltestbed.platform.shipped`, one file each); nothing else knows its name.

Before a run
    facility.problems(rate)                what in the settings cannot be in a loop of this rate: (path, message)
    facility.complaints(pose, tool)        why A cannot be at a pose in P: out of reach, a joint's travel, a singularity, with the place
    facility.alike()                       what must be equal in one batch; numbers of the drives may differ run by run
    facility.response(rate, feed)          nominal bandwidth, damping ratio, delay: `late(axis)` for a delay ledger, `at(f, axis)`
    facility.axes                          driven joints: travel, speed, acceleration, force (:class:`limits.Watch` watches them)
    facility.physical, moves_passive       bodies that move by themselves; a passive side that moves

Model: ``facility.spec()`` is an MjSpec in W with the site `mount`, for the active mechanism, and the body `passive_carrier` with the site
`P_nominal`, for force sensor and passive mechanism; its gravity may point anywhere (level insertion: along -y). The plant attaches both
mechanisms, sets the time step and stiffens the loops (:func:`facility.stiffen`).

Drives: ``d = facility.drives(model, settings, tick, substeps, feed, tool="active_A")``, arrays (n, ...) updated in place:

    d.settle(pose, twist, qpos, qvel)      joints and drives in the uniform motion that is commanded to be at `pose` (A in P)
    d.aim(pose_cmd, twist_cmd, accel_cmd)  one tick's references; the commands are relative, in P
    d.push(sub, qpos, qvel, ctrl)          the actuators' inputs for a step, from the state as it stands
    d.arrive()                             the tick is over: d.reference is that of t_(k+1)
    d.observe(qpos, qvel, limit, diverged) d.pose, d.twist of A relative to P, in P; place_A, motion_A, place_P, motion_P in W; d.joints
    d.follow(pose, twist)                  joints of a rig that follows exactly (ideal tracking)
    d.state()                              arrays that are saved and restored as a whole
    d.missed                               by how much the last command was out of reach

A tick of a driven rig, with the contact's wrench put on both sides before every step:

    d.aim(pose_cmd, twist_cmd, accel_cmd)
    for s in range(substeps):
        wrench at d.place_A, d.motion_A, d.place_P, d.motion_P  ->  xfrc_applied of active and passive mechanism
        d.push(s, qpos, qvel, ctrl)
        batch.step(stage=VEL)
        d.observe(qpos, qvel, limit, diverged)
    d.arrive()

Bodies that move by themselves (`facility.physical`) take the place of numerical model and drives:

    facility.stand(chaser, target)         puts the spacecraft into the hall: before anything else
    facility.lighten(spec, prefix)         takes an attached mechanism's mass out: it is part of its spacecraft's
    b = facility.bodies(model, settings, step, tool)
    b.settle, b.observe, b.state           as of drives; b.pose, b.twist, b.place_A, ... likewise
    b.push(qpos, qvel, qfrc_applied)       what bearings and cables do, before every step

There is no command: the commanded pose of a row is the one reached, the force used is the force.

Any kind may be followed by a response alone, without mass: :class:`response.ResponsePath`, with ideal tracking behind it.
"""
