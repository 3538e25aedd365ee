"""What a rig is, measured on its model: workspace, response, modes, stiffness.

Every function takes a facility and asks nothing of its kind. The rig carries a payload, the bumper's active half unless one is given, and
commands and wrenches are those of A, the tip of the mechanism.
"""

from hiltestbed.platform.facilities.measure.frequency_response import FrequencyResponse, frequency_response
from hiltestbed.platform.facilities.measure.modes import Mode, modes
from hiltestbed.platform.facilities.measure.stiffness import dynamic_stiffness, static_compliance
from hiltestbed.platform.facilities.measure.workspace import Reach, workspace

__all__ = [
    "FrequencyResponse",
    "Mode",
    "Reach",
    "dynamic_stiffness",
    "frequency_response",
    "modes",
    "static_compliance",
    "workspace",
]
