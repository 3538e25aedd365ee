"""The commands on one scenario, its files and its run: `hiltestbed run | check | rig | rank | view
| compare | new | doctor | schema`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hiltestbed.cli.options import (
    Json,
    Out,
    ScenarioFile,
    Sets,
    complete,
    overrides,
    print_json,
    read_scenario,
    result_folder,
)
from hiltestbed.errors import InputError
from hiltestbed.run_folder.folders import safe_name

if TYPE_CHECKING:
    from hiltestbed.analysis.record_comparison import RecordComparison

app = typer.Typer()


@app.command()
def run(
    scenario: ScenarioFile,
    out: Out = None,
    sets: Sets = None,
    no_rerun: Annotated[bool, typer.Option("--no-rerun", help="Leave recording.rrd out.")] = False,
    as_json: Json = False,
    case: Annotated[
        int | None, typer.Option("--case", metavar="N", help="Run case N of a campaign in full.")
    ] = None,
) -> None:
    """Run one scenario, or one case of a campaign, and write its run folder.

    hiltestbed run 04-bumper-delay-compensated

    hiltestbed run my-rig.yaml --set sensor.delay=0.010 --out runs/late
    """
    start = time.monotonic()
    from hiltestbed.process.progress import progress_bar

    spec = read_scenario(scenario, sets, case)
    label = spec.name if case is None else f"{scenario.stem}-case-{case}"
    folder = result_folder(out, safe_name(label))

    from hiltestbed.config.budget import refuse_beyond, run_budget
    from hiltestbed.config.sense import warnings
    from hiltestbed.run_folder.store import write_run
    from hiltestbed.simulation import run as simulate

    refuse_beyond(
        run_budget([spec]),
        spec.name,
        "a shorter duration, a lower rate or shorter delays need less",
        folder,
    )
    for warning in warnings(spec):
        print(f"{spec.name}: warning: {warning}", file=sys.stderr)

    with progress_bar(spec.name, spec.duration) as progress:
        result = simulate(spec, progress=progress)
    write_run(result, folder, rerun=not no_rerun)
    if as_json:
        print_json(result.summary, folder)
    else:
        from hiltestbed.report.table import print_run

        print_run(result.summary, folder, not no_rerun, time.monotonic() - start)
    if result.summary["status"] != "completed":
        print(
            f"{spec.name}: {result.summary['status']}: {result.summary['stop_reason']}; its "
            f"state is in {folder}. {result.assessment.advice[-1]}",
            file=sys.stderr,
        )
        raise typer.Exit(3)


@app.command()
def check(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE ...",
            help="Scenarios, campaigns, datasets and axes.",
            autocompletion=complete,
        ),
    ],
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Validate files and report all faults at once, with file, line and column. The data of a
    dataset are read and checked, too.

    hiltestbed check my-rig.yaml --set sensor.delay=0.010
    """
    from hiltestbed.analysis.kept_stability import stability_of_file
    from hiltestbed.compiled.warm import tell_of_compiling
    from hiltestbed.config.check import look_at
    from hiltestbed.config.gallery import find_scenario

    tell_of_compiling()
    changes, valid = overrides(sets), True
    rows = []
    for file in files:
        path = find_scenario(file)
        found = look_at(path, changes)
        valid = valid and not found.faults
        if not as_json:
            lines = [f"{file}: {remark}" for remark in found.remarks]
            if found.budget and not found.faults:
                lines.append(f"{file}: needs {found.budget}")
            lines = [*(found.faults or [f"{file}: {found.kind}: no faults"]), *lines]
            print(*lines, sep="\n", flush=True)  # the verdict may take seconds
        judged = (
            stability_of_file(path, changes)
            if found.kind == "scenario" and not found.faults
            else None
        )
        if judged and not as_json:
            print(f"{file}: {judged['verdict']}")
        row = {
            "file": str(file),
            "kind": found.kind,
            "faults": [vars(fault) for fault in found.faults],
            "remarks": list(found.remarks),
            "budget": vars(found.budget) if found.budget else None,
        }
        rows.append(row | ({"stability": judged} if judged else {}))
    if as_json:
        print(json.dumps({"valid": valid, "files": rows}))
    if not valid:
        raise typer.Exit(2)


@app.command()
def rig(
    scenario: ScenarioFile,
    out: Out = None,
    sets: Sets = None,
    as_json: Json = False,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="FILE",
            help="Only write the compiled model: .mjb for MuJoCo's viewer, .txt to read.",
        ),
    ] = None,
) -> None:
    """Measure the rig of a scenario: workspace, bandwidth and delay in six axes, modes, dynamic
    stiffness; as figures and a JSON file.

    hiltestbed rig my-rig.yaml --model rig.mjb && python -m mujoco.viewer --mjcf rig.mjb
    """
    if model is not None:
        from hiltestbed.platform.build import plant_of
        from hiltestbed.platform.plant import write_model

        print(write_model(plant_of([read_scenario(scenario, sets)]).model, model))
        return
    from hiltestbed.platform.rig_report import RIG, measure_rig, write_rig
    from hiltestbed.process.progress import count_bar

    spec = read_scenario(scenario, sets)
    folder = result_folder(out, f"rig-{safe_name(spec.name)}", RIG)
    with count_bar(f"rig {spec.name}") as progress:
        figures = measure_rig(spec, progress)
    write_rig(figures, folder)
    if as_json:
        print_json(figures.to_json(), folder)
    else:
        from hiltestbed.report.table import print_lines

        print_lines(f"rig of {spec.name}", figures.lines(), folder)


@app.command()
def rank(scenario: ScenarioFile, out: Out = None, sets: Sets = None, as_json: Json = False) -> None:
    """Try every compensation on a scenario, with the delay known and 20 % longer, and rank them.

    hiltestbed rank my-rig.yaml --plugin my_method.py
    """
    from hiltestbed.bench.ranking import HEADER, left_out, table
    from hiltestbed.bench.ranking import rank as try_all
    from hiltestbed.bench.result import BENCH, write_bench
    from hiltestbed.process.progress import count_bar

    spec = read_scenario(scenario, sets)
    folder = result_folder(out, f"rank-{safe_name(spec.name)}", BENCH)
    with count_bar(f"rank {spec.name}") as progress:
        result = try_all(spec, progress)
    write_bench(result, folder)
    if as_json:
        print_json(result.summary | {"methods": result.records}, folder)
    else:
        from hiltestbed.report.table import print_table

        print_table(f"compensations on {spec.name}", HEADER, table(result.records), folder)
        print("".join(f"{line}\n" for line in left_out(result.records)), end="")


@app.command()
def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, or a recording.")],
    png: Annotated[
        Path | None,
        typer.Option("--png", metavar="FILE", help="Write a picture; it needs no display."),
    ] = None,
) -> None:
    """Open a run in the rerun viewer, or write a picture of it.

    hiltestbed view runs/late --png late.png
    """
    if png is not None:
        from hiltestbed.viewer.picture import write_picture

        print(write_picture(run, png))
        return
    from hiltestbed.viewer import view as show

    show(run)


@app.command()
def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN RUN ...", help="Run folders; or two records, files of data."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Also write the comparison as an HTML page."),
    ] = None,
    channels: Annotated[
        Path | None,
        typer.Option("--channels", metavar="DATASET", help="Its channel map names the columns."),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option("--align", metavar="COLUMN", help="Align the clocks by it: pose_cmd.pz."),
    ] = None,
    stiffness: Annotated[
        float | None,
        typer.Option("--k", metavar="K", help="Stiffness [N/m]; left out: as record A shows it."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare runs: the differences between their scenarios, and their effect on the results. Or
    two records of any rig: aligned in time, the delay of each signal, and its worth as damping.

    hiltestbed compare runs/late runs/right --out both.html

    hiltestbed compare log.csv runs/right --channels dataset.yaml
    """
    from hiltestbed.analysis.record_comparison import compare_records, is_run

    if channels or align or stiffness is not None or not all(is_run(run) for run in runs):
        _print_delays(compare_records(runs, channels, align, stiffness), out, as_json)
        return
    from hiltestbed.analysis.comparison import compare as side_by_side
    from hiltestbed.analysis.comparison import write_comparison

    result = side_by_side(list(runs))
    if out is not None:
        write_comparison(result, out)
    if as_json:
        about = {"differences": result.differences, "figures": result.figures}
        print_json({"runs": list(result.names)} | about)
    else:
        from hiltestbed.report.table import print_comparison

        print_comparison(result.names, result.rows(), out)


def _print_delays(found: RecordComparison, out: Path | None, as_json: bool) -> None:
    from hiltestbed.analysis.record_comparison import HEADER
    from hiltestbed.report.table import print_table

    if out is not None:
        from hiltestbed.report.page import Report

        page = Report("Delays of two records")
        page.lead(found.sentence)
        page.table(HEADER, found.rows())
        page.write(out)
    if as_json:
        print_json(found.to_json())
        return
    print_table("delays of A " + " and B ".join(found.names), HEADER, found.rows(), None)
    print(found.sentence)


@app.command()
def new(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of the scenario; NAME.yaml is written.")
    ],
    logs: Annotated[
        list[Path] | None,
        typer.Option(
            "--from",
            metavar="LOG",
            help="Measured data: NAME.yaml is a dataset for `diagnose` (repeatable: one a run).",
        ),
    ] = None,
    kind: Annotated[
        Literal["dataset", "drive", "servo", "damper", "arm"] | None,
        typer.Option("--as", help="What the log is of, instead of the guess; dataset: a rig."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a commented scenario to start from; or from a log, a commented dataset with its
    guesses.

    hiltestbed new my-rig; hiltestbed new my-axis --from log.csv
    """
    if logs:
        from hiltestbed.config.from_log import write_from_log

        written = write_from_log(name, logs, kind or "")
        path = written.files[0]
        if as_json:
            print(json.dumps(written.to_json()))
        else:
            print("".join(f"{line}\n" for line in written.lines()), end="")
        return
    if kind:
        raise InputError(f"new: --as {kind} goes with --from LOG; give the log, or leave --as out")
    from hiltestbed.config.template import write_template

    path = write_template(name)
    if as_json:
        print(json.dumps({"file": str(path)}))
    else:
        print(f"{path}: written; next: hiltestbed check {path} && hiltestbed run {path}")


@app.command()
def doctor(as_json: Json = False) -> None:
    """List what this installation has: versions, extras, cores, viewer, compiled kernels. Status 1
    if something required is missing.
    """
    from hiltestbed.process.doctor import examine

    found = examine()
    healthy = all(f.good for f in found if f.needed)
    if as_json:
        print_json({"healthy": healthy, "findings": [vars(f) for f in found]})
    else:
        from hiltestbed.report.table import print_doctor

        print_doctor(found)
    if not healthy:
        raise typer.Exit(1)


@app.command()
def schema(
    what: Annotated[
        str,
        typer.Argument(
            metavar="[scenario|campaign|dataset|axis|arm|KEY]",
            help="A kind of file, or a key such as rig.platform.",
        ),
    ] = "scenario",
    search: Annotated[
        str | None,
        typer.Option(
            "--search", metavar="WORDS", help="List the keys that mention all of these words."
        ),
    ] = None,
) -> None:
    """Print the JSON Schema of a kind of file; or what a key takes and means, and the keys directly
    below it.

    hiltestbed schema rig.platform; hiltestbed schema dataset.channels; hiltestbed schema --search
    bandwidth
    """
    from hiltestbed.config.check import KINDS, json_schema
    from hiltestbed.config.keys import at, keys_of, text_of
    from hiltestbed.config.keys import search as search_keys

    kind, _, key = what.partition(".")
    kind, key = (kind, key) if kind in KINDS else ("scenario", what)
    if search is None and not key:
        print(json.dumps(json_schema(kind), indent=2))
        return
    keys = list(keys_of(json_schema(kind)))
    found = at(keys, key) if key else keys
    found = found if search is None else search_keys(found, search)
    if not found:
        raise InputError(
            f"schema: no key of a {kind} mentions {search!r}; fewer words, or a part of one, find "
            f"more"
        )
    print(text_of(found))
