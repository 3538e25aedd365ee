"""A user-defined mechanism: three pads on a ring that meet a flat plate. Its geometry is in the
MJCF files of the folder three_pads.

hiltestbed run 02-bumper --plugin examples/plugins/three_pads.py --set mechanism.kind=three_pads
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from hiltestbed.contact.settings import Mechanism
from hiltestbed.contact.sides import Rule
from hiltestbed.plugins import register

FOLDER = Path(__file__).with_name("three_pads")


@register
class ThreePads(Mechanism):
    """Three spherical pads at 120 degrees meet a plate; `contact.stiffness` is that of one pad."""

    kind: Literal["three_pads"] = "three_pads"

    def files(self) -> tuple[Path, Path]:
        """MJCF of the active and of the passive side, with the sites A and P."""
        return FOLDER / "active.xml", FOLDER / "passive.xml"

    def rules(self) -> tuple[Rule, ...]:
        """Which geoms may touch: each pad and the plate."""
        return (Rule("pad_*", "plate"),)
