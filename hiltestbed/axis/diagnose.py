"""The diagnosis of one axis from top to bottom: records in, an :class:`AxisDiagnosis` out.

1. model: what the nominal axis predicts (:mod:`hiltestbed.axis.models`);
2. search: the causes with the most evidence (:mod:`hiltestbed.inference.search`);
3. conclude: those that carry over to runs that were not fitted
   (:mod:`hiltestbed.inference.conclude`);
4. decide: the verdict (:func:`decide`);
5. report: the folder (:mod:`hiltestbed.axis.report`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.axis.dataset import LoadedAxis, load_axis
from hiltestbed.axis.models import AxisModel
from hiltestbed.diagnosis.plain import finite
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import Conclusion, Confirmed, conclude
from hiltestbed.inference.likelihood import Likelihood, independent
from hiltestbed.inference.model import Hypothesis
from hiltestbed.inference.search import Searched, search
from hiltestbed.run_folder.versions import versions

# times the noise: a residual that a test engineer calls noise
CLOSE = 1.5
# of the rms of a constant on left-out runs: a model that is no better says nothing of its input
LEAST_BETTER = 0.9
# of the largest input, rms difference of two runs that count as repeats of one
REPEATED = 0.02
COPIED = 1e-6  # of the range of an output: a straight line of its input leaves less
LINKS = {"drive": "dynamics", "servo": "platform", "damper": "contact"}
WORDS = {
    "dynamics": "the drive (force to position)",
    "platform": "the servo (command to position)",
    "contact": "the damper (displacement to force)",
}
Progress = Callable[[str], None]


@dataclass(frozen=True)
class AxisCause:
    """A named effect.

    Attributes:
        effect: id. parameters: name to estimate, 95 % interval and unit. probability: that it is
            this and none of ``indistinguishable_from``. gain: share of the rms on left-out runs
            that it removes beside the others.
    """

    effect: str
    parameters: Mapping[str, tuple[float, tuple[float, float] | None, str]]
    probability: float
    indistinguishable_from: tuple[str, ...]
    gain: float

    def entry(self) -> dict[str, Any]:
        """As it stands under `effects:`."""
        return {"kind": self.effect} | {n: v for n, (v, _, _) in self.parameters.items()}

    def words(self) -> str:
        """`dynamics.mass [factor 0.953 (0.931 to 0.978)]`."""
        inner = ", ".join(
            f"{name} {value:.4g}"
            + (f" ({ends[0]:.4g} to {ends[1]:.4g})" if ends is not None else "")
            + ("" if unit in ("-", "") else f" {unit}")
            for name, (value, ends, unit) in self.parameters.items()
        )
        rivals = (
            f", indistinguishable from {' or '.join(self.indistinguishable_from)}"
            if self.indistinguishable_from
            else ""
        )
        return f"{self.effect} [{inner}]{rivals}"

    def to_json(self) -> dict[str, Any]:
        """As it stands in diagnosis.json."""
        return {
            "effect": self.effect,
            "parameters": {
                n: {"estimate": v, "ci95": ends, "unit": unit}
                for n, (v, ends, unit) in self.parameters.items()
            },
            "probability": self.probability,
            "indistinguishable_from": list(self.indistinguishable_from),
            "gain": self.gain,
            "alternatives": [],
        }


@dataclass(frozen=True, eq=False)
class AxisDiagnosis:
    """What was found on an axis.

    Attributes:
        loaded: the data. model: nominal. verdict: as of any diagnosis. causes: those that remove
            most first. conclusion: the fit behind them, None where none was sought. constant: (R,)
            rms of each left-out run about its own mean. floors: (R,) noise in the unit of the
            residual. remarks: on the data and the verdict.
    """

    loaded: LoadedAxis
    model: AxisModel
    verdict: str
    causes: tuple[AxisCause, ...]
    conclusion: Conclusion | None
    constant: Array
    floors: Array
    remarks: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def name(self) -> str:
        return self.loaded.name

    @property
    def link(self) -> str | None:
        """The link of the loop that departs."""
        quiet = self.verdict in ("no_discrepancy", "inconclusive")
        return None if quiet else LINKS[self.loaded.spec.axis]

    @property
    def extends(self) -> bool:
        """Whether the model is extended."""
        return bool(self.causes) and self.verdict in ("named", "ambiguous", "named_in_part")

    def __repr__(self) -> str:
        causes = ", ".join(c.effect for c in self.causes) or "no cause"
        return f"AxisDiagnosis({self.name}: {self.verdict}, {causes})"

    def sentence(self) -> str:
        """The verdict in one or two self-contained sentences."""
        where = WORDS[LINKS[self.loaded.spec.axis]]
        if self.verdict == "inconclusive":
            return f"These records do not tell how the axis behaves. {' '.join(self.remarks)}"
        if self.verdict == "no_discrepancy":
            return f"The nominal model explains {where}: what it leaves is noise in every run."
        start = f"{where[0].upper()}{where[1:]} departs from its nominal model"
        if self.verdict == "unknown":
            return f"{start}, and no effect of the vocabulary explains it. {self._left()}"
        causes = " and ".join(c.words() for c in self.causes)
        if self.verdict == "named_in_part":
            return f"{start}. This is {causes}. Something else is left: {self._left()}"
        text = f"{start}: {causes}."
        if self.verdict == "ambiguous":
            return f"{text} These data cannot decide which of them it is."
        return text

    def _left(self) -> str:
        c = self.conclusion
        if c is None:
            return ""
        size = ", ".join(
            f"{value:.3g} ({value / level:.2g} times the noise)"
            for value, level in zip(c.fit.rms(), self.floors, strict=True)
        )
        unit = "" if not self.extends else f" {self.loaded.units()[self._compared()]}"
        return f"it leaves {size}{unit} rms in the runs."

    def _compared(self) -> int:
        """Whether the likelihood compares inputs (0) or outputs (1)."""
        return 0 if self.loaded.spec.axis == "drive" else 1

    def to_json(self) -> dict[str, Any]:
        """The contents of diagnosis.json: plain data without infinities."""
        c, (_, unit) = self.conclusion, self.loaded.units()
        out: dict[str, Any] = {
            "name": self.name,
            "axis": self.loaded.spec.axis,
            "verdict": self.verdict,
            "sentence": self.sentence(),
            "link": self.link,
            "causes": [x.to_json() for x in self.causes],
            "not_judged": {},
            "overridden": [],
            "partial": {"sentence": "", "causes": [], "heldout": None},
            "learned": None,
            "explained": None,
            "heldout": None,
            "residuals": [],
            "closed_loop": {f"cor_{s}": [] for s in ("measured", "nominal", "extended")},
            "next_experiment": None,
            "extended_scenario": "extended.yaml" if self.extends else None,
            "ranking": [],
            "remarks": list(self.remarks),
            "seconds": self.seconds,
            "versions": versions(),
        }
        if c is None:
            return finite(out)
        before, after = c.before, c.after
        out["heldout"] = heldout([name for name, _, _ in self.model.folds()], before, after)
        out["explained"] = 1.0 - float(np.sum(after**2) / np.sum(before**2))
        left = [np.asarray(x) for x in c.fit.left[:-1]]
        out["residuals"] = [
            {
                "channel": "output",
                "run": run,
                "unit": unit,
                "rms": b,
                "rms_extended": a,
                "constant": k,
                "noise_floor": f,
                "rms_free": None,
                "rms_contact": None,
                "white": bool(float(np.sqrt(np.mean(x * x))) <= CLOSE * f),
            }
            for run, b, a, k, f, x in zip(
                [name for name, _, _ in self.model.folds()],
                before,
                after,
                self.constant,
                self.floors,
                left,
                strict=False,
            )
        ]
        out["ranking"] = [
            {"effects": [x.kind for x in f.causes], "score": c.visited[0].evidence - f.evidence}
            for f in c.visited[:8]
        ]
        return finite(out)

    def write(self, folder: str | Path) -> Path:
        """Write the diagnosis folder. Raises InputError where it cannot be written."""
        from hiltestbed.axis.report import write_axis_diagnosis

        return write_axis_diagnosis(self, folder)


def heldout(runs: Sequence[str], before: Array, after: Array) -> dict[str, Any]:
    """The gain on left-out runs, with the interval by the bootstrap over them."""
    draws = np.random.default_rng(0).integers(0, len(runs), (1000, len(runs)))
    gains = 1.0 - np.sqrt((after**2)[draws].sum(axis=1) / (before**2)[draws].sum(axis=1))
    low, high = (float(v) for v in np.percentile(gains, [2.5, 97.5]))
    rms = [float(np.sqrt(np.mean(x**2))) for x in (before, after)]
    return {
        "runs": list(runs),
        "rms_before": rms[0],
        "rms_after": rms[1],
        "reduction": 1.0 - rms[1] / rms[0] if rms[0] > 0.0 else 0.0,
        "ci95": (low, high),
        "placebo_reduction": None,
        "per_run": [
            {"run": r, "before": float(b), "after": float(a)}
            for r, b, a in zip(runs, before, after, strict=True)
        ],
    }


def diagnose_axis(path: str | Path | LoadedAxis, progress: Progress | None = None) -> AxisDiagnosis:
    """The diagnosis of an axis.

    Raises:
        InputError: the file or its data cannot be used.
    """
    start = time.monotonic()
    loaded = path if isinstance(path, LoadedAxis) else load_axis(path)
    model = loaded.model()
    constant = np.array([spread(test.measured()) for _, _, test in model.folds()])
    why = tells_nothing(model)
    if why:
        return AxisDiagnosis(
            loaded, model, "inconclusive", (), None, constant, model.floors, (*loaded.remarks, why)
        )
    with np.errstate(all="ignore"):
        found = searched(model, progress)
        conclusion = conclude(found, model.folds(), model.candidates(), progress)
    verdict, causes, floors, remarks = decide(model, found, conclusion, constant)
    return AxisDiagnosis(
        loaded,
        model,
        verdict,
        causes,
        conclusion,
        constant,
        floors,
        (*loaded.remarks, *remarks),
        time.monotonic() - start,
    )


def searched(model: AxisModel, progress: Progress | None = None) -> Searched:
    """The hypotheses on a model, by their evidence."""
    of = Hypothesis((), np.zeros(0), np.zeros(len(model.nuisances)))
    counts = independent(model.residuals(of))
    return search(Likelihood(model, counts), model.candidates(), progress)


def spread(parts: Sequence[Array]) -> float:
    """rms of measurements about the mean of each run: what a constant leaves."""
    return float(np.sqrt(np.mean(np.concatenate([x - np.mean(x) for x in parts]) ** 2)))


def tells_nothing(model: AxisModel) -> str | None:
    """Why records tell nothing of an axis; None where they do."""
    for r in model.records:
        if float(np.ptp(r.u)) == 0.0:
            return f"The input of {r.name} is constant."
        if float(np.ptp(r.y)) == 0.0:
            return f"The output of {r.name} is constant."
        slope, zero = np.polyfit(r.u, r.y, 1)
        if float(np.abs(r.y - slope * r.u - zero).max()) < COPIED * float(np.ptp(r.y)):
            return f"The output of {r.name} is {slope:.6g} times its input: it is a copy of it."
    return None


def decide(
    model: AxisModel, found: Searched, c: Conclusion, constant: Array
) -> tuple[str, tuple[AxisCause, ...], Array, tuple[str, ...]]:
    """Verdict, causes, noise floors and remarks."""
    floors = np.maximum(model.floors, repeatability(model))
    null_noise = bool(np.all(c.null.rms() <= CLOSE * floors))
    causes = merged(c.causes, {x.kind for x in model.candidates()})
    if not causes:
        return ("no_discrepancy" if null_noise else "unknown"), (), floors, ()
    if model.kind != "drive" and float(np.mean(np.log(c.after / constant))) > math.log(
        LEAST_BETTER
    ):
        text = (
            "On left-out runs no model is better than a constant: the output does not follow the "
            "input."
        )
        return "unknown", (), floors, (text,)
    if np.all(c.fit.rms() <= CLOSE * floors):
        open_ = any(x.indistinguishable_from for x in causes)
        return ("ambiguous" if open_ else "named"), causes, floors, ()
    return "named_in_part", causes, floors, ()


def repeatability(model: AxisModel) -> Array:
    """(R,) rms by which the output of a run differs from that of a repeat of it, over the root of
    two; 0 where a run has none.
    """
    out = np.zeros(len(model.records))
    for i, a in enumerate(model.records):
        for b in model.records[:i]:
            n = min(len(a.u), len(b.u))
            size = float(np.abs(a.u[:n]).max())
            if float(np.sqrt(np.mean((a.u[:n] - b.u[:n]) ** 2))) <= REPEATED * size:
                apart = float(np.sqrt(np.mean((a.y[:n] - b.y[:n]) ** 2) / 2.0))
                out[i], j = max(out[i], apart), model.records.index(b)
                out[j] = max(out[j], apart)
    return out


def merged(causes: Sequence[Confirmed], searched: set[str]) -> tuple[AxisCause, ...]:
    """The confirmed parts as effects: parts of one effect are one cause. searched: kinds among
    which it was sought; those that would be the same are its equals.
    """
    groups: dict[tuple, list[Confirmed]] = {}
    for number, c in enumerate(causes):
        own = number if c.cause.effect.repeats and not c.cause.needs else -1
        groups.setdefault((c.cause.kind, own), []).append(c)
    out = []
    for (kind, _), parts in groups.items():
        parameters: dict[str, tuple[float, tuple[float, float] | None, str]] = {}
        for part in parts:
            unit = part.cause.effect.unit
            parameters |= {e.name: (e.value, (e.low, e.high), unit(e.name)) for e in part.estimates}
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
