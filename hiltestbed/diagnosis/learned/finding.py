"""A learned law for the report: its curves with the data, its gain, its equation, and the named
effects it resembles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.learned.families import SensorCurve
from hiltestbed.diagnosis.learned.learn import Law, carries_over, learn
from hiltestbed.diagnosis.learned.words import equation, resembling
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout, Learned, LearnedCurve
from hiltestbed.diagnosis.settings import MIN_EXPLAINED
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.sensor.effects import WRENCH_AXES

MAX_SAMPLES = 3000  # chosen: drawn under a curve
DIGITS = 6  # significant, of the numbers in a scenario


def learned_on(found: Explanation, known: Sequence[Effect]) -> tuple[Learned, Effect] | None:
    """The law learned on a link that leaves more than noise, beside ``known`` effects, and its
    effect as links take it, or None.
    """
    result = learn(found.residual(), known)
    if result is None:
        return None
    law, gain = result
    share = _share(gain)
    effect = law.effect
    given = {name: _rounded(value) for name, value in effect.parameters().items() if value}
    learned = Learned(
        effect.kind,
        given,
        effect.link,
        law.numbers,
        gain,
        share,
        carries_over(gain) and share >= MIN_EXPLAINED,
        equation(law),
        resembling(found, law),
        tuple(_curves(found.residual(), law)),
    )
    return learned, effect


def _share(gain: Heldout) -> float:
    """Share of the departure that is explained, in mean square beyond the noise."""
    before, after = gain.rms_before**2 - 1.0, max(gain.rms_after**2 - 1.0, 0.0)
    return 1.0 - after / before if before > 0.0 else 0.0


def _rounded(value: object) -> object:
    if isinstance(value, tuple):
        return [_rounded(v) for v in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def _curves(residual: Residual, law: Law) -> list[LearnedCurve]:
    """Each curve, with samples of its own value plus the residual of the whole law."""
    link = residual.link
    if not isinstance(link, WrenchLink):
        first, second = type(law.effect).unit("step").split(", ")
        return [
            LearnedCurve(
                "step",
                np.array(law.family.curves(law.values, law.choices)[0]),
                np.zeros((0, 2)),
                (first, second),
            )
        ]
    axis = WRENCH_AXES.index(law.family.axis) if isinstance(law.family, SensorCurve) else 2
    pairs = {
        b.name: np.array(c)
        for b, c in zip(law.family.blocks, law.family.curves(law.values, law.choices), strict=True)
        if c
    }
    effects = [*law.known, law.effect]
    left, places = [], {name: [] for name in pairs}
    for i in residual.runs:
        rows = np.flatnonzero(link.runs[i].touching & np.isfinite(link.runs[i].sigma[:, axis]))
        left.append((link.runs[i].measured - link.shown(i, effects))[rows, axis])
        late = np.clip(
            rows - round(link.lateness(i, law.known) / link.runs[i].scenario.tick),
            0,
            link.runs[i].rows - 1,
        )
        depth = link.penetration(i)
        held = link.runs[i].scenario.mechanism.captured
        rate = np.gradient(depth, link.runs[i].scenario.tick)
        series = {"penetration": depth, "rate": rate, "spring": depth, "spring_rate": rate}
        if "stretch" in pairs:
            series["stretch"] = stretches(
                depth, pairs["stretch"][0, 0], pairs["stretch"][-1, 0], held
            )
        for name, found in places.items():
            found.append(
                link.shown(i, law.known)[rows, axis] if name == "reading" else series[name][late]
            )
    remains = np.concatenate(left)
    step = max(1, len(remains) // MAX_SAMPLES)
    out = []
    for name, curve in pairs.items():
        x = np.concatenate(places[name])
        first, second = type(law.effect).unit(name).split(", ")
        inside = np.interp(x, curve[:, 0], curve[:, 1]) + remains
        if name.startswith("spring"):  # a factor on a vanishing force cannot be determined
            inside = np.full(len(x), np.nan)
        out.append(LearnedCurve(name, curve, np.column_stack([x, inside])[::step], (first, second)))
    return out


def stretches(depth: Array, low: float, high: float, held: bool) -> Array:
    """``(N,)`` stretch [m] of a slider along penetrations (N,): the slider moves where the stretch
    would leave ``low`` to ``high``.
    """
    out, slider = np.zeros(len(depth)), 0.0
    for k, x in enumerate(depth):
        if x <= 0.0 and not held:
            slider = 0.0
            continue
        out[k] = min(max(x - slider, low), high)
        slider = x - out[k]
    return out
