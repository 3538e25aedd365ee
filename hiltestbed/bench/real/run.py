"""`hiltestbed bench real`: public records of real machines, each diagnosed unattended beside the
model that an expert fits to the same records.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.axis.diagnose import diagnose_axis
from hiltestbed.bench.real import DEVICES
from hiltestbed.bench.real.device import Array, AxisRecord, Device
from hiltestbed.bench.real.peer import sysid_of
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.errors import InputError
from hiltestbed.report.page import Report, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUICK = ("so101_base", "friction_damper_80lb", "ur10e_joint_6", "mr_damper_1A")
AS_GOOD = 1.05  # times the expert's residual, up to which the product counts as good as he
SHOWN = 4000  # rows of a record in a picture
MEASURED, NOMINAL, EXPERT, PRODUCT = "#1b2530", "#d1495b", "#e0a100", "#0b6e99"


def real(
    quick: bool = False,
    progress: Progress = silent,
    data: Path | None = None,
) -> BenchResult:
    """Every device whose records are below ``data``; the others are skipped, and said.

    Raises:
        InputError: no data folder, or it holds the records of no device.
    """
    if data is None or not data.is_dir():
        raise InputError(
            f"bench real: no such folder of records (got {data}); give the folder with --data: "
            f"docs/real-machines.md says which files of which public source belong in it"
        )
    wanted = [d for d in DEVICES if not quick or d.name in QUICK]
    present = [d for d in wanted if not d.absent(data)]
    if not present:
        first = wanted[0]
        raise InputError(
            f"bench real: {data} holds the records of no device; the first would be "
            f"{', '.join(first.absent(data))} from {first.source}"
        )
    records, pictures = [], []
    for number, device in enumerate(present):
        progress(number, len(present))
        record, figure = measured(device, data)
        records.append(record)
        pictures.append((device, figure))
    progress(len(present), len(present))
    skipped = [d.name for d in wanted if d not in present]
    ratios = [r["ratio"] for r in records]
    summary = {
        "devices": len(records),
        "skipped": skipped,
        "as_good_as_the_expert": sum(x <= AS_GOOD for x in ratios),
        "worst_ratio": max(ratios),
        "median_ratio": float(np.median(ratios)),
        "median_cpu": float(np.median([r["cpu"] for r in records])),
        "longest_cpu": max(r["cpu"] for r in records),
    }
    report = Report("Real machines")
    report.lead(
        f"Of {len(records)} machines, {summary['as_good_as_the_expert']} are predicted as well as "
        f"by an expert's model (within {100 * (AS_GOOD - 1):.0f} %) on records that neither saw; "
        f"the ratio is {summary['median_ratio']:.2f} in the median, {summary['worst_ratio']:.2f} "
        "at worst."
    )
    report.table(
        ("machine", "unit", "constant", "nominal", "expert", "peer", "product", "ratio", "CPU [s]",
         "verdict"),
        [
            (r["device"], r["unit"], *(f"{r[k]:.3g}" if k in r else "-" for k in ("constant",
             "nominal", "expert", "peer", "product")), f"{r['ratio']:.2f}", f"{r['cpu']:.0f}",
             r["verdict"])
            for r in records
        ],
        "rms on the left-out records, the geometric mean over them. The expert, the peer and the "
        "product were fitted to the same other records; the peer is mujoco.sysid, where its extras "
        "are installed and the machine is a drive.",
    )  # fmt: skip
    for record, (device, figure) in zip(records, pictures, strict=True):
        report.heading(device.title)
        report.text(f"Source: {device.source}. Licence: {device.licence}.")
        report.text(record["sentence"])
        report.figure(
            figure, f"{device.name}: a left-out record, and what each model leaves of it."
        )
    if skipped:
        report.text(f"Skipped, since their records are not in the folder: {', '.join(skipped)}.")
    lines = [
        (
            r["device"],
            f"{r['ratio']:.2f} times the expert's residual, {r['verdict']}: "
            f"{', '.join(r['causes']) or 'no cause'}",
        )
        for r in records
    ]
    if skipped:
        lines.append(("skipped", ", ".join(skipped)))
    return BenchResult("real", records, summary, report, lines)


def measured(device: Device, data: Path) -> tuple[dict[str, Any], Figure]:
    """The record of one device, and its picture."""
    runs = {r.name: r for r in device.records(data)}
    fit, out = [runs[n] for n in device.fit], [runs[n] for n in device.left_out]
    expert, peer = device.expert(fit), sysid_of(device, fit)
    start = time.process_time()
    found = diagnose_axis(device.loaded(fit))
    cpu = time.process_time() - start
    model, conclusion = found.model, found.conclusion
    if conclusion is None:
        raise InputError(f"bench real: {device.name}: {' '.join(found.remarks)}")
    with np.errstate(all="ignore"):
        there = model.of(out)
        product = there.predicted(conclusion.fit.of)
        nominal = there.predicted(conclusion.null.of)
    shown = [expert(r) for r in out]
    left = {
        "constant": [rms(r.y - np.mean(r.y)) for r in out],
        "nominal": [rms(r.y - p) for r, p in zip(out, nominal, strict=True)],
        "expert": [rms(r.y - p) for r, p in zip(out, shown, strict=True)],
        "product": [rms(r.y - p) for r, p in zip(out, product, strict=True)],
    }
    if peer is not None:
        left["peer"] = [rms(r.y - peer(r)) for r in out]
    record: dict[str, Any] = {
        "device": device.name,
        "title": device.title,
        "source": device.source,
        "licence": device.licence,
        "kind": device.kind,
        "files": list(device.files),
        "fitted": list(device.fit),
        "unit": device.units[1],
        "verdict": found.verdict,
        "causes": [c.effect for c in found.causes],
        "parameters": [c.to_json() for c in found.causes],
        "undetermined": [c.to_json() for c in found.undetermined],
        "sentence": found.sentence(),
        "nominal_numbers": dict(device.nominal),
        "published": dict(device.published),
        "left": None if found.remainder is None else found.remainder.to_json(),
        "left_out": {k: dict(zip(device.left_out, v, strict=True)) for k, v in left.items()},
        "cpu": cpu,
    }
    record |= {k: geometric(v) for k, v in left.items()}
    record["ratio"] = record["product"] / record["expert"]
    return record, picture(out[0], nominal[0], shown[0], product[0], device.units[1])


def rms(x: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(x * x)))


def geometric(values: Sequence[float]) -> float:
    """Geometric mean."""
    return math.exp(float(np.mean(np.log(np.maximum(values, 1e-300)))))


def picture(r: AxisRecord, nominal: Array, expert: Array, product: Array, unit: str) -> Figure:
    """A left-out record, and below what nominal, expert and product leave of it."""
    rows = slice(0, min(len(r.t), SHOWN))
    figure, (top, below) = new_figure(9.0, 4.2, nrows=2, ncols=1)
    top.plot(r.t[rows], r.y[rows], color=MEASURED, lw=2.2, alpha=0.35, label="measured")
    for name, p, color in (
        ("nominal", nominal, NOMINAL),
        ("expert", expert, EXPERT),
        ("diagnosis", product, PRODUCT),
    ):
        top.plot(r.t[rows], p[rows], color=color, lw=0.9, label=name)
        below.plot(r.t[rows], (r.y - p)[rows], color=color, lw=0.7)
    span = float(np.ptp(r.y[rows]))
    top.set_ylim(r.y[rows].min() - 0.2 * span, r.y[rows].max() + 0.2 * span)
    most = 4.0 * max(rms(r.y - product), rms(r.y - expert))
    below.set_ylim(-most, most)
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)
    top.set_title(r.name, loc="left", fontsize=8)
    top.set_ylabel(f"[{unit}]")
    below.set_ylabel(f"left [{unit}]")
    below.set_xlabel("time [s]")
    return figure
