"""Mechanisms with a description file: classes of geom pairs that may touch, and phases of
capture.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field, model_validator

from hiltestbed.config.models import models_folder
from hiltestbed.contact import description
from hiltestbed.contact.description import Phase, Rule, Touching
from hiltestbed.contact.settings import Contact, Mechanism


class Described(Mechanism):
    """Base of the mechanisms whose folder in ``models`` holds active.xml, passive.xml and
    mechanism.yaml.

    Attributes:
        folder: its name in ``models``.
    """

    folder: ClassVar[str] = ""
    contact: Contact = Field(
        # never used: the validator below fills it in
        default_factory=lambda: Contact(stiffness=1.0),
        description="Stiffness, damping and friction of the first class of pairs; omitted: the "
        "values in the mechanism's own description",
    )

    @model_validator(mode="before")
    @classmethod
    def _first_class(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "contact" in data or not cls.folder:
            return data
        return {**data, "contact": _numbers(cls.described().contact[0]).model_dump()}

    @classmethod
    def described(cls) -> description.Mechanism:
        """The content of mechanism.yaml. Raises InputError."""
        file = models_folder() / cls.folder / "mechanism.yaml"
        return _read(file, file.stat().st_mtime_ns if file.is_file() else 0)

    def touching(self) -> tuple[Touching, ...]:
        """Classes of geom pairs that may touch."""
        return tuple(self.described().contact)

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / self.folder
        return folder / "active.xml", folder / "passive.xml"

    def rules(self) -> tuple[Rule, ...]:
        return tuple(Rule(t.active, t.passive, t.reach) for t in self.touching())

    def contacts(self) -> tuple[Contact, ...]:
        return (self.contact, *(_numbers(t) for t in self.touching()[1:]))

    def phases(self) -> tuple[Phase, ...]:
        return tuple(self.described().phases)


def _numbers(touching: Touching) -> Contact:
    return Contact(
        stiffness=touching.stiffness, damping=touching.damping, friction=touching.friction
    )


@lru_cache(maxsize=32)
def _read(file: Path, stamp: int) -> description.Mechanism:
    return description.read(file)
