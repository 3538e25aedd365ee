"""The diagnosis of one axis from top to bottom: records in, an :class:`AxisDiagnosis` out.

1. model: what the nominal axis predicts (:mod:`hiltestbed.axis.models`);
2. search: the causes with the most evidence (:mod:`hiltestbed.inference.search`);
3. conclude: those that carry over to runs that were not fitted
   (:mod:`hiltestbed.inference.conclude`);
4. decide: the verdict (:func:`decide`);
5. report: the folder (:mod:`hiltestbed.axis.report`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.axis.dataset import LoadedAxis, load_axis
from hiltestbed.axis.models import AxisModel
from hiltestbed.axis.result import CLOSE, EXTENDING, AxisCause, AxisFinding
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import Confirmed, SearchConclusion, conclude
from hiltestbed.inference.likelihood import Likelihood, independent
from hiltestbed.inference.model import Hypothesis
from hiltestbed.inference.search import search

OF_ROTATION = {  # units of an axis that slides, and of one that turns
    "m": "rad",
    "m/s": "rad/s",
    "m/s^2": "rad/s^2",
    "kg": "kg m^2",
    "N": "N m",
    "N/s": "N m/s",
    "N/m": "N m/rad",
    "N s/m": "N m s/rad",
}
Progress = Callable[[str], None]


class AxisDiagnosis(AxisFinding):
    """What was found on an axis, and its folder."""

    def write(self, folder: str | Path) -> Path:
        """Write the diagnosis folder. Raises InputError where it cannot be written."""
        from hiltestbed.axis.report import write_axis_diagnosis

        return write_axis_diagnosis(self, folder)


def diagnose_axis(path: str | Path | LoadedAxis, progress: Progress | None = None) -> AxisDiagnosis:
    """The diagnosis of an axis.

    Raises:
        InputError: the file or its data cannot be used.
    """
    start = time.monotonic()
    loaded = path if isinstance(path, LoadedAxis) else load_axis(path)
    model = loaded.model()
    found = diagnosed(model, progress)
    remarks = (*loaded.remarks, *found.remarks)
    elapsed = time.monotonic() - start
    return AxisDiagnosis(loaded, model, *found[:-1], remarks, elapsed)


class Diagnosed(NamedTuple):
    """What is found on the records of a model; the parts are those of an :class:`AxisDiagnosis`."""

    verdict: str
    causes: tuple[AxisCause, ...]
    undetermined: tuple[AxisCause, ...]
    extension: tuple[AxisCause, ...]
    conclusion: SearchConclusion | None
    constant: Array
    floors: Array
    remarks: tuple[str, ...]


def diagnosed(model: AxisModel, progress: Progress | None = None) -> Diagnosed:
    """Search, left-out runs and verdict on the records of a model."""
    if why := model.tells_nothing():
        return Diagnosed("inconclusive", (), (), (), None, np.zeros(0), model.floors, (why,))
    constant = np.array([spread(test.measured()) for _, _, test in model.folds()])
    with np.errstate(all="ignore"):
        none = Hypothesis((), np.zeros(0), np.zeros(len(model.nuisances)))
        counts = independent(model.residuals(none))
        found = search(Likelihood(model, counts), model.candidates(), progress)
        c = conclude(found, model.folds(), model.candidates(), progress)
    floors = np.maximum(model.floors, model.repeatability())
    kinds = {x.kind for x in model.candidates()}
    sizes = ([x for x in c.causes if x.determined], [x for x in c.causes if not x.determined])
    causes, undetermined, extension = (merged(x, kinds, model.turns) for x in (*sizes, c.causes))
    verdict, remarks = decide(model, causes, c, floors)
    if verdict not in EXTENDING:
        causes, undetermined, extension = (), (), ()
    return Diagnosed(verdict, causes, undetermined, extension, c, constant, floors, remarks)


def spread(parts: Sequence[Array]) -> float:
    """rms of measurements about the mean of each run: what a constant leaves."""
    return float(np.sqrt(np.mean(np.concatenate([x - np.mean(x) for x in parts]) ** 2)))


def decide(
    model: AxisModel, causes: Sequence[AxisCause], c: SearchConclusion, floors: Array
) -> tuple[str, tuple[str, ...]]:
    """Verdict and remarks."""
    if not causes:
        noise = bool(np.all(c.null.rms() <= CLOSE * floors))
        return ("no_discrepancy" if noise else "unknown"), ()
    if model.kind != "drive" and not follows(c):
        text = (
            "Fitted to one half of the records, no model is better on the other half than a "
            "constant: the output does not follow the input."
        )
        return "unknown", (text,)
    if c.alone is None and np.all(c.fit.rms() <= CLOSE * floors):
        open_ = any(x.indistinguishable_from for x in causes)
        return ("ambiguous" if open_ else "named"), ()
    return "named_in_part", ()


def follows(c: SearchConclusion) -> bool:
    """Whether each half of the runs is predicted by the fit to the other half better than by a
    constant. Stretches all over a run do not tell: slow signals resemble each other on the parts
    between them, too.
    """
    for rest, half in c.likelihood.model.halves():
        there = Likelihood(rest, c.likelihood.counts)
        fit = there.fit(c.fit.causes, [c.fit.of.theta], c.fit.of.nuisances)
        left = np.concatenate(half.departure(fit.of))
        if not np.sqrt(np.mean(left**2)) < spread(half.measured()):
            return False
    return True


def merged(
    causes: Sequence[Confirmed], searched: set[str], turns: Callable[[Candidate], bool]
) -> tuple[AxisCause, ...]:
    """The confirmed parts as effects: parts of one effect are one cause. searched: kinds among
    which it was sought; those that would be the same are its equals. turns: whether what an effect
    acts on turns.
    """
    groups: dict[tuple, list[Confirmed]] = {}
    for number, c in enumerate(causes):
        own = number if c.cause.effect.repeats and not c.cause.needs else -1
        groups.setdefault((c.cause.kind, c.cause.place, own), []).append(c)
    out = []
    for (kind, *_), parts in groups.items():
        parameters: dict[str, tuple[Any, tuple[float, float] | None, str]] = {}
        for part in parts:
            for e in part.estimates:
                unit = part.cause.effect.unit(e.name)
                shown = OF_ROTATION.get(unit, unit) if turns(part.cause) else unit
                parameters[e.name] = (e.value, (e.low, e.high), shown)
        first = parts[0]
        parameters |= {n: (v, None, "") for n, v in first.cause.fixed.items()}
        base = [p for p in parts if not p.cause.needs] or parts
        same = [x for x in first.cause.effect.same if x not in searched]
        rivals = tuple(dict.fromkeys([*same, *(r for p in base for r in p.rivals)]))
        out.append(
            AxisCause(
                kind,
                parameters,
                min(p.probability for p in base) / (1.0 + len(same)),
                rivals,
                max(p.gain for p in parts),
            )
        )
    return tuple(out)
