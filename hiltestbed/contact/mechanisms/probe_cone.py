"""A probe that slides down a cone into its socket."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from hiltestbed.config.models import models_folder
from hiltestbed.contact.settings import Mechanism
from hiltestbed.plugins import register


@register
class ProbeCone(Mechanism):
    """A probe with a ball at its tip, and a cone with a socket at its apex, in which latches may
    capture the probe.
    """

    kind: Literal["probe_cone"] = "probe_cone"
    latches: ClassVar[bool] = True

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / "probe_cone"
        return folder / "active.xml", folder / "passive.xml"
