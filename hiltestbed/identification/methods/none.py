"""No identification."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from hiltestbed.identification.settings import Identifier
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


@register
class NoIdentification(Identifier):
    """Stiffness and damping are not estimated."""

    kind: Literal["none"] = "none"

    @classmethod
    def start(cls, scenarios: Sequence[Scenario]) -> None:
        return None
