"""The schema of a campaign: its scenario, how keys vary, the design, what is kept of each case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from hiltestbed.build import runnable_from
from hiltestbed.config.validation import Problem, Strictly, Vector2, refuse, validate
from hiltestbed.config.yaml_source import Source, key_path, read_source, referenced_source
from hiltestbed.errors import Fault, InputError
from hiltestbed.scenario import Scenario

Figure = Literal[  # shown in a report
    "cor",
    "cor_log_error",
    "energy_generated",
    "peak_force",
    "contact_duration",
    "tracking_error",
    "limits_share",
]
FIGURES: tuple[str, ...] = get_args(Figure)
# a day on a thousand cores; a larger number is assumed to be a typing error
CASE_LIMIT = 10_000_000

WAYS = ("values", "uniform", "log_uniform", "normal")  # in which a key can vary
Count = Annotated[int, Field(ge=1, description="Number of cases")]
PointSeed = Annotated[
    int, Field(ge=0, description="Seed of the points; the same seed, the same points")
]


class Variation(Strictly):
    """How one key varies: exactly one of values, uniform, log_uniform and normal."""

    values: Annotated[tuple[Any, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="these values, with equal probability"
    )
    uniform: Vector2 | None = Field(default=None, description="[low, high]")
    log_uniform: Vector2 | None = Field(
        default=None, description="[low, high], uniform in the logarithm"
    )
    normal: Vector2 | None = Field(default=None, description="[mean, standard deviation]")
    points: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="number of points of a range in a grid, both ends included"
    )

    @property
    def kind(self) -> str:
        """Which of the four is given."""
        return next(name for name in WAYS if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _is_one(self) -> Variation:
        refuse(_variation_problems(self))
        return self

    def at(self, u: float) -> Any:
        """The value at the quantile `u` in [0, 1)."""
        if self.values is not None:
            return self.values[min(int(u * len(self.values)), len(self.values) - 1)]
        if self.uniform is not None:
            low, high = self.uniform
            return low + (high - low) * u
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return math.exp(math.log(low) + (math.log(high) - math.log(low)) * u)
        from statistics import NormalDist

        mean, sigma = self.normal or (0.0, 1.0)
        return NormalDist(mean, sigma).inv_cdf(min(max(u, 1e-12), 1.0 - 1e-12))

    def grid(self) -> list[Any]:
        """The values of a grid: those listed, or `points` of the range including both ends."""
        if self.values is not None:
            return list(self.values)
        low, high = self.uniform or self.log_uniform or (0.0, 0.0)
        if self.points in (None, 1):
            return [self.at(0.5)]
        return [low, *(self.at(i / (self.points - 1)) for i in range(1, self.points - 1)), high]


def _variation_problems(variation: Variation) -> Iterator[Problem]:
    given = [name for name in WAYS if getattr(variation, name) is not None]
    if len(given) != 1:
        got = ", ".join(given) or "none"
        yield (
            (),
            f"needs one way to vary (got {got}); allowed is exactly one of {', '.join(WAYS)}",
        )
        return
    kind, limits = given[0], getattr(variation, given[0])
    if kind in ("uniform", "log_uniform") and not limits[0] < limits[1]:
        yield (
            (kind,),
            f"is an empty range (got {list(limits)}); allowed is [low, high] with low < high",
        )
    if kind == "log_uniform" and limits[0] <= 0:
        yield (kind,), f"is out of range (got {list(limits)}); allowed are limits > 0"
    if kind == "normal" and limits[1] <= 0:
        yield (
            (kind,),
            f"has no spread (got {list(limits)}); allowed is [mean, standard deviation > 0]",
        )


class Grid(Strictly):
    """Every combination of the values; the last key varies fastest."""

    kind: Literal["grid"] = Field(
        default="grid", description="Design. grid: every combination of the values"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="Seed; not used by a grid")


class Sobol(Strictly):
    """Scrambled Sobol points: low discrepancy, best with a power of two of cases."""

    kind: Literal["sobol"] = Field(
        default="sobol", description="Design. sobol: scrambled Sobol points"
    )
    cases: Count
    seed: PointSeed = 0


class Random(Strictly):
    """Independent random points."""

    kind: Literal["random"] = Field(
        default="random", description="Design. random: independent random points"
    )
    cases: Count
    seed: PointSeed = 0


class Campaign(Strictly):
    """Many runs of one scenario with some of its keys varied."""

    name: str = Field(
        default="",
        description="Name of the campaign, used for its results folder; left out: the file's",
    )
    description: str = Field(
        default="", description="The question that the campaign answers, in a sentence or two"
    )
    scenario: Annotated[str, Field(min_length=1)] = Field(
        description="scenario file, relative to the campaign's folder, or a shipped name"
    )
    set: dict[str, Any] = Field(
        default={}, description="scenario keys that are set in every case: dotted key to value"
    )
    vary: Annotated[dict[str, Variation], Field(min_length=1)] = Field(
        description="dotted scenario key, and how it varies"
    )
    design: Annotated[Grid | Sobol | Random, Field(discriminator="kind")] = Field(
        description="How the cases are laid out"
    )
    keep: Literal["summary", "trace", "all"] = Field(
        default="summary",
        description="What is kept of each case. summary: its row; trace: also its trace; all: its "
        "run folder without report.html",
    )

    criterion: Figure | None = Field(
        default=None,
        description="figure by which the report ranks choices, smallest magnitude first; null: "
        "cor_log_error, or peak_force",
    )

    @property
    def cases(self) -> int:
        """Number of cases."""
        if isinstance(self.design, Grid):
            return math.prod(
                len(variation.values) if variation.values else variation.points or 1
                for variation in self.vary.values()
            )
        return self.design.cases

    @model_validator(mode="after")
    def _is_possible(self) -> Campaign:
        refuse([*_design_problems(self), *_overlap_problems(self)])
        return self


def _design_problems(campaign: Campaign) -> Iterator[Problem]:
    grid = isinstance(campaign.design, Grid)
    for key, variation in campaign.vary.items():
        if not grid and variation.points is not None:
            yield (
                ("vary", key, "points"),
                f"has no meaning in a {campaign.design.kind} design; allowed in a grid alone",
            )
        elif grid and variation.kind == "normal":
            yield (
                ("vary", key, "normal"),
                "has no ends to lay a grid between; allowed in a grid: values, uniform, "
                "log_uniform",
            )
        elif grid and variation.values is None and variation.points is None:
            yield ("vary", key), "needs points: N to be laid out in a grid"
    if campaign.cases > CASE_LIMIT:
        where = ("design",) if grid else ("design", "cases")
        yield where, f"has too many cases (got {campaign.cases}); allowed are {CASE_LIMIT}"


def _overlap_problems(campaign: Campaign) -> Iterator[Problem]:
    """A key and a key below it cannot both vary: the result would depend on which is set last."""
    paths = {key: key_path(key) for key in campaign.vary}
    for key, path in paths.items():
        for other, above in paths.items():
            if key != other and path[: len(above)] == above:
                yield (
                    ("vary", key),
                    f"is a part of {other}, which varies too; allowed is one of the two",
                )


@dataclass(frozen=True)
class LoadedCampaign:
    """A valid campaign; `source` is the scenario's data with the campaign's `set` applied."""

    spec: Campaign
    path: Path
    source: Source
    nominal: Scenario


def load_campaign(path: str | Path, set: Mapping[str, Any] | None = None) -> LoadedCampaign:
    """The campaign in a YAML file, with keys set. Raises InputError with every fault."""
    return campaign_from(read_source(path).with_set(set))


def campaign_from(source: Source) -> LoadedCampaign:
    """The campaign in a source that has been read already. Raises InputError with every fault."""
    if "vary" not in source.data and "design" not in source.data:
        text = (
            "is no campaign (got neither vary nor design); a campaign names a scenario and what "
            "varies in it"
        )
        raise InputError(source.fault((), text))
    spec = validate(Campaign, source)
    base = referenced_source(source)
    try:
        base = base.with_set(spec.set)
        nominal = runnable_from(base)
    except InputError as error:
        raise InputError([source.relocated(fault, ("set",)) for fault in error.faults]) from None
    faults = [
        fault
        for key, variation in spec.vary.items()
        for fault in _key_faults(source, base, key, variation)
    ]
    if faults:
        raise InputError(faults)
    return LoadedCampaign(spec, Path(source.file), base, nominal)


def _key_faults(source: Source, base: Source, key: str, variation: Variation) -> Iterator[Fault]:
    """Tests every listed value, or the ends of a range, alone; combinations when they run."""
    for index, value in enumerate(_probes(variation)):
        try:
            runnable_from(base, {key: value})
        except InputError as error:
            below = (variation.kind, index) if variation.kind != "normal" else (variation.kind,)
            for fault in error.faults:
                wrong = any(text in fault.message for text in ("unknown key", "has no keys"))
                path = ("vary", key) if wrong else ("vary", key, *below)
                message = fault.message if fault.key == key else f"{fault.key}: {fault.message}"
                yield source.fault(path, message)
            if "unknown key" in str(error):
                return


def _probes(variation: Variation) -> list[Any]:
    if variation.values is not None:
        return list(variation.values[:1000])
    if variation.normal is not None:
        return [variation.normal[0]]
    return list(variation.uniform or variation.log_uniform or ())
