"""What a scenario may say of a facility: units and sources at every number, and a table that knows
the kinds.
"""

from __future__ import annotations

import subprocess
import sys
from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from hiltestbed.config.gallery import shipped
from hiltestbed.platform.build import built
from hiltestbed.platform.facilities.bodies import PhysicalFacility
from hiltestbed.platform.facilities.settings import ResponseSettings
from hiltestbed.platform.kinds import PLATFORMS, Platform

KINDS = [
    kind
    for kind, cls in PLATFORMS.items()
    if cls.__module__.startswith("hiltestbed.platform.shipped.")
]


def bare(kind: str, **more: object) -> Platform:
    """A platform of which nothing is said but its kind."""
    model = {"model": str(shipped("models") / "xyz_table" / "xyz_table.xml")}
    return PLATFORMS[kind].model_validate(
        {"kind": kind, **(model if kind == "mjcf" else {}), **more}
    )


def sections(model: type[BaseModel]) -> list[type[BaseModel]]:
    """A model and all that it is made of."""
    found = [model]
    for field in model.model_fields.values():
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                found += sections(part)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_has_a_default_and_says_its_unit(kind: str) -> None:
    settings = bare(kind)
    for section in sections(type(settings)):
        for name, field in section.model_fields.items():
            if name == "kind" or any(
                isinstance(part, type) and issubclass(part, BaseModel)
                for part in (field.annotation,)
            ):
                continue
            described = field.description or ""
            worded = (
                "Literal" in str(field.annotation)
                or field.annotation is str
                or "Drive" in str(field.annotation)
            )
            assert worded or "[" in described, (
                f"{section.__name__}.{name} has no unit: {described!r}"
            )


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"mjcf"}))
def test_a_kind_is_found_by_its_settings(kind: str) -> None:
    found = built(bare(kind))
    assert found.kind == kind
    assert isinstance(found, PhysicalFacility) == (kind in ("air_bearing", "suspension"))


def test_what_is_not_a_key_is_refused() -> None:
    with pytest.raises(ValidationError, match="bandwith"):
        bare("serial_arm", controller={"bandwith": 3.0})
    with pytest.raises(ValidationError, match="delay_cycles"):
        bare("serial_arm", command={"delay_cycles": -1})
    with pytest.raises(ValidationError, match="bandwidth"):
        ResponseSettings.model_validate({"bandwidth": [1.0, 2.0]})


def test_settings_are_read_without_the_physics() -> None:
    """A scenario is checked before MuJoCo or compiled code is loaded."""
    code = (
        "import sys; from hiltestbed.platform.kinds import PLATFORMS; assert len(PLATFORMS) > 5; "
        "print([m for m in ('mujoco', 'numba', 'scipy') if m in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )
