"""What a diagnosis of an axis says: the causes, the verdict in a sentence, and the contents of
diagnosis.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hiltestbed.axis.dataset import LoadedAxis
from hiltestbed.axis.effects.base import AXIS_EFFECTS
from hiltestbed.axis.models import AxisModel
from hiltestbed.axis.motion import noise_of
from hiltestbed.axis.remainder import Remainder, remainder_of
from hiltestbed.axis.scaling import scaling_remark
from hiltestbed.diagnosis.plain import finite
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import SearchConclusion
from hiltestbed.inference.model import FEWEST
from hiltestbed.run_folder.versions import versions

# times the noise: a residual that a test engineer calls noise
CLOSE = 1.5
EXTENDING = ("named", "ambiguous", "named_in_part")  # verdicts with a model to offer
LINKS = {"drive": "dynamics", "servo": "platform", "damper": "contact", "arm": "dynamics"}
WORDS = {
    "drive": "the drive (force to position)",
    "servo": "the servo (command to position)",
    "damper": "the damper (displacement to force)",
    "arm": "the arm (motion to torques)",
}


@dataclass(frozen=True)
class AxisCause:
    """A named effect.

    Attributes:
        effect: id. parameters: name to estimate, 95 % interval and unit. probability: that it is
            this and none of ``indistinguishable_from``. gain: share of the rms on left-out runs
            that it removes beside the others.
    """

    effect: str
    parameters: Mapping[str, tuple[Any, tuple[float, float] | None, str]]
    probability: float
    indistinguishable_from: tuple[str, ...]
    gain: float

    def entry(self) -> dict[str, Any]:
        """As it stands under `effects:`."""
        return {"kind": self.effect} | {n: v for n, (v, _, _) in self.parameters.items()}

    def words(self) -> str:
        """`dynamics.mass [factor 0.953 (0.931 to 0.978)]`."""
        inner = ", ".join(
            f"{name} {estimate(value, ends)}" + ("" if unit in ("-", "") else f" {unit}")
            for name, (value, ends, unit) in self.parameters.items()
        )
        others = " or ".join(self.indistinguishable_from)
        return f"{self.effect} [{inner}]" + (f", indistinguishable from {others}" if others else "")

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
class AxisFinding:
    """What was found on an axis.

    Attributes:
        loaded: the data. model: nominal. verdict: as of any diagnosis. causes: those that remove
            most first. undetermined: effects without which the left-out runs are predicted worse,
            but whose size may be none. extension: both of these, as the model that is offered has
            them. conclusion: the fit behind them, None where none was sought. constant: (R,) rms of
            each left-out run about its own mean. floors: (R,) noise in the unit of the residual.
            remarks: on the data and the verdict.
    """

    loaded: LoadedAxis
    model: AxisModel
    verdict: str
    causes: tuple[AxisCause, ...]
    undetermined: tuple[AxisCause, ...]
    extension: tuple[AxisCause, ...]
    conclusion: SearchConclusion | None
    constant: Array
    floors: Array
    remarks: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def name(self) -> str:
        return self.loaded.name

    @property
    def extends(self) -> bool:
        """Whether the model is extended."""
        return self.verdict in EXTENDING

    def __repr__(self) -> str:
        causes = ", ".join(c.effect for c in self.causes) or "no cause"
        return f"AxisDiagnosis({self.name}: {self.verdict}, {causes})"

    def sentence(self) -> str:
        """The verdict in a few self-contained sentences."""
        return " ".join(part for part in (self.doubt, self._said()) if part)

    def _said(self) -> str:
        where = WORDS[self.loaded.spec.axis]
        if self.verdict == "inconclusive":
            return f"These records do not tell how the axis behaves: {'; '.join(self.remarks)}"
        if self.verdict == "no_discrepancy":
            return f"The nominal model explains {where}: what it leaves is noise in every run."
        start = f"{where[0].upper()}{where[1:]} departs from its nominal model"
        if self.verdict == "unknown":
            return f"{start}, and no effect of the vocabulary explains it. {self._left()}"
        causes = "; ".join(c.words() for c in self.causes) + self._together()
        if self.verdict == "named_in_part":
            return f"{start}. In part this is {causes}. {self._carried()} {self._left()}"
        text = f"{start}: {causes}. {self._carried()}"
        if self.verdict == "ambiguous":
            return f"{text} These data cannot decide which of them it is."
        return text

    def _together(self) -> str:
        """The sum of the forces at which elements in parallel slide, each of which has one."""
        forces = [
            c.parameters["force"][0]
            for c in self.causes
            if AXIS_EFFECTS[c.effect].parallel and "force" in c.parameters
        ]
        unit = "N m" if self.model.rotates else "N"
        return f" (together {sum(forces):.4g} {unit})" if len(forces) > 1 else ""

    @cached_property
    def doubt(self) -> str:
        """Why the units may be wrong; empty where they seem right, or nothing was judged."""
        return "" if self.conclusion is None else scaling_remark(self.model)

    @cached_property
    def remainder(self) -> Remainder | None:
        """What the offered hypothesis leaves; None where none was sought."""
        c = self.conclusion
        return None if c is None else remainder_of(self.model, c.fit, self.floors)

    def _left(self) -> str:
        return "" if self.remainder is None else f"What is left is {self.remainder.words()}."

    def _carried(self) -> str:
        """How much of the departure the causes carry where they were not fitted."""
        c, whole = self.conclusion, len(self.model.recorded) >= FEWEST
        if c is None:
            return ""
        before, after, unit = together(c.before), together(c.after), self.loaded.units()[1]
        said = (
            f"On {'runs' if whole else 'stretches'} that were not fitted the departure falls from "
            f"{before:.3g} to {after:.3g} {unit} rms, by {100.0 * (1.0 - after / before):.4g} %"
        )
        if c.alone is None:
            return f"{said}."
        beside = "; ".join(x.words() for x in self.undetermined)
        return (
            f"{said}, with {beside} beside it. These records do not determine the size of what is "
            f"beside it, which may stand for something else; without it the departure falls to "
            f"{together(c.alone):.3g} {unit}."
        )

    def to_json(self) -> dict[str, Any]:
        """The contents of diagnosis.json: plain data without infinities."""
        c, (_, unit) = self.conclusion, self.loaded.units()
        out: dict[str, Any] = {
            "name": self.name,
            "axis": self.loaded.spec.axis,
            "verdict": self.verdict,
            "sentence": self.sentence(),
            "link": LINKS[self.loaded.spec.axis]
            if self.extends or self.verdict == "unknown"
            else None,
            "causes": [x.to_json() for x in self.causes],
            "undetermined": [x.to_json() for x in self.undetermined],
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
            "left": None if self.remainder is None else self.remainder.to_json(),
            "remarks": [*self.remarks, *([self.doubt] if self.doubt else [])],
            "seconds": self.seconds,
            "versions": versions(),
        }
        if c is None:
            return finite(out)
        before, after = c.before, c.after
        out["heldout"] = heldout([name for name, _, _ in self.model.folds()], before, after)
        out["explained"] = 1.0 - float(np.sum(after**2) / np.sum(before**2))
        rms, noise = c.fit.rms(), self.floors
        if self.loaded.spec.axis == "drive":  # the likelihood compares its input
            noise = np.array([noise_of(r.y) for r in self.model.records])
        parts = zip(self.model.folds(), self.model.of_folds(), before, after, strict=True)
        out["residuals"] = [
            {
                "channel": "output",
                "run": run,
                "unit": unit,
                "rms": b,
                "rms_extended": a,
                "constant": k,
                "noise_floor": together(noise[of]),
                "rms_free": None,
                "rms_contact": None,
                "white": bool(np.all(rms[of] <= CLOSE * self.floors[of])),
            }
            for ((run, *_), of, b, a), k in zip(parts, self.constant, strict=True)
        ]
        out["ranking"] = [
            {"effects": [x.kind for x in f.causes], "score": c.visited[0].evidence - f.evidence}
            for f in c.visited[:8]
        ]
        return finite(out)


def estimate(value: Any, ends: tuple[float, float] | None) -> str:
    """`0.953 (0.931 to 0.978)`: a value and its interval."""
    shown = value if isinstance(value, str) else f"{value:.4g}"
    return shown + ("" if ends is None else f" ({ends[0]:.4g} to {ends[1]:.4g})")


def together(rms: Array) -> float:
    """rms of several signals of one size."""
    return float(np.sqrt(np.mean(rms * rms)))


def heldout(runs: Sequence[str], before: Array, after: Array) -> dict[str, Any]:
    """The gain on left-out runs, with the interval by the bootstrap over them."""
    draws = np.random.default_rng(0).integers(0, len(runs), (1000, len(runs)))
    gains = 1.0 - np.sqrt((after**2)[draws].sum(axis=1) / (before**2)[draws].sum(axis=1))
    low, high = (float(v) for v in np.percentile(gains, [2.5, 97.5]))
    first, last = together(before), together(after)
    return {
        "runs": list(runs),
        "rms_before": first,
        "rms_after": last,
        "reduction": 1.0 - last / first if first > 0.0 else 0.0,
        "ci95": (low, high),
        "placebo_reduction": None,
        "per_run": [
            {"run": r, "before": float(b), "after": float(a)}
            for r, b, a in zip(runs, before, after, strict=True)
        ],
    }
