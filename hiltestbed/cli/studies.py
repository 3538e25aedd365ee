"""The commands of many runs, before and after a test: `hiltestbed bench | sweep | diagnose | plan |
export`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from hiltestbed.bench import BENCHES, benchmark
from hiltestbed.cli.options import (
    Json,
    Out,
    Sets,
    complete,
    grouped,
    overrides,
    print_json,
    read_scenario,
    result_folder,
)
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.run_folder.folders import safe_name

app = typer.Typer()

# options of some benchmarks only
ONLY: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("noise", "docking", "computing", "minutes", "workers"), ("diagnosis",)
)
ONLY |= {"data": ("real", "rths"), "enter": ("hildock",)}


@dataclass
class Particular:
    """Options of some benchmarks only; None and False where they are not given."""

    noise: Annotated[
        bool, typer.Option("--noise", help="diagnosis: only sets with noise that is not white.")
    ] = False
    docking: Annotated[
        bool, typer.Option("--docking", help="diagnosis: only the docking sets.")
    ] = False
    computing: Annotated[
        bool,
        typer.Option(
            "--computing",
            help="diagnosis: only facilities with other sub-steps, sampling instants and time "
            "stamps.",
        ),
    ] = False
    minutes: Annotated[
        float | None,
        typer.Option("--for", metavar="MINUTES", min=0.01, help="diagnosis: duration."),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="diagnosis: processes; left out: one per core."),
    ] = None
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="DIR", help="real, rths: folder of the public records."),
    ] = None
    enter: Annotated[
        str | None,
        typer.Option(
            "--enter",
            metavar="URL|FMU",
            help="hildock: a method of your own behind udp://HOST:PORT, or in an FMU.",
        ),
    ] = None


@app.command()
@grouped
def bench(
    name: Annotated[str, typer.Argument(metavar="|".join(BENCHES), help="Which benchmark.")],
    particular: Particular,
    out: Out = None,
    quick: Annotated[bool, typer.Option("--quick", help="A smaller grid.")] = False,
    as_json: Json = False,
) -> None:
    """Run a benchmark and write its bench.json and report.html.

    hiltestbed bench cor --quick --plugin my_method.py

    hiltestbed bench diagnosis --noise --for 60 --out runs/noise      (repeat the command to
    continue)
    """
    if name not in BENCHES:
        raise InputError(f"bench: unknown benchmark (got {name!r}); allowed: {', '.join(BENCHES)}")
    given: dict[str, Any] = {k: v for k, v in vars(particular).items() if v not in (None, False)}
    named = {"for" if k == "minutes" else k: v for k, v in given.items()}
    for option, of in zip(named, map(ONLY.__getitem__, given), strict=True):
        if name not in of:
            raise InputError(
                f"bench {name}: --{option} is an option of bench {' and '.join(of)} only; "
                f"leave it out"
            )
    if name in ONLY["data"] and "data" not in given:
        raise InputError(f"bench {name}: needs --data DIR, the folder of the public records")
    measure = benchmark(name)
    from hiltestbed.bench.result import BENCH, write_bench
    from hiltestbed.compiled.warm import tell_of_compiling
    from hiltestbed.process.progress import count_bar

    folder = result_folder(out, f"bench-{name}", BENCH)
    tell_of_compiling()
    done: dict[str, Any] = (
        {"keep": folder.with_name(f"{folder.name}.sets.jsonl")} if name == "diagnosis" else {}
    )
    try:
        with count_bar(f"bench {name}") as progress:
            result = measure(quick=quick, progress=progress, **given, **done)
    except KeyboardInterrupt:
        if not done:
            raise
        raise HiltestbedError(
            f"interrupted; the same command with --out {folder} goes on from {done['keep']}"
        ) from None
    called = ({"quick": True} if quick else {}) | named
    called = {k: str(v) if isinstance(v, Path) else v for k, v in called.items()}
    write_bench(result, folder, called)
    if as_json:
        print_json({"name": name, "folder": str(folder), "summary": result.summary})
    else:
        from hiltestbed.report.table import print_lines

        print_lines(f"bench {name}", result.lines, folder)
    if result.failed:
        why = "; ".join(f"{own} ended with: {error}" for own, error in result.failed.items())
        raise HiltestbedError(
            f"bench {name}: left out: {why}; everything else was measured ({folder})"
        )


@app.command()
def sweep(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="Campaign file.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder of the results; left out: results/NAME."),
    ] = None,
    sets: Sets = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", metavar="N", help="Processes on this machine; default: one per core."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler, tcp://host:8786."),
    ] = None,
    chunk: Annotated[
        int,
        typer.Option(
            "--chunk", metavar="N", help="Cases that run in lockstep and are written together."
        ),
    ] = 64,
    as_json: Json = False,
) -> None:
    """Run a campaign; run again with the same --out, it resumes where it stopped.

    hiltestbed sweep delay-stiffness --out results/map

    hiltestbed sweep mine.yaml --set design.cases=256 --workers 4
    """
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.campaign.sweep import default_folder
    from hiltestbed.campaign.sweep import sweep as run_sweep
    from hiltestbed.compiled.warm import cores, tell_of_compiling
    from hiltestbed.config.gallery import campaign_names, find_scenario, refuse_unknown
    from hiltestbed.process.progress import case_bar

    if workers is not None and scheduler is not None:
        raise InputError(
            "--workers is for this machine and --scheduler for a cluster; allowed is one of the two"
        )
    refuse_unknown(campaign, campaign_names())
    tell_of_compiling()
    spec = load_campaign(find_scenario(campaign), overrides(sets))
    folder = out if out is not None else default_folder(spec)
    workers = workers if workers is not None else cores()
    from hiltestbed.config.budget import campaign_budget, refuse_beyond

    budget = campaign_budget(spec, max(workers, 1), max(chunk, 1))
    refuse_beyond(
        budget,
        str(campaign),
        "fewer cases, keep: summary, fewer --workers or a smaller --chunk need less",
        folder,
    )
    try:
        with case_bar() as progress:
            result = run_sweep(
                spec, folder, workers=workers, scheduler=scheduler, chunk=chunk, progress=progress
            )
    except KeyboardInterrupt:
        raise HiltestbedError(
            f"interrupted; finished cases are in {folder}, the same command resumes from there"
        ) from None
    if as_json:
        print_json(result.about, folder)
    else:
        from hiltestbed.report.table import print_sweep

        print_sweep(result.about, folder)


@app.command()
def diagnose(
    dataset: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET", help="Dataset file: a scenario or an axis, and the measured runs."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder to write; left out: runs/diagnosis-NAME."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare measured data with the simulation: where they deviate, the cause, and the gain of an
    extended model.

    hiltestbed check dataset.yaml && hiltestbed diagnose dataset.yaml --out results/mine
    """
    from hiltestbed.axis.dataset import is_axis, load_axis
    from hiltestbed.axis.diagnose import diagnose_axis
    from hiltestbed.compiled.warm import tell_of_compiling
    from hiltestbed.config.budget import dataset_budget, refuse_beyond
    from hiltestbed.config.dataset import dataset_from, label_of
    from hiltestbed.config.yaml_source import read_source
    from hiltestbed.diagnosis.diagnose import diagnose as run_diagnosis
    from hiltestbed.diagnosis.report.diagnosis import DIAGNOSIS
    from hiltestbed.process.progress import step_line

    tell_of_compiling()
    label = label_of(dataset)
    folder = result_folder(out, f"diagnosis-{safe_name(label)}", DIAGNOSIS)
    source = read_source(dataset)
    with step_line(label) as progress:
        if is_axis(source):
            found = diagnose_axis(load_axis(source), progress)
        else:
            loaded = dataset_from(source)
            remedy = "fewer or shorter runs need less"
            refuse_beyond(dataset_budget(loaded), source.file, remedy, folder)
            found = run_diagnosis(loaded, progress)
        progress("report and recording")
        found.write(folder)
        result = found.to_json()
    if as_json:
        print_json(result, folder)
    else:
        from hiltestbed.report.table import print_diagnosis

        print_diagnosis(result, folder)


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
    if kind in ("axis", "arm"):
        raise InputError(f"{file}: is an {kind}; plan takes a scenario or the dataset of a rig")
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


@app.command()
def export(
    diagnosis: Annotated[
        Path, typer.Argument(metavar="DIAGNOSIS", help="Folder that `diagnose` has written.")
    ],
    mjcf: Annotated[
        Path, typer.Option("--mjcf", metavar="FILE", help="MJCF file to write, for MuJoCo.")
    ],
    as_json: Json = False,
) -> None:
    """Write the extended model of a diagnosis as MJCF: a small model that loads, and what MuJoCo
    cannot say as a comment at its top.

    hiltestbed export runs/diagnosis-arm --mjcf arm.xml && python -m mujoco.viewer --mjcf arm.xml
    """
    from hiltestbed.analysis.export import export_mjcf

    found = export_mjcf(diagnosis, mjcf)
    if as_json:
        print(json.dumps({"file": str(mjcf), "said": found.said, "unsaid": found.unsaid}))
        return
    print(f"{mjcf}: written")
    print("".join(f"  {text}\n" for text in found.said), end="")
    if found.unsaid:
        print("MuJoCo cannot say:")
        print("".join(f"  {text}\n" for text in found.unsaid), end="")
