"""The user's own mechanism, given as two MJCF files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hiltestbed.config.validation import ModelFile
from hiltestbed.contact.described import Described
from hiltestbed.contact.description import Phase, Rule, Touching
from hiltestbed.contact.settings import Contact
from hiltestbed.plugins import register


@register
class Mjcf(Described):
    """The user's own mechanism: two MJCF files with the sites A and P, geoms of any kind, and
    moving parts.

    Without ``pairs`` every geom whose contype and conaffinity are not both 0 may touch, with the
    stiffness of ``contact``.
    """

    kind: Literal["mjcf"] = "mjcf"
    active: ModelFile = Field(
        description="MJCF of the active side, with the site A, its +z along the insertion"
    )
    passive: ModelFile = Field(
        description="MJCF of the passive side, with the site P, its +z along the insertion"
    )
    pairs: Annotated[tuple[Touching, ...], Field(strict=False)] = Field(
        default=(),
        description="Classes of geom pairs that may touch, each with its stiffness, damping and "
        "friction",
    )
    capture: Annotated[tuple[Phase, ...], Field(strict=False)] = Field(
        default=(), description="Phases of capture, in order"
    )

    @model_validator(mode="before")
    @classmethod
    def _of_the_first_pair(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "contact" in data:
            return data
        pairs = data.get("pairs")
        first = pairs[0] if isinstance(pairs, (list, tuple)) and pairs else {}
        return {
            **data,
            "contact": {
                k: first[k]
                for k in ("stiffness", "damping", "friction")
                if isinstance(first, dict) and k in first
            },
        }

    def files(self) -> tuple[Path, Path]:
        return Path(self.active), Path(self.passive)

    def touching(self) -> tuple[Touching, ...]:
        return self.pairs

    def rules(self) -> tuple[Rule, ...]:
        return super().rules() or (Rule(),)

    def contacts(self) -> tuple[Contact, ...]:
        return super().contacts() if self.pairs else (self.contact,)

    def phases(self) -> tuple[Phase, ...]:
        return self.capture
