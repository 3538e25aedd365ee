"""The description of a mechanism beyond its MJCF: which geoms touch and how, and the phases of its
capture.

``mechanism.yaml`` complements ``active.xml`` and ``passive.xml``: pairs of geoms, latches between
both sides and conditions on both sides belong to neither file. Names are those of the geoms, sites
and actuators in the two files; ``*`` stands for any characters.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.errors import Fault, InputError


class Rule(NamedTuple):
    """Geoms of both sides that may touch, by name (``*``: any characters); both None: those that
    MuJoCo would let collide.

    Attributes:
        reach: [m] pairs with a larger lateral distance, ports aligned, are excluded; None: no
            limit.
    """

    active: str | None = None
    passive: str | None = None
    reach: float | None = None


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Touching(_Strict):
    """A class of geom pairs that may touch; stiffness and damping are those of a pair, whatever its
    number of contact points.
    """

    active: str = Field(
        description="Geoms of the active side that may touch; * stands for any characters"
    )
    passive: str = Field(
        description="Geoms of the passive side that may touch; * stands for any characters"
    )
    stiffness: Positive = Field(description="Stiffness of a pair of geoms [N/m]")
    damping: NotNegative = Field(0.0, description="Damping of a pair of geoms [N s/m]")
    friction: NotNegative = Field(
        0.0, description="Coulomb friction coefficient of a pair of geoms [-]"
    )
    reach: Positive | None = Field(
        None,
        description="Largest lateral distance of a pair, ports aligned [m]; pairs farther apart "
        "are excluded; omitted: no limit",
    )


class Condition(_Strict):
    """Pairs of sites, active and passive, that are close, aligned and slow at the same time, and
    joints within given ranges.
    """

    pairs: list[tuple[str, str]] = Field(
        min_length=1, description="Pairs of sites, one of the active and one of the passive side"
    )
    within: Positive = Field(description="Largest distance between the sites of a pair [m]")
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] = Field(
        180.0, description="Largest angle between the z axes of the sites [deg]"
    )
    speed: Positive = Field(description="Highest relative speed of the sites [m/s]")
    joints: dict[str, tuple[float, float]] = Field(
        default_factory=dict,
        description="Joints of the active side and the range in which each must be [m, rad]",
    )
    count: Annotated[int, Field(ge=1)] | None = Field(
        None, description="Number of pairs that must meet the limits [-]; omitted: all"
    )
    lasting: NotNegative = Field(
        0.0, description="Time for which the condition must hold without interruption [s]"
    )

    @model_validator(mode="after")
    def _enough(self) -> Condition:
        if self.count is not None and self.count > len(self.pairs):
            raise ValueError(f"count is {self.count}, but there are {len(self.pairs)} pairs")
        return self


class Closure(_Strict):
    """A latch between two sites: it holds them in the relative pose at which it closes, or draws
    them together.
    """

    kind: Literal["weld", "connect"] = Field(
        description="Kind of latch. weld: holds all six axes; connect: a ball joint"
    )
    active: str = Field(description="Site of the active side that is held")
    passive: str = Field(description="Site of the passive side that holds it")
    stiffness: Positive = Field(description="Translational stiffness [N/m]")
    damping: NotNegative = Field(description="Translational damping [N s/m]")
    hold: Literal["here", "together"] = Field(
        "here",
        description="Pose that it holds. here: the relative pose of the sites when it closes; "
        "together: the sites coincide",
    )
    radius: Positive | None = Field(
        None,
        description="Radius of the ring of latches [m], for a weld; the rotational stiffness is "
        "stiffness radius^2",
    )

    @model_validator(mode="after")
    def _turning(self) -> Closure:
        if (self.radius is None) == (self.kind == "weld"):
            raise ValueError(
                "a weld needs its radius [m]"
                if self.kind == "weld"
                else "a connect has no rotational stiffness: leave radius out"
            )
        return self


class Phase(_Strict):
    """A phase of capture: it begins when its condition holds and the previous phase has begun."""

    name: str = Field(description="Name of the phase")
    when: Condition = Field(description="Condition that begins the phase")
    close: Closure | None = Field(None, description="Latch that closes when the phase begins")
    command: dict[str, float] = Field(
        default_factory=dict,
        description="Actuators of the active side and their commands from then on, in the "
        "actuators' units",
    )
    drop_contacts: list[str] = Field(
        default_factory=list,
        description="Geoms of the active side that no longer touch from then on",
    )

    def sites(self) -> list[tuple[str, str]]:
        """Port (A or P) of its side, and name, of each site in the phase."""
        pairs = [
            *self.when.pairs,
            *([(self.close.active, self.close.passive)] if self.close else []),
        ]
        return [(port, name) for pair in pairs for port, name in zip("AP", pair, strict=True)]


class MechanismFile(_Strict):
    """The content of ``mechanism.yaml``."""

    contact: list[Touching] = Field(min_length=1)
    phases: list[Phase] = Field(default_factory=list)
    actuated: list[Phase] = Field(
        default_factory=list, description="Phases in place of these, of a ring on actuators"
    )

    @model_validator(mode="after")
    def _names(self) -> MechanismFile:
        for names in ([p.name for p in self.phases], [p.name for p in self.actuated]):
            if len(set(names)) != len(names):
                raise ValueError(
                    f"several phases have the same name: "
                    f"{', '.join(sorted({n for n in names if names.count(n) > 1}))}"
                )
        return self


@lru_cache(maxsize=32)
def read(path: Path, stamp: int = 0) -> MechanismFile:
    """The description in the file ``path``, read again where its ``stamp``, the time of its last
    change, is another one. Raises InputError with all its faults.
    """
    try:
        tree = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
        return MechanismFile.model_validate(tree)
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; a mechanism has mechanism.yaml beside active.xml and "
            f"passive.xml"
        ) from None
    except YAMLError as error:
        raise InputError(f"{path}: not YAML: {error}") from None
    except ValidationError as error:
        keys = [(".".join(map(str, e["loc"])), e["msg"]) for e in error.errors()]
        raise InputError(
            [Fault(str(path), None, None, key, message) for key, message in keys]
        ) from None


def matching(pattern: str, names: list[str]) -> list[str]:
    """Those of the ``names`` that match the ``pattern``."""
    return [name for name in names if fnmatchcase(name, pattern)]
