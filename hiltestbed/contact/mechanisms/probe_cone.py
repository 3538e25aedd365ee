"""A probe that slides down a cone into its socket."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from hiltestbed.contact.settings import Mechanism
from hiltestbed.models import load
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from mujoco import MjSpec


@register
class ProbeCone(Mechanism):
    """A probe with a ball at its tip, and a cone with a socket at its apex; latches may hold the probe in it."""

    kind: Literal["probe_cone"] = "probe_cone"
    latches: ClassVar[bool] = True

    def sides(self) -> tuple[MjSpec, MjSpec]:
        return load("probe_cone/active"), load("probe_cone/passive")
