"""A learned law as a short equation, where one fits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.optimize import least_squares

from hiltestbed.config.piecewise import Pairs
from hiltestbed.diagnosis.learned.learn import Law
from hiltestbed.frames import Array

MAX_EQUATION_ERROR = 0.05  # chosen: share of a curve's rms that an equation may leave
CURVE_POINTS = 200  # chosen: of a curve at which an equation is compared with it
EXPONENTS = np.linspace(0.5, 5.0, 91)  # that are tried
SYMBOLS = {
    "penetration": ("x", "f(x)"),
    "rate": ("v", "g(v)"),
    "stretch": ("s", "h(s)"),
    "spring": ("x", "p(x)"),
    "spring_rate": ("v", "q(v)"),
    "reading": ("w", "f(w)"),
}

Term = tuple[Callable[[Array], Array], str]  # a function of the abscissa, and its name


def _power(n: int, name: str) -> Term:
    odd = f"{name}^{n}" if n % 2 or name in "xw" else f"|{name}|^{n - 1} {name}"
    return (lambda x: np.sign(x) * np.abs(x) ** n), (name if n == 1 else odd)


def _forms(name: str) -> tuple[list[Sequence[Term]], list[Sequence[Term]]]:
    """Sums of one term, and of several, in the order in which they are tried."""
    step, size = (np.ones_like, ""), (np.abs, f"|{name}|")
    one, two, three = (_power(n, name) for n in (1, 2, 3))
    more = [(step, one), (one, size), (one, two), (one, three)]
    more += [(step, one, two), (step, one, three)]
    return [(term,) for term in (step, one, size, two, three)], more


def equation_of(curve: Pairs, name: str) -> str | None:
    """`-1.2e+04 x + 3.1e+09 x^3` of a curve over ``name``, with the fewest terms that leave at most
    a twentieth; None where no terms do.
    """
    if not curve:
        return ""
    places, values = np.array(curve).T
    x = np.linspace(places[0], places[-1], CURVE_POINTS)
    y = np.interp(x, places, values)
    most = MAX_EQUATION_ERROR * float(np.sqrt(np.mean(y**2)))
    single, several = _forms(name)
    return (
        _as_sum(x, y, most, single)
        or _as_power(x, y, most, name)
        or _as_sum(x, y, most, several)
        or _as_kink(x, y, most, name)
    )


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(left**2)))


def _as_sum(x: Array, y: Array, most: float, forms: Sequence[Sequence[Term]]) -> str | None:
    """The first form within the allowed error."""
    for form in forms:
        columns = np.column_stack([f(x) for f, _ in form])
        scale = np.abs(columns).max(axis=0)
        found = np.linalg.lstsq(columns / scale, y, rcond=None)[0] / scale
        if _rms(columns @ found - y) <= most:
            return _sum(zip(found, [word for _, word in form], strict=True))
    return None


def _sum(terms: Iterable[tuple[float, str]]) -> str:
    out = ""
    for number, word in terms:
        sign = " - " if number < 0 else " + "
        first = "-" if number < 0 else ""
        out += f"{sign if out else first}{abs(number):.3g}{' ' if word else ''}{word}"
    return out


def _as_power(x: Array, y: Array, most: float, name: str) -> str | None:
    """a x^n."""
    largest = float(np.abs(x).max())
    columns = np.sign(x) * (np.abs(x) / largest) ** EXPONENTS[:, None]
    a = columns @ y / np.sum(columns**2, axis=1)
    left = np.sqrt(np.mean((a[:, None] * columns - y) ** 2, axis=1))
    best = int(np.argmin(left))
    if left[best] > most:
        return None
    n = EXPONENTS[best]
    return f"{a[best] / largest**n:.3g} {name}^{n:.2f}"


def _as_kink(x: Array, y: Array, most: float, name: str) -> str | None:
    """a x + b max(|x| - w, 0), on either side of 0."""
    largest = float(np.abs(x).max())

    def fitted(w: float) -> tuple[Array, Array]:
        columns = np.column_stack([x, np.sign(x) * np.maximum(np.abs(x) - w * largest, 0.0)])
        return columns, np.asarray(np.linalg.lstsq(columns, y, rcond=None)[0], dtype=float)

    def left(w: Array) -> Array:
        columns, found = fitted(float(w[0]))
        return columns @ found - y

    tried = [least_squares(left, [w], bounds=(0.0, 0.98)) for w in (0.2, 0.5, 0.8)]
    best = min(tried, key=lambda f: f.cost)
    if _rms(best.fun) > most:
        return None
    w = float(best.x[0])
    a, b = fitted(w)[1]
    one_sided = x.min() >= 0.0
    first = f"{a:.3g} {name} " if abs(a) > MAX_EQUATION_ERROR * abs(b) else ""
    inside = f"{name if one_sided else f'|{name}|'} - {w * largest:.3g}"
    sign = ("- " if b < 0 else "+ ") if first else ("-" if b < 0 else "")
    return f"{first}{sign}{abs(b):.3g} max({inside}, 0){'' if one_sided else f' sgn {name}'}"


def equation(law: Law) -> str | None:
    """The equation of the whole law; a curve without an equation is a letter; None where no curve
    has one.
    """
    if law.effect.link == "platform":
        return second_order_of(law.curves[0])
    text = "shown = w" if law.effect.link == "sensor" else "F = k x + c v"
    short, reach = False, ""
    for b, curve in zip(law.family.blocks, law.curves, strict=True):
        if not curve:
            continue
        name, symbol = SYMBOLS[b.name]
        words = equation_of(curve, name)
        short |= bool(words)
        part = f"({words or symbol}) k x" if b.part else words or symbol
        text += f" - {part[1:].lstrip()}" if part.startswith("-") else f" + {part}"
        if b.name == "stretch":
            reach = f", s' = v within {curve[-1][0]:.3g} m"
    return text + reach if short else None


def second_order_of(curve: Pairs) -> str | None:
    """The delay, natural frequency and damping ratio of a step response, with its last value as
    gain; None where it is not second order.
    """
    times, values = np.array(curve).T
    last, end = times[-1], values[-1]
    t = np.linspace(times[0], last, CURVE_POINTS)
    y = np.interp(t, times, values)
    most = MAX_EQUATION_ERROR * _rms(y - end)

    def left(p: Array) -> Array:
        w, zeta, since = np.exp(p[0]), min(p[1], 0.999), np.maximum(t - p[2], 0.0)
        s = w * np.sqrt(1.0 - zeta**2)
        swing = np.cos(s * since) + zeta * w / s * np.sin(s * since)
        return end * (1.0 - np.exp(-zeta * w * since) * swing) - y

    starts = [(np.log(part / last), 0.6, 0.1 * last) for part in (1.0, 3.0, 10.0)]
    bounds = ((np.log(0.1 / last), 0.02, 0.0), (np.log(100.0 / last), 0.999, last))
    best = min((least_squares(left, x, bounds=bounds) for x in starts), key=lambda f: f.cost)
    if most == 0.0 or _rms(best.fun) > most:
        return None
    w, zeta, late = float(np.exp(best.x[0])), float(best.x[1]), float(best.x[2])
    share = "" if abs(end - 1.0) < 1e-3 else f"{end:.3g} "
    return (
        f"x'' = w^2 ({share}x_cmd(t - {late:.2g} s) - x) - {2.0 * zeta:.2g} w x', w = 2 "
        f"pi {w / (2.0 * np.pi):.3g} Hz"
    )
