"""`hiltestbed bench rths --data DIR [--quick]`: every method on the benchmark, and the figures that
its repository states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.bench.rths.entrants import Rodeac, known, shipped, uncompensated
from hiltestbed.bench.rths.problem import (
    GROUNDS,
    SOURCE,
    TICK,
    Material,
    Plants,
    RthsRecord,
    Substructure,
    actual_specimen,
    hybrid,
    indices,
    noise,
    planned_specimen,
    plants,
    read,
    reference,
    sampled,
    undivided,
    without,
)
from hiltestbed.errors import InputError
from hiltestbed.report.page import Report, new_figure

SEED, PLANTS, QUICK_PLANTS = 1, 20, 2  # of the uncertain transfer systems
CALIBRATED, INTENSITIES = 10, (0.2, 0.4, 0.6)  # plants, of the ground [Offline_calibration.m]
# [mm] that a volt moves, and [V] at 0 [S1_Input_Data.m]
PER_VOLT = np.array([7.4921 * 1.053, 7.3907 * 1.055])
AT_REST = np.array([-0.0092 / 7.4921, 0.0059 / 7.3907])
SATURATION = 3.8  # [V]
SHOWN = (7.0, 8.0)  # [s] of El Centro, in its strong motion
NODE, UPPER = ("x", "theta"), ("x 2", "theta 2", "x 3", "theta 3")
PARTS = {f"J{i}": ("1", "2") if i < 5 else UPPER if i in (8, 10) else NODE for i in range(1, 11)}


def rths(
    quick: bool = False,
    progress: Progress = silent,
    data: Path | None = None,
) -> BenchResult:
    """Every method on every ground motion, with the nominal and with uncertain transfer systems.

    Raises:
        InputError: no data folder, or other files in it.
    """
    if data is None or not data.is_dir():
        raise InputError(f"bench rths: no folder {data}; --data DIR has to be a clone of {SOURCE}")
    material, rng = read(data), np.random.default_rng(SEED)
    whole, tested = reference(material), actual_specimen()
    rest = without(whole, planned_specimen())
    drawn = plants(QUICK_PLANTS if quick else PLANTS, rng)
    shaken = {g: sampled(material.ground[g]) for g in (GROUNDS[:1] if quick else GROUNDS)}
    first, nominal = shaken[GROUNDS[0]], Plants(*(x[:1] for x in drawn))
    readings = noise(len(first), 0, rng)
    told = known(hybrid(rest, tested, first, nominal, readings, uncompensated))
    methods = {"none": uncompensated, "rodeac": partial(Rodeac, material), **shipped(told)}
    records: list[dict[str, Any]] = []
    courses: dict[str, RthsRecord] = {}
    for ground, acceleration in shaken.items():
        right = undivided(whole, None, acceleration)
        records.append(_row(ground, "perfect", 0, undivided(rest, tested, acceleration), right))
        readings = noise(len(acceleration), len(drawn.poles) - 1, rng)
        for name, method in methods.items():
            record = hybrid(rest, tested, acceleration, drawn, readings, method)
            records += [_row(ground, name, i, record, right) for i in range(len(drawn.poles))]
            if acceleration is first:
                courses[name] = RthsRecord(*(rows[:, :1].copy() for rows in record))
            progress(len(records), len(shaken) * (1 + len(methods) * len(drawn.poles)))
    boards = {
        g: {name: _board([r for r in records if (r["ground"], r["method"]) == (g, name)])
            for name in (*methods, "perfect")}
        for g in shaken
    }  # fmt: skip
    summary = {
        "seed": SEED,
        "plants": len(drawn.poles) - 1,
        "told": {"factor": told.factor.tolist(), "delay": told.delay.tolist()},
        "grounds": boards,
        "calibration": None if quick else calibration(material, rest, rng),
    }
    lines = [
        (name, ", ".join(f"{k} {_digits(of, k)}" for k in ("J1", "J2", "J5", "J7")))
        for name, of in boards[GROUNDS[0]].items()
    ]
    for key, of in (summary["calibration"] or {}).items():
        off = np.abs(of["z"]).max()
        lines.append((f"published {key}", f"found again within {off:.1f} standard deviations"))
    return BenchResult("rths", records, summary, _report(summary, courses), lines)


def _row(
    ground: str, method: str, plant: int, record: RthsRecord, right: RthsRecord
) -> dict[str, Any]:
    found = indices(record, plant, right)
    volts = np.abs(record.command[:, plant] / PER_VOLT + AT_REST).max(axis=0)
    where = {"ground": ground, "method": method, "plant": plant}  # 0: the nominal one
    return {**where, "indices": found, "volts": volts.tolist() if found else None}


def _board(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Of the nominal run, and over the uncertain ones that were not lost."""
    kept = [r["indices"] for r in rows[1:] if r["indices"]]
    over = {"mean": np.mean, "sd": np.std, "max": np.max}
    return {
        "nominal": rows[0]["indices"],
        **{
            name: {k: f([r[k] for r in kept], axis=0).tolist() for k in (kept or [{}])[0]}
            for name, f in over.items()
        },
        "lost": sum(r["indices"] is None for r in rows),
        "volts": max((v for r in rows if r["volts"] for v in r["volts"]), default=None),
    }


def calibration(material: Material, rest: Substructure, rng: np.random.Generator) -> dict[str, Any]:
    """The authors' calibration of `rodeac` beside its published result: the mean over ground
    motions, intensities, the nominal and ten uncertain plants of the filter (4,) from readings [m]
    to target, without a specimen, and of the inverse of its normal matrix.

    Their random numbers are not known: `sigma` is the standard deviation of such a mean, from the
    scatter over the uncertain plants, and `z` the difference of the two over its own.
    """
    cells = []
    for record, intensity in product(material.ground.values(), INTENSITIES):
        ground = sampled(record, intensity)
        readings = noise(len(ground), CALIBRATED, rng)
        run = hybrid(rest, None, ground, plants(CALIBRATED, rng), readings, uncompensated)
        late = np.lib.stride_tricks.sliding_window_view(1e-3 * run.measured, 4, axis=0)
        x = np.moveaxis(late[..., ::-1], 0, 2)  # (n, 2, ticks, 4), the newest first
        target = np.moveaxis(1e-3 * run.target[3:], 0, 2)[..., None]
        inverse = np.linalg.inv(np.swapaxes(x, 2, 3) @ x)
        cells.append(((inverse @ (np.swapaxes(x, 2, 3) @ target))[..., 0], inverse))
    found = {}
    for i, published in enumerate((material.coefficients, material.correlation)):
        values = np.array([cell[i] for cell in cells])
        mean, runs = values.mean(axis=(0, 1)), values.shape[0] * values.shape[1]
        sigma = np.sqrt(CALIBRATED * values[:, 1:].var(axis=1, ddof=1).sum(axis=0)) / runs
        found[("coefficients", "correlation")[i]] = {
            "published": published.tolist(), "found": mean.tolist(), "sigma": sigma.tolist(),
            "z": ((mean - published) / sigma / np.sqrt(2.0)).tolist(), "runs": runs,
        }  # fmt: skip
    return found


def _digits(board: Mapping[str, Any], key: str) -> str:
    """As the authors round."""
    return (
        "lost" if board["nominal"] is None else "/".join(f"{v:.1f}" for v in board["nominal"][key])
    )


def _cell(board: Mapping[str, Any], key: str, part: int) -> str:
    nominal, mean = board["nominal"], board["mean"].get(key)
    shown = "lost" if nominal is None else f"{nominal[key][part]:.1f}"
    if mean:
        sd, most = board["sd"][key][part], board["max"][key][part]
        shown += f"; {mean[part]:.1f} ± {sd:.1f}, {most:.1f}"
    return shown


def _report(summary: Mapping[str, Any], courses: Mapping[str, RthsRecord]) -> Report:
    report = Report("Benchmark of real-time hybrid simulation")
    report.lead(
        f"{len(courses)} methods with the nominal and with {summary['plants']} uncertain transfer "
        "systems. The indices are defined on the documentation's page: delays in ms, others in %."
    )
    for ground, boards in summary["grounds"].items():
        rows = [
            [f"{key} {part}", *(_cell(board, key, i) for board in boards.values())]
            for key, parts in PARTS.items()
            for i, part in enumerate(parts)
        ]
        title = f"{ground}: nominal; mean ± standard deviation, largest of the uncertain ones."
        report.table(["index", *boards], rows, title)
        lost = ", ".join(f"{n} {b['lost']}" for n, b in boards.items() if b["lost"]) or "none"
        beyond = ", ".join(n for n, b in boards.items() if (b["volts"] or 0.0) > SATURATION)
        report.text(f"Lost runs: {lost}. Commands beyond {SATURATION} V: {beyond or 'none'}.")
    report.figure(_picture(courses), "Actuator 1 with the nominal transfer system.")
    for key, found in (summary["calibration"] or {}).items():
        columns = (np.ravel(found[c]) for c in ("published", "found", "sigma", "z"))
        rows = [
            [f"{p:.6g}", f"{f:.6g}", f"{s:.2g}", f"{z:.1f}"]
            for p, f, s, z in zip(*columns, strict=True)
        ]
        title = f"The authors' calibration, {key}: mean over {found['runs']} runs."
        report.table(["published", "found", "sigma", "z"], rows, title)
    return report


def _picture(courses: Mapping[str, RthsRecord]):
    figure, (above, below) = new_figure(10.0, 4.6, nrows=2, ncols=1, sharex=True)
    rows = slice(*(round(t / TICK) for t in SHOWN))
    t = TICK * np.arange(rows.start, rows.stop)
    for name, record in courses.items():
        if np.isnan(record.target).any():
            continue
        target, measured = record.target[rows, 0, 0], record.measured[rows, 0, 0]
        above.plot(t, measured, lw=0.9, label=name)
        below.plot(t, measured - target, lw=0.9)
        if name == "rodeac":
            above.plot(t, target, "k--", lw=1.2, label="its target", zorder=9)
    above.set_ylabel("measured [mm]")
    below.set(xlabel="time [s]", ylabel="error [mm]")
    figure.legend(loc="outside right upper", fontsize="small")
    return figure
