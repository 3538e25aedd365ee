"""The facilities that a scenario may name: models in ``models/<kind>``, settings with unit, default
and source (:mod:`hiltestbed.platform.shipped`), kinematics, drives and limits.

:mod:`hiltestbed.platform.build` makes one from its settings; no other code names it. To the plant
each is a :class:`facility.Facility`, and what moves its ports a :class:`facility.Mover`: drives
that follow commands, or bodies that move freely (:class:`bodies.PhysicalFacility`). Any kind can be
replaced by a massless response model, :class:`response.ResponsePath`, with ideal tracking of its
output.
"""
