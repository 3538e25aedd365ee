"""Every compensation on one scenario, ranked: `hiltestbed rank`.

Each force method replaces that of the scenario; each motion method then that of the platform,
beside the best force method. All else stays: rig, mechanism, sensor, effects, noise, seed. A run is
compared with the scenario's reference (no delay, ideal tracking). Methods that need the contact are
given its true stiffness and damping. A second run has a delay that the method does not know, a
share :data:`UNKNOWN` of that of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from hiltestbed.bench.contenders import Briefing, contenders
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.build import runnable_from
from hiltestbed.compensation.settings import MOTION_METHODS
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.report.page import Report, new_figure
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.simulation import Batch, log_error, reference_scenario, simulate

UNKNOWN = 0.2  # of sensor.delay: that by which `bench cor` lets the known delay be wrong
HEADER = ("method", "knows", "ln(e/e_ref)", "20 % late", "energy [J]")
ERRORS = ("cor_log_error", "late")
RAN = ("completed", "diverged", "stopped")


@dataclass(frozen=True)
class RankedMethod:
    """A method on the scenario.

    Attributes:
        link: force or motion. method: its name. needs: what it is told. section: its keys.
        status: completed, diverged or stopped; or why the method cannot be used here.
        cor_log_error: ln(e/e_ref), of the first contact along its impulse where the run or its
            reference has no rebound along z; None without either. late: the same with the delay
            that is not known.
        energy: made by the rig [J]. peak_force: [N]. why: it did not complete.
    """

    link: str
    method: str
    needs: str
    section: dict[str, Any]
    status: str
    cor_log_error: float | None = None
    late: float | None = None
    energy: float | None = None
    peak_force: float | None = None
    why: str = ""

    @property
    def order(self) -> tuple[float, float, float]:
        """Smaller is better: first what completes, then the error, then the energy made."""
        error, energy = self.cor_log_error, self.energy
        return (
            float(self.status != "completed"),
            math.inf if error is None else abs(error),
            math.inf if energy is None else abs(energy),
        )


def rank(scenario: Scenario, progress: Progress = silent) -> BenchResult:
    """All methods on a scenario, best first; their records and the report.

    Raises:
        InputError: its bodies move freely, so that there is no loop to compensate. HiltestbedError:
            nothing touches.
    """
    if scenario.rig.platform.physical:
        raise InputError(
            f"rank: nothing to compensate on a platform of kind {scenario.rig.platform.kind} (its "
            f"bodies move freely, there is no loop); allowed is a platform that is commanded"
        )
    reference = simulate([reference_scenario(scenario)])
    if not reference.figures[0].contact_duration:
        raise HiltestbedError(
            f"rank: nothing touches in {scenario.name}; lengthen duration, or aim the approach"
        )
    known, own = _briefing(scenario), resolved(scenario)["compensation"]
    methods = [m for m in contenders() if not m.name.endswith("_off")]
    servo = not scenario.rig.platform.prescribed
    motions = [kind for kind in MOTION_METHODS if kind != own["motion"]["kind"]] if servo else []
    whole = float(len(methods) + len(motions))
    forces, others = [], []
    for done, method in enumerate(methods):
        needs = "delay, k, c" if method.contact == "known" else "delay"
        if method.name in ("none", "dead_zone"):
            needs = "nothing"
        section = {"force": method.force(known), "motion": own["motion"]}
        row = RankedMethod("force", method.name, needs, section, "completed")
        forces.append(_measured(scenario, reference, row))
        progress(done + 1.0, whole)
    forces.sort(key=lambda row: row.order)
    for done, kind in enumerate(motions):
        section = {"force": forces[0].section["force"], "motion": {"kind": kind}}
        row = RankedMethod("motion", kind, "", section, "completed")
        others.append(_measured(scenario, reference, row))
        progress(len(methods) + done + 1.0, whole)
    others.sort(key=lambda row: row.order)
    summary = {
        "name": scenario.name,
        "best": forces[0].method,
        "cor_reference": _rebounds(reference, reference)[1],
        "unknown_delay": UNKNOWN * scenario.sensor.delay,
        **known._asdict(),
    }
    records = [asdict(row) for row in (*forces, *others)]
    return BenchResult("rank", records, summary, _report(scenario, records, summary), command="")


def _briefing(scenario: Scenario) -> Briefing:
    stiffness, damping = acting_along_z(scenario.impact)
    mass = effective_mass(scenario.spacecraft)
    speed = math.dist(scenario.approach.velocity, (0.0, 0.0, 0.0))
    peak = speed * math.sqrt(stiffness * mass)
    return Briefing(stiffness, damping, peak, scenario.sensor.delay)


def _measured(scenario: Scenario, reference: Batch, row: RankedMethod) -> RankedMethod:
    """A method on the scenario, with the known delay and with a longer one."""
    data = resolved(scenario) | {"compensation": row.section}
    late = {"kind": "sensor.delay", "delay": UNKNOWN * scenario.sensor.delay}
    try:
        scenarios = [runnable_from(data)]
        if late["delay"] > 0.0:
            scenarios.append(runnable_from(data | {"effects": [*data["effects"], late]}))
        # each alone: what an effect adds to the structure need not be that of the other
        runs = [simulate([one]) for one in scenarios]
    except HiltestbedError as error:
        return replace(row, status=str(error).removeprefix("scenario: "))
    trouble, figures = runs[0].trouble.get(0), runs[0].figures[0]
    errors = [_error(run, reference) for run in runs]
    return replace(
        row,
        status="completed" if trouble is None else trouble[1],
        cor_log_error=errors[0],
        late=errors[-1],
        energy=figures.energy_generated,
        peak_force=figures.peak_force,
        why="" if trouble is None else f"t = {trouble[0] / scenario.rate:.4g} s: {trouble[2]}",
    )


def _rebounds(batch: Batch, reference: Batch) -> tuple[float | None, float | None]:
    """Both coefficients of restitution, of the same kind."""
    one, other = batch.figures[0], reference.figures[0]
    if one.cor is None or other.cor is None:
        return one.cor_normal, other.cor_normal
    return one.cor, other.cor


def _error(batch: Batch, reference: Batch) -> float | None:
    return None if 0 in batch.trouble else log_error(*_rebounds(batch, reference))


def table(records: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """The records of :func:`rank` that could run, as cells below :data:`HEADER`."""
    return [
        (
            ("motion " if record["link"] == "motion" else "") + record["method"],
            record["needs"].replace(",", ""),
            *(
                [f"{v:+.4f}" if (v := record[n]) is not None else "-" for n in ERRORS]
                if record["status"] == "completed"
                else [record["status"], ""]
            ),
            _cell(record["energy"]),
        )
        for record in records
        if record["status"] in RAN
    ]


def left_out(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Why a method could not run on this scenario to its end, one line each."""
    ended = [f"{r['method']}: {r['status']} at {r['why']}" for r in records if r["why"]]
    left = [f"{r['method']}: left out, {r['status']}" for r in records if r["status"] not in RAN]
    return ended + left


def _report(
    scenario: Scenario, records: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]
) -> Report:
    report = Report(f"Compensations on {scenario.name}")
    best = records[0]
    report.lead(
        f"{best['method']} reproduces the contact best: ln(e/e_ref) "
        f"{_cell(best['cor_log_error'])}, and {_cell(best['late'])} with "
        f"{1e3 * summary['unknown_delay']:.3g} ms of delay that it does not know."
    )
    report.table(
        HEADER,
        table(records),
        "Motion methods: beside the best force method. Reference: no delay, ideal tracking.",
    )
    for line in left_out(records):
        report.text(line)
    shown = [r for r in records if r["cor_log_error"] is not None]
    if shown:
        figure, axis = new_figure(8.0, 1.0 + 0.32 * len(shown))
        names = [f"{r['method']} ({r['link']})" for r in shown]
        for i, r in enumerate(shown):
            ends = [max(abs(r[name]), 1e-6) for name in ERRORS if r[name] is not None]
            known, longer = ("known delay", "20 % longer") if not i else (None, None)
            axis.plot(ends, [i] * len(ends), color="0.7", zorder=1)
            axis.scatter(ends[:1], [i], color="#0072b2", label=known)
            axis.scatter(ends[1:], [i] * len(ends[1:]), color="#d55e00", label=longer)
        axis.set(xscale="log", xlabel="|ln(e/e_ref)|", yticks=range(len(names)))
        axis.set_yticklabels(names)
        axis.invert_yaxis()
        axis.legend(loc="lower left", fontsize=8)
        report.figure(figure, "Error of the rebound with each method.")
    return report


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:+.3g}"
