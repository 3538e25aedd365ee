"""How often a hidden cause is found: data sets of an independent rig with random effects, sizes,
rigs and seeds.

Single effects, pairs and triples, effects with a look-alike, healthy rigs, and effects outside the
vocabulary; the same in dockings, with probe and cone, friction, tilt and spin, on a mount, latched;
with non-white noise; on facilities that divide and stamp their ticks in other ways; then each
effect at decreasing sizes, until it is missed.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.bench.result import BenchResult
from hiltestbed.compiled.warm import cores
from hiltestbed.errors import HiltestbedError
from hiltestbed.process.workers import Workers
from tests.equipment.diagnosis.report import diagnosis_report
from tests.equipment.diagnosis.summary import summarise, summary_lines
from tests.equipment.diagnosis.tasks import Task, plan
from tests.equipment.independent_rig import write_set
from tests.equipment.kept import Kept

# largest set of indistinguishable causes, the true one included, that counts as right
MOST_TOGETHER = 3
POLL = 1.0  # [s]


def diagnosis(
    quick: bool = False,
    progress: Callable[[float, float], None] | None = None,
    noise: bool = False,
    docking: bool = False,
    computing: bool = False,
    minutes: float | None = None,
    workers: int | None = None,
    keep: Path | None = None,
) -> BenchResult:
    """The benchmark, its sets in random order, so that those done when the time is up represent
    all.

    Args:
        quick: few sets, without the smallest sizes.
        noise, docking, computing: only these parts; see
            :func:`~tests.equipment.diagnosis.tasks.plan`.
        minutes: time limit, at which sets in progress are abandoned; None: until all are done.
        workers: processes, by default one per core. keep: file to which records are saved as they
            arrive, to resume from.
    """
    asked = {"docking": docking, "noise": noise, "computing": computing}
    todo = plan(quick, [name for name in asked if asked[name]])
    kept = Kept(keep, lambda record: (record["seed"], record["scale"]))
    until = time.monotonic() + 60.0 * minutes if minutes is not None else math.inf
    waiting = [
        todo[i]
        for i in np.random.default_rng(0).permutation(len(todo))
        if _key(todo[i]) not in kept.records
    ]
    for left, record in _diagnosed(waiting, workers or cores(), until):
        if record is not None:
            kept.add(record)
        if progress:
            progress(len(todo) - left, len(todo))
    records = [kept.records[_key(task)] for task in todo if _key(task) in kept.records]
    if len(records) == len(todo):
        kept.done()
    summary = summarise(records) | {"planned": len(todo), "done": len(records)}
    return BenchResult(
        "diagnosis", records, summary, diagnosis_report(records, summary), summary_lines(summary)
    )


def _diagnosed(
    waiting: list[Task], workers: int, until: float
) -> Iterator[tuple[int, dict[str, Any] | None]]:
    """Number of sets left with each record, None at a poll without; abandoned at ``until``."""
    pool, running = Workers(workers), set[Future[dict[str, Any]]]()
    try:
        while (waiting or running) and time.monotonic() < until:
            while waiting and len(running) < workers:
                running.add(pool.submit(one_set, waiting.pop(0)))
            ended, running = wait(running, POLL, FIRST_COMPLETED)
            for one in ended:
                yield len(waiting) + len(running), one.result()
            if not ended:
                yield len(waiting) + len(running), None
    except BrokenProcessPool:
        raise HiltestbedError(
            "bench diagnosis: a worker process died (killed, or out of memory); the same command "
            "with the same --out resumes it; --workers 1 needs less memory"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _key(task: Task) -> tuple[int, float]:
    return task.seed, task.scale


def one_set(task: Task) -> dict[str, Any]:
    """Draw a set, write it, diagnose it from its files, and compare."""
    from hiltestbed.diagnosis.find import cause_of, gain_of, judge
    from hiltestbed.diagnosis.investigate import investigate
    from hiltestbed.measured import load_dataset

    hidden = task.draw()
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_set(folder, hidden)
        judged = judge(investigate(load_dataset(Path(folder) / "dataset.yaml")))
    findings, verdict = judged.findings, judged.verdict
    causes = [cause_of(c) for c in verdict.causes]
    gain = gain_of(findings, verdict.causes)
    truth = [e["kind"] for e in hidden.effects]
    sets = [(c.effect, *c.indistinguishable_from) for c in causes]
    right = judged_right(task.kind, truth, list(hidden.links), verdict.verdict, verdict.link, sets)
    held, asked = coverage(hidden.effects, causes)
    return {
        "seed": task.seed,
        "kind": task.kind,
        "design": task.design,
        "scale": task.scale,
        "hidden": hidden.effects,
        "noise": list(task.noise) if task.noise else None,
        "computing": task.computing,
        "strengths": list(hidden.strengths),
        "verdict": verdict.verdict,
        "link": verdict.link,
        "right": right,
        "intervals_held": held,
        "intervals": asked,
        "causes": [
            {name: getattr(c, name) for name in ("effect", "probability")}
            | {"indistinguishable_from": list(c.indistinguishable_from)}
            for c in causes
        ],
        "cpu": time.process_time() - start,
        "gain": gain.reduction if gain else None,
        "gain_true": true_gain(findings, verdict, hidden.effects)
        if right and task.kind == "single"
        else None,
    }


def judged_right(
    kind: str,
    truth: Sequence[str],
    links: Sequence[str],
    verdict: str,
    link: str | None,
    sets: Sequence[Sequence[str]],
) -> bool:
    """Whether a verdict is right: no discrepancy if healthy, unknown with its link or inconclusive
    if foreign, otherwise each hidden effect in a set of its own.
    """
    if kind == "healthy":
        return verdict == "no_discrepancy"
    if kind == "foreign":  # contact and sensor are one link to the data
        if verdict == "inconclusive":
            return True
        return verdict == "unknown" and (link in links or {link, *links} <= {"contact", "sensor"})
    if (
        verdict not in ("named", "ambiguous")
        or len(sets) != len(truth)
        or any(len(s) > MOST_TOGETHER for s in sets)
    ):
        return False
    return all(any(name in s for s in sets) for name in truth)


def coverage(hidden: Sequence[dict[str, Any]], causes: Sequence[Any]) -> tuple[int, int]:
    """Number of true parameters within their intervals, and of those that were estimated."""
    held = asked = 0
    for effect in hidden:
        for cause in causes:
            if cause.effect != effect["kind"] or any(
                isinstance(p.estimate, str) and p.estimate != effect.get(n)
                for n, p in cause.parameters.items()
            ):
                continue
            for name, p in cause.parameters.items():
                if name not in effect:  # at its default in the drawn set
                    continue
                pairs = (
                    zip(effect[name], p.ci95, strict=True)
                    if isinstance(p.estimate, tuple)
                    else [(effect.get(name), p.ci95)]
                )
                for true, ends in pairs:
                    if ends is not None and isinstance(true, (int, float)) and ends[0] != ends[1]:
                        asked += 1
                        held += ends[0] <= true <= ends[1]
    return held, asked


def true_gain(findings: Any, verdict: Any, hidden: Sequence[dict[str, Any]]) -> float | None:
    """Gain of the hidden effect at its true size, in the variant in which it was found."""
    cause = verdict.causes[0]
    if cause.effect != hidden[0]["kind"] or cause.effect == "log.skew":
        return None
    residual, fitted = findings.explanations[cause.link].residual(), cause.fitted
    true = {name: value for name, value in hidden[0].items() if name != "kind"}
    found = fitted.parameters()
    if any(isinstance(value, str) and value != true.get(name) for name, value in found.items()):
        return None
    values = {n: tuple(v) if isinstance(v, list) else v for n, v in (found | true).items()}
    effect = type(fitted).hypothesis(fitted.variant, **values)
    before, after = (
        [residual.mean_square(i, effects) for i in residual.runs] for effects in ((), (effect,))
    )
    return 1.0 - float(np.sqrt(sum(after) / sum(before))) if sum(before) > 0 else None
