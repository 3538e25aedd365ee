"""How often a hidden cause is found: sets of an independent rig with effects, sizes, rigs and seeds drawn at random.

Alone and in pairs, healthy rigs, and effects that the vocabulary has no name for; the same in dockings, with probe and cone, friction,
tilt and spin, on a mount, latched; then each effect ever smaller, until it is missed.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.bench.diagnosis_report import diagnosis_report
from hiltestbed.bench.reliability import reliability, reliability_lines
from hiltestbed.bench.result import BenchResult
from hiltestbed.effects.table import EFFECTS
from hiltestbed.kernels import cores

SEED = 400_000
FULL = {"single": 82, "pair": 40, "healthy": 120, "foreign": 40}
QUICK = {"single": 8, "pair": 3, "healthy": 3, "foreign": 3}
NOISE_SEED, NOISE_FULL, NOISE_QUICK = 600_000, 60, 1  # sets of each kind at each strength
DOCKING_SEED = 500_000
DOCKING_FULL = {"single": 60, "pair": 20, "healthy": 60, "foreign": 20}
DOCKING_QUICK = {"single": 3, "pair": 1, "healthy": 2, "foreign": 1}
DOCKINGS = ("docking", "docking", "mounted", "held")  # in turn
SMALLER = (0.3, 0.1, 0.03, 0.01)  # of the drawn size, down the ladder of the smallest that is found
MOST_TOGETHER = 3  # a set of the truth and at most two others counts as right


@dataclass(frozen=True)
class Task:
    """One set to draw and diagnose."""

    seed: int
    kind: str
    names: tuple[str, ...] | None = None
    scale: float = 1.0
    design: str = "bumper"
    noise: tuple[str, float] | None = None


def noise_tasks(each: int) -> list[Task]:
    """Healthy sets under every kind of noise at each of its strengths."""
    from hiltestbed.bench.independent_rig import NOISE_KINDS

    kinds = [(name, strength) for name, kind in NOISE_KINDS.items() for strength in kind.strengths]
    return [Task(NOISE_SEED + i * each + j, "healthy", noise=noise) for i, noise in enumerate(kinds) for j in range(each)]


def docking_tasks(counts: dict[str, int]) -> list[Task]:
    """The docking sets; singles go through the effects that act in their design in turn."""
    from hiltestbed.bench.independent_rig import acting_in

    out: list[Task] = []
    for kind, count in counts.items():
        for i in range(count):
            design = DOCKINGS[i % len(DOCKINGS)]
            acting = acting_in(design)  # type: ignore[arg-type]
            names = (acting[(i * 7) % len(acting)],) if kind == "single" else None
            out.append(Task(DOCKING_SEED + len(out), kind, names, design=design))
    return out


def tasks(counts: dict[str, int], ladder: bool) -> list[Task]:
    """The sets of the benchmark; singles go through the vocabulary in turn."""
    from hiltestbed.bench.independent_rig import SIZES

    out, ids = [], [name for name in EFFECTS if name in SIZES]  # learned laws are not drawn
    for kind, count in counts.items():
        for i in range(count):
            out.append(Task(SEED + len(out), kind, (ids[(i * 7) % len(ids)],) if kind == "single" else None))
    if ladder:
        out += [Task(SEED + 5000 + i, "single", (name,), scale) for scale in SMALLER for i, name in enumerate(ids) if name not in UNSCALED]
    return out


UNSCALED = {"dynamics.integrator", "dynamics.step_delay"}  # there is no smaller one


def diagnosis(
    quick: bool = False, progress: Callable[[int, int], None] | None = None, noise: bool = False, docking: bool = False
) -> BenchResult:
    """The benchmark.

    Args:
        quick: a handful of sets, without the smallest sizes. noise: healthy rigs under every kind of noise alone. docking: the docking
            sets alone.
    """
    todo = docking_tasks(DOCKING_QUICK if quick else DOCKING_FULL)
    if noise:
        todo = noise_tasks(NOISE_QUICK if quick else NOISE_FULL) + (todo if docking else [])
    elif not docking:
        todo = [*tasks(QUICK if quick else FULL, not quick), *todo]
    records: list[dict[str, Any]] = [{}] * len(todo)
    mixed = np.random.default_rng(0).permutation(len(todo))  # kinds differ in what they take: what is done stands for what is left
    with ProcessPoolExecutor(cores()) as pool:
        waiting = {pool.submit(one_set, todo[i]): int(i) for i in mixed}
        for done, future in enumerate(as_completed(waiting), 1):
            records[waiting[future]] = future.result()
            if progress:
                progress(done, len(todo))
    summary = summarise(records)
    lines = [
        (name.replace("_", " "), f"{value:.3g}" if isinstance(value, float) else "-" if value is None else str(value))
        for name, value in summary.items()
        if not isinstance(value, (dict, list))
    ]
    lines += reliability_lines(summary["reliability"])
    return BenchResult("diagnosis", records, summary, diagnosis_report(records, summary), lines)


def one_set(task: Task) -> dict[str, Any]:
    """Draw a set, write it, diagnose it from its files, and compare."""
    from hiltestbed.bench.independent_rig import draw_set, write_set
    from hiltestbed.diagnosis.find import cause_of, gain_of, judge
    from hiltestbed.diagnosis.investigate import investigate
    from hiltestbed.measured import load_dataset

    options: dict[str, Any] = {"names": task.names} if task.names else {}
    hidden = draw_set(np.random.default_rng(task.seed), task.kind, scale=task.scale, design=task.design, noise=task.noise, **options)  # type: ignore[arg-type]
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_set(folder, hidden)
        judged = judge(investigate(load_dataset(Path(folder) / "dataset.yaml")))
    findings, verdict = judged.findings, judged.verdict
    causes = [cause_of(findings, c) for c in verdict.causes]
    gain = gain_of(findings, verdict.causes)
    truth = [e["kind"] for e in hidden.effects]
    sets = [(c.effect, *c.indistinguishable_from) for c in causes]
    right = judged_right(task.kind, truth, list(hidden.links), verdict.verdict, verdict.link, sets)
    held, asked = coverage(hidden.effects, causes)
    return {
        "seed": task.seed, "kind": task.kind, "design": task.design, "scale": task.scale, "hidden": hidden.effects,
        "noise": list(task.noise) if task.noise else None,
        "strengths": list(hidden.strengths),
        "verdict": verdict.verdict, "link": verdict.link, "right": right, "intervals_held": held, "intervals": asked,
        "causes": [
            {"effect": c.effect, "indistinguishable_from": list(c.indistinguishable_from), "probability": c.probability} for c in causes
        ],
        "alarm": alarm_figures(findings),
        "cpu": time.process_time() - start, "gain": gain.reduction if gain else None,
        "gain_true": true_gain(findings, verdict, hidden.effects) if right and task.kind == "single" else None,
    }  # fmt: skip


def alarm_figures(findings: Any) -> dict[str, float]:
    """How near the links come to an alarm: chi-square that the best single takes off, its penalty paid, and the excess over noise."""
    from hiltestbed.diagnosis.fit import inflation

    found = list(findings.explanations.values())
    best = [(e.null.chi2 - e.singles[0].score) / inflation(e.singles[0]) for e in found if e.singles]
    excess = [left.excess for e in found for left in e.before.values()]
    return {"taken_off": max(best, default=0.0), "excess": max(excess, default=0.0)}


def judged_right(
    kind: str, truth: Sequence[str], links: Sequence[str], verdict: str, link: str | None, sets: Sequence[Sequence[str]]
) -> bool:
    """Whether a verdict is right: healthy left alone, foreign unknown with its link or inconclusive, each hidden effect in its own set."""
    if kind == "healthy":
        return verdict == "no_discrepancy"
    if kind == "foreign":  # contact and sensor are one link to the data
        if verdict == "inconclusive":
            return True
        return verdict == "unknown" and (link in links or {link, *links} <= {"contact", "sensor"})
    if verdict not in ("named", "ambiguous") or len(sets) != len(truth) or any(len(s) > MOST_TOGETHER for s in sets):
        return False
    return all(any(name in s for s in sets) for name in truth)


def coverage(hidden: Sequence[dict[str, Any]], causes: Sequence[Any]) -> tuple[int, int]:
    """How many true numbers lie in their intervals, of how many that were estimated under the right name."""
    held = asked = 0
    for effect in hidden:
        for cause in causes:
            if cause.effect != effect["kind"] or any(
                isinstance(p.estimate, str) and p.estimate != effect.get(n) for n, p in cause.parameters.items()
            ):
                continue
            for name, p in cause.parameters.items():
                if name not in effect:  # left at its default in the set that was drawn
                    continue
                pairs = zip(effect[name], p.ci95, strict=True) if isinstance(p.estimate, tuple) else [(effect.get(name), p.ci95)]
                for true, ends in pairs:
                    if ends is not None and isinstance(true, (int, float)) and ends[0] != ends[1]:
                        asked += 1
                        held += ends[0] <= true <= ends[1]
    return held, asked


def true_gain(findings: Any, verdict: Any, hidden: Sequence[dict[str, Any]]) -> float | None:
    """The gain of the hidden effect itself, at its true size, in the variant in which it was found."""
    from hiltestbed.diagnosis import heldout

    cause = verdict.causes[0]
    if cause.effect != hidden[0]["kind"] or cause.effect == "log.skew":
        return None
    residual, fitted = findings.explanations[cause.link].residual, cause.fit.effects()[cause.index]
    true = {name: value for name, value in hidden[0].items() if name != "kind"}
    if any(isinstance(value, str) and value != true.get(name) for name, value in fitted.parameters().items()):
        return None
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in (fitted.parameters() | true).items()}
    effect = type(fitted).hypothesis(fitted.variant, **values)
    before, after = ([heldout.mean_square(residual, i, effects) for i in residual.runs] for effects in ((), (effect,)))
    return 1.0 - float(np.sqrt(sum(after) / sum(before))) if sum(before) > 0 else None


def summarise(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The rates, the confusion of names, the smallest size of each effect that was found."""
    noisy, said = [r for r in records if r["noise"]], reliability(records)
    records = [r for r in records if not r["noise"]]
    moderate = [r for r in records if r["scale"] == 1.0 and r["design"] == "bumper"]
    dockings = {kind: [r for r in records if r["design"] != "bumper" and r["kind"] == kind] for kind in DOCKING_FULL}
    by_kind = {kind: [r for r in moderate if r["kind"] == kind] for kind in FULL}
    hidden = by_kind["single"] + by_kind["pair"]
    asked = sum(r["intervals"] for r in hidden)
    ratios = [r["gain"] / r["gain_true"] for r in hidden if r["gain"] is not None and r["gain_true"]]
    return {
        "named_rate": _rate(by_kind["single"]),
        "pair_rate": _rate(by_kind["pair"]),
        "false_alarm_rate": 1.0 - _rate(by_kind["healthy"]) if by_kind["healthy"] else 0.0,
        "foreign_unknown_rate": _rate(by_kind["foreign"]),
        "foreign_named_rate": sum(bool(r["causes"]) for r in by_kind["foreign"]) / max(1, len(by_kind["foreign"])),
        "named_in_part_wrong_rate": wrong_in_part(records),
        "healthy_taken_off": max((r["alarm"]["taken_off"] for r in by_kind["healthy"]), default=None),
        "healthy_excess": max((r["alarm"]["excess"] for r in by_kind["healthy"]), default=None),
        "abstention_rate": sum(r["verdict"] == "unknown" for r in hidden) / max(1, len(hidden)),
        "interval_coverage": sum(r["intervals_held"] for r in hidden) / asked if asked else None,
        "gain_ratio": float(np.median(ratios)) if ratios else None,
        "sets": {kind: len(part) for kind, part in by_kind.items()},
        "docking_named_rate": _rate(dockings["single"]),
        "docking_pair_rate": _rate(dockings["pair"]),
        "docking_false_alarm_rate": 1.0 - _rate(dockings["healthy"]) if dockings["healthy"] else 0.0,
        "docking_foreign_unknown_rate": _rate(dockings["foreign"]),
        "docking_sets": {kind: len(part) for kind, part in dockings.items()},
        "noise_alarms": noise_alarms(noisy),
        "noise_alarm_rate": 1.0 - _rate(noisy) if noisy else None,
        "cpu_median": float(np.median([r["cpu"] for r in records])) if records else None,
        "cpu_longest": max((r["cpu"] for r in records), default=None),
        "reliability": said,
        "confusion": confusion(by_kind["single"] + dockings["single"]),
        "smallest_found": smallest(records),
    }


def wrong_in_part(records: Sequence[dict[str, Any]]) -> float | None:
    """Share of the causes named in part that were not hidden; None where none was named in part."""
    said = [
        bool({c["effect"], *c["indistinguishable_from"]} & {e["kind"] for e in r["hidden"]})
        for r in records for c in r["causes"] if r["verdict"] == "named_in_part"
    ]  # fmt: skip
    return 1.0 - sum(said) / len(said) if said else None


def noise_alarms(records: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Kind of noise and strength to alarms of sets."""
    out: dict[str, list[bool]] = {}
    for r in records:
        out.setdefault(f"{r['noise'][0]} {r['noise'][1]:g}", []).append(not r["right"])
    return {name: f"{sum(wrong)} of {len(wrong)}" for name, wrong in out.items()}


def _rate(records: Sequence[dict[str, Any]]) -> float:
    return sum(r["right"] for r in records) / max(1, len(records))


def confusion(singles: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Hidden effect to what it was called, and how often."""
    out: dict[str, Counter] = {}
    for r in singles:
        called = " + ".join(sorted(c["effect"] for c in r["causes"])) if r["verdict"] in ("named", "ambiguous") else r["verdict"]
        out.setdefault(r["hidden"][0]["kind"], Counter())[called] += 1
    return {name: dict(counts) for name, counts in sorted(out.items())}


def smallest(records: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Effect to its smallest size that was found, with how far that stood above the noise."""
    out: dict[str, dict[str, Any]] = {}
    for r in records:
        if r["kind"] != "single" or not r["right"] or r["design"] != "bumper":
            continue
        name, strength = r["hidden"][0]["kind"], r["strengths"][0]
        if name not in out or strength < out[name]["strength"]:
            out[name] = {"strength": strength} | {k: v for k, v in r["hidden"][0].items() if k != "kind"}
    return dict(sorted(out.items()))
