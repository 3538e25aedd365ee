"""Measured characteristics of a rig, with drawings: workspace, bandwidth and delay in six axes,
modes, dynamic stiffness.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.platform.build import facility_of
from hiltestbed.platform.facilities.measure import (
    FrequencyResponse,
    Mode,
    Reach,
    dynamic_stiffness,
    frequency_response,
    modes,
    workspace,
)
from hiltestbed.platform.facilities.stand import Stand
from hiltestbed.report.page import Report, new_figure
from hiltestbed.run_folder.store import whole_folder
from hiltestbed.run_folder.versions import versions
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import AXES

RIG, REPORT = "rig.json", "report.html"
SLOWEST, FASTEST = 1.0, 100.0  # [Hz] of the sines
POINTS = 10
UNITS, SHOWN = ("m",) * 3 + ("rad",) * 3, ("m",) * 3 + ("deg",) * 3
Progress = Callable[[int, int], None]


@dataclass
class RigFigures:
    """Measurements of a rig; only the frequency response includes the drives' friction."""

    scenario: Scenario
    reach: tuple[Reach, ...]
    response: FrequencyResponse
    modes: tuple[Mode, ...]
    frequency: Array
    stiffness: NDArray[np.complex128]

    def to_json(self) -> dict[str, Any]:
        """The contents of rig.json."""
        s, r = self.scenario, self.response
        bands = [r.bandwidth(k) for k in range(6)]
        return {
            "name": s.name,
            "platform": resolved(s)["rig"]["platform"],
            "rate": s.rate,
            "feed_forward": bool(s.compensation.motion.feeds),
            "versions": versions(),
            "workspace": [
                {"axis": w.axis, "low": w.low, "high": w.high, "unit": unit, "stops": list(w.stops)}
                for w, unit in zip(self.reach, UNITS, strict=True)
            ],
            "bandwidth": {
                a: b if math.isfinite(b) else None for a, b in zip(AXES, bands, strict=True)
            },
            "delay": {a: r.delay(k) for k, a in enumerate(AXES)},
            "frequency_response": {
                "frequency": r.frequency.tolist(),
                "gain_db": _by_axis(r.gain_db()),
                "phase_deg": _by_axis(r.phase_deg()),
                "cross": _by_axis(r.cross),
            },
            "modes": [asdict(m) | {"shape": m.shape.tolist()} for m in self.modes],
            "dynamic_stiffness": {
                "frequency": self.frequency.tolist(),
                "magnitude": _by_axis(np.abs(self.stiffness)),
                "phase_deg": _by_axis(np.degrees(np.angle(self.stiffness))),
            },
        }

    def lines(self) -> list[tuple[str, str]]:
        """The figures in a few lines."""
        r, platform, out = self.response, self.scenario.rig.platform, []
        if platform.prescribed:
            unused = f"with tracking {platform.tracking} a run does not use them"
            out.append(("these are the drives", unused))
        for w, unit in zip(self.reach, SHOWN, strict=True):
            low, high = _shown(w, unit)
            out.append((f"reach {w.axis}", f"{low:.4g} to {high:.4g} {unit}"))
        bands = [r.bandwidth(k) for k in range(6)]
        most = f"> {r.frequency[-1]:.0f}"
        shown = ", ".join(f"{b:.1f}" if math.isfinite(b) else most for b in bands)
        out.append(("bandwidth x, y, z, rx, ry, rz", f"{shown} Hz"))
        out.append((f"delay along z at {r.frequency[0]:g} Hz", f"{1e3 * r.delay(2):.2f} ms"))
        first = "none found"
        if self.modes:
            m = self.modes[0]
            first = f"{m.frequency:.1f} Hz, damping ratio {m.damping_ratio:.2f}, {m.motion}"
        out.append(("first mode", first))
        along_z = f"{abs(self.stiffness[2, 0]):.3g} N/m"
        out.append((f"stiffness along z at {self.frequency[0]:g} Hz", along_z))
        return out


def measure_rig(scenario: Scenario, progress: Progress | None = None) -> RigFigures:
    """Measure the rig of a scenario, with its mechanism and its feed-forward.

    Raises:
        InputError: the rig has no drives.
    """
    facility = facility_of(scenario)
    if scenario.rig.platform.physical:
        raise InputError(
            f"rig.platform.kind {facility.kind}: drives nothing, its bodies move freely; only a "
            f"driven rig can be measured"
        )
    stands = partial(
        Stand,
        facility,
        rate=scenario.rate,
        substeps=scenario.substeps,
        mechanism=scenario.mechanism,
    )
    fed = partial(stands, feed=bool(scenario.compensation.motion.feeds))
    f = np.geomspace(SLOWEST, min(FASTEST, 0.05 * scenario.rate), POINTS).tolist()
    found: list[Any] = []
    work = (
        lambda: workspace(facility),
        lambda: frequency_response(fed, f),
        lambda: modes(fed),
        lambda: dynamic_stiffness(stands, f[::2]),
    )
    for done, measure in enumerate(work):
        if progress:
            progress(done, len(work))
        found.append(measure())
    if progress:
        progress(len(work), len(work))
    return RigFigures(scenario, found[0], found[1], found[2], np.array(f[::2]), found[3])


def write_rig(figures: RigFigures, path: str | Path) -> Path:
    """Write rig.json, report.html and the drawings, and return the folder.

    Raises:
        InputError: the folder cannot be written, or has other contents.
    """
    path = Path(path)
    with whole_folder(path, mark=RIG) as folder:
        (folder / RIG).write_text(
            json.dumps(figures.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8"
        )
        report = Report(f"Rig of {figures.scenario.name}: {figures.scenario.rig.platform.kind}")
        report.table(["figure", "value"], figures.lines())
        for name, (draw, caption) in DRAWINGS.items():
            figure = draw(figures)
            figure.savefig(
                folder / f"{name}.png", dpi=110, bbox_inches="tight", metadata={"Software": None}
            )
            report.figure(figure, caption)
        report.heading("Modes")
        rows = [[f"{m.frequency:.2f}", f"{m.damping_ratio:.3f}", m.motion] for m in figures.modes]
        report.table(
            ["frequency [Hz]", "damping ratio", "motion of A"],
            rows,
            "With the drives active and a constant command, without friction.",
        )
        report.heading("Limits of the workspace")
        stops = [[w.axis, *(s or "not searched further" for s in w.stops)] for w in figures.reach]
        report.table(["axis", "below", "above"], stops)
        report.write(folder / REPORT)
    return path


def _workspace(figures: RigFigures):
    figure, axes = new_figure(8.0, 3.2, ncols=2)
    halves = (axes[0], "m", figures.reach[:3]), (axes[1], "deg", figures.reach[3:])
    for panel, unit, reach in halves:
        low, high = np.array([_shown(w, unit) for w in reach]).T
        bars = panel.barh([w.axis for w in reach], high - low, left=low, height=0.5, alpha=0.5)
        ends = [f"{a:.3g} to {b:.3g}" for a, b in zip(low, high, strict=True)]
        panel.bar_label(bars, ends, label_type="center", fontsize=9)
        panel.invert_yaxis()
        panel.use_sticky_edges = False
        panel.axvline(0.0, color="0.4", lw=0.8)
        panel.set_xlabel(f"reach from home [{unit}]")
    return figure


def _response(figures: RigFigures):
    figure, (gain, phase) = new_figure(8.0, 5.0, nrows=2, sharex=True)
    r = figures.response
    for k, axis in enumerate(AXES):
        style = {
            "color": f"C{k % 3}",
            "ls": "-" if k < 3 else ":",
            "marker": "o",
            "ms": 3,
            "label": axis,
        }
        gain.semilogx(r.frequency, r.gain_db()[k], **style)
        phase.semilogx(r.frequency, r.phase_deg()[k], **style)
    gain.axhline(-3.0, color="0.5", ls="--", lw=0.8)
    phase.axhline(-90.0, color="0.5", ls="--", lw=0.8)
    gain.set_ylabel("gain [dB]")
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
    gain.legend(ncols=6, fontsize=8)
    return figure


def _stiffness(figures: RigFigures):
    figure, panels = new_figure(8.0, 3.2, ncols=2)
    for k, axis in enumerate(AXES):
        panels[k // 3].loglog(
            figures.frequency,
            np.abs(figures.stiffness[k]),
            "o-",
            ms=3,
            color=f"C{k % 3}",
            label=axis,
        )
    for panel, unit in zip(panels, ("N/m", "N m/rad"), strict=True):
        panel.set(xlabel="frequency [Hz]", ylabel=f"|stiffness| [{unit}]")
        panel.legend(fontsize=8)
    return figure


DRAWINGS = {
    "workspace": (
        _workspace,
        "Reach from home, one axis at a time, limited by joint travel, singularities and reach.",
    ),
    "response": (
        _response,
        "Ratio of reached to commanded pose of A, axis by axis; dashed: -3 dB and -90 degrees.",
    ),
    "stiffness": (
        _stiffness,
        "Dynamic stiffness at A with a constant command; where it drops, at a mode, contact and "
        "rig exchange energy.",
    ),
}


def _shown(reach: Reach, unit: str) -> tuple[float, float]:
    scale = math.degrees(1.0) if unit == "deg" else 1.0
    return reach.low * scale, reach.high * scale


def _by_axis(rows: Array) -> dict[str, list[float]]:
    return dict(zip(AXES, rows.tolist(), strict=True))
