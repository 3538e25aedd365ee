"""Which kind of file a file is, whether it holds, and the JSON Schema of each kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from hiltestbed.errors import Fault, InputError
from hiltestbed.yaml_source import Source, read_source

Kind = Literal["scenario", "campaign", "dataset"]
KINDS: tuple[Kind, ...] = ("scenario", "campaign", "dataset")


def file_kind(source: Source) -> Kind:
    """A campaign varies keys, a dataset lists runs, anything else is a scenario."""
    if "vary" in source.data or "design" in source.data:
        return "campaign"
    return "dataset" if "runs" in source.data else "scenario"


def check_file(path: str | Path) -> tuple[Kind | None, tuple[Fault, ...]]:
    """The kind of a file and every fault in it; None for what is no YAML file at all."""
    kind: Kind | None = None
    try:
        source = read_source(path)
        kind = file_kind(source)
        _load(kind, source)
    except InputError as error:
        return kind, error.faults
    return kind, ()


def _load(kind: Kind, source: Source) -> None:
    if kind == "campaign":
        from hiltestbed.campaign.schema import campaign_from

        campaign_from(source)
    elif kind == "dataset":
        from hiltestbed.dataset import dataset_from

        dataset_from(source)
    else:
        from hiltestbed.scenario import scenario_from

        scenario_from(source)


def json_schema(kind: Kind) -> dict[str, Any]:
    """The JSON Schema of one kind of file."""
    from hiltestbed import plugins
    from hiltestbed.campaign.schema import Campaign
    from hiltestbed.dataset import Dataset
    from hiltestbed.scenario import Scenario

    plugins.load()
    model = {"scenario": Scenario, "campaign": Campaign, "dataset": Dataset}[kind]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | model.model_json_schema()
