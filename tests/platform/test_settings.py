"""What a scenario may say of a facility: units and sources at every number, and a table that knows
the kinds.
"""

from __future__ import annotations

from typing import Literal, get_args

import pytest
from pydantic import BaseModel, ValidationError

from hiltestbed.errors import InputError
from hiltestbed.platform.build import built
from hiltestbed.platform.facilities.bodies import PhysicalFacility
from hiltestbed.platform.facilities.facility import Facility
from hiltestbed.platform.kinds import PLATFORMS, Platform, ResponseSettings
from hiltestbed.plugins import register
from tests.platform.halls import TABLE, stewart

KINDS = [
    kind
    for kind, cls in PLATFORMS.items()
    if cls.__module__.startswith("hiltestbed.platform.shipped.")
]


def bare(kind: str, **more: object) -> Platform:
    """A platform of which nothing is said but its kind."""
    needed = {"model": TABLE} if kind == "mjcf" else {}
    return PLATFORMS[kind].model_validate({"kind": kind, **needed, **more})


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
    for section in sections(type(bare(kind))):
        for name, field in section.model_fields.items():
            made_of = field.annotation
            section_of_its_own = isinstance(made_of, type) and issubclass(made_of, BaseModel)
            words = "Literal" in str(made_of) or "Drive" in str(made_of) or made_of is str
            if name != "kind" and not section_of_its_own and not words:
                assert "[" in (field.description or ""), f"{section.__name__}.{name} has no unit"


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


def test_a_users_kind_gives_its_own_facility_and_is_refused_without() -> None:
    class Own(Platform):
        """Six legs in a hall of their own."""

        kind: Literal["own"] = "own"

        def facility(self) -> Facility:
            return stewart("electric")

    class Bare(Platform):
        """Nothing."""

        kind: Literal["bare"] = "bare"

    assert built(Own.model_validate({"kind": "own"})).kind == "stewart"
    with pytest.raises(InputError, match="lacks facility"):
        register(Bare)
