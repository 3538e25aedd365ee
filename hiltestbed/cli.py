"""The command line: `hiltestbed run | check | rig | schema | view | compare | bench | sweep | diagnose | new | doctor`.

Exit status: 0 done; 2 bad input; 3 the simulation diverged or a safety limit stopped it; 1 anything else that failed. Results go to
standard output, progress and messages to standard error. A command imports what it needs when it runs, so that --help is quick.
"""

from __future__ import annotations

import io
import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hiltestbed import cli_devices, interrupt
from hiltestbed.errors import HiltestbedError, InputError, printable
from hiltestbed.folders import free_folder, safe_name

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

app = typer.Typer(
    help="A hardware-in-the-loop contact simulator for spacecraft docking, in software.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder to write; left out: runs/NAME.")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a key: approach.velocity.2=0.05 (repeatable).")
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, and nothing else there.")]


def _complete(incomplete: str) -> list[str]:
    """Shipped scenarios and campaigns, and files, that begin like that: for a shell."""
    from hiltestbed.gallery import campaign_names, scenario_names

    files = [str(path) for path in Path().glob("*.yaml")]
    return [name for name in (*files, *scenario_names(), *campaign_names()) if name.startswith(incomplete)]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"hiltestbed {version('hiltestbed')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            "--plugin",
            metavar="MODULE",
            help="Load effects, methods, mechanisms or platforms of your own: a module, or a .py file (repeatable, with every command).",
        ),
    ] = None,
) -> None:
    if plugin and not {"--help", "-h"} & set(sys.argv):
        from hiltestbed import plugins

        plugins.load(plugin)


@app.command()
def run(
    scenario: Annotated[
        Path, typer.Argument(metavar="SCENARIO", help="Scenario file, or the name of a shipped one.", autocompletion=_complete)
    ],
    out: Out = None,
    sets: Sets = None,
    no_rerun: Annotated[bool, typer.Option("--no-rerun", help="Leave recording.rrd out.")] = False,
    as_json: Json = False,
    case: Annotated[int | None, typer.Option("--case", metavar="N", help="Run case N of a campaign in full.")] = None,
) -> None:
    """Run one scenario, or one case of a campaign, and write its run folder.

    hiltestbed run 04-bumper-delay-compensated

    hiltestbed run my-rig.yaml --set sensor.delay=0.010 --out runs/late
    """
    start = time.monotonic()
    from hiltestbed.progress import progress_bar

    spec = _scenario(scenario, sets, case)
    label = spec.name if case is None else f"{scenario.stem}-case-{case}"
    folder = out if out is not None else free_folder(Path("runs") / safe_name(label))

    from hiltestbed.recording import refuse_foreign, write_run
    from hiltestbed.simulation import run as simulate

    refuse_foreign(folder)
    from hiltestbed.budget import refuse_beyond, run_budget
    from hiltestbed.sense import warnings

    refuse_beyond(run_budget([spec]), spec.name, "a shorter duration, a lower rate or shorter delays need less", folder)
    for warning in warnings(spec):
        print(printable(f"{spec.name}: warning: {warning}"), file=sys.stderr)

    from hiltestbed.kernels import compiled

    if not compiled():
        print("compiling the inner loops: once after the install, half a minute or so", file=sys.stderr)
    with progress_bar(spec.name, spec.duration) as progress:
        result = simulate(spec, progress=progress)
    write_run(result, folder, rerun=not no_rerun)
    if as_json:
        print(json.dumps(result.summary | {"folder": str(folder)}, allow_nan=False))
    else:
        from hiltestbed.table import print_run

        print_run(result.summary, folder, not no_rerun, time.monotonic() - start)
    if result.summary["status"] != "completed":
        print(
            printable(f"{spec.name}: {result.summary['status']}: {result.summary['stop_reason']}; its state lies in {folder}"),
            file=sys.stderr,
        )
        raise typer.Exit(3)


@app.command()
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE ...", help="Scenarios, campaigns and datasets.")], as_json: Json = False
) -> None:
    """Validate files: every fault at once, with file, line and column; the data of a dataset are opened and checked, too."""
    from hiltestbed.check import look_at
    from hiltestbed.gallery import find_scenario
    from hiltestbed.stability import stability_of_file

    paths = [find_scenario(file) for file in files]
    found = [(file, look_at(path)) for file, path in zip(files, paths, strict=True)]
    stable = [
        stability_of_file(path) if one.kind == "scenario" and not one.faults else None
        for path, (_, one) in zip(paths, found, strict=True)
    ]  # fmt: skip
    if as_json:
        rows = [
            {
                "file": str(file), "kind": one.kind, "faults": [vars(fault) for fault in one.faults], "remarks": list(one.remarks),
                "budget": vars(one.budget) if one.budget else None,
            } | ({"stability": judged} if judged else {})
            for (file, one), judged in zip(found, stable, strict=True)
        ]  # fmt: skip
        print(json.dumps({"valid": not any(one.faults for _, one in found), "files": rows}))
    else:
        for (file, one), judged in zip(found, stable, strict=True):
            print("\n".join(str(fault) for fault in one.faults) if one.faults else f"{file}: {one.kind}: no faults")
            print(printable("".join(f"{file}: {remark}\n" for remark in one.remarks)), end="")
            print(f"{file}: needs {one.budget}\n" if one.budget else "", end="")
            print(f"{file}: {judged['verdict']}\n" if judged else "", end="")
    if any(one.faults for _, one in found):
        raise typer.Exit(2)


@app.command()
def rig(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file, or the name of a shipped one.")],
    out: Out = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Measure the rig of a scenario: workspace, bandwidth and delay in six axes, modes, dynamic stiffness; in pictures and a JSON file."""
    from hiltestbed.platform.rig_report import RIG, measure_rig, write_rig
    from hiltestbed.progress import count_bar
    from hiltestbed.recording import refuse_foreign

    spec = _scenario(scenario, sets, None)
    folder = out if out is not None else free_folder(Path("runs") / f"rig-{safe_name(spec.name)}")
    refuse_foreign(folder, RIG)
    with count_bar(f"rig {spec.name}") as progress:
        figures = measure_rig(spec, progress)
    write_rig(figures, folder)
    if as_json:
        print(json.dumps(figures.to_json() | {"folder": str(folder)}, allow_nan=False))
    else:
        from hiltestbed.table import print_lines

        print_lines(f"rig of {spec.name}", figures.lines(), folder)


@app.command()
def view(run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, or a recording.")]) -> None:
    """Open a run in the rerun viewer."""
    from hiltestbed.viewer import view as show

    show(run)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN ...", help="Run folders.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the comparison as an HTML page, too.")] = None,
    as_json: Json = False,
) -> None:
    """Put runs side by side: what differs in their scenarios, and what that did to the figures.

    hiltestbed compare runs/late runs/right --out both.html
    """
    from hiltestbed.comparison import compare as side_by_side
    from hiltestbed.comparison import write_comparison

    result = side_by_side(list(runs))
    if out is not None:
        write_comparison(result, out)
    if as_json:
        print(json.dumps({"runs": list(result.names), "differences": result.differences, "figures": result.figures}, allow_nan=False))
    else:
        from hiltestbed.table import print_comparison

        print_comparison(result.names, result.rows(), out)


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the scenario; NAME.yaml is written.")],
    as_json: Json = False,
) -> None:
    """Write a commented scenario to start from."""
    from hiltestbed.template import write_template

    path = write_template(name)
    if as_json:
        print(json.dumps({"file": str(path)}))
    else:
        print(f"{path}: written; next: hiltestbed check {path} && hiltestbed run {path}")


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what this installation has: versions, extras, cores, viewer, compiled kernels. Status 1 where something needed is missing."""
    from hiltestbed.doctor import examine

    found = examine()
    if as_json:
        print(json.dumps({"healthy": all(f.good for f in found if f.needed), "findings": [vars(f) for f in found]}))
    else:
        from hiltestbed.table import print_doctor

        print_doctor(found)
    if not all(f.good for f in found if f.needed):
        raise typer.Exit(1)


@app.command()
def schema(kind: Annotated[str, typer.Argument(metavar="[scenario|campaign|dataset]", help="Which kind of file.")] = "scenario") -> None:
    """Print the JSON Schema of a kind of file."""
    from hiltestbed.check import KINDS, json_schema

    if kind not in KINDS:
        raise InputError(f"schema: unknown kind of file (got {kind!r}); allowed: {', '.join(KINDS)}")
    print(json.dumps(json_schema(kind), indent=2))


BENCHES = {  # name to the module whose function of that name measures
    "cor": "hiltestbed.bench.cor",
    "diagnosis": "hiltestbed.bench.diagnosis",
    "facilities": "hiltestbed.bench.facilities",
    "identification": "hiltestbed.bench.identification",
    "realtime": "hiltestbed.bench.realtime",
    "robustness": "hiltestbed.bench.robustness.run",
    "throughput": "hiltestbed.bench.throughput",
}


@app.command()
def bench(
    name: Annotated[str, typer.Argument(metavar="|".join(BENCHES), help="Which benchmark.")],
    out: Out = None,
    quick: Annotated[bool, typer.Option("--quick", help="A smaller grid.")] = False,
    noise: Annotated[bool, typer.Option("--noise", help="diagnosis: healthy rigs under every kind of noise alone.")] = False,
    docking: Annotated[bool, typer.Option("--docking", help="diagnosis: the docking sets alone.")] = False,
    minutes: Annotated[float | None, typer.Option("--for", metavar="MINUTES", min=0.01, help="robustness: how long to go on.")] = None,
    workers: Annotated[int | None, typer.Option("--workers", metavar="N", help="robustness: processes; left out: one a core.")] = None,
    as_json: Json = False,
) -> None:
    """Run a benchmark and write its bench.json and report.html.

    hiltestbed bench cor --quick --plugin my_method.py
    """
    from importlib import import_module

    if name not in BENCHES:
        raise InputError(f"bench: unknown benchmark (got {name!r}); allowed: {', '.join(BENCHES)}")
    chosen = {option: True for option, given in (("noise", noise), ("docking", docking)) if given}
    if chosen and name != "diagnosis":
        raise InputError(f"bench {name}: --{next(iter(chosen))} is an option of bench diagnosis alone; leave it out")
    if (minutes is not None or workers is not None) and name != "robustness":
        raise InputError(f"bench {name}: --for and --workers are options of bench robustness alone; leave them out")
    from hiltestbed.bench.result import BENCH, write_bench
    from hiltestbed.progress import count_bar
    from hiltestbed.recording import refuse_foreign

    folder = out if out is not None else free_folder(Path("runs") / f"bench-{name}")
    refuse_foreign(folder, BENCH)
    with count_bar(f"bench {name}") as progress:
        more: dict[str, Any] = {k: v for k, v in (("minutes", minutes), ("workers", workers)) if v is not None}
        result = getattr(import_module(BENCHES[name]), name)(quick=quick, progress=progress, **chosen, **more)
    write_bench(result, folder)
    if as_json:
        print(json.dumps({"name": name, "folder": str(folder), "summary": result.summary}, allow_nan=False))
    else:
        from hiltestbed.table import print_lines

        print_lines(f"bench {name}", result.lines, folder)


@app.command()
def sweep(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="Campaign file.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results; left out: results/NAME.")] = None,
    sets: Sets = None,
    workers: Annotated[int | None, typer.Option("--workers", metavar="N", help="Processes on this machine; left out: one a core.")] = None,
    scheduler: Annotated[str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler, tcp://host:8786.")] = None,
    chunk: Annotated[int, typer.Option("--chunk", metavar="N", help="Cases in lockstep, and on disk, at a time.")] = 64,
    as_json: Json = False,
) -> None:
    """Run a campaign; run again with the same --out, it goes on where it stopped.

    hiltestbed sweep delay-stiffness --out results/map

    hiltestbed sweep mine.yaml --set design.cases=256 --workers 4
    """
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.campaign.sweep import default_folder
    from hiltestbed.campaign.sweep import sweep as run_sweep
    from hiltestbed.gallery import campaign_names, find_scenario, refuse_unknown
    from hiltestbed.kernels import cores
    from hiltestbed.progress import case_bar

    if workers is not None and scheduler is not None:
        raise InputError("--workers is for this machine and --scheduler for a cluster; allowed is one of the two")
    refuse_unknown(campaign, campaign_names())
    spec = load_campaign(find_scenario(campaign), overrides(sets))
    folder = out if out is not None else default_folder(spec)
    workers = workers if workers is not None else cores()
    from hiltestbed.budget import campaign_budget, refuse_beyond

    budget = campaign_budget(spec, max(workers, 1), max(chunk, 1))
    refuse_beyond(budget, str(campaign), "fewer cases, keep: summary, fewer --workers or a smaller --chunk need less", folder)
    try:
        with case_bar() as progress:
            result = run_sweep(spec, folder, workers=workers, scheduler=scheduler, chunk=chunk, progress=progress)
    except KeyboardInterrupt:
        raise HiltestbedError(f"interrupted; what is finished lies in {folder}, the same command goes on from there") from None
    if as_json:
        print(json.dumps(result.about | {"folder": str(folder)}, allow_nan=False))
    else:
        from hiltestbed.table import print_sweep

        print_sweep(result.about, folder)


@app.command()
def diagnose(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Dataset file: a scenario and the measured runs.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder to write; left out: runs/diagnosis-NAME.")] = None,
    as_json: Json = False,
) -> None:
    """Measured data against the simulation: what departs, why, and what is gained.

    hiltestbed check dataset.yaml && hiltestbed diagnose dataset.yaml --out results/mine
    """
    from hiltestbed.diagnosis.diagnose import diagnose as run_diagnosis
    from hiltestbed.diagnosis.report.folder import DIAGNOSIS
    from hiltestbed.progress import step_line
    from hiltestbed.recording import refuse_foreign

    label = dataset.stem if dataset.stem != "dataset" else dataset.resolve().parent.name
    folder = out if out is not None else free_folder(Path("runs") / f"diagnosis-{safe_name(label)}")
    refuse_foreign(folder, DIAGNOSIS)
    from hiltestbed.budget import dataset_budget, refuse_beyond
    from hiltestbed.dataset import load_dataset as load_specification

    loaded = load_specification(dataset)
    refuse_beyond(dataset_budget(loaded), str(dataset), "fewer or shorter runs need less", folder)
    with step_line(label) as progress:
        result = run_diagnosis(loaded, progress)
        progress("report and recording")
        result.write(folder)
    if as_json:
        print(json.dumps(result.to_json() | {"folder": str(folder)}, allow_nan=False))
    else:
        from hiltestbed.table import print_diagnosis

        print_diagnosis(result.to_json(), folder)


def device_scenario(file: Path, sets: list[str] | None, seconds: float | None = None) -> Scenario:
    """The scenario in a file, for ``seconds`` where they are given."""
    return _scenario(file, [*(sets or []), *([f"duration={seconds!r}"] if seconds is not None else [])], None)


cli_devices.add(app, device_scenario)


def overrides(sets: list[str] | None) -> dict[str, Any]:
    """`["a.b=1"]` as `{"a.b": "1"}`. Raises InputError for what has no `=`."""
    result = {}
    for item in sets or []:
        key, sign, value = item.partition("=")
        if not sign or not key.strip():
            raise InputError(f"--set {item}: is not KEY=VALUE (got {item!r}); write for example --set sensor.delay=0.005")
        result[key.strip()] = value
    return result


def _scenario(file: Path, sets: list[str] | None, case: int | None) -> Scenario:
    """The scenario in a file, or of one case of the campaign in it; another kind of file is named, not taken for a faulty scenario."""
    from hiltestbed.check import file_kind
    from hiltestbed.gallery import campaign_names, find_scenario, refuse_unknown, scenario_names
    from hiltestbed.scenario import scenario_from
    from hiltestbed.yaml_source import read_source

    refuse_unknown(file, scenario_names() if case is None else campaign_names())
    source = read_source(find_scenario(file))
    kind = file_kind(source)
    if kind == "campaign" and case is not None:
        from hiltestbed.campaign.schema import campaign_from
        from hiltestbed.campaign.sweep import case_scenario

        return case_scenario(campaign_from(source), case, overrides(sets))
    if case is not None:
        raise InputError(source.fault((), f"is a {kind} (got its keys); --case is for campaigns"))
    if kind != "scenario":
        other = {"campaign": "sweep FILE` or `hiltestbed run FILE --case N", "dataset": "diagnose FILE"}[kind]
        raise InputError(source.fault((), f"is a {kind} (got its keys); a scenario is expected here; for a {kind}: `hiltestbed {other}`"))
    return scenario_from(source, overrides(sets))


def _fail(error: BaseException, text: str, status: int) -> int:
    """Says what went wrong on standard error; with --json on standard output too, as the one object there."""
    if "--json" in sys.argv:
        faults = [vars(fault) for fault in error.faults] if isinstance(error, InputError) else []
        print(json.dumps({"status": "error", "exit_status": status, "error": text, "faults": faults}))
    print(printable(text), file=sys.stderr)
    return status


def main() -> None:
    """Entry point: runs a command and turns what goes wrong into a message and an exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without UTF-8 gets a mark in place of what it cannot show
            stream.reconfigure(errors="replace")
    try:
        status = _run()
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the interpreter flushes once more at exit
        status = 1
    sys.exit(status)


def _plugins_first(arguments: list[str]) -> list[str]:
    """The arguments with every ``--plugin MODULE`` at their head, where the program takes it: it may stand behind any command."""
    ahead, rest = [], []
    waiting = iter(arguments)
    for argument in waiting:
        if argument == "--":
            rest += [argument, *waiting]
        elif argument == "--plugin":
            ahead += [argument, *([following] if (following := next(waiting, None)) is not None else [])]
        elif argument.startswith("--plugin="):
            ahead.append(argument)
        else:
            rest.append(argument)
    return [*ahead, *rest]


def _run() -> int:
    interrupt.install()
    try:
        app(_plugins_first(sys.argv[1:]))
    except SystemExit as ended:  # what typer ends with: 2 for a wrong call, 130 after Ctrl-C
        return ended.code if ended.code in (0, 1, 2, 3) else int(ended.code is not None)  # type: ignore[return-value]
    except HiltestbedError as error:
        return _fail(error, str(error), error.exit_status)
    except KeyboardInterrupt as error:
        return _fail(error, "interrupted", 1)
    except BrokenPipeError:
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(error, f"{where}{error.strerror or error}", 1)
    except (ImportError, RuntimeError, SystemError) as error:
        if not interrupt.asked():
            raise
        return _fail(error, "interrupted", 1)
    except MemoryError as error:
        return _fail(error, "out of memory; a shorter duration or a lower rate needs less", 1)
    return 0


if __name__ == "__main__":
    main()
