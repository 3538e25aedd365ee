"""Stage "explain": starts for the fit of a platform with stiction.

Each jump begins where the last one ended, so that some hundred jumps in a row end in the right
place only for a stick that is right to 1e-5 and for the right instants within a tick: chi-square is
rugged. But it has few values: the path changes only where the stick passes the length of a jump,
and each replay tells how far the next such place is. So all paths are compared for every number of
instants a tick, first on the beginning of the slowest run, which jumps least; those that fit are
followed over more and more rows.

Where clocks are off, the jumps tell it: each shows between which rows the command was obeyed that
the axis is held at from then on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import median_abs_deviation

from hiltestbed.diagnosis.links import PlatformLink, Timing
from hiltestbed.diagnosis.links.base import padded
from hiltestbed.diagnosis.residual import square
from hiltestbed.diagnosis.settings import MIN_DEPARTURE, MIN_POSE_NOISE, SIGNIFICANCE_SIGMA
from hiltestbed.frames import Array
from hiltestbed.measured.noise import MAD_TO_SIGMA
from hiltestbed.replay.stiction import Followed, Obeying, all_paths

DEPARTURE_SIGMA = 6.0  # chosen: times the noise: a departure that may be a stick
INSTANTS = range(2, 201)  # a tick
# chosen: rows and jumps that are replayed in a scan: some two seconds; the best are followed first
SCAN_BUDGET = 1e8
MIN_SCAN_ROWS = 50  # chosen: rows of the first scan
SCAN_TRAVEL = 6.0  # chosen: of the largest stick: travel of the command in the first scan
# chosen: quantile of the departures that are about a stick: in uniform motion they are even between
# none and a stick
LARGEST = 0.98
ROW_GROWTH = 1.5  # chosen: times as many rows in each next scan
MAX_SCAN_ROWS = 4000  # chosen: rows of the last scan
# chosen: with the same instants, in a scan; stretches of sticks that are followed to the next
MAX_PATHS, MAX_STRETCHES = 20000, 8
# chosen: chi-square of a sample, so that a jump in the wrong row counts no more however far it goes
MAX_SAMPLE_CHI2 = 25.0
# chosen: chi-square above the best with these instants, within which a path is followed,
PATH_MARGIN = 2.0 * MAX_SAMPLE_CHI2
ROW_MARGIN = 0.1  # chosen: and for each row
# chosen: times the best of all paths, and more: the same
MAX_CHI2_RATIO, RATIO_MARGIN = 1.5, 4.0 * PATH_MARGIN
MAX_SHARE = 0.7  # chosen: of the chi-square without stiction: what no stick betters is none
# chosen: times the least chi-square: starts with other instants that are given, too
MAX_WORSE = 2.0
# chosen: times the chi-square under the timing of the link, with which another timing is taken
MAX_OTHER_CHI2 = 0.8
# chosen: sticks for each number of instants; such numbers, beside that of the believed physics
MAX_STARTS, MAX_INSTANTS = 4, 2
# chosen: of the noise: travel of the command between two phases that are tried; such phases
PHASE_SIGMA, MAX_PHASES = 0.3, 100
# chosen: of the noise by third differences of an axis that jumps; ten times was seen
MAX_OVERESTIMATE = 20.0
LATEST = 2.5  # ticks: by which a pose may be stamped early or late, and more than that
# chosen: ticks; steps to either side, among which the best fit is sought last
LATE_STEP, LATE_STEPS, LATE_HALVINGS = 0.01, 8, 3
STICK_SPAN = 1e-4  # chosen: of a stick, to either side: the same
# chosen: jumps that tell how late a pose is; share of the most that agree
MIN_JUMPS, AGREEING = 10, 0.99


class Instants(NamedTuple):
    """When a platform may move: ``number`` a tick with a ``phase``, see
    :class:`hiltestbed.platform.parameters.PlatformParameters`; and by how many ticks the command is
    ``late`` that it obeys then.
    """

    number: int
    phase: float
    late: float


@dataclass(frozen=True)
class Paths:
    """P paths that a platform with stiction may take.

    Attributes:
        instants: of a hypothesis. of: (P,) its index for each path. low, high: (P,) [m] the sticks
            that give the path. chi2: (P,).
    """

    instants: Sequence[Instants]
    of: np.ndarray
    low: Array
    high: Array
    chi2: Array

    def __iter__(self) -> Iterator[tuple[Instants, float, float]]:
        """The instants, a stick [m] and chi-square of each path."""
        middle = 0.5 * (self.low + self.high)
        return (
            (self.instants[i], float(s), float(c))
            for i, s, c in zip(self.of, middle, self.chi2, strict=True)
        )

    @classmethod
    def between(cls, instants: Sequence[Instants], low: float, high: float) -> Paths:
        """Those of all ``instants`` with sticks between ``low`` and ``high`` [m]."""
        n = len(instants)
        return cls(instants, np.arange(n), np.full(n, low), np.full(n, high), np.zeros(n))


@dataclass(frozen=True)
class Sticking:
    """What a platform seems to stick at.

    Attributes:
        starts: instants a tick and their phase to sticks [m]; empty where it does not seem to
            stick.
        timing: of the pose, where it is not the believed one.
    """

    starts: Mapping[tuple[int, float], Sequence[float]]
    timing: Timing | None = None


def sticking(link: PlatformLink, noise: float, substeps: int) -> Sticking:
    """Starts for stiction; noise: of the pose [m]; substeps: believed instants a tick."""
    data = Data(link, noise)
    if not data.departs(link):
        return Sticking({})
    shift = link.timing.delay + link.timing.obeyed
    found = data.paths([Instants(m, 0.0, shift / data.tick) for m in sorted({substeps, *INSTANTS})])
    late = data.late()
    if late is None:
        return Sticking(_starts(found, substeps))
    other = data.paths(data.phases(late))
    if not len(other.chi2) or (len(found.chi2) and MAX_OTHER_CHI2 * found.chi2[0] <= other.chi2[0]):
        return Sticking(_starts(found, substeps))
    (m, phase, late), stick, _ = next(iter(data.placed(other)))
    whole = math.floor(late)
    return Sticking(
        {(m, phase): [stick]}, Timing(obeyed=(late - whole) * data.tick, delay=whole * data.tick)
    )


def _starts(found: Paths, believed: int) -> dict[tuple[int, float], list[float]]:
    """Sticks of the best paths, for each number of instants that fits about as well as the best."""
    out: dict[tuple[int, float], list[float]] = {}
    for (m, phase, _), stick, chi2 in found:
        others = sum(number != believed for number, _ in out)
        if chi2 > MAX_WORSE * found.chi2[0] or (
            (m, phase) not in out and m != believed and others >= MAX_INSTANTS
        ):
            continue
        if len(sticks := out.setdefault((m, phase), [])) < MAX_STARTS:
            sticks.append(stick)
    return out


def _stretches(found: Paths, margin: float) -> Paths:
    """The stretches of sticks whose paths are no worse than the best by more than a ``margin``."""
    if not len(found.chi2):
        return found
    best = np.full(len(found.instants), np.inf)
    np.minimum.at(best, found.of, found.chi2)
    order = np.lexsort((found.low, found.of))
    fits = order[found.chi2[order] <= best[found.of[order]] + margin]
    of, low, high, chi2 = found.of[fits], found.low[fits], found.high[fits], found.chi2[fits]
    apart = np.flatnonzero((of[1:] != of[:-1]) | (low[1:] != high[:-1]))
    first, last = np.r_[0, apart + 1], np.r_[apart, len(of) - 1]
    least = np.minimum.reduceat(chi2, first)
    kept: list[int] = []
    count: dict[int, int] = {}
    for i in np.argsort(least, kind="stable").tolist():
        h = int(of[first[i]])
        count[h] = count.get(h, 0) + 1
        if count[h] <= MAX_STRETCHES:
            kept.append(i)
    return Paths(found.instants, of[first[kept]], low[first[kept]], high[last[kept]], least[kept])


def _speed(command: Array) -> float:
    """Largest travel of a command (N, >= 3) in a row [m]."""
    return float(np.max(np.abs(np.diff(command[:, :3], axis=0))))


class Data:
    """The runs of a platform, the slowest first, as arrays.

    Attributes:
        order: indices of the runs in the link. tick: [s]. noise: of the pose [m]. commands, goal,
            sigma: (R, N, 3) [m]; goal: the measured
        positions, sigma: infinite where none was measured. rows: (R,). start, velocity: (R, 3) of
            the approach. moves: (R, 3) axes that are commanded to move. whole: rows of the last
            scan. speed: mean travel of all axes in a row [m].
    """

    def __init__(self, link: PlatformLink, noise: float) -> None:
        """noise: [m] of the pose; by third differences, which take jumps for noise. Those of an
        axis that is mostly held do not.
        """
        self.order = np.argsort([_speed(c) for c in link.commands], kind="stable").tolist()
        order, runs = self.order, [link.runs[i] for i in self.order]
        self.tick = runs[0].scenario.tick
        self.commands = padded([link.commands[i][:, :3] for i in order])
        self.goal = padded(
            [
                run.measured[:, :3] - link.deflection[i][:, :3]
                for i, run in zip(order, runs, strict=True)
            ]
        )
        self.rows = np.array([run.rows for run in runs])
        self.speed = float(np.abs(np.diff(self.commands, axis=1)).sum(axis=2).mean())
        self.whole = min(MAX_SCAN_ROWS, int(self.rows.sum()))
        approach = [run.scenario.approach for run in runs]
        self.start = np.array([[*a.offset, -a.gap] for a in approach], dtype=float)
        self.velocity = np.array([a.velocity for a in approach], dtype=float)
        self.moves = (self.velocity != 0.0) | (self.commands != self.start[:, None]).any(axis=1)
        noise = max(noise, MIN_POSE_NOISE)
        steps = [np.diff(self.goal[r, : self.rows[r], axis]) for r, axis in np.argwhere(self.moves)]
        held = [
            float(median_abs_deviation(s)) * MAD_TO_SIGMA / math.sqrt(2.0) for s in steps if len(s)
        ]
        self.noise = max(min([noise, *held]), noise / MAX_OVERESTIMATE)
        sigma = padded([run.sigma[:, :3] for run in runs])
        least = np.min(sigma, axis=(0, 1))
        self.sigma = sigma * np.where(np.isfinite(least), self.noise / least, 1.0)

    def departs(self, link: PlatformLink) -> bool:
        """Whether the slowest run departs from the believed platform by more than its noise and
        rounding, in one row or in all together.
        """
        slowest = self.order[0]
        run = link.runs[slowest]
        sigma = self.sigma[0, 1 : run.rows]
        known = np.isfinite(sigma)
        departed, sigma = np.abs(run.measured - link.shown(slowest))[1:, :3][known], sigma[known]
        alone = (departed - self.noise > DEPARTURE_SIGMA * self.noise) & (
            departed > DEPARTURE_SIGMA * sigma
        )
        return bool(alone.any()) or square(departed / sigma) / max(1, len(departed)) > MIN_DEPARTURE

    def late(self) -> float | None:
        """Ticks by which the pose follows the command late, from the rows between which an axis
        jumps to what the command has been.

        An axis that is held for two rows at least has jumped there between the row before and the
        first of these rows. None where too few jumps show it.
        """
        bounds = np.array(
            [b for r, axis in np.argwhere(self.moves) for b in self._jumps(r, axis)]
        ).reshape(-1, 2)
        if len(bounds) < MIN_JUMPS:
            return None
        tried = np.arange(-LATEST, LATEST, LATE_STEP)
        agree = ((bounds[:, 0] <= tried[:, None]) & (bounds[:, 1] > tried[:, None])).sum(axis=1)
        return float(tried[agree >= AGREEING * agree.max()].mean())

    def _jumps(self, r: int, axis: int) -> Iterable[tuple[float, float]]:
        """The least and the most by which an axis is late [ticks], by each of its jumps."""
        goal = self.goal[r, : self.rows[r], axis]
        command = np.concatenate(
            [self.start[r, axis, None], self.commands[r, : self.rows[r] - 1, axis]]
        )
        ends = np.flatnonzero(np.abs(np.diff(goal)) > SIGNIFICANCE_SIGMA * self.noise)
        first, last = np.r_[0, ends + 1], np.r_[ends, len(goal) - 1]
        held = np.flatnonzero(last > first)
        for before, after in itertools.pairwise(held):
            start = max(last[before] - math.ceil(LATEST) - 1, 0)
            away = (
                command[start : first[after] + math.ceil(LATEST) + 2]
                - goal[first[after] : last[after] + 1].mean()
            )
            passes = np.flatnonzero(away[:-1] * away[1:] <= 0.0)
            if (
                after - before > 2
                or len(passes) != 1
                or abs(away[passes[0] + 1] - away[passes[0]])
                < 2.0 * SIGNIFICANCE_SIGMA * self.noise
            ):
                continue
            k = passes[0]
            at = start + k + away[k] / (away[k] - away[k + 1])
            yield last[before] - at, first[after] - at

    def phases(self, late: float) -> list[Instants]:
        """Numbers of instants with phases a command moves by :data:`PHASE_SIGMA` between."""
        fastest = float(np.abs(np.diff(self.commands, axis=1)).max())
        count = {
            m: min(math.ceil(fastest / (m * PHASE_SIGMA * self.noise)), MAX_PHASES)
            for m in INSTANTS
        }
        return [Instants(m, j / n, late) for m, n in count.items() for j in range(n)]

    def paths(self, instants: Sequence[Instants]) -> Paths:
        """The paths that fit best, best first."""
        obeyed = self._obeyed(instants[0].late)
        low, high = self._sticks(obeyed)
        travel = np.cumsum(np.abs(np.diff(self.commands[0], axis=0)).max(axis=1))
        rows = max(MIN_SCAN_ROWS, int(np.searchsorted(travel, SCAN_TRAVEL * high)) + 1)
        found = Paths.between(instants, low, high)
        while rows < self.whole:
            found = _stretches(self._followed(found, rows), PATH_MARGIN + ROW_MARGIN * rows)
            if not len(found.chi2) or found.chi2[0] > MAX_SHARE * self._unstuck(obeyed, rows):
                return Paths.between([], 0.0, 0.0)
            rows = int(ROW_GROWTH * rows)
        return self._followed(found, self.whole)

    def _unstuck(self, obeyed: Array, rows: int) -> float:
        """Chi-square of a platform that is where the ``obeyed`` command is, on ``rows``."""
        compared = np.arange(self.goal.shape[1])[:, None] < self._compared(rows)[:, None, None]
        z = (self.goal - obeyed) / self.sigma
        return float(np.minimum(z * z, MAX_SAMPLE_CHI2)[compared & self.moves[:, None]].sum())

    def _compared(self, rows: int) -> np.ndarray:
        """(R,) rows of each run, of the first ``rows`` of all."""
        return np.clip(rows - np.concatenate([[0], np.cumsum(self.rows)[:-1]]), 0, self.rows)

    def _obeyed(self, late: float) -> Array:
        """(R, N, 3) command that is obeyed ``late`` [ticks] [m]."""
        at = np.arange(self.goal.shape[1]) - late
        nodes = np.concatenate([self.start[:, None], self.commands], axis=1)
        low = np.clip(np.floor(at).astype(int), 0, len(at) - 1)
        part = np.clip(at - low, 0.0, 1.0)[:, None]
        before = np.minimum(at, 0.0)[:, None] * self.tick * self.velocity[:, None]
        return np.asarray(nodes[:, low] + part * (nodes[:, low + 1] - nodes[:, low]) + before)

    def _sticks(self, obeyed: Array) -> tuple[float, float]:
        """The range of sticks [m]: the largest departures of the slowest run, but for its ends, are
        one, within the travel in a tick.
        """
        rows, noise = self.rows[0], self.noise
        known = np.isfinite(self.sigma[0, :rows]) & self.moves[0]
        away = np.where(known, np.abs(self.goal - obeyed)[0, :rows], 0.0)
        largest = float(np.quantile(away, LARGEST, axis=0).max())
        travel = _speed(self.commands[0])
        least = max(largest - travel - 4.0 * noise, 0.5 * largest, noise)
        return least, largest / LARGEST + travel + noise

    def _followed(self, found: Paths, rows: int, limit: float = math.inf) -> Paths:
        """The paths of ``found`` that fit the first ``rows`` best; limit: chi-square at most."""
        runs, compared = (self.commands, self.goal, self.sigma), self._compared(rows)
        followed = Followed(*runs, compared, self.start, self.velocity, self.moves)
        margin, budget = PATH_MARGIN + ROW_MARGIN * rows, SCAN_BUDGET
        out, buffer = [], np.empty((MAX_PATHS, 3))
        ends = zip(found.of.tolist(), found.low.tolist(), found.high.tolist(), strict=True)
        for h, low, high in ends:
            m, phase, late = found.instants[h]
            obeying, within = Obeying(self.tick, late, m, phase), (MAX_SAMPLE_CHI2, limit, margin)
            count, budget = all_paths(
                followed, obeying, (low, high), *within, self.speed, budget, buffer
            )
            if count:
                out.append(np.column_stack([np.full(count, float(h)), buffer[:count]]))
                limit = min(limit, MAX_CHI2_RATIO * float(buffer[:count, 2].min()) + RATIO_MARGIN)
        each = np.concatenate([np.zeros((0, 4)), *out])
        each = each[np.argsort(each[:, 3], kind="stable")]
        return Paths(found.instants, each[:, 0].astype(int), each[:, 1], each[:, 2], each[:, 3])

    def placed(self, found: Paths) -> Paths:
        """The best path, and those about it with another lateness or phase, best first."""
        steps = range(-LATE_STEPS, LATE_STEPS + 1)
        for halved in range(LATE_HALVINGS):
            (m, phase, late), stick, chi2 = next(iter(found))
            step = LATE_STEP / 2**halved
            near = [
                Instants(m, (phase - m * step * (i + j)) % 1.0, late + i * step)
                for i in steps
                for j in steps
            ]
            about = Paths.between(near, (1.0 - STICK_SPAN) * stick, (1.0 + STICK_SPAN) * stick)
            placed = self._followed(about, self.whole, chi2 + 1.0)
            if len(placed.chi2) and placed.chi2[0] <= chi2:  # else a scan's budget did not suffice
                found = placed
        return found
