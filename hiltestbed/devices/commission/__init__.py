"""Commissioning: what a facility's sensor and platform are, measured by small known motions.

Read :mod:`~hiltestbed.devices.commission.procedure` first: the sequence. Then motions (what the platform is told), expected (the wrench
that the mechanism exerts on the way), platform and sensor (what is fitted), folder (what is written).
"""
