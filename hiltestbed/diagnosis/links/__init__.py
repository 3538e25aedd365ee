"""The loop cut into links, each replayed alone on measured inputs, so that one link's error cannot leak into another's."""

from hiltestbed.diagnosis.links.axis import AxisLink
from hiltestbed.diagnosis.links.base import Later, Link, LinkRun, flat_pose
from hiltestbed.diagnosis.links.compensation import CompensationLink
from hiltestbed.diagnosis.links.numerical_model import DynamicsLink
from hiltestbed.diagnosis.links.platform import PlatformLink
from hiltestbed.diagnosis.links.wrench import WrenchLink

__all__ = ["AxisLink", "CompensationLink", "DynamicsLink", "Later", "Link", "LinkRun", "PlatformLink", "WrenchLink", "flat_pose"]
