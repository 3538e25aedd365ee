"""A learned law for the report: its curves with the data, its gain, its equation, and the named
effects it resembles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.explain import Explanation, effects_of
from hiltestbed.diagnosis.learned.families import SensorCurve
from hiltestbed.diagnosis.learned.learn import Law, carries_over, learn
from hiltestbed.diagnosis.learned.words import equation
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Learned, LearnedCurve
from hiltestbed.diagnosis.settings import MIN_EXPLAINED
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.signals import AXES

MAX_SAMPLES = 3000  # chosen: drawn under a curve
DIGITS = 6  # significant, of the numbers in a scenario
MAX_RESEMBLING = 3  # named effects that are listed
# derived: cosine above which a named effect removes four fifths of the square of what a law removes
MIN_RESEMBLANCE = 0.9
RESEMBLING_LINKS = ("contact", "sensor", "platform")


def learned_on(found: Explanation, known: Sequence[Effect]) -> tuple[Learned, Effect] | None:
    """The law learned on a link that leaves more than noise, beside ``known`` effects, and its
    effect as links take it, or None.
    """
    residual = found.residual()
    result = learn(residual, known)
    if result is None:
        return None
    law, gain = result
    effect = law.effect
    # of the departure, in mean square beyond the noise
    before, after = gain.rms_before**2 - 1.0, max(gain.rms_after**2 - 1.0, 0.0)
    share = 1.0 - after / before if before > 0.0 else 0.0
    learned = Learned(
        effect.kind,
        {name: _rounded(value) for name, value in effect.parameters().items() if value},
        effect.link,
        law.numbers,
        gain,
        share,
        carries_over(gain) and share >= MIN_EXPLAINED,
        equation(law),
        resembling(found, law),
        tuple(_curves(residual, law)),
    )
    return learned, effect


def _rounded(value: object) -> object:
    if isinstance(value, tuple):
        return [_rounded(v) for v in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def resembling(found: Explanation, law: Law) -> tuple[str, ...]:
    """Named effects that, fitted alone, remove from the residual what the law does: by the cosine
    between the two reductions.
    """
    residual = found.residual()
    before, after, null = residual.many([law.known, [*law.known, law.effect], ()])
    taken, alike = before - after, {}
    for (effect,) in map(effects_of, found.singles()):
        if effect.link in RESEMBLING_LINKS:
            other = null - residual([effect])
            length = float(np.linalg.norm(taken) * np.linalg.norm(other))
            alike[effect.kind] = float(taken @ other) / length if length > 0.0 else 0.0
    near = sorted((k for k in alike if alike[k] > MIN_RESEMBLANCE), key=lambda k: -alike[k])
    return tuple(near[:MAX_RESEMBLING])


def _curves(residual: Residual, law: Law) -> list[LearnedCurve]:
    """Each curve, with samples of its own value plus the residual of the whole law."""
    link, family = residual.link, law.family
    pairs = {b.name: np.array(c) for b, c in zip(family.blocks, law.curves, strict=True) if c}
    units = {}
    for name in pairs:
        over, _, unit = type(law.effect).unit(name).partition(", ")
        units[name] = over, unit
    if not isinstance(link, WrenchLink):
        return [LearnedCurve(n, c, np.zeros((0, 2)), units[n]) for n, c in pairs.items()]
    axis = AXES.index(family.axis) if isinstance(family, SensorCurve) else 2
    left: list[Array] = []
    places: dict[str, list[Array]] = {name: [] for name in pairs}
    for i in residual.runs:
        run, scenario = link.runs[i], link.runs[i].scenario
        rows = np.flatnonzero(run.touching & np.isfinite(run.sigma[:, axis]))
        left.append((run.measured - link.shown(i, [*law.known, law.effect]))[rows, axis])
        late = round(link.lateness(i, law.known) / scenario.tick)
        depth, felt = link.penetration(i), np.clip(rows - late, 0, run.rows - 1)
        rate = np.gradient(depth, scenario.tick)
        series = {"penetration": depth, "rate": rate, "spring": depth, "spring_rate": rate}
        if "stretch" in pairs:
            ends = pairs["stretch"][0, 0], pairs["stretch"][-1, 0]
            series["stretch"] = stretches(depth, *ends, scenario.mechanism.captured)
        for name, found in places.items():
            reading = name == "reading"
            found.append(link.shown(i, law.known)[rows, axis] if reading else series[name][felt])
    remains = np.concatenate(left)
    step, out = max(1, len(remains) // MAX_SAMPLES), []
    for name, curve in pairs.items():
        x = np.concatenate(places[name])
        inside = np.interp(x, curve[:, 0], curve[:, 1]) + remains
        if name.startswith("spring"):  # a factor on a vanishing force cannot be determined
            inside = np.full(len(x), np.nan)
        out.append(LearnedCurve(name, curve, np.column_stack([x, inside])[::step], units[name]))
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
