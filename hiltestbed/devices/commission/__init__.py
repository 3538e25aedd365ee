"""Commissioning: identification of a facility's sensor and platform by small known motions.

Read :mod:`~hiltestbed.devices.commission.procedure` first: the sequence, and the results on disk.
Then motions (commands to the platform), platform and sensor (the fits).
"""
