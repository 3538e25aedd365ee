"""Runs and batches: the loop from the first tick to the last, the reference, the results."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from hiltestbed import plugins
from hiltestbed.analysis.ledger import delay_ledger, predicted_log_error
from hiltestbed.analysis.limits import verdict
from hiltestbed.analysis.metrics import ContactFigures
from hiltestbed.analysis.outcome import MovingParts
from hiltestbed.analysis.stability import stability
from hiltestbed.build import runnable
from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive
from hiltestbed.config.budget import refuse_beyond, run_budget
from hiltestbed.config.sense import warnings
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.resolution import converged, rate_for_comparison, sufficient_rate
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.touch import axis_truth, normal_truth
from hiltestbed.effects.log import LogParameters, stamp_late
from hiltestbed.errors import HiltestbedError
from hiltestbed.identification.least_squares import RecursiveLeastSquares
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.run_folder.result import Run
from hiltestbed.run_folder.versions import versions
from hiltestbed.scenario import Scenario, resolved, scenario_from, scenario_sha256
from hiltestbed.scenario.monitoring import ContactEstimate
from hiltestbed.signals import AXES, JOINT, Trace
from hiltestbed.supervision.snapshot import Snapshot, Snapshots

Progress = Callable[[int, int], None]
# makes an object that takes the rows of a loop instead of a Trace
MakeTrace = Callable[[Loop], Any]
PROGRESS_TICKS = 500
ESTIMATED = ("stiffness", "damping", "stiffness_sd", "damping_sd")


@dataclass
class Batch:
    """Raw results of the loop for ``n`` runs, before they are summarised."""

    scenarios: Sequence[Scenario]
    figures: list[ContactFigures]
    trouble: dict[int, tuple[int, str, str]]
    identification: list[dict[str, Any]]
    force_delay: list[dict[str, float] | None]
    outcomes: list[dict[str, Any]]
    payload: list[dict[str, float] | None]
    ticks: int
    wall: float
    trace: Trace | None = None
    failures: dict[int, Snapshot] = field(default_factory=dict)


def run(scenario: Scenario, progress: Progress | None = None, nthread: int = 1) -> Run:
    """Run one scenario, with its trace, its reference, and its stability in a contact."""
    done = run_batch([scenario], trace=True, progress=progress, nthread=nthread)[0]
    done.summary["stability"] = stability(done.scenario)
    return done


def run_batch(
    scenarios: Sequence[Scenario],
    *,
    trace: bool | MakeTrace = False,
    progress: Progress | None = None,
    nthread: int = 1,
) -> list[Run]:
    """Run scenarios of the same structure in lockstep, each with its reference: the same without
    delay and with ideal tracking.

    A run's result does not depend on the others in its batch. Raises InputError if the models of a
    scenario cannot run.
    """
    scenarios = [runnable(s) for s in scenarios]
    batch = simulate(scenarios, trace=trace, progress=progress, nthread=nthread)
    references = [reference_scenario(s) for s in scenarios]
    names = [scenario_sha256(reference) for reference in references]
    # scenarios that differ only in the rig share one
    different = dict(zip(names, references, strict=True))
    reference = simulate(list(different.values()), until_parted=True, nthread=nthread)
    found = {
        name: (figures, reference_fault(reference, k))
        for k, (name, figures) in enumerate(zip(different, reference.figures, strict=True))
    }
    remarks = _compared(different, {n: figures for n, (figures, _) in found.items()}, nthread)
    return [
        concluded(batch, *found[name], i, remarks.get(name, ())) for i, name in enumerate(names)
    ]


def _compared(
    references: Mapping[str, Scenario], found: Mapping[str, ContactFigures], nthread: int
) -> dict[str, tuple[str, ...]]:
    """Warnings on references, by name, whose rebound changes with half the physics step."""
    finer = {
        name: s.model_copy(update={"stated_physics_rate": rate})
        for name, s in references.items()
        if (rate := rate_for_comparison(s.impact, s.physics_rate))
    }
    if not finer:
        return {}
    halved = simulate(list(finer.values()), until_parted=True, nthread=nthread).figures
    out = {}
    for (name, scenario), figures in zip(finer.items(), halved, strict=True):
        if converged(found[name].cor, figures.cor):
            continue
        pair = found[name].cor, figures.cor
        before, after = ("none" if e is None else f"{e:.4g}" for e in pair)
        step = 1e3 / references[name].physics_rate
        enough = sufficient_rate(scenario.impact, scenario.rate)
        out[name] = (
            f"the physics step of {step:.3g} ms is too long for this contact: half of it changes "
            f"the coefficient of restitution of the reference from {before} to {after}; use a "
            f"physics_rate of {enough:g} Hz or leave it out",
        )
    return out


def simulate(
    scenarios: Sequence[Scenario],
    *,
    trace: bool | MakeTrace = False,
    until_parted: bool = False,
    progress: Progress | None = None,
    nthread: int = 1,
) -> Batch:
    """Run the loop to its end; ``until_parted`` ends it once every run's rebound speed is known."""
    ticks = max(s.ticks for s in scenarios)
    budget = run_budget(scenarios, rows=trace is True)
    refuse_beyond(
        replace(budget, time=0.0, disk=0.0),
        scenarios[0].name,
        "a shorter duration, a lower rate or shorter delays need less",
    )
    loop = Loop(scenarios, nthread)
    parts = MovingParts(loop.plant) if trace is True else None
    rows = (
        trace(loop)
        if callable(trace)
        else Trace(ticks, len(scenarios), scenarios[0].rate, loop.plant.units, parts.joints)
        if parts
        else None
    )
    snapshots = Snapshots(loop)
    start = 0.0
    while loop.k < ticks and loop.alive.any():
        snapshots.keep()
        if rows is not None and parts is not None and parts.joints:
            rows[JOINT.name][loop.k] = parts.positions()
        try:
            loop.step(rows)
        # a denominator is zero or has overflowed, with numbers far from those of any rig
        except ZeroDivisionError:
            if len(scenarios) > 1:
                raise HiltestbedError(
                    "a run of the batch divided by zero; run each alone to find out which"
                ) from None
            why = "a denominator reached zero or overflowed"
            loop.trouble[0] = (max(loop.k - 1, 0), "diverged", why)
            loop.alive[:] = False
        if rows is not None:
            rows.filled(loop.k)
        if loop.trouble:
            snapshots.failures()
        if loop.k == 1:  # the first tick may have compiled the blocks and is not timed
            start = time.perf_counter()
            if progress:
                progress(1, ticks)
        if loop.k % PROGRESS_TICKS == 0:
            if progress:
                progress(loop.k, ticks)
            if until_parted and loop.tally.parted(loop.alive):
                break
    wall = time.perf_counter() - start
    if progress:
        progress(loop.k, ticks)
    if rows is not None:
        rows.length[:] = loop.k
        if isinstance(rows, Trace):
            skews = [LogParameters().with_effects(s.effects).skew for s in scenarios]
            stamp_late(rows, scenarios[0].rate, skews)
        for i, (k, *_) in loop.trouble.items():
            rows.length[i] = k + 1
    return collected(loop, rows, wall, snapshots.failures())


def collected(loop: Loop, rows: Any, wall: float, failures: dict[int, Snapshot]) -> Batch:
    """The raw results of ``loop``, with ``rows`` and the wall time ``wall`` [s]."""
    scenarios = loop.scenarios
    outcomes, runs = loop.outcomes, range(len(scenarios))
    return Batch(
        scenarios=scenarios,
        figures=[loop.tally.figures(i) for i in runs],
        trouble=loop.trouble,
        identification=[_identified(loop, i) for i in runs],
        force_delay=[_force_delay(loop, i) for i in runs],
        outcomes=[
            outcomes.summary(i) | _capture(loop, i) | _along_normal(loop, i) | _monitored(loop, i)
            for i in runs
        ],
        payload=[loop.plant.payload_left(i) for i in runs],
        ticks=loop.k,
        wall=wall,
        trace=rows,
        failures=failures,
    )


def reference_scenario(scenario: Scenario) -> Scenario:
    """The same contact between the same bodies with an ideal rig: no sensor, no compensation, ideal
    tracking.

    Effects of the contact itself are kept; those of the rig, the sensor and the numerical model are
    removed.
    """
    data = resolved(scenario) | {"name": "reference", "description": "", "seed": 0}
    data["sensor"] = {}
    data["compensation"] = {"force": {"kind": "none"}, "motion": {"kind": "none"}}
    data["identification"] = {"kind": "none"}
    data["safety"] = dict.fromkeys(data["safety"])  # no limits
    data["monitoring"] = None
    data["rig"]["platform"] = scenario.rig.platform.reference()
    data["rig"]["upper"]["tracking"] = "ideal"
    data["effects"] = [e for e in data["effects"] if e["kind"].startswith("contact.")]
    return scenario_from(data)


def reference_fault(batch: Batch, i: int) -> str | None:
    """Why run ``i`` of a ``batch`` of references is none: it diverged, or its contact made energy
    though nothing in the mechanism can; None: it is one.
    """
    figures, mechanism = batch.figures[i], batch.scenarios[i].mechanism
    if i in batch.trouble:
        tick, status, why = batch.trouble[i]
        return f"the reference {status} at t = {tick / batch.scenarios[i].rate:.6f} s: {why}"
    if not figures.energy_made or sides_of(mechanism).releases:
        return None
    cor = figures.cor_normal if figures.cor is None else figures.cor
    return (
        f"the reference, an ideal rig without delay, makes {figures.energy_made:.3g} J in its "
        f"first contact (coefficient of restitution {cor:.4g}), which a passive mechanism cannot: "
        f"no figure of this run can be trusted; raise rate and physics_rate, and look at the law "
        f"and the geometry of the contact"
    )


def _identified(loop: Loop, i: int) -> dict[str, Any]:
    """Per axis: estimates and their sd, None without one, and true values where defined."""
    scenario, plant, estimate = loop.scenarios[i], loop.plant, loop.identification
    held = plant.held_pair(i)
    truth = (
        axis_truth(scenario.impact, bool(plant.captured[i]))
        if held is None
        else [(float(held[0][j, j]), float(held[1][j, j])) for j in range(len(AXES))]
    )
    # a ball joint rotates freely: a fit on its rotations would only give the arm of its force
    identifiable = len(AXES)
    if plant.phases is not None:
        begun = scenario.mechanism.phases()[: int(plant.phases.begun[i])]
        if not any(p.close is not None and p.close.kind == "weld" for p in begun):
            identifiable = 3
    # not every method states how sure it is
    values = {name: getattr(estimate, name, None) for name in ESTIMATED}
    out = {}
    for j, axis in enumerate(AXES):
        known = {
            name: None if value is None or j >= identifiable else _number(value[i, j])
            for name, value in values.items()
        }
        pair = truth[j] or (None, None)
        out[axis] = known | {
            "stiffness_true": pair[0],
            "damping_true": pair[1],
            "samples": int(estimate.samples[i, j]) if estimate else 0,
        }
    return out


def _force_delay(loop: Loop, i: int) -> dict[str, float] | None:
    """[s] nominal, estimated, half width of its interval; None if it is not estimated."""
    drive = loop.drive
    if not isinstance(drive, ResynchronisedDrive):
        return None
    return {
        "told": loop.scenarios[i].sensor.delay,
        "estimated": float(drive.delay[i]),
        "half_width": float(drive.delay_half_width[i]),
    }


def _along_normal(loop: Loop, i: int) -> dict[str, Any]:
    """The values along the contact normal before latching, for surfaces that are no plane."""
    estimate, mechanism = loop.identification, loop.scenarios[i].mechanism
    if not isinstance(estimate, RecursiveLeastSquares) or mechanism.flat or mechanism.captured:
        return {}
    *known, samples = (_number(v) for v in estimate.along_normal[i])
    truth = normal_truth(loop.scenarios[i].impact, int(estimate.source.at_once[i])) or (None, None)
    found = dict(zip(ESTIMATED, known, strict=True)) | {"samples": int(samples or 0)}
    return {"identification_normal": found | {"stiffness_true": truth[0], "damping_true": truth[1]}}


def _capture(loop: Loop, i: int) -> dict[str, Any]:
    """The beginning [s] of each phase, or None; what the legs of an active ring did."""
    phases, rate = loop.plant.phases, loop.scenarios[i].rate
    if phases is None:
        return {}
    since = zip(phases.names, map(int, phases.since[i]), strict=True)
    legs = phases.legs
    return {
        "phases": [{"name": name, "at": k / rate if k >= 0 else None} for name, k in since],
        **({} if legs is None else {"active_ring": legs.summary(i)}),
    }


def _monitored(loop: Loop, i: int) -> dict[str, Any]:
    """Result of process monitoring, if requested; wear by what was identified along z."""
    if loop.monitor is None or loop.scenarios[i].monitoring is None:
        return {}
    estimate, contact = loop.identification, None
    if isinstance(estimate, RecursiveLeastSquares):
        found = {name: float(getattr(estimate, name)[i, 2]) for name in ESTIMATED}
        damping = found.pop("damping")
        if damping >= 0.0 and all(value > 0.0 for value in found.values()):
            contact = ContactEstimate(damping=damping, **found)
    return {"monitoring": loop.monitor.summary(i, contact)}


def _number(value: float) -> float | None:
    return None if not math.isfinite(value) else float(value)


def concluded(
    batch: Batch,
    reference: ContactFigures | None,
    reference_fault: str | None,
    i: int,
    remarks: Sequence[str] = (),
) -> Run:
    """Run ``i`` of a batch with its summary; ``reference``: figures of the same contact with an
    ideal rig, and why it is no reference, see :func:`reference_fault`; ``remarks``: warnings on it.
    """
    scenario, figures = batch.scenarios[i], batch.figures[i]
    cor, along = figures.cor, figures.cor_normal
    cor_reference = reference.cor if reference else None
    along_reference = reference.cor_normal if reference else None
    ledger = delay_ledger(scenario, figures)
    status, stop_reason = "completed", None
    if (trouble := batch.trouble.get(i)) is not None:
        status = trouble[1]
        stop_reason = f"tick {trouble[0]}, t = {trouble[0] / scenario.rate:.6f} s: {trouble[2]}"
    elif reference_fault is not None:
        status, stop_reason = "no_reference", reference_fault
    wall, speed, mass = batch.wall, figures.approach_speed, effective_mass(scenario.spacecraft)
    simulated = (batch.ticks - 1) / scenario.rate * len(batch.scenarios)
    summary = {
        "name": scenario.name,
        "scenario_sha256": scenario_sha256(scenario),
        "seed": scenario.seed,
        "versions": versions(),
        "plugins": plugins.loaded(),
        "status": status,
        "stop_reason": stop_reason,
        "cor": cor,
        "cor_reference": cor_reference,
        "cor_log_error": log_error(cor, cor_reference),
        "cor_normal": along,
        "cor_normal_reference": along_reference,
        "cor_normal_log_error": log_error(along, along_reference),
        "cor_log_error_predicted": predicted_log_error(scenario, ledger),
        "approach_speed": speed,
        "approach_energy": None if speed is None else 0.5 * mass * speed**2,
        "rebound_speed": figures.rebound_speed,
        "energy_generated": figures.energy_generated,
        "energy_reference": _energy_reference(scenario, figures),
        "energy_resolution": 0.5
        * scenario.tick
        * acting_along_z(scenario.impact)[1]
        * _speed(scenario) ** 2
        * max(figures.contacts, 1),
        "peak_force": figures.peak_force,
        "contact_duration": figures.contact_duration,
        "contacts": figures.contacts,
        "first_contact": figures.first_contact,
        "impulse": figures.impulse,
        "tracking_error": figures.tracking_error,
        "tracking_compliance": figures.tracking_compliance,
        "payload_left": batch.payload[i],
        **batch.outcomes[i],
        **verdict(scenario.limits, batch.outcomes[i]["interface"]),
        "warnings": [*warnings(scenario), *remarks],
        "delay_ledger": [vars(entry) for entry in ledger],
        "identification": batch.identification[i],
        "force_delay": batch.force_delay[i],
        "timing": {
            "ticks": batch.ticks,
            "wall": wall,
            "real_time_factor": simulated / wall if wall > 0.0 and simulated > 0.0 else None,
        },
    }
    trace = batch.trace.run(i) if batch.trace is not None else None
    return Run(scenario, summary, trace, batch.failures.get(i))


def _speed(scenario: Scenario) -> float:
    """Speed of A's origin relative to P before the contact [m/s]."""
    return math.dist(scenario.approach.velocity, (0.0, 0.0, 0.0))


def _energy_reference(scenario: Scenario, figures: ContactFigures) -> float | None:
    """[J] kinetic energy of the approach or, of contacts that begin at rest, of the spring at the
    peak force, F^2/(2 k); None if nothing touched.
    """
    if not figures.contact_duration:
        return None
    mass, speed = effective_mass(scenario.spacecraft), _speed(scenario)
    if scenario.mechanism.captured:
        stored = figures.peak_force**2 / (2.0 * acting_along_z(scenario.impact)[0])
        return max(stored, 0.5 * mass * speed**2)
    return 0.5 * mass * max(speed, figures.approach_speed or 0.0) ** 2


def log_error(cor: float | None, reference: float | None) -> float | None:
    """``ln(e/e_ref)``, which is additive over bounces; None without a rebound."""
    if cor is None or reference is None or cor <= 0.0 or reference <= 0.0:
        return None
    return math.log(cor / reference)
