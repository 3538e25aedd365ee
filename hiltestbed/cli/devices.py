"""The commands against real devices and other simulators: `live | emulate | commission | fmu`."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hiltestbed.cli.options import (
    Json,
    ScenarioFile,
    Sets,
    grouped,
    print_json,
    read_scenario,
    result_folder,
)
from hiltestbed.errors import InputError
from hiltestbed.process import interrupt

if TYPE_CHECKING:
    from hiltestbed.devices.session import Observed, Options

Sensor = Annotated[
    str,
    typer.Option(
        "--sensor",
        metavar="URL",
        help="Force sensor: rdt://, rtde://, udp://, shm:// and its options.",
    ),
]
Platform = Annotated[
    str,
    typer.Option(
        "--platform",
        metavar="URL",
        help="Motion platform: rsi://, rtde://, udp://, shm://, and options.",
    ),
]
Cpu = Annotated[
    int | None,
    typer.Option(
        "--cpu", metavar="N", help="Processor for the cycle, preferably one that nothing else uses."
    ),
]

app = typer.Typer()


@dataclass
class DeviceOptions:
    """The devices of a loop, and what they may do."""

    sensor: Sensor
    platform: Platform
    arm: Annotated[
        bool,
        typer.Option(
            "--arm", help="Let the platform move. Left out, the devices are only watched."
        ),
    ] = False
    cpu: Cpu = None


@app.command()
@grouped
def live(
    scenario: ScenarioFile,
    devices: DeviceOptions,
    seconds: Annotated[
        float | None, typer.Option("--for", metavar="SECONDS", help="Duration of the run.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder to write; left out: runs/NAME-live."),
    ] = None,
    sets: Sets = None,
    no_rerun: Annotated[bool, typer.Option("--no-rerun", help="Leave recording.rrd out.")] = False,
    as_json: Json = False,
) -> None:
    """Run the loop in real time against a real sensor and a real platform; nothing moves without
    --arm. See docs/safety.md.
    """
    from hiltestbed.devices.live import live as run_live
    from hiltestbed.devices.recorder import discard
    from hiltestbed.devices.session import Observed
    from hiltestbed.run_folder.folders import safe_name
    from hiltestbed.run_folder.store import write_run

    if seconds is not None:
        sets = [*(sets or []), f"duration={seconds!r}"]
    spec = read_scenario(scenario, sets)
    folder = result_folder(out, safe_name(f"{spec.name}-live"))
    interrupt.track_shared_memory()
    # remains if the process dies; deleted once the run is written
    rows = folder.with_name(folder.name + ".rows.f64")
    result = run_live(spec, _options(devices, rows))
    if isinstance(result, Observed):
        _print_observed(result, spec.rate, as_json)
        return
    whole = result.trace is not None and len(result.trace.t) > 0
    write_run(result, folder, rerun=whole and not no_rerun)
    discard(rows)
    _print_live(result.summary, folder, whole and not no_rerun, as_json)
    if result.summary["status"] != "completed":
        print(
            f"{spec.name}: {result.summary['status']}: {result.summary['stop_reason']}; the run "
            f"is in {folder}",
            file=sys.stderr,
        )
        raise typer.Exit(3)


@app.command()
def emulate(
    scenario: ScenarioFile,
    sensor: Sensor,
    platform: Platform,
    seconds: Annotated[
        float | None,
        typer.Option("--for", metavar="SECONDS", help="How long; left out: until Ctrl-C."),
    ] = None,
    sets: Sets = None,
    cpu: Cpu = None,
    as_json: Json = False,
) -> None:
    """Emulate the physical side of a scenario in real time, with the protocols of real devices."""
    from hiltestbed.devices.emulate import emulate as run_emulation

    interrupt.track_shared_memory()
    spec = read_scenario(scenario, sets)

    def ready() -> None:
        line = f"{spec.name}: sensor {sensor}, platform {platform}, {spec.rate:g} Hz"
        print(line, file=sys.stderr, flush=True)

    result = run_emulation(spec, sensor, platform, seconds, cpu, ready)
    if as_json:
        print(json.dumps(result))
    else:
        print(
            "{cycles} cycles, {missed} without a command in time, {skipped} skipped; "
            "{ended}".format(**result)
        )


@app.command()
@grouped
def commission(
    scenario: ScenarioFile,
    devices: DeviceOptions,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder to write; left out: runs/NAME-commission."
        ),
    ] = None,
    force: Annotated[
        float, typer.Option("--force", metavar="N", help="Force of the presses [N].")
    ] = 100.0,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Measure sensor and platform of a live facility by small known motions: its nominal scenario,
    and a dataset for `diagnose`.
    """
    from hiltestbed.devices.commission.procedure import RESULT, figures, write_commission
    from hiltestbed.devices.commission.procedure import commission as run_commission
    from hiltestbed.process.progress import step_line
    from hiltestbed.run_folder.folders import safe_name

    spec = read_scenario(scenario, sets)
    folder = result_folder(out, safe_name(f"{spec.name}-commission"), RESULT)
    interrupt.track_shared_memory()
    with step_line(spec.name) as progress:
        result = run_commission(spec, _options(devices), force, progress)
    write_commission(result, folder)
    found = figures(result)
    if as_json:
        print(json.dumps(found | {"folder": str(folder)}))
    else:
        _print_commission(found, folder)


@app.command()
def fmu(
    scenario: ScenarioFile,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder to write the FMU into.")
    ] = Path(),
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="Of the FMU.")] = None,
    part: Annotated[
        str, typer.Option("--part", metavar="rig|sensor", help="What is packed.")
    ] = "rig",
    sets: Sets = None,
) -> None:
    """Pack the physical side of a scenario (rig, mechanism and force sensor), or its force sensor
    alone, as an FMU of FMI 3.0 for co-simulation.
    """
    import tempfile

    from hiltestbed.devices.fmu import PackedSensor, PackedSide, pack
    from hiltestbed.scenario import dump_scenario

    parts = {
        "rig": ("hiltestbed.devices.physical:from_file", PackedSide, "pose_cmd in, pose_act and"),
        "sensor": ("hiltestbed.sensor:ForceSensor.from_scenario", PackedSensor, "wrench in,"),
    }
    if part not in parts:
        raise InputError(f"--part: no such part (got {part!r}); allowed are {', '.join(parts)}")
    factory, how, ports = parts[part]
    spec = read_scenario(scenario, sets)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.yaml"
        file.write_text(dump_scenario(spec), encoding="utf-8")
        out.mkdir(parents=True, exist_ok=True)
        about = spec.description or spec.name
        packed = pack(factory, file, out, name or part.capitalize(), about, how)
    print(
        f"{packed}: {ports} wrench_meas out; communication step {spec.tick:g} s or a whole multiple"
    )


def _options(devices: DeviceOptions, record: Path | None = None) -> Options:
    from hiltestbed.devices.session import Options

    def say(step: str) -> None:
        print(step, file=sys.stderr, flush=True)

    return Options(
        devices.sensor, devices.platform, devices.arm, devices.cpu, record=record, say=say
    )


def _print_commission(found: dict[str, Any], folder: Path) -> None:
    sensor, platform = found["sensor"], found["platform"]
    angles = ", ".join(f"{value:.3f}" for value in sensor["attitude_deg"])
    print(
        f"sensor: sign {sensor['sign']:+d}, attitude in P {angles} deg, delay "
        f"{1e3 * sensor['delay']:.3f} ms"
    )
    for n in sensor["gains_and_crosstalk"]:
        what = (
            f"gain {n['axis']}"
            if n["source"] == n["axis"]
            else f"crosstalk {n['source']} to {n['axis']}"
        )
        print(f"  {what}: {n['value']:.4f} +- {n['ci95']:.4f}")
    print("  noise: " + ", ".join(f"{axis} {value:.3g}" for axis, value in found["noise"].items()))
    scale = ", ".join(f"{value:.4f}" for value in platform["scale"] or ()) or "not measured"
    gives = ", ".join(f"{1e9 * value:.3g}" for value in platform["compliance"])
    print(
        f"platform: delay {1e3 * platform['delay']:.3f} ms, scale {scale}, compliance {gives} nm/N"
    )
    print(
        f"{folder}: nominal.yaml, believed.yaml, dataset.yaml; next: hiltestbed diagnose "
        f"{folder / 'dataset.yaml'}"
    )


def _print_observed(observed: Observed, rate: float, as_json: bool) -> None:
    figures: dict[str, Any] = {"armed": False, "rate": observed.rate, "fault": observed.fault}
    for name in ("pose", "wrench", "noise"):
        figures[name] = [float(v) for v in getattr(observed, name)]
    figures["events"] = observed.counts
    if as_json:
        print_json(figures)
        return
    print(
        f"not armed: nothing was commanded; {observed.rate:.1f} ticks a second, the scenario asks "
        f"for {rate:g}"
    )
    for name in ("pose", "wrench", "noise"):
        print(f"  {name:7s}" + " ".join(f"{value:11.5g}" for value in figures[name]))
    for name, counts in observed.counts.items():
        happened = ", ".join(f"{event} {count}" for event, count in counts.items() if count)
        print(f"  {name}: {happened}")
    if observed.fault is not None:
        print(f"--arm would be refused: {observed.fault}")
        return
    print("give --arm to let the platform move; read docs/safety.md first")


def _print_live(summary: dict[str, Any], folder: Path, recording: bool, as_json: bool) -> None:
    if as_json:
        print_json(summary, folder)
        return
    from hiltestbed.report.table import print_run

    print_run(summary, folder, recording=recording)
    cycles, jitter, busy = (summary["live"][name] for name in ("cycles", "jitter", "busy"))
    print(f"{cycles} cycles, {summary['live']['missed']} missed; clock: {summary['live']['clock']}")
    for name, times in (("jitter", jitter), ("from record to command", busy)):
        print(
            f"{name}: median {1e6 * times['median']:.0f}, 99 % {1e6 * times['p99']:.0f}, worst "
            f"{1e6 * times['worst']:.0f} us"
        )
