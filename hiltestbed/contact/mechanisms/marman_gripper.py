"""Three jaws that close on the interface ring of a launch adapter."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.contact.described import Described
from hiltestbed.plugins import register


@register
class MarmanGripper(Described):
    """A gripper whose three jaws close on the interface ring of a launch adapter, as in satellite
    servicing.
    """

    kind: Literal["marman_gripper"] = "marman_gripper"
    folder: ClassVar[str] = "marman_gripper"
