"""What a test would show, before it is made: `hiltestbed plan`.

The planned runs are simulated with the nominal scenario and laid out as measured data. Each link is
then replayed with every effect: the smallest size that the runs would show, and the effects that
would look the same at that size, are those of :mod:`hiltestbed.diagnosis.isolability`. Further runs
are simulated as well; of them, those are proposed that tell most look-alikes apart.

Runs are independent: what a further run is worth follows from its own products of the changes by
two effects.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.config.dataset import LoadedDataset, label_of
from hiltestbed.diagnosis.further import (
    MEASURED,
    Further,
    as_measured,
    chosen,
    noise_on_record,
    possible,
    with_noise,
)
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.isolability import Detectable, FisherInformation, alike, detectable
from hiltestbed.diagnosis.link_model import SHIFT_SIGMA
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.effects.table import EFFECTS
from hiltestbed.errors import HiltestbedError
from hiltestbed.inference.search import Progress
from hiltestbed.measured import load_dataset
from hiltestbed.process.progress import labelled
from hiltestbed.scenario import Scenario


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
        return asdict(self) | {"sentence": self.sentence}


@dataclass(frozen=True)
class _LinkPlan:
    """Of a link: what is shown of each effect by the planned runs, and what these effects change in
    each run, planned and proposed.
    """

    link: str
    shown: list[Detectable]
    sensitivity: FisherInformation

    def alike(self, runs: Sequence[int]) -> set[frozenset[str]]:
        """The pairs that look the same in these runs."""
        kinds, same = [s.kind for s in self.shown], alike(self.sensitivity.of(runs))
        return {frozenset((kinds[i], kinds[j])) for i, j in zip(*np.nonzero(same), strict=True)}


def plan(task: Scenario | LoadedDataset, progress: Progress | None = None) -> Plan:
    """The plan of one run of a scenario, or of the runs of a dataset; files of a dataset that exist
    already give the noise of their channels and which of them there are.

    Raises:
        InputError: the data of the dataset contradict its scenario.
        HiltestbedError: a planned run diverges.
    """
    scenarios = [task] if isinstance(task, Scenario) else list(task.scenarios)
    noise, columns = ({}, MEASURED) if isinstance(task, Scenario) else _on_record(task)
    scenarios = [with_noise(s, noise, seed) for seed, s in enumerate(scenarios)]
    further = list(possible(scenarios[0], len(scenarios)))
    if progress:
        progress(f"simulating {len(scenarios)} planned runs and {len(further)} further ones")
    every = (*scenarios, *(run.scenario for run in further))
    with np.errstate(all="ignore"):
        data, trouble = as_measured(every, every, noise, columns)
        for i, why in enumerate(trouble[: len(scenarios)]):
            if why:
                raise HiltestbedError(f"run {i} of the plan: {why}")
        assert data is not None
        findings = investigate(data, progress)
    further = [f for f, why in zip(further, trouble[len(scenarios) :], strict=True) if not why]
    links, missing = [], dict(findings.missing)
    for name, found in findings.explanations.items():
        if found.departs:
            missing[name] = "its replay of the nominal simulation leaves more than noise"
            continue
        told = labelled(progress, f"sizes, {LINK_NAMES[name]}")
        # the clocks of a simulation are exact, those of the facility are not known yet
        model = found.timed().clocked(0.0, SHIFT_SIGMA)
        every_effect = detectable(model.on(range(len(scenarios))), found.candidates, told)
        shown = [s for s in every_effect if s.size is not None]
        known = _LinkPlan(name, shown, FisherInformation(model, [s.effects for s in shown]))
        links.append((every_effect, known))
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
    return task.name if isinstance(task, Scenario) else task.spec.name or label_of(task.path)


def _proposals(
    links: Sequence[_LinkPlan], own: range, further: Sequence[Further]
) -> tuple[Proposal, ...]:
    """The further runs that tell most pairs apart, each beside those before it."""
    left = {pair for link in links for pair in link.alike(own)}

    def settled(ks: Sequence[int]) -> dict[frozenset[str], float]:
        runs = [*own, *(len(own) + k for k in ks)]
        alike = {pair for link in links for pair in link.alike(runs)}
        return dict.fromkeys(left - alike, 1.0)

    return tuple(
        Proposal(further[k].words, further[k].set, tuple(sorted((min(p), max(p)) for p in pairs)))
        for k, pairs in chosen(len(further), left, settled)
    )


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
    columns = {column for run in data.runs for column in run.record.columns()}
    return noise_on_record(data), columns
