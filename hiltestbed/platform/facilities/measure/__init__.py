"""Measurements on the model of a rig: workspace, response, modes, stiffness.

A rig carries a payload, by default the bumper's active side, and commands and wrenches refer to A,
the tip of the mechanism.
"""

from hiltestbed.platform.facilities.measure.frequency_response import (
    FrequencyResponse,
    dynamic_stiffness,
    frequency_response,
)
from hiltestbed.platform.facilities.measure.modes import Mode, modes
from hiltestbed.platform.facilities.measure.workspace import Reach, workspace

__all__ = [
    "FrequencyResponse",
    "Mode",
    "Reach",
    "dynamic_stiffness",
    "frequency_response",
    "modes",
    "workspace",
]
