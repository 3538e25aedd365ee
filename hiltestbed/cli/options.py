"""Options that the commands share, and the reading of a scenario."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from hiltestbed.errors import InputError
from hiltestbed.run_folder.folders import free_folder

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

Out = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder to write; left out: runs/NAME.")
]
Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a key: approach.velocity.2=0.05 (repeatable)."
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="One JSON object on standard output, and nothing else there.")
]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """``command`` as typer reads it: a parameter that is a dataclass stands for an option for each
    of its fields.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters = []
    for given in signature(command).parameters.values():
        kind = groups.get(given.name)
        options = fields(kind) if kind else (given,)
        kinds = get_type_hints(kind, include_extras=True) if kind else hints
        for option in options:
            default = getattr(kind, option.name, Parameter.empty) if kind else option.default
            annotation = kinds[option.name]
            parameters.append(
                Parameter(
                    option.name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation
                )
            )

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, kind in groups.items():
            given[name] = kind(**{option.name: given.pop(option.name) for option in fields(kind)})
        command(**given)

    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in parameters}
    return run


def complete(incomplete: str) -> list[str]:
    """Shell completion: shipped scenarios and campaigns, and files, beginning so."""
    from hiltestbed.config.gallery import campaign_names, scenario_names

    files = [str(path) for path in Path().glob("*.yaml")]
    return [
        name
        for name in (*files, *scenario_names(), *campaign_names())
        if name.startswith(incomplete)
    ]


ScenarioFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCENARIO",
        help="Scenario file, or the name of a shipped one.",
        autocompletion=complete,
    ),
]


def result_folder(out: Path | None, label: str, mark: str | None = None) -> Path:
    """``out``, or if left out a folder below `runs` that does not exist yet. Raises InputError for
    one with anything else in it than a result with the file ``mark`` (None: a run).
    """
    from hiltestbed.run_folder.store import SUMMARY, refuse_foreign

    folder = out if out is not None else free_folder(Path("runs") / label)
    refuse_foreign(folder, mark or SUMMARY)
    return folder


def print_json(found: dict[str, Any], folder: Path | None = None) -> None:
    """One JSON object on standard output, with the folder of the result."""
    about = {"folder": str(folder)} if folder is not None else {}
    print(json.dumps(found | about, allow_nan=False))


def overrides(sets: list[str] | None) -> dict[str, Any]:
    """`["a.b=1"]` as `{"a.b": "1"}`. Raises InputError for an item without `=`."""
    result = {}
    for item in sets or []:
        key, sign, value = item.partition("=")
        if not sign or not key.strip():
            raise InputError(
                f"--set {item}: is not KEY=VALUE (got {item!r}); write for example --set "
                f"sensor.delay=0.005"
            )
        result[key.strip()] = value
    return result


def read_scenario(file: Path, sets: list[str] | None, case: int | None = None) -> Scenario:
    """The scenario in a file, or a campaign's case. Raises InputError naming another kind."""
    from hiltestbed.build import runnable_from
    from hiltestbed.compiled.warm import tell_of_compiling
    from hiltestbed.config.check import file_kind
    from hiltestbed.config.gallery import (
        campaign_names,
        find_scenario,
        refuse_unknown,
        scenario_names,
    )
    from hiltestbed.config.yaml_source import read_source

    tell_of_compiling()
    refuse_unknown(file, scenario_names() if case is None else campaign_names())
    source = read_source(find_scenario(file))
    kind = file_kind(source)
    one = f"an {kind}" if kind in ("axis", "arm") else f"a {kind}"
    if kind == "campaign" and case is not None:
        from hiltestbed.campaign.schema import campaign_from
        from hiltestbed.campaign.sweep import case_scenario

        return case_scenario(campaign_from(source), case, overrides(sets))
    if case is not None:
        raise InputError(source.fault((), f"is {one} (got its keys); --case is for campaigns"))
    if kind != "scenario":
        other = {
            "campaign": "sweep FILE` or `hiltestbed run FILE --case N",
            "dataset": "diagnose FILE",
            "axis": "diagnose FILE",
            "arm": "diagnose FILE",
        }[kind]
        raise InputError(
            source.fault(
                (),
                f"is {one} (got its keys); a scenario is expected here; for {one}: "
                f"`hiltestbed {other}`",
            )
        )
    return runnable_from(source, overrides(sets))
