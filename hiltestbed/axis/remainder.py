"""What an extended axis leaves of its records: how much, and what it looks like.

Three views of it, none of which names a cause: a quantity that it follows, a range of a quantity in
which half of it stands, and the frequencies that hold half of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.axis.motion import States, even
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import independent
from hiltestbed.inference.residuals import HALF, range_of_half

if TYPE_CHECKING:
    from hiltestbed.axis.models import AxisModel
    from hiltestbed.inference.likelihood import PosteriorFit

PARTS = 10  # of the values of a quantity, with as many rows each
FOLLOWS = 0.2  # share of the squares from which a quantity is worth a look
ALMOST = 0.8  # of the mean squares of the runs: nearly all
CLEARER = 0.9  # of the rows of a range: another quantity tells it better
DENSE = 2.0  # times its share of the rows: half of the squares stand together
RATES = {"position": "", "speed": "/s", "acceleration": "/s^2"}  # of the unit of a position


@dataclass(frozen=True)
class Correlate:
    """A quantity that a residual follows: the share of its squares that the means over parts of the
    quantity hold, the range of the part whose mean is largest, and that mean.
    """

    quantity: str
    share: float
    low: float
    high: float
    mean: float


@dataclass(frozen=True)
class Dense:
    """A range of a quantity in which half of the squares stand, and its share of the rows."""

    quantity: str
    low: float
    high: float
    rows: float


@dataclass(frozen=True)
class Remainder:
    """What is left of an axis, or of a joint of an arm.

    Attributes:
        place: the joint. unit: SI unit of the residual. units: of each quantity. rms, noise: (R,)
            of each run. signal: rms of what is compared, about its mean. follows, dense: what it
            looks like, where it does. band: [Hz] that holds half of it.
    """

    place: str
    unit: str
    units: Mapping[str, str]
    rms: tuple[float, ...]
    noise: tuple[float, ...]
    run: str
    signal: float
    follows: Correlate | None
    dense: Dense | None
    band: tuple[float, float]

    def words(self) -> str:
        """`0.23 to 0.5 N rms, 7 to 36 times the noise and ...`."""
        times = [r / n for r, n in zip(self.rms, self.noise, strict=True)]
        out = [
            f"{f'at the joint {self.place} ' if self.place else ''}{span(self.rms)} {self.unit} "
            f"rms, {span(times, 2)} times the noise and "
            f"{100.0 * max(self.rms) / self.signal:.2g} % of the signal"
        ]
        if self.run:
            out.append(f"nearly all of it is in {self.run}")
        if f := self.follows:
            out.append(
                f"{100.0 * f.share:.0f} % of it follows the {f.quantity}, most where that is "
                f"{between(f.low, f.high)} {self.units[f.quantity]} ({f.mean:+.2g} {self.unit})"
            )
        if d := self.dense:
            out.append(
                f"half of it stands in {100.0 * d.rows:.2g} % of the rows, where the {d.quantity} "
                f"is {between(d.low, d.high)} {self.units[d.quantity]}"
            )
        if not self.follows and not self.dense:
            out.append(f"it follows neither {' nor '.join(self.units)}")
        return f"{'; '.join(out)}; half of its power lies at {span(self.band, 2)} Hz"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"units": dict(self.units), "words": self.words()}


def span(values: Sequence[float], digits: int = 3) -> str:
    """`0.23 to 0.5`; one number where both are the same."""
    ends = [f"{float(f'{v:.{digits}g}'):g}" for v in (min(values), max(values))]
    return " to ".join(dict.fromkeys(ends))


def between(low: float, high: float) -> str:
    """`-0.01 to 0.3`: a range, to a hundredth of its larger end."""
    places = 2 - math.floor(math.log10(max(abs(low), abs(high), 1e-300)))
    return f"{round(low, places):g} to {round(high, places):g}"


def remainder_of(model: AxisModel, fit: PosteriorFit, floors: Array) -> Remainder:
    """What a fit leaves; of an arm, at the joint where it is most beside the noise."""
    rms, left, states = fit.rms(), fit.left[:-1], model.states()
    places: dict[str, list[int]] = {}
    for i, s in enumerate(states):
        places.setdefault(s.place, []).append(i)
    own = max(places.values(), key=lambda rows: float(np.max(rms[rows] / floors[rows])))
    there = [states[i] for i in own]
    scale, turns = there[0].scale, there[0].turns
    length, force = ("rad", "N m") if turns else ("m", "N")
    unit = length if there[0].force is None else force
    units = {name: length + more for name, more in RATES.items()} | {"time": "s"}
    values = dict(zip(units, (_joined(there, part) for part in "xvat"), strict=True))
    if there[0].force is not None:
        units["force"], values["force"] = force, _joined(there, "force")
    y = [scale * left[i] for i in own]
    fullest, held = own[int(np.argmax(rms[own]))], rms[own] ** 2
    alone = len(own) > 1 and held.max() > ALMOST * held.sum()
    compared = [s.x if s.force is None else s.force for s in there]
    signal = np.concatenate([x - np.mean(x) for x in compared])
    return Remainder(
        there[0].place,
        unit,
        units,
        tuple(float(scale * v) for v in rms[own]),
        tuple(float(scale * v) for v in floors[own]),
        model.runs[fullest] if alone else "",
        float(np.sqrt(np.mean(signal**2))),
        _followed(y, values),
        _dense(np.concatenate(y), values),
        _band(y, [s.t for s in there]),
    )


def _joined(states: Sequence[States], part: str) -> Array:
    return np.concatenate([getattr(s, part) for s in states])


def _followed(left: Sequence[Array], values: Mapping[str, Array]) -> Correlate | None:
    """The quantity whose parts have means that hold most of the squares, beyond those of noise."""
    y, count = np.concatenate(left), float(np.sum(independent([*left, np.zeros(0)])))
    found = None
    for name, x in values.items():
        edges = np.quantile(x, np.linspace(0.0, 1.0, PARTS + 1))
        edges = np.unique(np.r_[edges, np.clip(0.0, edges[0], edges[-1])])  # a sign parts it
        if len(edges) < 3:
            continue
        part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        rows = np.bincount(part, minlength=len(edges) - 1)
        means = np.bincount(part, y, len(edges) - 1) / np.maximum(rows, 1)
        held = float(rows @ (means - y.mean()) ** 2) / float(np.sum((y - y.mean()) ** 2))
        free = max(count - len(rows), 1.0)
        share = 1.0 - (1.0 - held) * max(count - 1.0, 1.0) / free
        if share > (found.share if found else FOLLOWS):
            most = int(np.argmax(np.abs(means) * np.sqrt(rows)))
            found = Correlate(
                name, share, float(edges[most]), float(edges[most + 1]), float(means[most])
            )
    return found


def _dense(y: Array, values: Mapping[str, Array]) -> Dense | None:
    """The range of a quantity in which half of the squares stand in the fewest rows."""
    found = None
    for name, x in values.items():
        low, high = range_of_half(x, y)
        rows = float(np.mean((x >= low) & (x <= high)))
        if rows < (CLEARER * found.rows if found else HALF / DENSE):
            found = Dense(name, low, high, rows)
    return found


def _band(left: Sequence[Array], times: Sequence[Array]) -> tuple[float, float]:
    """The shortest range of frequencies [Hz], by their logarithm, with half of the power."""
    places, sizes = [], []
    for y, t in zip(left, times, strict=True):
        at, x = even(t, y)
        places.append(np.log(np.fft.rfftfreq(len(x), float(np.median(np.diff(at))))[1:]))
        sizes.append(np.abs(np.fft.rfft(x - np.mean(x)))[1:] / np.sqrt(len(x)))
    low, high = range_of_half(np.concatenate(places), np.concatenate(sizes))
    return float(np.exp(low)), float(np.exp(high))
