"""What a test would show, before it is made: `hiltestbed plan`.

The planned runs are simulated with the nominal scenario and laid out as measured data. Each link is
then replayed with every effect: the smallest size that the runs would show, and the effects that
would look the same at that size, are those of :mod:`hiltestbed.diagnosis.isolability`. Further runs
are simulated as well; of them, those are proposed that tell most look-alikes apart.

Two effects a and b at these sizes change the residuals, in units of the noise, by d_a and d_b. Runs
are independent, so that d_a . d_b is a sum over runs, and what a further run is worth follows from
its own products.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hiltestbed.config.dataset import Dataset, LoadedDataset, RunEntry
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.isolability import LOOK_ALIKE_COSINE, Detectable, detectable
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.effects.table import EFFECTS
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.frames import Array
from hiltestbed.inference.search import Progress
from hiltestbed.measured import examine, load_dataset
from hiltestbed.measured.record import MEASURED_GROUPS
from hiltestbed.process.progress import labelled
from hiltestbed.scenario import Scenario, resolved, scenario_from
from hiltestbed.signals import GROUPS
from hiltestbed.simulation import simulate

MEASURED = frozenset(c for group in MEASURED_GROUPS for c in GROUPS[group].columns)
MOST_PROPOSED = 3  # runs
FACTOR = 4.0  # of a stiffness or mass: its frequency is then twice or half the nominal one
SPEED_FACTOR = 3.0  # half a decade; the peak force grows as much
# of the approach speed, across it: 9 mm/s at 0.03 m/s, where friction is regularised below 0.1 mm/s
SLIDING = 0.3
TILT = 2.0  # [deg] a tip 0.1 m off the axis then touches 3.5 mm early


@dataclass(frozen=True)
class PlannedEffect:
    """What the planned runs would show of an effect.

    Attributes:
        effect: id. link: of the loop. parameter, unit: its size. smallest: that would be detected,
            a factor's departure from 1; None: these runs do not show it.
        confused_with: effects that would look the same at that size.
    """

    effect: str
    link: str
    parameter: str
    unit: str
    smallest: float | None
    confused_with: tuple[str, ...]


@dataclass(frozen=True)
class Proposal:
    """A further run: in words, as settings of a run in a dataset, and the pairs that it would tell
    apart.
    """

    words: str
    set: dict[str, Any]
    settles: tuple[tuple[str, str], ...]


class Further(NamedTuple):
    """A further run that may be proposed: in words, as settings, and its scenario."""

    words: str
    set: dict[str, Any]
    scenario: Scenario


@dataclass(frozen=True)
class Plan:
    """What planned runs would show.

    Attributes:
        name: of the scenario or dataset. runs: their names. noise: column to its standard
            deviation, as far as it was measured. effects: link by link. proposals: the runs that
            would settle most. not_judged: link to the reason.
    """

    name: str
    runs: tuple[str, ...]
    noise: dict[str, float]
    effects: tuple[PlannedEffect, ...]
    proposals: tuple[Proposal, ...]
    not_judged: dict[str, str]

    @property
    def sentence(self) -> str:
        """The plan in one or two sentences."""
        seen = [e for e in self.effects if e.smallest is not None]
        pairs = {frozenset((e.effect, o)) for e in seen for o in e.confused_with}
        runs = "One run" if len(self.runs) == 1 else f"{len(self.runs)} runs"
        text = (
            f"{runs} would show {len(seen)} of {len(self.effects)} effects, and at these sizes "
            f"confuse {len(pairs)} pairs."
        )
        if not pairs:
            return text
        if not self.proposals:
            return f"{text} No other speed, spring, mass or attitude tells more of them apart."
        first = self.proposals[0]
        apart = ", ".join(" from ".join(pair) for pair in first.settles)
        return f"{text} One more run, {first.words}, would tell {apart}."

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"sentence": self.sentence}


@dataclass(frozen=True)
class _LinkPlan:
    """Of a link: what is shown of each effect by the planned runs, and (R, E, E) the products of
    the changes of the residual by two effects in each run, planned and proposed.
    """

    link: str
    shown: list[Detectable]
    products: Array

    def alike(self, runs: Sequence[int]) -> set[frozenset[str]]:
        """The pairs that look the same in these runs."""
        total = self.products[list(runs)].sum(axis=0)
        size = np.sqrt(np.diag(total))
        cosine = np.abs(total) / np.outer(size, size)
        kinds = [s.kind for s in self.shown]
        return {
            frozenset((kinds[i], kinds[j]))
            for i, j in zip(*np.nonzero(np.triu(cosine > LOOK_ALIKE_COSINE, 1)), strict=True)
        }


def plan(task: Scenario | LoadedDataset, progress: Progress | None = None) -> Plan:
    """The plan of one run of a scenario, or of the runs of a dataset; files of a dataset that exist
    already give the noise of their channels and which of them there are.

    Raises:
        InputError: the data of the dataset contradict its scenario.
        HiltestbedError: a planned run diverges.
    """
    scenarios = [task] if isinstance(task, Scenario) else list(task.scenarios)
    noise, columns = ({}, MEASURED) if isinstance(task, Scenario) else _on_record(task)
    scenarios = [_with_noise(s, noise, seed) for seed, s in enumerate(scenarios)]
    further: list[Further] = []
    with tempfile.TemporaryDirectory() as name, np.errstate(all="ignore"):
        folder = Path(name)
        for i, scenario in enumerate(scenarios):
            if progress:
                progress(f"simulating run {i + 1} of {len(scenarios)}")
            if why := _simulate(scenario, folder / f"{i}.parquet", noise, columns):
                raise HiltestbedError(f"run {i} of the plan: {why}")
        for run in _possible(scenarios[0], len(scenarios)):
            if progress:
                progress(f"simulating a run {run.words}")
            file = folder / f"{len(scenarios) + len(further)}.parquet"
            if not _simulate(run.scenario, file, noise, columns):
                further.append(run)
        every = (*scenarios, *(run.scenario for run in further))
        files = tuple(folder / f"{i}.parquet" for i in range(len(every)))
        spec = Dataset(scenario="plan", runs=tuple(RunEntry(file=f.name) for f in files))
        loaded = LoadedDataset(spec, folder / "plan.yaml", scenarios[0], every, files)
        # simulated by these scenarios: no finding of the check forbids a diagnosis
        findings = investigate(examine(loaded), progress)
    links, missing = [], dict(findings.missing)
    for name, found in findings.explanations.items():
        if found.departs:
            missing[name] = "its replay of the nominal simulation leaves more than noise"
            continue
        told = labelled(progress, f"sizes, {LINK_NAMES[name]}")
        planned = found.residual().on(range(len(scenarios)))
        every_effect = detectable(planned, found.candidates, told)
        shown = [s for s in every_effect if s.size is not None]
        alike = _LinkPlan(name, shown, _products(found.residual(), shown))
        links.append((every_effect, alike))
    own = range(len(scenarios))
    return Plan(
        name=_name(task),
        runs=("planned run",) if isinstance(task, Scenario) else tuple(f.name for f in task.files),
        noise=noise,
        effects=tuple(
            _shown(s, {k for pair in known.alike(own) if s.kind in pair for k in pair - {s.kind}})
            for every_effect, known in links
            for s in every_effect
        ),
        proposals=_proposals([known for _, known in links], own, further),
        not_judged={LINK_NAMES[name]: why for name, why in missing.items()},
    )


def _shown(s: Detectable, alike: set[str]) -> PlannedEffect:
    link = EFFECTS[s.kind].link
    return PlannedEffect(s.kind, link, s.parameter, s.unit, s.size, tuple(sorted(alike)))


def _name(task: Scenario | LoadedDataset) -> str:
    return task.name if isinstance(task, Scenario) else task.spec.name or task.path.parent.name


def _products(residual: Residual, shown: Sequence[Detectable]) -> Array:
    """(R, E, E) of each run, see :class:`_LinkPlan`."""
    null, *others = residual.by_run([(), *(s.effects for s in shown)])
    out = np.zeros((len(null), len(shown), len(shown)))
    for i, nominal in enumerate(null):
        changes = np.stack([rows[i] - nominal for rows in others]).reshape(len(shown), -1)
        out[i] = changes @ changes.T
    return out


def _proposals(
    links: Sequence[_LinkPlan], own: range, further: Sequence[Further]
) -> tuple[Proposal, ...]:
    """The further runs that tell most pairs apart, each beside those before it."""
    runs, out = list(own), []
    left = {pair for link in links for pair in link.alike(runs)}
    while left and len(out) < MOST_PROPOSED:
        settled = [
            left - {p for link in links for p in link.alike([*runs, len(own) + k])}
            for k in range(len(further))
        ]
        best = max(range(len(further)), key=lambda k: len(settled[k]), default=None)
        if best is None or not settled[best]:
            break
        pairs = sorted((min(p), max(p)) for p in settled[best])
        out.append(Proposal(further[best].words, further[best].set, tuple(pairs)))
        runs.append(len(own) + best)
        left -= settled[best]
    return tuple(out)


def _possible(scenario: Scenario, seed: int) -> Iterator[Further]:
    """Those of the further runs that the facility can make, each with its own noise."""
    believed = resolved(scenario)
    for i, (words, settings) in enumerate(alternatives(scenario)):
        try:
            other = scenario_from(believed, settings | {"seed": seed + i})
        except InputError:  # the facility, or the mechanism, does not allow it
            continue
        yield Further(words, settings, other)


def alternatives(scenario: Scenario) -> list[tuple[str, dict[str, Any]]]:
    """Further runs of a scenario, in words and as settings: other springs and masses, tilted, and
    where it approaches, other speeds and sliding.
    """
    approach, duration = scenario.approach, scenario.duration
    speed, k = approach.velocity[2], scenario.mechanism.contact.stiffness
    mass = scenario.spacecraft.chaser.mass / FACTOR
    springs = [
        (
            f"on a known spring of {factor * k:.3g} N/m",
            {
                "mechanism.contact.stiffness": factor * k,
                "duration": duration * max(1.0, factor**-0.5),  # a contact lasts as 1/sqrt(k)
            },
        )
        for factor in (FACTOR, 1.0 / FACTOR)
    ]
    speeds = [
        (
            f"at {factor * speed:.3g} m/s",
            {"approach.velocity.2": factor * speed, "approach.gap": factor * approach.gap},
        )
        for factor in (SPEED_FACTOR, 1.0 / SPEED_FACTOR)
    ]
    sliding = (f"sliding at {SLIDING * speed:.3g} m/s", {"approach.velocity.0": SLIDING * speed})
    return [
        *springs,
        (f"with a chaser of {mass:.3g} kg in the model", {"spacecraft.chaser.mass": mass}),
        (f"tilted by {TILT:g} degrees", {"approach.attitude_deg.1": TILT}),
        *((*speeds, sliding) if speed else ()),
    ]


def _on_record(task: LoadedDataset) -> tuple[dict[str, float], Set[str]]:
    """The noise of the columns of the runs that are on record, and these columns; no noise and all
    columns where no run is.
    """
    known = [i for i, file in enumerate(task.files) if file.is_file()]
    if not known:
        return {}, MEASURED
    spec = task.spec.model_copy(update={"runs": tuple(task.spec.runs[i] for i in known)})
    data = load_dataset(
        replace(
            task,
            spec=spec,
            scenarios=tuple(task.scenarios[i] for i in known),
            files=tuple(task.files[i] for i in known),
        )
    )
    levels: dict[str, list[float]] = {}
    for run in data.runs:
        for column, found in run.survey.noise.items():
            levels.setdefault(column, []).append(found.white)
    columns = {column for run in data.runs for column in run.record.columns()}
    return {column: float(np.median(v)) for column, v in levels.items()}, columns


def _with_noise(scenario: Scenario, noise: Mapping[str, float], seed: int) -> Scenario:
    """A scenario whose sensor has the noise on record; of another ``seed`` in each run, since noise
    that all runs share is none.
    """
    levels: dict[str, Any] = {
        f"sensor.{key}": float(np.median([noise[c] for c in columns]))
        for key, columns in (
            ("noise", [c for c in noise if c.startswith("wrench_meas.f")]),
            ("torque_noise", [c for c in noise if c.startswith("wrench_meas.t")]),
        )
        if columns
    }
    return scenario_from(resolved(scenario), levels | {"seed": seed})


def _simulate(scenario: Scenario, file: Path, noise: Mapping[str, float], columns: Set[str]) -> str:
    """Write a run to a ``file`` as its log would have it: the ``columns`` that are measured, with
    the noise of a measured pose; that of the force has gone through the loop.

    Returns:
        In words why there is no run; empty where it is written.
    """
    try:
        batch = simulate([scenario], trace=True)
    except HiltestbedError as error:
        return str(error)
    if batch.trouble or batch.trace is None:
        return batch.trouble[0][2] if batch.trouble else "it has no trace"
    rng = np.random.default_rng(scenario.seed)
    logged = {name: v for name, v in batch.trace.run(0).items() if name in columns | {"t"}}
    for name, values in logged.items():
        if name.startswith("pose_act."):
            logged[name] = values + noise.get(name, 0.0) * rng.standard_normal(len(values))
    pq.write_table(pa.table(logged), file)
    return ""
