"""The same contacts and the same docking on every facility: uncompensated, with the field's usual
compensation, and with the default.

A bounce of 500 kg on 2000 kg with a sensor delay of 2 ms, compared with the contact of both free
bodies; a probe that slides into its cone and is captured. Facilities with freely moving bodies run
both without compensation.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from hiltestbed.analysis.stability import measured_response, stability
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.bench.throughput import side_by_side
from hiltestbed.build import runnable_from
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.platform.build import facility_of
from hiltestbed.platform.facilities.measure import workspace
from hiltestbed.platform.kinds import PLATFORMS
from hiltestbed.report.page import Report, new_figure
from hiltestbed.scenario import Scenario, load_scenario, resolved
from hiltestbed.simulation import log_error, reference_scenario, simulate

RATIO = 0.05  # damping ratio of the contacts
STIFFNESS = (1.0e4, 5.0e4, 1.0e5)  # [N/m]: 0.8, 1.8, 2.5 Hz
LEAST = 1e-4  # smallest |ln(e/e_ref)| that is drawn
QUIET = {"sensor": {"delay": 0.002}, "identification.kind": "none"}
NONE = {"force": {"kind": "none"}, "motion": {"kind": "none"}}


def facilities(quick: bool = False, progress: Progress = silent) -> BenchResult:
    """Every facility with every compensation; ``quick``: one contact, no docking."""
    stiffness, entered = STIFFNESS[1:2] if quick else STIFFNESS, facilities_entered()
    records, rigs = [], []
    for done, (name, platform) in enumerate(entered.items()):
        progress(done, len(entered))
        contacts = [bounce(platform, k) for k in stiffness]
        records += [r | {"facility": name} for r in _bounces(contacts)]
        if not quick:
            records += [r | {"facility": name} for r in _dockings(platform)]
        rigs.append(_rig(name, contacts[0], 2 if quick else 6))
    progress(len(entered), len(entered))
    summary = {"rigs": rigs, "worst": _worst(records)}
    lines = [(f"{w['facility']}, {w['treatment']}", _line(w)) for w in summary["worst"]]
    return BenchResult("facilities", records, summary, facilities_report(records, summary), lines)


def facilities_entered() -> dict[str, dict[str, Any]]:
    """Name to `rig.platform`: every kind of platform, also of plugins, in its variants."""
    return {
        name: dict(settings)
        for platform in PLATFORMS.values()
        for name, settings in platform.contest().items()
    }


def bounce(platform: dict[str, Any], stiffness: float) -> Scenario:
    """A bumper of a stiffness [N/m] between two free bodies, within reach of every facility."""
    mass = effective_mass(load_scenario("18-stewart").spacecraft)
    keys = {
        "mechanism.contact.stiffness": stiffness,
        "mechanism.contact.damping": 2.0 * RATIO * math.sqrt(stiffness * mass),
        "rig.platform": platform,
        "approach.gap": 0.005,
        "duration": 2.0,
    }
    return load_scenario("18-stewart", set=keys | QUIET)


def docking(platform: dict[str, Any]) -> Scenario:
    """A probe that meets its cone 30 mm off the axis, in a plane in which all facilities move."""
    keys = {
        "rig.platform": platform,
        "approach.offset": [0.03, 0.0],
        "approach.attitude_deg": [0.0, 0.0, 0.0],
        "duration": 4.0,
    }
    return load_scenario("19-serial-arm", set=keys | QUIET)


def treated(
    scenario: Scenario, compensation: dict[str, Any], identification: str = "none"
) -> Scenario:
    """A scenario with another compensation."""
    changed = {"compensation": compensation, "identification": {"kind": identification}}
    return runnable_from(resolved(scenario) | changed)


def treatments(scenario: Scenario) -> dict[str, tuple[dict[str, Any], str]]:
    """Name to compensation and identification; of freely moving bodies only the uncompensated."""
    platform = scenario.rig.platform
    if platform.physical:
        return {"as it is": (NONE, "none")}
    contact = scenario.mechanism.contact
    judged = stability(treated(scenario, NONE | {"motion": {"kind": "feedforward"}}))
    lost = (
        contact.damping - judged["net_damping"]
        if judged
        else contact.stiffness * scenario.sensor.delay
    )
    method, cure = platform.cure(max(lost, 0.0))
    return {"uncompensated": (NONE, "none"), method: (cure, "none"), "default": ({}, "rls")}


def _bounces(contacts: list[Scenario]) -> list[dict[str, Any]]:
    """Records of the bounces; one batch per compensation."""
    references = simulate([reference_scenario(s) for s in contacts], until_parted=True).figures
    out = []
    given = [treatments(s) for s in contacts]
    for name in given[0]:
        runs = [treated(s, *t[name]) for s, t in zip(contacts, given, strict=True)]
        if runs[0].compensation.force.adds_force:
            runs = tuned(runs, [reference.cor for reference in references])
        start = time.perf_counter()
        batch = simulate(runs, until_parted=True)
        wall = time.perf_counter() - start
        for i, (run, figures, reference) in enumerate(
            zip(runs, batch.figures, references, strict=True)
        ):
            judged = stability(run)
            bare = judged and (judged if judged["stable"] is not None else judged["uncompensated"])
            limits = ("net_damping", "largest_delay", "largest_stiffness")
            out.append(
                {
                    "case": "bounce",
                    "treatment": name,
                    "stiffness": run.mechanism.contact.stiffness,
                    "cor": figures.cor,
                    "cor_reference": reference.cor,
                    "cor_log_error": log_error(figures.cor, reference.cor),
                    "peak_force_error": figures.peak_force / reference.peak_force - 1.0,
                    "energy_generated": figures.energy_generated,
                    **{name: bare[name] if bare else None for name in limits},
                    "status": batch.trouble.get(i, (0, "completed"))[1],
                    "passive": figures.cor is not None and figures.cor <= 1.0,
                    "wall": wall / len(runs),
                }
            )
    return out


def tuned(runs: list[Scenario], wanted: list[float | None]) -> list[Scenario]:
    """The same bounces with the virtual damper b tuned by one trial of each: ln e falls by pi/(2 m
    w) for each N s/m of it.

    The damping from the sinusoidal response is not exact: the damper also acts on a delayed pose,
    so that only b cos(phi) damps, and the half swing of a bounce has a transient, with no force at
    first and some after separation, of the order (w tau)^2.
    """
    trial = simulate(runs, until_parted=True)
    out = []
    for run, figures, cor in zip(runs, trial.figures, wanted, strict=True):
        settings = run.compensation.force.model_dump(mode="json")
        if figures.cor is not None and cor is not None:
            mass = effective_mass(run.spacecraft)
            each = math.pi / (2.0 * mass * math.sqrt(run.mechanism.contact.stiffness / mass))
            settings["damping"] = max(0.0, settings["damping"] + math.log(figures.cor / cor) / each)
        motion = run.compensation.motion.model_dump(mode="json")
        out.append(treated(run, {"force": settings, "motion": motion}))
    return out


def _dockings(platform: dict[str, Any]) -> list[dict[str, Any]]:
    """Records of the docking, compensated by default and not, with the reference's capture time."""
    scenario = docking(platform)
    reference = simulate([reference_scenario(scenario)]).outcomes[0]
    out = []
    for name, treatment in treatments(scenario).items():
        if name not in ("uncompensated", "default", "as it is"):
            continue
        batch = simulate([treated(scenario, *treatment)])
        outcome = batch.outcomes[0]
        out.append(
            {
                "case": "docking",
                "treatment": name,
                "outcome": outcome["outcome"],
                "captured_at": outcome["captured_at"],
                "captured_at_reference": reference["captured_at"],
                "peak_force": batch.figures[0].peak_force,
                "energy_generated": batch.figures[0].energy_generated,
                "status": batch.trouble.get(0, (0, "completed"))[1],
            }
        )
    return out


def _rig(name: str, scenario: Scenario, stretches: int) -> dict[str, Any]:
    """Characteristics of a facility: reach, response along the insertion, cost of a tick."""
    platform, facility = scenario.rig.platform, facility_of(scenario)
    cost = side_by_side(scenario, 16, 1, stretches)
    out = {"facility": name, "distorts": platform.distorts, "cost": cost["ratio"]}
    out["real_time_factor"] = cost["real_time_factor"]
    if platform.physical:
        return out | dict.fromkeys(("reach", "turn", "delay", "compliance"))
    reach = workspace(facility)
    response = measured_response(scenario)
    k = int(np.searchsorted(response.frequency, 2.0))
    return out | {
        "reach": min(min(-w.low, w.high) for w in reach[:3]),
        "turn": math.degrees(min(min(-w.low, w.high) for w in reach[3:])),
        "delay": float(-np.angle(response.follows[k]) / (2.0 * math.pi * response.frequency[k])),
        "compliance": float(response.yields[k].real),
    }


def _worst(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The largest errors over the contacts, for each facility and compensation."""
    grouped: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for r in records:
        if r["case"] == "bounce":
            grouped.setdefault((r["facility"], r["treatment"]), []).append(r)
    out = []
    for (facility, treatment), rows in grouped.items():
        known = {
            name: [r[name] for r in rows if r[name] is not None]
            for name in ("cor_log_error", "net_damping", "largest_delay")
        }
        errors = known.pop("cor_log_error")
        worst = {
            "facility": facility,
            "treatment": treatment,
            "lost": len(rows) - len(errors),
            "cor_log_error": max(map(abs, errors), default=None),
            "peak_force_error": max(abs(r["peak_force_error"]) for r in rows),
            "passive": all(r["passive"] for r in rows),
        }
        out.append(worst | {name: min(values, default=None) for name, values in known.items()})
    return out


def _line(w: dict[str, Any]) -> str:
    e = w["cor_log_error"]
    error = "no rebound" if e is None else f"|ln e/e_ref| <= {e:.4f}"
    active = "" if w["passive"] else ", active"
    return f"{error}, peak force error {100.0 * w['peak_force_error']:.1f} %{active}"


def facilities_report(records: list[dict[str, Any]], summary: dict[str, Any]) -> Report:
    """Results of the same contacts on each kind of rig, and characteristics of the rigs."""
    report = Report("Facilities")
    worst = summary["worst"]
    bare = [w for w in worst if w["treatment"] == "uncompensated" and not w["passive"]]
    report.lead(
        f"{len(bare)} of {sum(w['treatment'] == 'uncompensated' for w in worst)} driven facilities "
        "add energy to a contact without compensation; the rows below give the remaining errors "
        "with the field's usual compensation and with the default."
    )
    rows = []
    for w in worst:
        error, passive = f"{100.0 * w['peak_force_error']:.1f} %", "yes" if w["passive"] else "no"
        limits = _number(w["net_damping"], 0), _number(w["largest_delay"], 1, 1e3)
        first = w["facility"], w["treatment"], _number(w["cor_log_error"], 4)
        rows.append([*first, error, passive, *limits])
    report.table(
        ("facility", "compensation", "|ln(e/e_ref)|", "peak force error", "passive",
         "net damping [N s/m]", "largest delay [ms]"),
        rows,
        "Largest values over the contacts; for net damping and largest delay, the smallest. For a "
        "method that adds a force of its own "
        "these two are those of the loop without it. A dash: no rebound, or no loop.",
    )  # fmt: skip
    report.figure(
        _errors(worst),
        "Error of the coefficient of restitution, the largest over the contacts; hatched: active.",
    )
    report.heading("The rigs")
    rows = []
    for r in summary["rigs"]:
        size = r["facility"], _number(r["reach"], 2), _number(r["turn"], 0)
        gives = "-" if r["compliance"] is None else f"{r['compliance']:.2e}"
        pace = f"{r['cost']:.2f}", f"{r['real_time_factor']:.2f}"
        rows.append([*size, _number(r["delay"], 2, 1e3), gives, *pace])
    report.table(
        ("facility", "reach [m]", "rotation [deg]", "delay at 2 Hz [ms]", "compliance [m/N]",
         "tick / bare steps", "times real time"),
        rows,
        "Reach and rotation: the smallest over the axes, from home. Delay and compliance: measured "
        "along the insertion, with feed-forward. Cost of a tick with 16 runs on one thread.",
    )  # fmt: skip
    dockings = [r for r in records if r["case"] == "docking"]
    if dockings:
        report.heading("The same docking")
        report.table(
            ("facility", "compensation", "outcome", "captured at [s]", "without rig [s]",
             "energy generated [J]"),
            [
                [*(r[key] for key in ("facility", "treatment", "outcome")),
                 *(_number(r[key], 3) for key in ("captured_at", "captured_at_reference")),
                 f"{r['energy_generated']:.3g}"]
                for r in dockings
            ],
            "A probe 30 mm off the axis of its cone. The reference is the contact of the free "
            "bodies with six degrees of freedom.",
        )  # fmt: skip
    report.heading("What each kind distorts")
    for rig in summary["rigs"]:
        report.text(f"{rig['facility']}: {rig['distorts']}")
    return report


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def _errors(worst: list[dict[str, Any]]):
    """One group of bars per facility: uncompensated, the field's usual method, the default."""
    names = list(dict.fromkeys(w["facility"] for w in worst))
    figure, axes = new_figure(9.0, 3.8)
    colors = {"uncompensated": "0.55", "default": "C0", "as it is": "C2"}
    for x, name in enumerate(names):
        mine = [w for w in worst if w["facility"] == name]
        for k, w in enumerate(mine):
            at = x + (k - 0.5 * (len(mine) - 1)) * 0.26
            height = max(w["cor_log_error"] if w["cor_log_error"] is not None else 1.0, LEAST)
            color, hatch = colors.get(w["treatment"], "C1"), "" if w["passive"] else "//"
            axes.bar(at, height, 0.24, color=color, hatch=hatch, edgecolor="white")
    labels = ("uncompensated", "field's usual compensation", "default", "no loop")
    for label, color in zip(labels, ("0.55", "C1", "C0", "C2"), strict=True):
        axes.bar(np.nan, np.nan, color=color, label=label)
    axes.set_yscale("log")
    axes.set_ylim(0.6 * LEAST, 5.0)
    axes.set_xticks(
        range(len(names)), [n.replace(", ", "\n").replace("_", "\n") for n in names], fontsize=8
    )
    axes.set_ylabel("|ln(e/e_ref)|")
    axes.legend(ncols=4, fontsize=8)
    return figure
