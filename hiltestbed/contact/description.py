"""What a mechanism's folder says beside its MJCF: which geoms touch and how, and the phases of its capture.

``mechanism.yaml`` stands beside ``active.xml`` and ``passive.xml``: a pair of geoms, a latch between both sides, a criterion on both
belong to neither file. Names are those of the geoms, sites and actuators in the two files; ``*`` stands for any ending.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from hiltestbed.errors import Fault, InputError

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Touching(_Strict):
    """A class of pairs of geoms that may touch; stiffness and damping are those of a pair, however many points it touches at."""

    active: str = Field(description="Geoms of the active side that may touch; * stands for any ending")
    passive: str = Field(description="Geoms of the passive side that may touch; * stands for any ending")
    stiffness: Positive = Field(description="Stiffness of a pair of geoms [N/m]")
    damping: NotNegative = Field(0.0, description="Damping of a pair of geoms [N s/m]")
    friction: NotNegative = Field(0.0, description="Coulomb coefficient of a pair of geoms [-]")
    reach: Positive | None = Field(
        None, description="Distance from which pairs are left out [m]: those farther apart than this across the axis, ports aligned"
    )


class Condition(_Strict):
    """Pairs of sites, active and passive, that are near, aligned and slow at the same time, and joints that stand where they must."""

    pairs: list[tuple[str, str]] = Field(min_length=1, description="Pairs of sites, one of the active and one of the passive side")
    within: Positive = Field(description="Largest distance between the sites of a pair [m]")
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] = Field(180.0, description="Largest angle between the z axes of the sites [deg]")
    speed: Positive = Field(description="Highest relative speed of the sites [m/s]")
    joints: dict[str, tuple[float, float]] = Field(
        default_factory=dict, description="Joints of the active side that must stand between two values [m, rad]"
    )
    count: Annotated[int, Field(ge=1)] | None = Field(None, description="Number of pairs that is enough [-]; left out: all")
    lasting: NotNegative = Field(0.0, description="Time for which all of it must hold without a break [s]")

    @model_validator(mode="after")
    def _enough(self) -> Condition:
        if self.count is not None and self.count > len(self.pairs):
            raise ValueError(f"count is {self.count}, but there are {len(self.pairs)} pairs")
        return self


class Closure(_Strict):
    """A latch between two sites: it holds them where they are when it closes, or draws them together."""

    kind: Literal["weld", "connect"] = Field(description="Kind of latch. weld: holds six axes; connect: a ball joint")
    active: str = Field(description="Site of the active side that is held")
    passive: str = Field(description="Site of the passive side that holds it")
    stiffness: Positive = Field(description="Stiffness against shift [N/m]")
    damping: NotNegative = Field(description="Damping against shift [N s/m]")
    hold: Literal["here", "together"] = Field(
        "here", description="Where it holds. here: the sites stay as they are then; together: they are drawn into one place"
    )
    radius: Positive | None = Field(
        None, description="Radius of the ring of latches [m]; the stiffness against turning is stiffness radius^2"
    )

    @model_validator(mode="after")
    def _turning(self) -> Closure:
        if (self.radius is None) == (self.kind == "weld"):
            raise ValueError(
                "a weld needs its radius [m]" if self.kind == "weld" else "a connect has no stiffness against turning: no radius"
            )
        return self


class Phase(_Strict):
    """A step of capture: begins when its condition holds and the phase before has begun."""

    name: str = Field(description="Name of the phase")
    when: Condition = Field(description="Condition that begins the phase")
    close: Closure | None = Field(None, description="Latch that closes when the phase begins")
    command: dict[str, float] = Field(
        default_factory=dict, description="Actuators of the active side to what they are told from then on, in their units"
    )
    drop_contacts: list[str] = Field(default_factory=list, description="Geoms of the active side that touch no more")

    def sites(self) -> list[tuple[str, str]]:
        """Port of its side (A, P) and name of each site that the phase names."""
        pairs = [*self.when.pairs, *([(self.close.active, self.close.passive)] if self.close else [])]
        return [(port, name) for pair in pairs for port, name in zip("AP", pair, strict=True)]


class Mechanism(_Strict):
    """The whole of ``mechanism.yaml``."""

    contact: list[Touching] = Field(min_length=1)
    phases: list[Phase] = Field(default_factory=list)

    @model_validator(mode="after")
    def _names(self) -> Mechanism:
        names = [p.name for p in self.phases]
        if len(set(names)) != len(names):
            raise ValueError(f"phases of one name: {', '.join(sorted({n for n in names if names.count(n) > 1}))}")
        return self


def read(path: Path) -> Mechanism:
    """The description in the file ``path``; every fault of it as an InputError."""
    try:
        tree = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
        return Mechanism.model_validate(tree)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a mechanism has mechanism.yaml beside active.xml and passive.xml") from None
    except YAMLError as error:
        raise InputError(f"{path}: not YAML: {error}") from None
    except ValidationError as error:
        keys = [(".".join(map(str, e["loc"])), e["msg"]) for e in error.errors()]
        raise InputError([Fault(str(path), None, None, key, message) for key, message in keys]) from None


def matching(pattern: str, names: list[str]) -> list[str]:
    """Those of the ``names`` that the ``pattern`` stands for."""
    return [name for name in names if fnmatchcase(name, pattern)]
