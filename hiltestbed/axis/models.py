"""The models of the kinds of axis: what each predicts, from which recorded signal."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hiltestbed.axis import servo
from hiltestbed.axis.effects.base import AXIS_EFFECTS, AxisKind, RecordScale, applied
from hiltestbed.axis.inverse import RESOLVED_SIGMA, InverseRecord, blocks_of, rows_of
from hiltestbed.axis.law import (
    BEYOND,
    BEYOND_BACK,
    GAIN,
    OFFSET,
    VISCOUS,
    VISCOUS_BACK,
    AxisLaw,
    force_along,
    motion_under,
    stroke_before,
)
from hiltestbed.axis.motion import Motion, States, even, motion_of, noise_of, related
from hiltestbed.effects.departure import Departure
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.model import FEWEST, FOLDS, Hypothesis, Model, Nuisance

# [rows] standard deviation of the offset between the time stamps of input and output: loggers stamp
# either up to a row late, uniformly
STAMP_SIGMA = 1.0 / math.sqrt(3.0)
# of the range of an output, standard deviation of its zero from run to run: what a tare or a homing
# leaves
ZERO_ERROR = 0.01
LONGEST_RESPONSE = 1e-2  # [s] of a step of a servo, which is exact but for limits and turns
RESISTANCES = ("viscous", "coulomb", "offset")  # numbers of a nominal drive
LONGEST_STEP = 1e-3  # [s] of an integration; friction and controllers of machines are slower
STEPS_A_RADIAN = 4.0  # steps of an integration per radian of the fastest response
START_ROWS = 24  # rows from which the state at the start is estimated
NOT_MEASURED = np.zeros(0)
START_STEPS = 2  # of Gauss-Newton: a motion is all but linear in its start
# of the mean speed of the first rows, by which their slope is a difference; [m/s] of rows at rest
START_NUDGE = 1e-3
# of the largest input, rms difference of two runs that count as repeats of one
REPEATED = 0.02
COPIED = 1e-6  # of the range of an output: a straight line of its input leaves less


class AxisRun(NamedTuple):
    """One record of an axis: times [s], recorded input and output, (N,) each, in SI units."""

    name: str
    t: Array
    u: Array
    y: Array


class AxisModel(Model):
    """A model of one axis.

    Attributes:
        kind: of the axis. records: of the runs. nominal: the owner's numbers. rotates: whether
            positions are angles.
    """

    kind: AxisKind

    def __init__(
        self,
        records: Sequence[AxisRun],
        nominal: Mapping[str, float],
        rotates: bool = False,
        believed: Sequence[Departure] = (),
    ) -> None:
        """``believed``: effects that are part of the nominal model."""
        self.records, self.nominal, self.rotates = tuple(records), dict(nominal), rotates
        self.believed = tuple(believed)
        self.runs = tuple(r.name for r in records)
        self.ticks = np.array([float(np.median(np.diff(r.t))) for r in records])
        tick = float(np.median(self.ticks))
        self.nuisances = (Nuisance("time-stamp offset", "s", STAMP_SIGMA * tick, tick),)
        self._prepare()

    def on(self, runs: Sequence[int]) -> AxisModel:
        return self.of([self.records[i] for i in runs])

    def of(self, records: Sequence[AxisRun]) -> AxisModel:
        """The same model of other records."""
        return type(self)(records, self.nominal, self.rotates, self.believed)

    @abstractmethod
    def candidates(self) -> tuple[Candidate, ...]:
        """Every part of every effect that acts on this kind of axis."""

    def turns(self, cause: Candidate) -> bool:
        """Whether what a cause acts on turns, so that its forces are torques."""
        return self.rotates

    def _parts(self, scale: RecordScale) -> tuple[Candidate, ...]:
        effects = [e for e in AXIS_EFFECTS.values() if self.kind in e.axes]
        return tuple(c for effect in effects for c in effect.parts(scale))

    @abstractmethod
    def _prepare(self) -> None:
        """What the predictions need, computed once."""

    @abstractmethod
    def predicted(self, of: Hypothesis) -> list[Array]:
        """(N,) output of each record at its own times, in the unit of the record."""

    @abstractmethod
    def states(self) -> list[States]:
        """Where the axis is at each value of the :meth:`residuals` of each record."""

    def measured(self) -> list[Array]:
        """(N,) what :meth:`predicted` is compared with."""
        return [r.y for r in self.records]

    def departure(self, of: Hypothesis) -> list[Array]:
        return self.scored(of)

    def residuals(self, of: Hypothesis) -> list[Array]:
        """Less their means, and the priors of what was taken off."""
        left = self._compared(of)
        means = np.array([float(np.mean(x)) for x in left])
        priors = np.concatenate([of.nuisances / self.prior_sigma(), means / self._zeros()])
        return [*(x - m for x, m in zip(left, means, strict=True)), priors]

    def _compared(self, of: Hypothesis) -> list[Array]:
        """(N,) measured less predicted of each record, with its zero."""
        return [y - p for y, p in zip(self.measured(), self.predicted(of), strict=True)]

    def _zeros(self) -> Array:
        """(R,) standard deviation of the zero of each output."""
        return np.array([ZERO_ERROR * float(np.ptp(y)) for y in self.measured()])

    def scored(self, of: Hypothesis) -> list[Array]:
        # less the offset of its run, as far as its zero may be off
        pairs = zip(self._compared(of), 2.0 * self._zeros(), strict=True)
        return [x - min(max(float(np.mean(x)), -most), most) for x, most in pairs]

    def of_recorded(self) -> list[list[int]]:
        """The records of each of the :attr:`recorded`, by number."""
        return [[i] for i in range(len(self.records))]

    def of_folds(self) -> list[list[int]]:
        """The records of which each of the :meth:`folds` leaves out something, by number."""
        each = self.of_recorded()
        return each if len(each) >= FEWEST else [list(range(len(self.records)))] * FOLDS

    def tells_nothing(self) -> str | None:
        """Why records tell nothing of an axis; None where they do."""
        for r in self.records:
            if float(np.ptp(r.u)) == 0.0:
                return f"The input of {r.name} is constant."
            if float(np.ptp(r.y)) == 0.0:
                return f"The output of {r.name} is constant."
            slope, zero = np.polyfit(r.u, r.y, 1)
            if float(np.abs(r.y - slope * r.u - zero).max()) < COPIED * float(np.ptp(r.y)):
                return f"The output of {r.name} is {slope:.6g} times its input: it is a copy of it."
        if not any(related(r.t, *self.moved(r)) for r in self.records):
            return (
                "In no run do input and output have to do with each other: the same motion at "
                "another pace would match as well."
            )
        return None

    def moved(self, r: AxisRun) -> tuple[Array, Array]:
        """Position and force of a record, or command and position."""
        return r.u, r.y

    def repeatability(self) -> Array:
        """(R,) rms by which the output of a run differs from that of a repeat of it, over the root
        of two; 0 where a run has none.
        """
        out = np.zeros(len(self.records))
        for i, a in enumerate(self.records):
            for b in self.records[:i]:
                n = min(len(a.u), len(b.u))
                size = float(np.abs(a.u[:n]).max())
                if float(np.sqrt(np.mean((a.u[:n] - b.u[:n]) ** 2))) <= REPEATED * size:
                    apart = float(np.sqrt(np.mean((a.y[:n] - b.y[:n]) ** 2) / 2.0))
                    out[i], j = max(out[i], apart), self.records.index(b)
                    out[j] = max(out[j], apart)
        return out

    def _scale(
        self, places: Sequence[Array], motions: Sequence[Motion], **more: Any
    ) -> RecordScale:
        """Of places and the motions through them, but for their most extreme thousandths."""
        ends = (float(np.ptp(np.quantile(x, (0.001, 0.999)))) for x in places)
        return RecordScale(
            travel=max(ends) or 1.0,
            speed=largest([m.v for m in motions]),
            acceleration=largest([m.a for m in motions]),
            tick=float(np.median(self.ticks)),
            rotates=self.rotates,
            **{"duration": max(float(m.t[-1] - m.t[0]) for m in motions), **more},
        )


def largest(values: Sequence[Array]) -> float:
    """The largest size of signals, but for their most extreme thousandths."""
    return max(float(np.quantile(np.abs(v), 0.999)) for v in values) or 1e-12


def damper_law(nominal: Mapping[str, float], effects: Sequence[Departure]) -> AxisLaw:
    """The law of a damper with these nominal numbers and ``effects``."""
    law = AxisLaw(0.0, 1.0, nominal.get("stiffness", 0.0))
    law.numbers[[VISCOUS, VISCOUS_BACK, BEYOND, BEYOND_BACK]] = nominal.get("damping", 0.0)
    law.numbers[OFFSET] += nominal.get("preload", 0.0)
    return applied(effects, law)


def drive_law(nominal: Mapping[str, float], effects: Sequence[Departure]) -> AxisLaw:
    """The law of a drive with these nominal numbers and ``effects``."""
    law = AxisLaw(nominal.get("mass", 1.0), nominal.get("gain", 1.0))
    believed = {k: v for k, v in nominal.items() if k in RESISTANCES}
    if believed:
        AXIS_EFFECTS["dynamics.force"].hypothesis({}, **believed).apply(law)
    return applied(effects, law)


def servo_numbers(nominal: Mapping[str, float], effects: Sequence[Departure]) -> Array:
    """The numbers of the response of a servo with these nominal numbers and ``effects``."""
    p = servo.following()
    p[servo.DELAY] = nominal.get("delay", 0.0)
    if "bandwidth" in nominal:
        p[servo.BANDWIDTH] = 2.0 * math.pi * nominal["bandwidth"]
        p[servo.ZETA] = nominal.get("damping_ratio", 0.7)
    return applied(effects, p)


class DamperModel(AxisModel):
    """Force over displacement; nominal: ``stiffness``, ``damping``, ``preload``."""

    kind = "damper"

    def _prepare(self) -> None:
        self._rows: list[
            tuple[Motion, Array, Array, np.ndarray]
        ] = []  # motion, force, its slope, kept
        for r in self.records:
            t, x, y = even(r.t, r.u, r.y)
            motion = motion_of(t, x)
            few = np.arange(len(t))[rows_of(motion)]
            rows = np.union1d(few, motion.turns(RESOLVED_SIGMA))  # dry friction remembers them
            kept = np.isin(rows, few[1:])  # how it stood before the first row is not known
            self._rows.append((motion.thinned(rows), y[rows], motion_of(t, y).v[rows], kept))
        self.floors = np.array([noise_of(r.y) for r in self.records])

    def candidates(self) -> tuple[Candidate, ...]:
        m = [m for m, *_ in self._rows]
        scale = self._scale(
            [x.x for x in m],
            m,
            force=largest([y for _, y, *_ in self._rows]),
            stiffness=self.nominal.get("stiffness", 0.0),
            damping=self.nominal.get("damping", 0.0),
        )
        return self._parts(scale)

    def states(self) -> list[States]:
        return [
            States(m.t[kept], m.x[kept], m.v[kept], m.a[kept], y[kept], turns=self.rotates)
            for m, y, _, kept in self._rows
        ]

    def _compared(self, of: Hypothesis) -> list[Array]:
        late = float(of.nuisances[0])
        rows = zip(self._rows, self._force(of), strict=True)
        return [(y + late * slope - f)[kept] for (_, y, slope, kept), f in rows]

    def predicted(self, of: Hypothesis) -> list[Array]:
        late = float(of.nuisances[0])
        return [
            np.interp(r.t - late, m.t, f)
            for r, (m, *_), f in zip(self.records, self._rows, self._force(of), strict=True)
        ]

    def _force(self, of: Hypothesis) -> list[Array]:
        """(N,) at the even times."""
        law = damper_law(self.nominal, (*self.believed, *of.effects()))
        return [along(m, law, y[:START_ROWS]) for m, y, *_ in self._rows]


class DriveModel(AxisModel):
    """Position under a recorded force or current; nominal: ``mass``, ``gain``, and what of friction
    the owner believes: ``viscous``, ``coulomb``, ``offset``.

    Causes are sought on the inverse model (:mod:`hiltestbed.axis.inverse`): a mass that is driven
    integrates each error twice, so that its position tells less of what caused it than its force.
    """

    kind = "drive"
    stretches = 4  # it integrates: what is left out has to last, or its neighbours tell it

    def _prepare(self) -> None:
        inertial = self.nominal.get("mass", 0.0) / self.nominal.get("gain", 1.0)
        self._inverse = []
        for r in self.records:
            t, u, y = even(r.t, r.u, r.y)
            m = motion_of(t, y)
            self._inverse.append(InverseRecord.of(m, u, inertial * m.shaken, blocks_of(m)))
        self.floors = np.array([r.floor for r in self._inverse])

    def tells_nothing(self) -> str | None:
        for r, inverse in zip(self.records, self._inverse, strict=True):
            if inverse.blocks < self.stretches:
                return f"The axis does not move in {r.name}, but for the noise of its position."
        return super().tells_nothing()

    def candidates(self) -> tuple[Candidate, ...]:
        m = [r.motion for r in self._inverse]
        scale = self._scale(
            [x.x for x in m],
            m,
            force=largest([r.input * self.nominal.get("gain", 1.0) for r in self._inverse]),
            resists=any(self.nominal.get(k, 0.0) for k in RESISTANCES) or bool(self.believed),
        )
        return self._parts(scale)

    def _law(self, of: Hypothesis) -> AxisLaw:
        return drive_law(self.nominal, (*self.believed, *of.effects()))

    def residuals(self, of: Hypothesis) -> list[Array]:
        law, late = self._law(of), float(of.nuisances[0])
        left = [r.left(along(r.motion, law) / law.numbers[GAIN], late) for r in self._inverse]
        return [*left, of.nuisances / self.prior_sigma()]

    def scored(self, of: Hypothesis) -> list[Array]:
        return self.residuals(of)[:-1]

    def moved(self, r: AxisRun) -> tuple[Array, Array]:
        return r.y, r.u

    def states(self) -> list[States]:
        return [r.states(self.nominal.get("gain", 1.0), self.rotates) for r in self._inverse]

    def departure(self, of: Hypothesis) -> list[Array]:
        return self._compared(of)

    def in_time(self) -> MovedModel | None:
        return MovedModel(self.records, self.nominal, self.rotates, self.believed)

    def predicted(self, of: Hypothesis) -> list[Array]:
        law, late = self._law(of), float(of.nuisances[0])
        out = []
        for r in self.records:
            x0, v0 = started(r, late, law.numbers)
            out.append(motion_under(r.t, r.u, late, x0, v0, law.numbers, LONGEST_STEP))
        return out


class MovedModel(DriveModel):
    """A drive by its motion alone: the residual is that of the simulated position, over all of a
    run. What it leaves is a random walk, of which few samples are independent; what it fits is what
    the owner of a simulation wants.
    """

    def _prepare(self) -> None:
        super()._prepare()
        self.floors = np.array([noise_of(r.y) for r in self.records])

    def residuals(self, of: Hypothesis) -> list[Array]:
        return [*self.departure(of), of.nuisances / self.prior_sigma()]

    def in_time(self) -> None:
        return None


class ServoModel(AxisModel):
    """Position under a command; the nominal axis follows it."""

    kind = "servo"

    def _prepare(self) -> None:
        self.floors = np.array([noise_of(r.y) for r in self.records])

    def candidates(self) -> tuple[Candidate, ...]:
        scale = self._scale(
            [r.y for r in self.records],
            [motion_of(t, y) for t, y in (even(r.t, r.y) for r in self.records)],
            force=0.0,
            duration=max(float(r.t[-1] - r.t[0]) for r in self.records),
        )
        return self._parts(scale)

    def states(self) -> list[States]:
        out = []
        for r in self.records:
            t, y = even(r.t, r.y)
            m = motion_of(t, y)
            x, v, a = (np.interp(r.t, m.t, part) for part in (m.x, m.v, m.a))
            out.append(States(r.t, x, v, a, turns=self.rotates))
        return out

    def predicted(self, of: Hypothesis) -> list[Array]:
        p = servo_numbers(self.nominal, (*self.believed, *of.effects()))
        p[servo.DELAY] += float(of.nuisances[0])
        fastest = max(p[servo.BANDWIDTH] * max(1.0, p[servo.ZETA]), 1e-9)
        step = min(LONGEST_RESPONSE, 1.0 / (STEPS_A_RADIAN * fastest))
        return [servo.response(r.t, r.u, float(r.y[0]), p, step) for r in self.records]


def started(r: AxisRun, late: float, law: Array) -> tuple[float, float]:
    """Position and speed at the first row of a record, of the motion by the numbers of the ``law``
    that comes closest to the first rows; its input acts ``late`` [s] after its stamps.
    """
    t, u, y = r.t[:START_ROWS], r.u[:START_ROWS], r.y[:START_ROWS]
    start = np.array([y[0], float(np.polyfit(t - t[0], y, 2)[1])])
    nudge = START_NUDGE * float(np.ptp(y)) / (t[-1] - t[0]) or START_NUDGE
    for _ in range(START_STEPS):
        there, faster = (
            motion_under(t, u, late, start[0], start[1] + more, law, LONGEST_STEP)
            for more in (0.0, nudge)
        )
        slopes = np.column_stack([np.ones(len(t)), (faster - there) / nudge])
        start += np.linalg.lstsq(slopes, y - there, rcond=None)[0]
    return float(start[0]), float(start[1])


def along(m: Motion, law: AxisLaw, first: Array = NOT_MEASURED) -> Array:
    """(N,) force of a ``law`` along a motion, of which the force at its ``first`` rows is known."""
    motion = m.t, m.x, m.v, m.a, m.way, law.numbers, law.sliders, law.branches
    return force_along(*motion, stroke_before(*motion, first))


MODELS: dict[AxisKind, type[AxisModel]] = {
    "damper": DamperModel,
    "drive": DriveModel,
    "servo": ServoModel,
}


def model_of(
    kind: AxisKind,
    records: Sequence[AxisRun],
    nominal: Mapping[str, float] | None = None,
    rotates: bool = False,
    believed: Sequence[Departure] = (),
) -> AxisModel:
    """The model of an axis of this kind."""
    return MODELS[kind](records, nominal or {}, rotates, believed)
