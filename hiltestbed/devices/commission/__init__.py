"""Commissioning: identification of a facility's sensor and platform by small known motions.

Read :mod:`~hiltestbed.devices.commission.procedure` first: the sequence. Then motions (commands to
the platform), expected (the wrench of the nominal mechanism along the path), platform and sensor
(the fits), folder (the results on disk).
"""
