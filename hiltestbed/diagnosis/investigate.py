"""The explanation of each link by one likelihood, in the order in which one helps the next: a force
record that is stamped late shows in the compensation, and where A went in the platform.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.explain import Explanation, explain
from hiltestbed.diagnosis.lacking import too_little
from hiltestbed.diagnosis.layout import lay_out, with_noise_beside
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import ModelLink, PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.path_noise import Path
from hiltestbed.diagnosis.paths import (
    best_path,
    choose_lever,
    choose_ring,
    choose_steps,
    make_wrench_link,
    too_divergent,
)
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.recorded import (
    DatasetLayout,
    compensation_link,
    dynamics_link,
    platform_link,
)
from hiltestbed.diagnosis.settings import MIN_POSE_NOISE
from hiltestbed.diagnosis.stiction import sticking
from hiltestbed.diagnosis.timing import clocks_of, is_off, judged_again
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.inference.search import Progress
from hiltestbed.measured import MeasuredDataset
from hiltestbed.measured.noise import finest_noise
from hiltestbed.process.progress import labelled
from hiltestbed.sensor.effects import SensorJitter
from hiltestbed.signals import GROUPS

JITTERS = (0.3, 1.0, 3.0)  # [rows] from which a jitter is sought
CLOCKS = ("sensor.delay", "log.skew")
ORDER = ("compensation", "dynamics", "platform", "wrench")  # of the links


@dataclass(frozen=True)
class Findings:
    """The explanations, link by link.

    Attributes:
        layout: the data as laid out. explanations: link to its explanation. missing: link to the
            reason why it was not judged.
        whole: link on whole runs, for the series of the report. weighed: sentences on rivals that
            the rebound told apart.
    """

    layout: DatasetLayout
    explanations: dict[str, Explanation]
    missing: dict[str, str]
    whole: dict[str, ModelLink]
    weighed: tuple[str, ...] = ()

    @property
    def noise(self) -> dict[str, float]:
        """Channel to its floor."""
        return dict(self.layout.noise)


def investigate(dataset: MeasuredDataset, progress: Progress | None = None) -> Findings:
    """Explain every link that the dataset's channels allow."""
    layout = lay_out(dataset)
    judged = [name for name in ORDER if name not in layout.missing]
    found: dict[str, Explanation] = {}
    whole: dict[str, ModelLink] = {}
    missing = dict(layout.missing)

    def told(name: str) -> Progress | None:
        words = f"link {judged.index(name) + 1} of {len(judged)}, {LINK_NAMES[name]}"
        return labelled(progress, words)

    scales = layout.scales
    if "compensation" in judged:
        # of a late record each row is tried: a delay that is a row off fits no better than none
        candidates = candidates_of(replace(scales, jumps=True), ("compensation", "log"))
        model = LinkModel(compensation_link(layout, layout.rows))
        found["compensation"] = explain(model, candidates, told("compensation"))
        whole["compensation"] = compensation_link(layout, layout.whole)
    if "dynamics" in judged:
        model = LinkModel(dynamics_link(layout, layout.rows))
        found["dynamics"] = explain(model, candidates_of(scales, ("dynamics",)), told("dynamics"))
        whole["dynamics"] = dynamics_link(layout, layout.whole)
        layout = with_computed_commands(dataset, layout, found["dynamics"])
    if "platform" in judged:
        link = platform_link(layout, layout.rows)
        scales, link = with_stiction(layout, link)
        candidates = candidates_of(scales, ("platform",))
        found["platform"] = explain(LinkModel(link), candidates, told("platform"))
        whole["platform"] = platform_link(layout, layout.whole)
    if "wrench" in judged:
        layout, path = _path(layout, found)
        if why := too_divergent(layout, path):
            missing["wrench"] = why
        else:
            contact = make_wrench_link(layout, path, layout.rows)
            contact = choose_steps(choose_ring(choose_lever(contact)))
            candidates = _wrench_candidates(
                replace(scales, jumps=contact.jumps is not None),
                found.get("compensation"),
                bool(contact.commands),
            )
            found["wrench"] = with_other_clock(
                explain(
                    LinkModel(contact).clocked(*clocks_of("wrench", found)),
                    candidates,
                    told("wrench"),
                    found.get("compensation"),
                )
            )
            whole["wrench"] = make_wrench_link(layout, path, layout.whole)
    for name in judged_again(found):
        if name != "wrench":
            e = found[name]
            model = e.model.clocked(*clocks_of(name, found))
            found[name] = explain(model, e.candidates, told(name))
    if "wrench" in found:
        read, entire = found["wrench"].link, whole["wrench"]
        assert isinstance(read, WrenchLink)
        assert isinstance(entire, WrenchLink)
        whole["wrench"] = entire.as_interpreted(read)
    for name, explained in found.items():
        if not explained.departs and (why := too_little(explained.link)):
            missing[name] = why
    order = [name for name in LINK_NAMES if name in found]
    timed = {name: link.with_timing(found[name].timing()) for name, link in whole.items()}
    return Findings(layout, {n: found[n] for n in order}, missing, timed)


def with_computed_commands(
    dataset: MeasuredDataset, layout: DatasetLayout, numerical_model: Explanation
) -> DatasetLayout:
    """The layout with the poses that the explained numerical model computed in place of a record of
    them that lacks rows, or to which the log adds more noise than they have; and with what that
    computation leaves open.
    """
    link, names = numerical_model.link, GROUPS["pose_cmd"].columns
    absent = any(n in r.record.absent for r in layout.runs for n in names)
    if absent or not numerical_model.adequate or link.weights(0) is not None:
        return layout
    whole = dynamics_link(layout, layout.whole).with_timing(link.timing)
    timing = numerical_model.timing() if is_off(numerical_model) else link.timing
    shown = whole.with_timing(timing).shown_in_all(numerical_model.effects())
    own = _noise_of_positions(shown)
    noise = _noise_of_positions([r.record.filled("pose_cmd") for r in layout.runs])
    lost = not all(r.record.whole("pose_cmd") for r in layout.runs)
    if not lost and noise**2 - own**2 < max(own, MIN_POSE_NOISE) ** 2:
        return layout
    runs = [
        replace(r, record=r.record.with_group("pose_cmd", poses_of(flat)))
        for r, flat in zip(layout.runs, shown, strict=True)
    ]
    other = [whole.shown_in_all(effects) for effects in numerical_model.alternatives()]
    each = zip(shown, *other, strict=True)
    changes = tuple(np.stack([x - own for x in others], axis=2) for own, *others in each)
    return replace(lay_out(replace(dataset, runs=tuple(runs))), open_commands=changes)


def _noise_of_positions(poses: Sequence[Array]) -> float:
    """[m] the largest noise of a position in (N, C) poses."""
    return max(finest_noise(x) for p in poses for x in p[:, :3].T)


def with_stiction(layout: DatasetLayout, link: PlatformLink) -> tuple[Scales, PlatformLink]:
    """Scales with starts for stiction from the data, and the link with the timing that its jumps
    show.
    """
    noise = min((level for c in link.channels[:3] if (level := layout.noise.get(c))), default=0.0)
    sticks = sticking(link, noise, layout.scales.substeps)
    timed = link if sticks.timing is None else link.with_timing(sticks.timing)
    return replace(layout.scales, sticks=sticks.starts), timed


def with_other_clock(e: Explanation) -> Explanation:
    """With a late sensor and a late record as rivals of each other, where both are hypotheses.

    They are where no channel shows what the loop made of the force: only the facility's
    interpolation between rows, which is not known, could tell them apart. So the link itself counts
    as much for the one, as it suits that best, as for the other.
    """
    clocks = [c for c in e.candidates if c.kind in CLOCKS]
    acting = [c for c in e.causes if c.cause.kind in CLOCKS]
    if len({c.kind for c in clocks}) < len(CLOCKS) or len(acting) != 1:
        return e
    (own,) = acting
    assert isinstance(e.link, WrenchLink)
    groups = e.link.interpretations(e.effects())
    links = [e.link, *(link for group in groups for link in group)]
    there = [e.model.through(link).likelihood(e.likelihood.choices) for link in links]
    late, other = min(
        (
            (likelihood.fit([c if k.key == own.cause.key else k for k in e.fit.causes], start), c)
            for c in clocks
            if c.kind != own.cause.kind
            for likelihood, start in ((x, [e.fit.of.theta]) for x in there)
        ),
        key=lambda found: found[0].cost,
    )
    if not e.model.leaves_noise(late.left):
        return e
    rival = replace(late, evidence=e.fit.evidence)
    rivals = dict(zip(own.rivals, own.others, strict=True))
    counted = rivals.pop(other.kind, None)  # as one that may suit the link less
    odds = 1.0 / own.probability - 1.0
    if counted is not None:
        here = e.likelihood.again(e.fit).evidence
        odds -= math.exp(min(counted.evidence - here, 0.0))
    alike = replace(
        own,
        rivals=(other.kind, *rivals),
        others=(rival, *rivals.values()),
        probability=1.0 / (2.0 + odds),
    )
    causes = tuple(alike if c is own else c for c in e.causes)
    return replace(e, conclusion=replace(e.conclusion, causes=causes))


def candidates_of(scales: Scales, links: Sequence[str]) -> tuple[Candidate, ...]:
    """The hypotheses of every effect on ``links``; of a jitter as well, which changes the variance
    of a reading more than its mean.
    """
    effects = [e for e in EFFECTS.values() if e.link in links]
    found = tuple(c for e in effects for c in e.candidates(scales))
    if SensorJitter.link not in links:
        return found
    return (*found, candidate(SensorJitter, {"sigma": [x * scales.tick for x in JITTERS]}))


def _wrench_candidates(
    scales: Scales, late_record: Explanation | None, commanded: bool
) -> Sequence[Candidate]:
    """Those of contact and sensor, which the data cannot separate into two links; of the log where
    the compensation shows it late, and then not of a late sensor, or where it was not judged; of
    the platform where only its command is on record.
    """
    links = ["contact", "sensor", *(["platform"] if commanded else [])]
    late = late_record is not None and "log.skew" in late_record.kinds
    if late or late_record is None:
        links.append("log")
    found = candidates_of(scales, links)
    return [c for c in found if not (late and c.kind == "sensor.delay")]


def _path(layout: DatasetLayout, found: Mapping[str, Explanation]) -> tuple[DatasetLayout, Path]:
    """The path of A, and the layout with the noise of a latched mechanism's force from what the
    believed contact on that path leaves of the readings.
    """
    path = best_path(layout, found.get("platform"))
    if not any(r.scenario.mechanism.captured for r in layout.runs):
        return layout, path
    link = choose_ring(choose_lever(make_wrench_link(layout, path, layout.whole)))
    shown = link.shown_in_all()
    return with_noise_beside(layout, shown), path


def links_of(layout: DatasetLayout) -> list[ModelLink]:
    """The links that runs record, on the path of A that is measured."""
    makers = (compensation_link, dynamics_link, platform_link)
    there = [make for n, make in zip(ORDER, makers, strict=False) if n not in layout.missing]
    found: list[ModelLink] = [make(layout, layout.rows) for make in there]
    if "wrench" in layout.missing:
        return found
    layout, path = _path(layout, {})
    if too_divergent(layout, path):
        return found
    return [*found, make_wrench_link(layout, path, layout.rows)]
