"""The upper 3-PRS platform that carries the passive side, and the nine-axis rig formed by both
platforms.
"""
