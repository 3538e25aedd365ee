"""Check of a file: its kind, its faults, its cost, remarks on unusual values; and the JSON Schema
of each kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

from hiltestbed.config.budget import Budget
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.errors import Fault, InputError

Kind = Literal["scenario", "campaign", "dataset", "axis", "arm"]
KINDS: tuple[Kind, ...] = get_args(Kind)


def file_kind(source: Source) -> Kind:
    """A campaign varies keys, an axis or arm names itself, a dataset lists runs; else: a
    scenario.
    """
    if "axis" in source.data:
        return "arm" if source.data["axis"] == "arm" else "axis"
    if "vary" in source.data or "design" in source.data:
        return "campaign"
    return "dataset" if "runs" in source.data else "scenario"


@dataclass(frozen=True)
class FileReport:
    """Result of `hiltestbed check` for a file.

    Attributes:
        kind: None if it is not a YAML file. faults: errors. remarks: losses and notes on a
            dataset's files, and numbers of a scenario that are implausible in combination.
        budget: resources that the task needs, None if it cannot be started.
    """

    kind: Kind | None
    faults: tuple[Fault, ...]
    remarks: tuple[str, ...] = ()
    budget: Budget | None = None


def look_at(path: str | Path, set: Mapping[str, Any] | None = None) -> FileReport:
    """All findings on a file, with dotted keys overridden; a dataset's data are checked too."""
    kind: Kind | None = None
    try:
        source = read_source(path).with_set(set)
        kind = file_kind(source)
        return _CHECKS[kind](source)
    except InputError as error:
        return FileReport(kind, error.faults or (Fault(str(path), None, None, "", str(error)),))


def _scenario(source: Source) -> FileReport:
    from hiltestbed.build import runnable_from
    from hiltestbed.config.budget import run_budget
    from hiltestbed.config.models import remarks_on
    from hiltestbed.config.validation import user_files
    from hiltestbed.contact.findings import remarks

    scenario = runnable_from(source)
    models = [file for file, kind in user_files(scenario).values() if kind.mjcf]
    said = (f"{file}: {text}" for file in models for text in remarks_on(file))
    remarked = (*_foreseen(scenario), *remarks(scenario), *said)
    return _within(FileReport("scenario", (), remarked, run_budget([scenario])), source)


def _campaign(source: Source) -> FileReport:
    from hiltestbed.campaign.schema import campaign_from
    from hiltestbed.campaign.sweep import varied_in_vain
    from hiltestbed.config.budget import campaign_budget

    campaign = campaign_from(source)
    remarked = _foreseen(campaign.nominal, varied_in_vain(campaign))
    return _within(FileReport("campaign", (), remarked, campaign_budget(campaign)), source)


def _dataset(source: Source) -> FileReport:
    from hiltestbed.config.budget import dataset_budget
    from hiltestbed.config.dataset import dataset_from
    from hiltestbed.measured import as_faults, examine
    from hiltestbed.measured.remark import together

    loaded = dataset_from(source)
    examined = examine(loaded)
    faults = tuple(as_faults(examined))
    remarks = map(str, together(r for r in examined.remarks if r.severity != "error"))
    return _within(FileReport("dataset", faults, tuple(remarks), dataset_budget(loaded)), source)


def _axis(source: Source) -> FileReport:
    from hiltestbed.axis.dataset import load_axis
    from hiltestbed.axis.scaling import scaling_remark

    loaded = load_axis(source)
    model = loaded.model()
    more = model.tells_nothing() or scaling_remark(model)
    return FileReport(file_kind(source), (), (*loaded.remarks, *([more] if more else [])))


_CHECKS = dict(zip(KINDS, (_scenario, _campaign, _dataset, _axis, _axis), strict=True))


def _foreseen(scenario: Any, more: Iterable[str] = ()) -> tuple[str, ...]:
    """What a run of a scenario will meet, its warnings and ``more`` of them first."""
    from hiltestbed.analysis.limits import ahead, rig_ahead
    from hiltestbed.config.sense import warnings

    said = (f"warning: {text}" for text in (*warnings(scenario), *more))
    return (*said, *ahead(scenario), *rig_ahead(scenario))


def _within(found: FileReport, source: Source) -> FileReport:
    """The findings, with a fault for each limit that the budget exceeds."""
    over = found.budget.refused() if found.budget is not None else []
    return replace(found, faults=(*found.faults, *(source.fault((), why) for why in over)))


def json_schema(kind: Kind) -> dict[str, Any]:
    """The JSON Schema of one kind of file."""
    from hiltestbed import plugins
    from hiltestbed.axis.dataset import ArmDataset, AxisDataset
    from hiltestbed.campaign.schema import Campaign
    from hiltestbed.config.dataset import Dataset
    from hiltestbed.scenario import Scenario

    plugins.load()
    models = dict(zip(KINDS, (Scenario, Campaign, Dataset, AxisDataset, ArmDataset), strict=True))
    schema = models[kind].model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema
