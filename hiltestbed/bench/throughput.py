"""Speed: cost of the loop relative to the bare physics steps that it contains.

Ratios are measured side by side: intervals of the loop and of bare steps of the same plant in the
same state alternate within one process, so that speed drift of the machine affects both. The loop
writes its trace while it is timed.
"""

from __future__ import annotations

import math
import resource
import runpy
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hiltestbed.analysis.metrics import take_figures
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.campaign.cases import run_chunk
from hiltestbed.campaign.schema import load_campaign
from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.state import arrays_of
from hiltestbed.config.gallery import shipped
from hiltestbed.contact.surfaces.turned import obj_text, polyline, turn
from hiltestbed.errors import HiltestbedError
from hiltestbed.loop import Loop, write_row
from hiltestbed.platform.plant import Plant
from hiltestbed.report.page import Report, new_figure
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.signals import Trace
from hiltestbed.simulation import run

STRETCH = 0.05  # [s] approximate length of an interval
DOCKING_TICKS = 1000  # 0.5 s, with contact in the last two thirds
CHUNK = 64
CASES = ((64, 250), (128, 250), (256, 250), (512, 250), (1024, 250))  # (cases, ticks)
TICKS = ((64, 250), (64, 500), (64, 1000), (64, 2000), (64, 4000))


def throughput(quick: bool = False, progress: Progress = silent) -> BenchResult:
    """Loop against bare steps, 1 to 512 runs; recording; scaling with cases and ticks."""
    scenario = load_scenario(shipped("scenarios") / "reference-bumper.yaml")
    sizes = [(n, t) for t in (1, 2) for n in (1, 4, 16, 64, 256, 512)]
    if quick:
        sizes = [(1, 1), (64, 1), (64, 2)]
    records = []
    for done, (n, threads) in enumerate(sizes):
        progress(done, len(sizes) + 1)
        records.append(side_by_side(scenario, n, threads, stretches=6 if quick else 12))
    recording = seconds_per_1e5_ticks(scenario)
    single = next(r for r in records if r["runs"] == 1 and r["threads"] == 1)
    batch = next(r for r in records if r["runs"] == 64 and r["threads"] == 2)
    summary = {
        "single_run_ratio": single["ratio"],
        "batch_ratio": batch["ratio"],
        "real_time_factor": single["real_time_factor"],
        "recording_per_1e5_ticks": recording,
        "docking_ratios": {n: docking_ratios(n, stretches=10 if quick else 40) for n in (1, 64)},
    }
    blocks = {n: per_block(scenario, n) for n in (1, 64)}
    grown = growth(quick)
    summary |= {"growth": grown, "memory": max(record["memory"] for record in grown)}
    progress(len(sizes) + 1, len(sizes) + 1)
    lines = [
        ("one pass of the loop over its bare steps, one run", f"{single['ratio']:.2f}"),
        ("a sim-tick of 64 runs over its bare steps, 2 threads", f"{batch['ratio']:.2f}"),
        ("real-time factor of one run, one core", f"{single['real_time_factor']:.1f}"),
        ("recording of 1e5 ticks", f"{recording:.2f} s"),
    ]
    lines += [
        (f"a tick of {n} run(s), {case}, over the bumper's", f"{ratio:.2f}")
        for n, ratios in summary["docking_ratios"].items()
        for case, ratio in ratios.items()
    ]
    report = _report(records, summary, blocks)
    report_growth(report, grown)
    return BenchResult("throughput", records, summary, report, lines)


def side_by_side(scenario: Scenario, n: int, threads: int, stretches: int) -> dict[str, Any]:
    """The loop and bare steps of an identical plant in alternation; medians over the intervals."""
    loop, bare = Loop([scenario] * n, threads), Loop([scenario] * n, threads).plant
    assert isinstance(bare, Plant)  # the simulated side
    trace = Trace(scenario.ticks, n, scenario.rate, loop.plant.units)
    m = scenario.substeps
    loop.step(trace)
    bare.bare_steps(m)
    start = time.perf_counter()
    loop.step(trace)
    taken = max(time.perf_counter() - start, 1e-6)
    ticks = max(4, min(scenario.ticks // (2 * stretches), int(STRETCH / taken)))
    skip = int(0.3 * scenario.rate)  # the intervals are around the contact
    ratios, passes = [], []
    for s in range(stretches):
        while n <= 16 and loop.k < skip + s * ticks:
            loop.step(trace)
        ours, theirs = arrays_of(bare), arrays_of(loop.plant)
        for name, array in ours.items():
            array[...] = theirs[name]
        a = time.perf_counter()
        for _ in range(ticks):
            loop.step(trace)
        b = time.perf_counter()
        bare.bare_steps(m * ticks)
        c = time.perf_counter()
        ratios.append((b - a) / (c - b))
        passes.append((b - a) / ticks)
    each = statistics.median(passes)
    return {
        "runs": n,
        "threads": threads,
        "ratio": statistics.median(ratios),
        "ratio_low": min(ratios),
        "ratio_high": max(ratios),
        "sim_ticks_per_second": n / each,
        "real_time_factor": n / each / scenario.rate,
    }


def docking_ratios(n: int, stretches: int) -> dict[str, float]:
    """Cost of a tick of ``n`` runs with probe and cone relative to the bumper on the same rig.

    The cone is the shipped one, whose profile is recovered (with the passive side fixed, and on the
    upper platform), and one of 1024 segments that is 2 % wider along y than along x, so that its
    96,256 triangles are searched. Median of processor times measured alternately, two thirds of
    them in contact, at the bottom of the socket, where most triangles are at almost the same
    distance.
    """
    path = shipped("scenarios") / "09-docking.yaml"
    docking: dict[str, Any] = {
        "approach.gap": 0.01,
        "approach.velocity.2": 0.06,
        "approach.offset": [0.0, 0.0],
        "mechanism.latch": None,
    }
    bumper: dict[str, Any] = {"mechanism.kind": "bumper", "mechanism.contact.friction": 0.0}
    with tempfile.TemporaryDirectory() as folder:
        cases: dict[str, dict[str, Any]] = {
            "bumper": bumper,
            "cone by its profile": {},
            "cone by its profile, upper platform moving": {"rig.upper.kind": "prs3"},
            "cone by its triangles": {"mechanism.kind": "mjcf", **_oval_cone(Path(folder))},
        }
        loops = [Loop([load_scenario(path, set=docking | keys)] * n) for keys in cases.values()]
    times: list[list[float]] = [[] for _ in loops]
    for _ in range(stretches + 1):
        for loop, taken in zip(loops, times, strict=True):
            start = time.thread_time()
            for _ in range(DOCKING_TICKS // stretches):
                loop.step()
            taken.append(time.thread_time() - start)
    # the first interval may include compilation
    plain, *others = (statistics.median(taken[1:]) for taken in times)
    return {name: cost / plain for name, cost in zip([*cases][1:], others, strict=True)}


def _oval_cone(folder: Path) -> dict[str, str]:
    """Keys of a scenario: the shipped probe, and a cone that is no surface of revolution."""
    models = shipped("models") / "probe_cone"
    shape = runpy.run_path(str(models / "turn_cone.py"))
    vertices, faces = turn(polyline(shape["PROFILE"], shape["ARC_STEP"]), 1024)
    for name in ("active.xml", "passive.xml"):
        shutil.copy(models / name, folder / name)
    (folder / "cone.obj").write_text(
        obj_text(vertices * [1.0, 1.02, 1.0], faces, "Cone, 2 % wider along y")
    )
    return {f"mechanism.{side}": str(folder / f"{side}.xml") for side in ("active", "passive")}


def per_block(scenario: Scenario, n: int) -> dict[str, float]:
    """Microseconds per tick in each block of the loop."""
    loop = Loop([scenario] * n)
    trace = Trace(scenario.ticks, n, scenario.rate, loop.plant.units)
    for _ in range(int(0.4 * scenario.rate)):
        loop.step(trace)
    plant, drive, repeats = loop.plant, loop.drive, 200
    assert isinstance(plant, Plant)  # the simulated side
    figures = bound(take_figures, ..., *loop.figures_of())
    row = bound(write_row, ..., *loop.row_of(trace))
    calls: dict[str, Callable[[], Any]] = {
        "sensor": lambda: loop.sensor.read(loop.k, plant.wrench_sub),
        "compensation and numerical model": lambda: drive.advance(loop.measurement),
        "figures": lambda: figures(loop.k),
        "trace": lambda: row(loop.k),
        "platform, mechanisms, contact": lambda: plant.advance(
            drive.pose, loop.motion.twist, loop.motion.acceleration
        ),
    }
    if loop.identification:
        identification = loop.identification
        calls["identification"] = lambda: identification.update(
            loop.sensor.reading, plant.pose_act, plant.twist_act
        )
    out = {}
    for name, call in calls.items():
        start = time.perf_counter()
        for _ in range(repeats):
            call()
        out[name] = 1e6 * (time.perf_counter() - start) / repeats
    return out


def seconds_per_1e5_ticks(scenario: Scenario) -> float:
    """Time to write the recording of a run of 1e5 ticks."""
    from hiltestbed.viewer import write_recording

    # stays within the platform's stroke
    slow = {"duration": 1.0e5 / scenario.rate, "approach.velocity": [0.0, 0.0, 0.005]}
    result = run(load_scenario(shipped("scenarios") / "reference-bumper.yaml", set=slow))
    if result.trace is None or len(result.trace.t) != 100_000:
        raise HiltestbedError(
            f"the run to be recorded ended early: {result.summary['stop_reason']}"
        )
    with tempfile.TemporaryDirectory() as folder:
        # not timed: imports and compiles
        write_recording(Path(folder) / "first.rrd", run(scenario))
        start = time.perf_counter()
        write_recording(Path(folder) / "recording.rrd", result)
        return time.perf_counter() - start


def _report(
    records: list[dict[str, Any]], summary: dict[str, Any], blocks: dict[int, dict[str, float]]
) -> Report:
    report = Report("Throughput")
    report.lead(
        f"One pass of the loop costs {summary['single_run_ratio']:.2f} times its bare physics "
        f"steps for one run and {summary['batch_ratio']:.2f} times for 64 runs on two threads; one "
        f"run goes {summary['real_time_factor']:.1f} times real time."
    )
    header = ["runs", "threads", "loop / bare steps", "lowest", "highest", "sim-ticks per second"]
    rows = []
    for r in records:
        ratios = (f"{r[k]:.2f}" for k in ("ratio", "ratio_low", "ratio_high"))
        rows.append([r["runs"], r["threads"], *ratios, f"{r['sim_ticks_per_second']:.3g}"])
    report.table(
        header,
        rows,
        "Intervals of the loop and of bare steps of the same plant alternated; the ratio is the "
        "median over them.",
    )
    figure, axes = new_figure(8, 3.4)
    for threads in sorted({r["threads"] for r in records}):
        line = [r for r in records if r["threads"] == threads]
        runs, pace = ([r[k] for r in line] for k in ("runs", "sim_ticks_per_second"))
        axes.plot(runs, pace, "o-", label=f"{threads} thread(s)")
    axes.set(xscale="log", xlabel="runs in the batch", ylabel="sim-ticks per second")
    axes.legend()
    report.figure(figure, "Simulated ticks per second against the size of the batch.")
    report.heading("Time of a tick by block")
    names = list(blocks[1])
    report.table(
        ["block", *(f"{n} run(s) [us]" for n in blocks)],
        [[name, *(f"{blocks[n][name]:.1f}" for n in blocks)] for name in names],
    )
    return report


def growth(quick: bool = False) -> list[dict[str, Any]]:
    """Records of `cases`, `ticks`, `wall` [s] without the process's start, peak `memory` [MB]."""
    points = [CASES[0], CASES[2], TICKS[2]] if quick else list(dict.fromkeys((*CASES, *TICKS)))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        return [pool.submit(measured, cases, ticks).result() for cases, ticks in points]


def measured(cases: int, ticks: int) -> dict[str, Any]:
    """One point: a campaign with the reference bumper, ended after `ticks`, in chunks."""
    file = shipped("scenarios") / "campaigns" / "delay-stiffness.yaml"
    keys = {"set.duration": ticks / 2000.0, "set.identification": {"kind": "none"}}
    campaign = load_campaign(file, keys)
    run_chunk(campaign, range(2))  # not timed: compiles and loads what every process needs
    start = time.perf_counter()
    for first in range(0, cases, CHUNK):
        run_chunk(campaign, range(first, min(first + CHUNK, cases)))
    wall = time.perf_counter() - start
    return {"cases": cases, "ticks": ticks, "wall": wall, "memory": peak_memory()}


def peak_memory() -> float:
    """Peak memory of this process [MB]; on Linux `ru_maxrss` would include its parent's."""
    status = Path("/proc/self/status")
    if status.is_file():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return int(lines["VmHWM"].split()[0]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20  # macOS counts bytes


def order(records: list[dict[str, Any]], key: str, other: str) -> float:
    """Exponent p of wall ~ key^p from the smallest to the largest record with equal `other`."""
    line = sorted((r for r in records if r[other] == records[0][other]), key=lambda r: r[key])
    first, last = line[0], line[-1]
    if last[key] == first[key]:
        return math.nan
    return math.log(last["wall"] / first["wall"]) / math.log(last[key] / first[key])


def report_growth(report: Report, records: list[dict[str, Any]]) -> None:
    """Add a table of the points, and the growth exponents of the time with cases and ticks."""
    report.heading("Scaling of a campaign")
    by_cases, by_ticks = order(records, "cases", "ticks"), order(records, "ticks", "cases")
    report.text(
        f"Time grows as cases^{by_cases:.2f} and as ticks^{by_ticks:.2f}; each point in a fresh "
        f"process, in chunks of {CHUNK}."
    )
    rows = [[r["cases"], r["ticks"], f"{r['wall']:.2f}", f"{r['memory']:.0f}"] for r in records]
    report.table(["cases", "ticks each", "time [s]", "peak memory [MB]"], rows)
