"""Stage "replay": the link wrench: the pose through contact and sensor to wrench_meas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import ndtr

from hiltestbed.contact.parameters import (
    FRICTION,
    ContactParameters,
    believed_contacts,
    contact_rows,
    latch_limits,
)
from hiltestbed.contact.phases import closes
from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.links.base import (
    Effects,
    Lane,
    LinkRun,
    ModelLink,
    Timing,
    flat_pose,
    moved,
    padded,
    perturbed,
)
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.low_pass import LowPass
from hiltestbed.diagnosis.settings import BLOCK_ROWS, UNKNOWN
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.platform.build import runs_of
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.replay import Felt, Simulated, replay_platform, replay_wrench
from hiltestbed.replay.compensation import central_rates
from hiltestbed.replay.wrench import Lane as FeltLane
from hiltestbed.scenario import Scenario
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.signals import GROUPS

NODES, WEIGHTS = hermegauss(8)  # of a standard normal distribution, which reach four deviations
MOST_TOUCHES = 24  # chosen: of a run on a mount, whose instants are not known
STEP_RATIO = 2  # of the steps of a mount, for the extrapolation to steps of zero length
LEVERS = (0.0, 0.25, 0.5, 0.75, 1.0)  # between the surface and the tip
# chosen: of the longest jump: what is shorter is motion of the axes that are held
SHARE_OF_A_JUMP = 0.1
WEIGHTS = WEIGHTS / math.sqrt(2.0 * math.pi)


_NO_LOG_EFFECT = LogParameters()


class Interpretation(NamedTuple):
    """What a facility's description leaves open of how it computes its contact.

    Attributes:
        lever: where between the undeformed surface (0) and the tip (1) the force acts. blunt: 1
            where the ball of the tip touches, 0 where its foremost point does. ring: 1 where a
            latch resists turning, 0 where it does not. grid: instants a tick between which a late
            reading is interpolated linearly, as by a facility that computes its contact step by
            step; None: it is the reading at the instant at which it left the contact. The rate of a
            contact jumps from one tick to the next, so that the two differ.
        exact: whether a mount is integrated to second order, and corrected to the exact integral by
            what that misses of the believed motion; else it is stepped as by MuJoCo, to first
            order.
    """

    lever: float = 0.5
    blunt: float = 1.0
    ring: float = 1.0
    grid: int | None = None
    exact: bool = False


class _Numbers(NamedTuple):
    """Contacts and sensor of a scenario: contacts of the rules, those of each pair, their rows."""

    contacts: list[ContactParameters]
    rules: Sequence[int]
    rows: Array
    sensor: SensorParameters


def _numbers(scenario: Scenario, reads: Interpretation) -> _Numbers:
    mechanism, own = scenario.mechanism, {k: getattr(reads, k) for k in ("lever", "blunt", "ring")}
    contacts = [replace(c, **own) for c in believed_contacts(mechanism)]
    rules = sides_of(mechanism).rules
    rows = contact_rows(contacts, rules, mechanism.captured)
    return _Numbers(contacts, rules, rows, SensorParameters.believed(scenario.sensor))


def _lateness(lane: FeltLane) -> float:
    """[s] by which a reading is later than the contact; negative: it is stamped before it."""
    return lane.sensor.delay + lane.later + lane.log.skew * lane.log.reread


class WrenchLink(ModelLink):
    """Contact and sensor on the paths of A.

    A mechanism whose wrench does not follow from the pose of A alone is simulated as in its MJCF;
    it has no alternative interpretation.

    Attributes:
        reads: the interpretation of what the facility leaves open.
        logged: the filter through which readings went to the record; None: none.
    """

    name = "wrench"
    channels = GROUPS["wrench_meas"].columns

    def __init__(
        self,
        runs: Sequence[LinkRun],
        paths: Sequence[Array],
        jumps: Sequence[Array] | None = None,
        rates: Sequence[Array] | None = None,
    ) -> None:
        """paths: (N, 7) of A in P at t_k. jumps: (N,) distance [m] by which A jumped in the tick
        that ends at t_k, at an unknown instant. rates: (N, 6) its twist at t_k; None: the slope
        over the tick that ends there.
        """
        self.runs, self.paths, self.jumps, self.rates = runs, paths, jumps, rates
        self.reads = Interpretation()
        self.commands: Sequence[Array] | None = None
        self.deflection: Sequence[Array] = ()
        self.logged: LowPass | None = None
        self.unknown_rate = False
        self.unknown_steps = False
        self._step_error: list[Array] | None = None
        self._believed = [_numbers(r.scenario, self.reads) for r in runs]
        scenarios = [r.scenario for r in runs]
        self._felt: Felt | Simulated
        make = Felt.along if sides_of(scenarios[0].mechanism).rigid else Simulated
        self._felt = make(
            [s.mechanism for s in scenarios],
            approach_states(s.approach for s in scenarios),
            runs_of(scenarios),
            padded(paths),
            None if rates is None else padded(rates),
        )

    def interpreted(self, **changed: Any) -> WrenchLink:
        """The same link with other parts of its interpretation."""
        out = copy(self)
        before, reads = self.reads, self.reads._replace(**changed)
        out.reads = reads
        if isinstance(self._felt, Felt) and reads != before:
            out._believed = [_numbers(r.scenario, reads) for r in self.runs]
            if (reads.exact, reads.blunt) != (before.exact, before.blunt):
                out._felt = replace(self._felt, leapfrog=reads.exact, blunt=reads.blunt)
        out._step_error = out._missed_by_steps() if reads.exact else None
        return out

    def interpretations(self, effects: Effects = ()) -> list[list[WrenchLink]]:
        """Other interpretations of what the facility leaves open under ``effects``, a group for
        each question: where between surface and tip the force acts, what of the tip meets a plane,
        whether a latch resists turning, how a mount is integrated, and whether late readings lie
        between the instants of the physics.
        """
        if not isinstance(self._felt, Felt):
            return []
        first, reads, out = self.runs[0].scenario, self.reads, []
        if self.acts_across(effects):
            out.append([self.interpreted(lever=x) for x in LEVERS if x != reads.lever])
        if first.mechanism.flat:
            out.append([self.interpreted(blunt=1.0 - reads.blunt)])
        if first.mechanism.captured:
            out.append([self.interpreted(ring=1.0 - reads.ring)])
        if self.stepped:
            out.append([self.interpreted(exact=not reads.exact)])
        else:
            out.append([self.interpreted(grid=None if reads.grid else first.substeps)])
        return out

    def as_interpreted(self, other: WrenchLink) -> WrenchLink:
        """The same link with interpretation and timing of another, perhaps of fewer rows."""
        out = self._read_as(other)
        return out.with_unknown_steps() if other.unknown_steps else out

    def _read_as(self, other: WrenchLink) -> WrenchLink:
        return self.interpreted(**other.reads._asdict()).with_timing(other.timing)

    def acts_across(self, effects: Effects = ()) -> bool:
        """Whether a part of the force acts across the overlap, so that it matters where along it
        the force acts: there is friction.
        """
        lanes = (self._lane(i, effects) for i in range(len(self.runs)))
        return any(lane.contact[:, FRICTION].any() for lane in lanes)

    @property
    def simulated(self) -> bool:
        """Whether the force along a path is computed by simulating the mechanism."""
        return isinstance(self._felt, Simulated)

    @property
    def stepped(self) -> bool:
        """Whether a mount is integrated, so that the steps matter."""
        return isinstance(self._felt, Felt) and self._felt.mount is not None

    def _missed_by_steps(self) -> list[Array]:
        """(N, 6) error of the steps of a believed mount in each run, of second order, extrapolated
        from steps of half the length (L. F. Richardson, Phil. Trans. A 210, 1911).
        """
        assert isinstance(self._felt, Felt)
        finer = replace(self._felt, substeps=STEP_RATIO * self._felt.substeps)
        lanes: list[Lane] = [(i, ()) for i in range(len(self.runs))]
        pairs = zip(self._read(finer, lanes), self._read(self._felt, lanes), strict=True)
        return [(f - c) * STEP_RATIO**2 / (STEP_RATIO**2 - 1.0) for f, c in pairs]

    def with_unknown_steps(self) -> WrenchLink:
        """The same link of a facility whose mount moves in steps that are not known: nuisance terms
        of each run for the correction to the exact integral, and for each touch, which begins
        anywhere within a believed step. Itself where the steps are those of MuJoCo.
        """
        if self._step_error is None or self.unknown_steps or not isinstance(self._felt, Felt):
            return self
        everything: list[Lane] = [(i, ()) for i in range(len(self.runs))]
        as_it_is, terms = self._read(self._felt, everything), [self._step_error]
        for touch in range(1, MOST_TOUCHES + 1):
            earlier = self._read(replace(self._felt, hastened=touch), everything)
            changes = [e - s for e, s in zip(earlier, as_it_is, strict=True)]
            if not any(c.any() for c in changes):
                break
            terms.append(changes)
        out = copy(self)
        out.unknown_steps = True
        own = [np.stack(t, axis=2) for t in zip(*terms, strict=True)]
        out.runs = [r.with_nuisances(t) for r, t in zip(self.runs, own, strict=True)]
        return out

    def commanded(self, commands: Sequence[Array], deflection: Sequence[Array]) -> WrenchLink:
        """The same link where the paths were not measured: they are the platform's response to
        ``commands`` (N, 7) with its effects, plus the ``deflection`` (N, 6) of the believed drives
        [m, rad].
        """
        out = copy(self)
        out.commands, out.deflection = commands, deflection
        return out

    def with_unknown_paths(self, changes: Sequence[Sequence[Array]]) -> WrenchLink:
        """The same link, each of whose ``changes`` (N, 6) of the path is a nuisance."""
        out = copy(self)
        for change in zip(*changes, strict=True):
            pairs = list(zip(self.paths, change, strict=True))
            paths = [poses_of(flat_pose(p) + c[: len(p)]) for p, c in pairs]
            rates = self.rates and [
                r + np.gradient(c[: len(r)], self.tick, axis=0)
                for r, c in zip(self.rates, change, strict=True)
            ]
            out.runs = self._with_terms(out.runs, paths, rates)
        return out

    def _with_terms(
        self,
        runs: Sequence[LinkRun],
        paths: Sequence[Array],
        rates: Sequence[Array] | None,
        times: float = 1.0,
    ) -> list[LinkRun]:
        """The ``runs`` with a nuisance term: the change of readings on other paths and rates."""
        other = self._on(self.runs, paths, rates, self.jumps)
        changes = [b - a for a, b in zip(self.shown_in_all(), other.shown_in_all(), strict=True)]
        return [r.with_nuisances(times * c[:, :, None]) for r, c in zip(runs, changes, strict=True)]

    def _on(
        self,
        runs: Sequence[LinkRun],
        paths: Sequence[Array],
        rates: Sequence[Array] | None,
        jumps: Sequence[Array] | None = None,
    ) -> WrenchLink:
        """The same link of other runs and paths, without nuisances."""
        return WrenchLink(runs, paths, jumps, rates)._read_as(self).through(self.logged)

    def with_unknown_rate(self) -> WrenchLink:
        """The same link of a facility that takes the rate of the contact at an instant that is not
        known: a nuisance term of each run.

        Its standard deviation is a tick: the rate may be the slope of a tick or of its last half,
        and pose, command and reading may each be up to half a tick from where they are stamped. A
        latch that waits for A to be slow may then close a row later, a term of its own: what it
        holds A with afterwards depends on where it closed. Where A jumps, these decide row by row
        whether a reading shows the jump: readings beside a jump then do not count.
        """
        out = copy(self)
        out.unknown_rate = True
        if self.jumps is not None:
            return out
        rates = self.rates
        smooth = None if rates is not None else self._rates_on(self.runs, self.paths)
        out.runs = self._with_terms(self.runs, self.paths, smooth, 2.0)
        later = None if rates is None else self._closing_later(rates)
        if later is not None:
            out.runs = self._with_terms(out.runs, self.paths, later)
        return out

    @staticmethod
    def _rates_on(runs: Sequence[LinkRun], paths: Sequence[Array]) -> list[Array]:
        """(N, 6) twists by central differences."""
        pairs = zip((r.scenario for r in runs), paths, strict=True)
        return [central_rates(s.approach, s.tick, path) for s, path in pairs]

    def _closing_later(self, rates: Sequence[Array]) -> list[Array] | None:
        """The rates with which each latch that waits closes a row later; None: none does."""
        out, waits = [], False
        for run, path, rate in zip(self.runs, self.paths, rates, strict=True):
            mechanism = run.scenario.mechanism
            limits = latch_limits([run.scenario.mechanism.latch])[0]
            held = rate.copy()
            out.append(held)
            if mechanism.latch is None or mechanism.captured:
                continue
            row = next((k for k in range(1, len(path)) if closes(path[k], rate[k], limits)), None)
            if row is not None and not closes(path[row], rate[row - 1], limits):
                held[row], waits = rate[row - 1], True
        return out if waits else None

    def through(self, logged: LowPass | None) -> WrenchLink:
        """The same link whose readings went through a filter to the record."""
        out = copy(self)
        out.logged = logged
        return out

    def _with_errors(self, i: int) -> WrenchLink:
        paths = perturbed(self.paths[i], self.rounding[i][: self.runs[i].rows])
        runs = [self.runs[i]] * len(paths)
        rates = None if self.rates is None else self._rates_on(runs, paths)
        return self._on(runs, paths, rates)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        moves = [bool(self.commands) and any(e.link == "platform" for e in own) for _, own in lanes]
        rest = [lane for lane, m in zip(lanes, moves, strict=True) if not m]
        moving = [lane for lane, m in zip(lanes, moves, strict=True) if m]
        others = iter(self._felt_by(rest) if rest else [])
        moved = iter(self._moved(moving) if moving else [])
        return [next(moved if m else others) for m in moves]

    def _moved(self, lanes: Sequence[Lane]) -> list[Array]:
        """Predictions on the paths of a platform with effects, with the commanded attitude."""
        runs = [self.runs[i] for i, _ in lanes]
        scenarios = [r.scenario for r in runs]
        believed = [PlatformParameters(s.tick) for s in scenarios]
        pairs = zip(believed, lanes, strict=True)
        parameters = [p.with_effects(effects) for p, (_, effects) in pairs]
        which, substeps = np.array([i for i, _ in lanes]), [s.substeps for s in scenarios]
        start = approach_states(s.approach for s in scenarios)
        places = replay_platform(parameters, start, substeps, padded(self.commands or ()), which)
        paths = []
        for place, run, i in zip(places, runs, which, strict=True):
            at = place[: run.rows] + self.deflection[i][: run.rows, :3]
            paths.append(np.column_stack([at, self.paths[i][: run.rows, 3:]]))
        rates = None if self.rates is None else self._rates_on(runs, paths)
        rest = [[e for e in effects if e.link != "platform"] for _, effects in lanes]
        return self._on(runs, paths, rates).predict(list(enumerate(rest)))

    def _felt_by(self, lanes: Sequence[Lane]) -> list[Array]:
        shown = self._read(self._felt, lanes)
        if (error := self._step_error) is not None:
            shown = [reading + error[i] for reading, (i, _) in zip(shown, lanes, strict=True)]
        return [self.logged(reading) for reading in shown] if self.logged else shown

    def _read(self, felt: Felt | Simulated, lanes: Sequence[Lane]) -> list[Array]:
        """(N, 6) reading of each lane as it is stamped, on the paths of ``felt``."""
        read, tick = [self._lane(i, effects) for i, effects in lanes], self.tick
        # stamped before its contact: read later, by whole rows
        ahead = [max(math.ceil(-_lateness(lane) / tick), 0) for lane in read]
        later = [x._replace(later=x.later + n * tick) for x, n in zip(read, ahead, strict=True)]
        out = []
        found = replay_wrench(felt, later, self.reads.grid)
        for reading, n, (i, _) in zip(found, ahead, lanes, strict=True):
            out.append(moved(reading[: self.runs[i].rows], -n))
        return out

    def _lane(self, i: int, effects: Effects) -> FeltLane:
        links = {e.link for e in effects}
        contacts, rules, rows, sensor = self._believed[i]
        if "contact" in links:
            rows = contact_rows(
                [copy(c).with_effects(effects) for c in contacts],
                rules,
                self.runs[i].scenario.mechanism.captured,
            )
        if "sensor" in links:
            sensor = deepcopy(sensor).with_effects(effects)
        log = LogParameters().with_effects(effects) if "log" in links else _NO_LOG_EFFECT
        return FeltLane(i, rows, sensor, log, self.timing_with(effects).delay)

    def penetration(self, i: int) -> Array:
        """(N,) [m] of run i by geometry: the deepest contact; if latched, along z."""
        if self.runs[i].scenario.mechanism.captured:
            return self.paths[i][:, 2]
        if isinstance(self._felt, Simulated):
            return self._felt.believed(i).depth[: self.runs[i].rows]
        return np.asarray(self._felt.depth[i, : self.runs[i].rows].max(axis=1, initial=-1.0))

    def lateness(self, i: int, effects: Effects) -> float:
        """[s] by which the reading of run i is later than the contact."""
        return _lateness(self._lane(i, effects))

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """(N, 6) uncertainty of a reading due to what a replay does not know.

        It has three parts: what happens between two instants of the physics, which is large at a
        touch or a jump; noise that decides whether a force at the edge of a dead zone is read; and
        the correction for the steps of a mount, which is that of the believed motion, errs alike
        over many rows and counts like noise that is larger by the root of a block.
        """
        out = np.hypot(self._between_instants(i, effects), self._at_the_edge(i, effects))
        if self._step_error is None:
            return out
        return np.hypot(out, math.sqrt(BLOCK_ROWS) * np.abs(self._step_error[i]))

    def _between_instants(self, i: int, effects: Effects) -> Array:
        s, sigma = self.runs[i].scenario, self.runs[i].sigma
        if self.jumps is not None:
            open_ = self.beside_jumps(i, effects)[:, None] & np.isfinite(sigma)
            return np.where(open_, UNKNOWN * sigma, 0.0)
        step = s.tick / min(s.substeps, 4)
        if abs(self.lateness(i, effects)) < step:
            return np.zeros((self.runs[i].rows, 6))
        shifts = [[*effects, Timing(delay=d)] for d in (-step, step)]
        early, after, now = self.predict([(i, shifts[0]), (i, shifts[1]), (i, effects)])
        return np.abs(early + after - 2.0 * now)

    def beside_jumps(self, i: int, effects: Effects = ()) -> np.ndarray:
        """(N,) bool: rows whose reading may be of a tick in which A jumps, or beside it."""
        out = np.zeros(self.runs[i].rows, dtype=bool)
        if self.jumps is None:
            return out
        jumps, late = self.jumps[i], self.lateness(i, effects) / self.tick
        after = np.arange(math.floor(late) - 1, math.ceil(late) + 2)
        at = np.flatnonzero(jumps > SHARE_OF_A_JUMP * jumps.max(initial=0.0))
        beside = at[:, None] + after
        out[beside[(beside >= 0) & (beside < len(out))]] = True
        return out

    def _at_the_edge(self, i: int, effects: Effects) -> Array:
        """(N, 6) spread due to noise before a dead zone of width w: w times the root of the
        probability that noise takes a force f across the edge, Q(| |f| - w | / sigma), Q of the
        standard normal.
        """
        lane, run = self._lane(i, effects), self.runs[i]
        width = lane.sensor.deadzone
        if not width.any():
            return np.zeros((run.rows, 6))
        through = replace(lane.sensor, deadzone=np.zeros(6))
        force = replay_wrench(self._felt, [lane._replace(sensor=through)], self.reads.grid)[0][
            : run.rows
        ]
        return width * np.sqrt(ndtr(-np.abs(np.abs(force) - width) / run.sigma))
