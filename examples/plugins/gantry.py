"""A user-defined platform: a gantry of three slides with a wrist of three hinges, described by the
MJCF file in the folder gantry.

hiltestbed run 02-bumper --plugin examples/plugins/gantry.py --set 'rig.platform={kind: gantry}'
hiltestbed rig 02-bumper --plugin examples/plugins/gantry.py --set 'rig.platform={kind: gantry}'
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hiltestbed.platform.kinds import CommandPath
from hiltestbed.platform.shipped.mjcf import MjcfSettings
from hiltestbed.plugins import register

MODEL = Path(__file__).with_name("gantry") / "gantry.xml"


@register
class Gantry(MjcfSettings):
    """A gantry of three slides with a wrist of three hinges under position control."""

    kind: Literal["gantry"]
    model: str = Field(
        default=str(MODEL),
        description="MJCF file of the rig, with a site `mount` and position actuators",
    )
    command: CommandPath = Field(
        default=CommandPath(controller_rate=1000.0),
        description="How commands reach the drives: every millisecond",
    )
