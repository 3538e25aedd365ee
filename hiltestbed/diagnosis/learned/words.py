"""A learned law as a short equation, where one fits, and the named effects that it resembles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from hiltestbed.config.piecewise import Pairs
from hiltestbed.diagnosis.explain import Explanation, effects_of
from hiltestbed.diagnosis.learned.learn import Law
from hiltestbed.diagnosis.settings import MAX_EQUATION_ERROR, MIN_RESEMBLANCE
from hiltestbed.frames import Array

CURVE_POINTS = 200  # chosen: of a curve at which an equation is compared with it
MAX_RESEMBLING = 3  # named effects that are listed
RESEMBLING_LINKS = ("contact", "sensor", "platform")


class Form(NamedTuple):
    """A sum of terms with a coefficient each; a term is a function of the abscissa and its name."""

    terms: tuple[tuple[Callable[[Array], Array], str], ...]


def _power(n: int, name: str) -> tuple[Callable[[Array], Array], str]:
    odd = f"{name}^{n}" if n % 2 or name in "xw" else f"|{name}|^{n - 1} {name}"
    return (lambda x: np.sign(x) * np.abs(x) ** n), (name if n == 1 else odd)


def _forms(name: str) -> tuple[tuple[Form, ...], tuple[Form, ...]]:
    """Forms of one term, and of several."""
    step, size = ((lambda x: np.ones_like(x)), ""), (np.abs, f"|{name}|")
    one, two, three = (_power(n, name) for n in (1, 2, 3))
    more = (
        (step, one),
        (one, size),
        (one, two),
        (one, three),
        (step, one, two),
        (step, one, three),
    )
    return tuple(Form((term,)) for term in (step, one, size, two, three)), tuple(
        Form(terms) for terms in more
    )


def equation_of(curve: Pairs, name: str) -> str | None:
    """`-1.2e+04 x + 3.1e+09 x^3` of a curve over ``name``, with the fewest terms that leave at most
    a twentieth; None where no terms do.
    """
    if not curve:
        return ""
    places, values = np.array(curve).T
    x = np.linspace(places[0], places[-1], CURVE_POINTS)
    y = np.interp(x, places, values)
    size = float(np.sqrt(np.mean(y**2)))
    single, several = _forms(name)
    tries = (
        lambda: _as_sum(x, y, size, single),
        lambda: _as_power(x, y, size, name),
        lambda: _as_sum(x, y, size, several),
    )
    return next((words for attempt in tries if (words := attempt())), None) or _as_kink(
        x, y, size, name
    )


def _as_sum(x: Array, y: Array, size: float, forms: Sequence[Form]) -> str | None:
    """The first form within the allowed error."""
    for form in forms:
        columns = np.column_stack([f(x) for f, _ in form.terms])
        scale = np.abs(columns).max(axis=0)
        found = np.linalg.lstsq(columns / scale, y, rcond=None)[0] / scale
        if np.sqrt(np.mean((columns @ found - y) ** 2)) <= MAX_EQUATION_ERROR * size:
            return _sum(zip(found, [word for _, word in form.terms], strict=True))
    return None


def _sum(terms: object) -> str:
    out = ""
    for number, word in terms:  # type: ignore[attr-defined]
        sign = " - " if number < 0 else " + "
        out += (
            sign if out else sign.strip() if number < 0 else ""
        ) + f"{abs(number):.3g}{' ' if word else ''}{word}"
    return out


def _as_power(x: Array, y: Array, size: float, name: str) -> str | None:
    """a x^n."""
    depth = np.abs(x) / np.abs(x).max()
    side = np.sign(x)
    best = None
    for n in np.linspace(0.5, 5.0, 91):
        column = side * depth**n
        a = float(column @ y / (column @ column))
        left = float(np.sqrt(np.mean((a * column - y) ** 2)))
        if best is None or left < best[0]:
            best = (left, a / np.abs(x).max() ** n, n)
    if best is None or best[0] > MAX_EQUATION_ERROR * size:
        return None
    return f"{best[1]:.3g} {name}^{best[2]:.2f}"


def _as_kink(x: Array, y: Array, size: float, name: str) -> str | None:
    """a x + b max(|x| - w, 0), on either side of 0."""
    most = float(np.abs(x).max())

    def columns(w: float) -> Array:
        return np.column_stack([x, np.sign(x) * np.maximum(np.abs(x) - w, 0.0)])

    def left(w: Array) -> Array:
        c = columns(float(w[0]) * most)
        return c @ np.linalg.lstsq(c, y, rcond=None)[0] - y

    found = min(
        (least_squares(left, [w], bounds=(0.0, 0.98)) for w in (0.2, 0.5, 0.8)),
        key=lambda f: f.cost,
    )
    if np.sqrt(np.mean(found.fun**2)) > MAX_EQUATION_ERROR * size:
        return None
    w = float(found.x[0]) * most
    a, b = np.linalg.lstsq(columns(w), y, rcond=None)[0]
    first = f"{a:.3g} {name} " if abs(a) > MAX_EQUATION_ERROR * abs(b) else ""
    inside = f"{name} - {w:.3g}" if x.min() >= 0.0 else f"|{name}| - {w:.3g}"
    sign = ("- " if b < 0 else "+ ") if first else ("-" if b < 0 else "")
    return f"{first}{sign}{abs(b):.3g} max({inside}, 0){'' if x.min() >= 0.0 else f' sgn {name}'}"


SYMBOLS = {
    "penetration": ("x", "f(x)"),
    "rate": ("v", "g(v)"),
    "stretch": ("s", "h(s)"),
    "spring": ("x", "p(x)"),
    "spring_rate": ("v", "q(v)"),
    "reading": ("w", "f(w)"),
}


def equation(law: Law) -> str | None:
    """The equation of the whole law; a curve without an equation is a letter; None where no curve
    has one.
    """
    curves = law.family.curves(law.values, law.choices)
    if law.effect.link == "platform":
        return second_order_of(curves[0])
    parts, short, reach = [], False, ""
    for b, curve in zip(law.family.blocks, curves, strict=True):
        if not curve:
            continue
        name, symbol = SYMBOLS[b.name]
        words = equation_of(curve, name)
        short |= bool(words)
        parts.append(f"({words or symbol}) k x" if b.part else words or symbol)
        reach = f", s' = v within {curve[-1][0]:.3g} m" if b.name == "stretch" else reach
    if not short:
        return None
    text = "shown = w" if law.effect.link == "sensor" else "F = k x + c v"
    for part in parts:
        text += f" - {part[1:].lstrip()}" if part.startswith("-") else f" + {part}"
    return text + reach


def second_order_of(curve: Pairs) -> str | None:
    """The delay, natural frequency and damping ratio of a step response, with its last value as
    gain; None where it is not second order.
    """
    times, values = np.array(curve).T
    t, end = np.linspace(times[0], times[-1], CURVE_POINTS), values[-1]
    y = np.interp(t, times, values)
    size = float(np.sqrt(np.mean((y - end) ** 2)))

    def step(p: Array) -> Array:
        w, zeta, since = np.exp(p[0]), min(p[1], 0.999), np.maximum(t - p[2], 0.0)
        s = w * np.sqrt(1.0 - zeta**2)
        return end * (
            1.0 - np.exp(-zeta * w * since) * (np.cos(s * since) + zeta * w / s * np.sin(s * since))
        )

    starts = [(np.log(part / times[-1]), 0.6, 0.1 * times[-1]) for part in (1.0, 3.0, 10.0)]
    bounds = ((np.log(0.1 / times[-1]), 0.02, 0.0), (np.log(100.0 / times[-1]), 0.999, times[-1]))
    found = min(
        (least_squares(lambda p: step(p) - y, x, bounds=bounds) for x in starts),
        key=lambda f: f.cost,
    )
    if size == 0.0 or np.sqrt(np.mean(found.fun**2)) > MAX_EQUATION_ERROR * size:
        return None
    w, zeta, late = float(np.exp(found.x[0])), float(found.x[1]), float(found.x[2])
    share = "" if abs(end - 1.0) < 1e-3 else f"{end:.3g} "
    return (
        f"x'' = w^2 ({share}x_cmd(t - {late:.2g} s) - x) - {2.0 * zeta:.2g} w x', w = 2 "
        f"pi {w / (2.0 * np.pi):.3g} Hz"
    )


def resembling(found: Explanation, law: Law) -> tuple[str, ...]:
    """Named effects that, fitted alone, remove from the residual what the law does: by the cosine
    between the two reductions.
    """
    residual = found.residual()
    before, after, null = residual.many([law.known, [*law.known, law.effect], ()])
    taken, alike = before - after, {}
    for f in found.singles():
        (effect,) = effects_of(f)
        if effect.link not in RESEMBLING_LINKS:
            continue
        other = null - residual([effect])
        length = float(np.linalg.norm(taken) * np.linalg.norm(other))
        if length > 0.0:
            alike[effect.kind] = float(taken @ other) / length
    near = sorted(
        (kind for kind, cosine in alike.items() if cosine > MIN_RESEMBLANCE),
        key=lambda kind: -alike[kind],
    )
    return tuple(near[:MAX_RESEMBLING])
