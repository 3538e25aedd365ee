"""Stage "replay": the loop cut into links, each replayed alone on measured inputs, so that no error
leaks from one link into another.
"""

from hiltestbed.diagnosis.links.base import LinkRun, ModelLink, Timing, flat_pose
from hiltestbed.diagnosis.links.compensation import CompensationLink
from hiltestbed.diagnosis.links.numerical_model import DynamicsLink
from hiltestbed.diagnosis.links.platform import PlatformLink
from hiltestbed.diagnosis.links.wrench import WrenchLink

__all__ = [
    "CompensationLink",
    "DynamicsLink",
    "LinkRun",
    "ModelLink",
    "PlatformLink",
    "Timing",
    "WrenchLink",
    "flat_pose",
]
