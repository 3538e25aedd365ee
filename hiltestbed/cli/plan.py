"""`hiltestbed plan`: what a test would show, before it is made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from hiltestbed.cli.options import Json, Sets, complete, overrides, print_json, read_scenario
from hiltestbed.errors import InputError

app = typer.Typer()


@app.command()
def plan(
    task: Annotated[
        Path,
        typer.Argument(
            metavar="SCENARIO|DATASET",
            help="A scenario, or a dataset whose runs need not be on record yet.",
            autocompletion=complete,
        ),
    ],
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Before a test: the smallest size of each effect that these runs would show, the effects that
    they would confuse, and the runs that would settle most.

    hiltestbed plan my-rig.yaml --set sensor.noise=0.2
    """
    from hiltestbed.compiled.warm import tell_of_compiling
    from hiltestbed.config.check import file_kind
    from hiltestbed.config.dataset import dataset_from
    from hiltestbed.config.gallery import find_scenario
    from hiltestbed.config.yaml_source import read_source
    from hiltestbed.diagnosis.plan import plan as planned
    from hiltestbed.process.progress import step_line

    tell_of_compiling()
    file = find_scenario(task)
    kind = file_kind(read_source(file)) if file.is_file() else "scenario"
    if kind == "axis":
        raise InputError(f"{file}: is one axis; plan takes a scenario or the dataset of a rig")
    known = (
        dataset_from(read_source(file).with_set(overrides(sets)), on_record=False)
        if kind == "dataset"
        else read_scenario(task, sets)
    )
    with step_line(f"plan {task.stem}") as progress:
        found = planned(known, progress)
    if as_json:
        print_json(found.to_json())
        return
    from hiltestbed.report.table import print_table

    rows = [
        (
            e.effect,
            "-" if e.smallest is None else f"{e.parameter} {e.smallest:.3g} {e.unit}".rstrip(" -"),
            ", ".join(e.confused_with) or "-",
        )
        for e in found.effects
    ]
    print_table(f"plan {found.name}", ("effect", "would show from", "looks like"), rows, None)
    lines = [found.sentence, *(f"{k} was not judged: {v}" for k, v in found.not_judged.items())]
    for proposal in found.proposals:
        apart = ", ".join(" from ".join(pair) for pair in proposal.settles)
        settings = json.dumps(proposal.set)
        lines.append(f"  - {{file: FILE, set: {settings}}}  # {proposal.words}: tells {apart}")
    if not found.noise:
        lines.append(
            "noise: of the scenario's sensor; poses without noise. A dataset with one recorded run "
            "gives that of the facility."
        )
    print("\n".join(lines))
