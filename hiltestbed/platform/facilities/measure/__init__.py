"""Measurements on the model of a rig with a payload, by default the bumper's active side; commands
and wrenches refer to A, the tip of the mechanism.
"""
