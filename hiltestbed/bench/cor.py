"""The coefficient of restitution achieved with each compensation, over contact frequency, delay and
damping ratio.

Every method is applied to the same contacts: a first contact about which it knows nothing, or a
contact identified before; a delay known exactly, off by 20 % or with jitter; ideal tracking or the
platform's servo; 0.2 % of the peak force as noise. The reference is the same contact with no delay
and perfect tracking. Random rigs, with off-axis hits, sliding and friction, give mean, standard
deviation and maximum, as reported by the benchmark of real-time hybrid simulation (C. E. Silva et
al., MSSP 135, 2020).
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from hiltestbed.bench.contacts import (
    DELAYS,
    FREQUENCIES,
    BenchContact,
    BenchRuns,
    bounce,
    effective_contact,
    effort,
    grid,
    random_rigs,
)
from hiltestbed.bench.contenders import BEST, CONTENDERS, Contender, contenders
from hiltestbed.bench.cor_report import cor_report
from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.errors import HiltestbedError
from hiltestbed.loop import Loop
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import log_error, reference_scenario

T = TypeVar("T")
COST_RUNS, COST_TICKS = 64, 300  # the touch is at tick 60, its delayed force arrives at tick 100
REPORT = 4.0  # effort of the report's figures
BOUNDARY = ("none", "phase_lead", BEST)
RANDOM_METHODS = ("none", "phase_lead", "reconstruction", BEST)


def cor(quick: bool = False, progress: Progress = silent) -> BenchResult:
    """All methods on the whole grid; ``quick``: on its corners."""
    contacts = grid((2.0, 8.0), (0.005, 0.020), damping_ratios=(0.05,)) if quick else grid()
    methods = contenders()
    jobs = [(c, m) for c in _conditions(quick) for m in methods if _takes_part(m, c, quick)]
    rigs, points = random_rigs(8 if quick else 64, seed=11), 6 if quick else 12
    random_methods = [
        m for m in methods if m.own or (m.name in RANDOM_METHODS and m.contact == "first")
    ]
    under = {
        (tracking, known): [replace(c, tracking=tracking, delay_knowledge=known) for c in contacts]
        for tracking, known in _conditions(quick)
    }
    ideal_rigs = [replace(rig, tracking="ideal") for rig in rigs]
    random_effort = effort(rigs) + effort(ideal_rigs)
    boundary_effort = len(BOUNDARY) * effort(_boundary(points))
    ticks = COST_TICKS // (2 if quick else 1)
    cost_effort = effort(_costly(), ticks)
    whole = effort(contacts) + sum(effort(under[condition]) for condition, _ in jobs)
    whole += len(random_methods) * random_effort + boundary_effort
    whole += len(methods) * cost_effort + REPORT
    done = 0.0

    def step(work: float) -> None:
        nonlocal done
        done += work
        progress(min(done, whole), whole)

    reference = bounce([reference_scenario(c.scenario({"kind": "none"})) for c in contacts])
    step(effort(contacts))
    records: list[dict[str, Any]] = []
    random_records: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for condition, contender in jobs:
        found = _unless_failed(failed, contender, measure, under[condition], reference)
        records += found or []
        step(effort(under[condition]))
    for contender in random_methods:
        random_records += _unless_failed(failed, contender, measure_random, rigs) or []
        step(random_effort)
    boundary = stability_boundary(points)
    step(boundary_effort)
    costs = {}
    for m in methods:
        costs[m.name, m.contact] = _unless_failed(failed, m, cost, ticks)
        step(cost_effort)
    records = [r for r in records if r["method"] not in failed]
    random_records = [r for r in random_records if r["method"] not in failed]
    board = leaderboard(records, costs)
    summary = {
        "leaderboard": board,
        "random_rigs": statistics_of(random_records),
        "boundary": boundary,
        "best": BEST,
        "failed": failed,
    }
    lines = [
        (f"{row['method']} ({row['contact']} contact)", f"|ln e/e_ref| <= {error:.4f}")
        for row in board
        if (error := row["largest_log_error"]) is not None
    ]
    report = cor_report(records, summary)
    step(REPORT)
    return BenchResult("cor", records + random_records, summary, report, lines, failed)


def _unless_failed(
    failed: dict[str, str], contender: Contender, measured: Callable[..., T], *more: Any
) -> T | None:
    """Result of ``measured``; None if a user's method raises, with the reason in ``failed``."""
    if contender.name in failed:
        return None
    try:
        return measured(contender, *more)
    except HiltestbedError as error:
        if not contender.own:
            raise
        failed[contender.name] = str(error)
        return None


def _conditions(quick: bool) -> list[tuple[str, str]]:
    """(tracking, delay knowledge)."""
    return [("ideal", "exact"), ("ideal", "off"), ("servo", "exact")] + (
        [] if quick else [("ideal", "jitter")]
    )


def _takes_part(contender: Contender, condition: tuple[str, str], quick: bool) -> bool:
    """Quick: every method under ideal conditions, the leading and the user's under others too."""
    leads = contender.own or contender.name.startswith((BEST, "phase_lead"))
    return not quick or leads or condition == ("ideal", "exact")


def measure(
    contender: Contender, contacts: Sequence[BenchContact], reference: BenchRuns
) -> list[dict[str, Any]]:
    """One record per contact."""
    servo = contacts[0].tracking == "servo"
    result = bounce(_scenarios(contender, contacts), trace=servo)
    return [
        _record(contender, c, result, reference, i) | (_tracking(result, i) if servo else {})
        for i, c in enumerate(contacts)
    ]


def _scenarios(contender: Contender, contacts: Sequence[BenchContact]) -> list[Scenario]:
    return [c.scenario(contender.force(c.briefing)) for c in contacts]


def _record(
    contender: Contender, contact: BenchContact, result: BenchRuns, reference: BenchRuns, i: int
) -> dict[str, Any]:
    figures, ideal = result.figures[i], reference.figures[i]
    return {
        "method": contender.name,
        "frequency": contact.frequency,
        "delay": contact.delay,
        "damping_ratio": contact.damping_ratio,
        "contact": contender.contact,
        "delay_knowledge": contact.delay_knowledge,
        "tracking": contact.tracking,
        "cor": figures.cor,
        "cor_reference": ideal.cor,
        "cor_log_error": log_error(figures.cor, ideal.cor),
        "energy_generated": figures.energy_generated,
        "energy_of_approach": 0.5 * contact.mass * contact.speed**2,
        "peak_force_error": figures.peak_force / ideal.peak_force - 1.0,
        "stable": figures.cor is not None and figures.cor <= 1.0,
        "w_tau": contact.w * contact.delay,
    }


def _tracking(result: BenchRuns, i: int) -> dict[str, float]:
    """J1 delay by cross-correlation [ms], J2 rms error over rms [%], J3 peak error over peak [%] of
    the position along z in contact.
    """
    trace = result.trace
    if trace is None:
        return {}
    contact = trace.contact[: trace.length[i], i]
    if not contact.any():
        return {}
    first, last = int(np.argmax(contact)), len(contact) - int(np.argmax(contact[::-1]))
    wanted = trace["pose_cmd"][first - 1 : last - 1, i, 2]  # commanded at t_k for t_(k+1)
    reached = trace["pose_act"][first:last, i, 2]
    lags = range(-2, min(60, len(wanted) // 3))
    size = len(wanted)
    products = [
        float(np.dot(wanted[max(0, -n) : size - max(0, n)], reached[max(0, n) : size + min(0, n)]))
        for n in lags
    ]
    error = wanted - reached
    return {
        "J1": 1e3 * lags[int(np.argmax(products))] * result.loop.model.tick,
        "J2": 100.0 * float(np.sqrt(np.mean(error**2) / np.mean(wanted**2))),
        "J3": 100.0 * float(np.abs(error).max() / np.abs(wanted).max()),
    }


def measure_random(contender: Contender, rigs: Sequence[BenchContact]) -> list[dict[str, Any]]:
    """One record per rig; ``twist_error``: relative error of a body's change of velocity, linear or
    angular, the larger of both bodies'.
    """
    scenarios = _scenarios(contender, rigs)
    result = bounce(scenarios)
    reference = bounce([reference_scenario(s) for s in scenarios])
    shape = (-1, 2, 2, 3)  # rig, body, linear or angular, axis
    change = np.linalg.norm((reference.velocity - reference.start).reshape(shape), axis=3)
    error = np.linalg.norm((result.velocity - reference.velocity).reshape(shape), axis=3)
    worst = (error / change).max(axis=(1, 2))
    return [
        _record(contender, rig, result, reference, i)
        | {
            "random_rig": i,
            "w_tau": effective_contact(rig),
            "twist_error": float(worst[i]) if np.isfinite(worst[i]) else None,
        }
        for i, rig in enumerate(rigs)
    ]


def statistics_of(records: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Method to mean, sd and max of |ln e/e_ref| and of the twist error over the random rigs, and
    the number that rebounded in time.
    """
    out = {}
    for name in dict.fromkeys(r["method"] for r in records):
        mine = [r for r in records if r["method"] == name]
        out[name] = {
            "rigs": len(mine),
            "rebounded": sum(r["cor_log_error"] is not None for r in mine),
        }
        for key in ("cor_log_error", "twist_error"):
            values = [abs(r[key]) for r in mine if r[key] is not None]
            if values:
                out[name][key] = {
                    "mean": statistics.fmean(values),
                    "sd": statistics.pstdev(values),
                    "max": max(values),
                }
    return out


def stability_boundary(points: int) -> dict[str, Any]:
    """e over a fine grid of frequency and delay, for the methods in :data:`BOUNDARY`, at a damping
    ratio of 0.05.
    """
    contacts = _boundary(points)
    frequencies, delays = (
        list(dict.fromkeys(getattr(c, key) for c in contacts)) for key in ("frequency", "delay")
    )
    out: dict[str, Any] = {"frequency": frequencies, "delay": delays, "damping_ratio": 0.05}
    for name in BOUNDARY:
        contender = next(m for m in CONTENDERS if m.name == name and m.contact == "first")
        figures = bounce(_scenarios(contender, contacts)).figures
        cor = np.array([np.nan if f.cor is None else f.cor for f in figures])
        out[name] = cor.reshape(points, points).tolist()
    return out


def _boundary(points: int) -> list[BenchContact]:
    """The contacts of the fine grid, frequency by frequency."""
    frequencies = np.geomspace(FREQUENCIES[0], FREQUENCIES[-1], points)
    delays = np.geomspace(0.5 * DELAYS[0], 1.5 * DELAYS[-1], points)
    return [BenchContact(float(f), float(d), 0.05, noise=0.0) for f in frequencies for d in delays]


def _costly() -> list[BenchContact]:
    """The contacts on which the cost of a method is measured."""
    return [BenchContact(4.0, 0.02, 0.05, seed=i) for i in range(COST_RUNS)]


def cost(contender: Contender, ticks: int = COST_TICKS) -> float:
    """Microseconds per sim-tick beyond the numerical model's, in a batch of 64 runs in contact."""
    loop = Loop(_scenarios(contender, _costly()))
    craft, plant = loop.model, loop.plant
    assert isinstance(plant, Plant)  # the simulated side
    times = []
    for k in range(ticks):
        loop.sensor.read(loop.k, plant.wrench_sub)
        start = time.perf_counter()
        loop.drive.advance(loop.measurement)
        middle = time.perf_counter()
        q, v = craft.q.copy(), craft.v.copy()
        pose, twist = craft.pose.copy(), craft.twist.copy()
        again = time.perf_counter()
        craft.advance(loop.drive.wrench)
        end = time.perf_counter()
        craft.q[:], craft.v[:], craft.pose[:], craft.twist[:] = q, v, pose, twist
        loop.motion.update(loop.drive.pose, loop.drive.twist, loop.measurement)
        plant.advance(loop.motion.pose, loop.motion.twist, loop.motion.acceleration)
        loop.k += 1
        if k > ticks // 2:
            times.append((middle - start) - (end - again))
    return max(0.0, 1e6 * statistics.median(times) / COST_RUNS)


def leaderboard(
    records: Sequence[dict[str, Any]], costs: dict[tuple[str, str], float | None]
) -> list[dict[str, Any]]:
    """A row per method and knowledge of the contact, best first; without a rebound it is last."""
    rows = []
    for name, contact in dict.fromkeys((r["method"], r["contact"]) for r in records):
        mine = [r for r in records if (r["method"], r["contact"]) == (name, contact)]
        exact = [r for r in mine if r["delay_knowledge"] == "exact" and r["tracking"] == "ideal"]
        groups = {"largest_log_error": exact}
        groups |= {
            f"to_w_tau_{limit:.2f}": [r for r in exact if r["w_tau"] <= limit + 0.01]
            for limit in (0.25, 0.5, 1.0)
        }
        groups["servo"] = [r for r in mine if r["tracking"] == "servo"]
        groups["delay_off"] = [r for r in mine if r["delay_knowledge"] == "off"]
        groups["delay_jitter"] = [r for r in mine if r["delay_knowledge"] == "jitter"]
        row: dict[str, Any] = {"method": name, "contact": contact}
        row["runs"] = {key: len(group) for key, group in groups.items()}
        row |= {key: _largest(group) for key, group in groups.items()}
        row["energy_created"] = max(r["energy_generated"] / r["energy_of_approach"] for r in exact)
        row["peak_force_error"] = max(abs(r["peak_force_error"]) for r in exact)
        row["stable"] = sum(r["stable"] for r in exact) / len(exact)
        row["cost"] = costs[name, contact]
        rows.append(row)
    return sorted(
        rows, key=lambda r: np.inf if r["largest_log_error"] is None else r["largest_log_error"]
    )


def _largest(records: Sequence[dict[str, Any]]) -> float | None:
    errors = [r["cor_log_error"] for r in records]
    return max(abs(e) for e in errors) if errors and None not in errors else None
