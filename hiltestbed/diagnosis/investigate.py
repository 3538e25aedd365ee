"""Stages "replay", "fit" and "select" for every link: from the `Layout` of a dataset to an
`Explanation` of each link.

The order of the links is that in which one link's explanation helps the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.adequacy import (
    judge_of_axis,
    judge_of_compensation,
    judge_of_dynamics,
    noise_alone,
)
from hiltestbed.diagnosis.decimation import refit_on_all_rows
from hiltestbed.diagnosis.driven import (
    AXIS_EFFECTS,
    DISPLACEMENT_SPAN,
    axis_link,
    mass_and_force,
    simplest_force,
)
from hiltestbed.diagnosis.fit import Fit, null_fit, refit
from hiltestbed.diagnosis.grow import Richer
from hiltestbed.diagnosis.jitter_and_hum import hum_beside, jitter_beside, lines
from hiltestbed.diagnosis.lacking import too_little
from hiltestbed.diagnosis.layout import (
    DatasetLayout,
    compensation_link,
    dynamics_link,
    lay_out,
    levels,
    platform_link,
    with_noise_beside,
    with_readings,
)
from hiltestbed.diagnosis.links import (
    AxisLink,
    CompensationLink,
    DynamicsLink,
    ModelLink,
    PlatformLink,
    Timing,
    WrenchLink,
)
from hiltestbed.diagnosis.paths import (
    BestPath,
    best_path,
    make_wrench_link,
    path_under,
    path_without_delay,
    too_divergent,
    with_clocks_off,
    with_filter_error,
)
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.readings import (
    choose_lever,
    choose_ring,
    choose_steps,
    lever_under,
    other_lever,
    other_steps,
    reinterpreted,
    with_point_contact,
    with_time_grid,
    wrench_link_of,
)
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Progress, Search, labelled
from hiltestbed.diagnosis.settings import DETECTION
from hiltestbed.diagnosis.stamps import (
    exactly_stamped,
    least_left,
    only_late_record,
    other_reading_betters,
    rows_in_common,
    stamped_late,
    stamps_known,
    used_readings,
    without_end,
)
from hiltestbed.diagnosis.stiction import sticking
from hiltestbed.diagnosis.timing import (
    MAX_STAMP_SHIFT_ROWS,
    best_placed,
    explain_with_timing,
    may_be_stamp,
    timing_departs,
    timing_under,
)
from hiltestbed.effects.log import log_parameters
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.effects.table import EFFECTS
from hiltestbed.measured import MeasuredDataset
from hiltestbed.replay import follows_exactly

# chosen: of chi-square, below which another estimate of the initial state is taken
MAX_RESTART_CHI2 = 0.9
# chosen: of a skew in the compensation: if contact and sensor show less, wrench_meas is not late
MIN_SKEW_SHARE = 0.25
# look-alikes of a path shifted in time
SHIFT_LOOK_ALIKES = ("sensor.delay", "contact.damping", "contact.stiffness", "sensor.lag")
# chosen: times the noise: a row extrapolated from two by s rows has hypot(1 + s, s) times theirs: 2
# for 0.8 rows
LOST_START = 2.0
ORDER = ("compensation", "dynamics", "platform", "wrench")  # of the links
# links of the vocabulary that act between the pose and the reading
WRENCH_LINKS = ("contact", "sensor")


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


def investigate(
    dataset: MeasuredDataset, progress: Progress | None = None, stamps: bool = True
) -> Findings:
    """Explain every link that the data allow; stamps: whether a late record may be its stamps."""
    layout = lay_out(dataset)
    found: dict[str, Explanation] = {}
    whole: dict[str, ModelLink] = {}
    if "compensation" not in layout.missing:
        candidates = candidates_of(layout.scales, ("compensation", "log"))
        found["compensation"] = _explain_compensation(
            layout, compensation_link(layout, layout.rows), candidates, progress, stamps
        )
    if "dynamics" not in layout.missing:
        found["dynamics"], whole["dynamics"] = _explain_dynamics(layout, found, progress)
    if "compensation" in found:  # whose stamps the numerical model may have shown
        whole["compensation"] = _whole(compensation_link, layout, found["compensation"])
    if "platform" not in layout.missing:
        found["platform"], whole["platform"] = _explain_platform(
            layout, _stamped_platform(layout, found), _begin(progress, layout, "platform")
        )
    missing = dict(layout.missing)
    if "wrench" not in missing:
        path = _choose_path(layout, found, whole, progress)
        layout = _with_noise_of_residual(layout, path)
        if why := _investigate_wrench(layout, path, found, whole, progress):
            missing["wrench"] = why
        else:
            layout = _settle_platform(layout, found, whole, progress)
    if stamps and only_late_record(found):  # where nothing else departs, a part of a row counts
        return investigate(dataset, progress, stamps=False)
    # errors of bridged rows are in the residual of the dynamics
    for name in ("compensation", "platform", "wrench"):
        if name in found and not found[name].departs:
            why = too_little(found[name].residual.link)
            missing |= {name: why} if why else {}
    return Findings(
        layout, {name: found[name] for name in LINK_NAMES if name in found}, missing, whole
    )


def _whole(
    make: Callable[[DatasetLayout, Sequence[int]], ModelLink],
    layout: DatasetLayout,
    explanation: Explanation,
) -> ModelLink:
    """A link on whole runs, with the timing of its explanation."""
    return make(layout, layout.whole).with_timing(explanation.residual.link.timing)


def candidates_of(
    scales: Scales, links: Sequence[str], rich: bool | None = False
) -> tuple[Candidate, ...]:
    """The hypotheses of each effect that acts on one of ``links``: of ``rich`` ones, of the others,
    or (None) of all.
    """
    effects = [e for e in EFFECTS.values() if e.link in links and rich in (None, e.rich)]
    return tuple(c for e in effects for c in e.candidates(scales))


def _begin(
    progress: Progress | None, layout: DatasetLayout, link: str, words: str = ""
) -> Progress | None:
    """Tell that a link is begun; the callback for what is done on it."""
    judged = [name for name in ORDER if name not in layout.missing]
    told = labelled(
        progress, f"link {judged.index(link) + 1} of {len(judged)}, {words or LINK_NAMES[link]}"
    )
    if told:
        told("replay")
    return told


def with_stiction(layout: DatasetLayout, link: PlatformLink) -> tuple[Scales, Timing | None]:
    """Scales with starts for stiction from the data, and the timing that its jumps show, if any."""
    noise = min((level for c in link.channels[:3] if (level := layout.noise.get(c))), default=0.0)
    sticks = sticking(link, noise, layout.scales.substeps)
    return replace(layout.scales, sticks=sticks.starts), sticks.timing


def _explain_platform(
    layout: DatasetLayout, link: PlatformLink, progress: Progress | None
) -> tuple[Explanation, ModelLink]:
    """The explanation of the platform, and that link on whole runs."""
    scales, timing = with_stiction(layout, link)
    link = link if timing is None else link.with_timing(timing)
    search = Search(candidates_of(scales, ("platform",)), progress=progress, reread=timing_under)
    found = explain_with_timing(Residual(link), search)
    richer = Richer(search, candidates_of(scales, ("platform",), rich=True))
    best = richer.in_place_of(found)
    there = found.residual if best is found else timing_under(best.residual, best.chosen)
    if there is not best.residual:
        placed = replace(richer, search=search.after(best)).in_place_of(found, there)
        best = best if placed is found else placed
    return best, _whole(platform_link, layout, best)


def _explain_dynamics(
    layout: DatasetLayout, found: dict[str, Explanation], progress: Progress | None
) -> tuple[Explanation, ModelLink]:
    """The explanation of the numerical model, or of a driven axis; and that link on whole runs.

    found: of the compensation, which may show that stamps are off: then a departure no larger than
        what interpolation does shows nothing.
    """
    if layout.scales.driven is not None:
        return _explain_axis(layout, _begin(progress, layout, "dynamics", "driven axis"))
    link = _stamped_dynamics(layout, found)
    judge = judge_of_dynamics(Residual(link))
    if not noise_alone(judge(Residual(link), ())):
        link = _with_unknown_start(layout, link)
    search = Search(
        candidates_of(layout.scales, ("dynamics",)),
        judge,
        (),
        _begin(progress, layout, "dynamics"),
        bounded=timing_departs(found),
    )
    explanation = explain_with_timing(Residual(link), search)
    return explanation, _whole(dynamics_link, layout, explanation)


def _stamped_dynamics(layout: DatasetLayout, found: dict[str, Explanation]) -> DynamicsLink:
    """The numerical model with the stamps of wrench_comp that the compensation shows.

    Whole rows by which both of its channels are late do not show there: those are taken, for
    ``found`` as well, with which the model fits best.
    """
    link, stamps, tick = dynamics_link(layout, layout.rows), stamps_known(found), layout.scales.tick
    if "wrench_comp" not in stamps:
        return link
    common = rows_in_common(stamps, tick)
    links = [link.stamped(before=-stamps["wrench_comp"] - n * tick) for n in common]
    several = [_with_unknown_start(layout, other) for other in links] if len(links) > 1 else []
    best = least_left(several) if several else 0
    if common[best]:
        found["compensation"] = found["compensation"].stamped(
            delay=common[best] * tick, before=-common[best] * tick
        )
    return links[best]


def _with_unknown_start(layout: DatasetLayout, link: DynamicsLink) -> DynamicsLink:
    """The numerical model where the wrench that acted first may not be on record."""
    return link.with_unknown_start(LOST_START * levels(layout, "wrench_comp"))


def _explain_axis(layout: DatasetLayout, progress: Progress | None) -> tuple[Explanation, AxisLink]:
    """A driven axis: its mass and what resists it, sought from the estimates of a regression."""
    link = axis_link(layout.runs)
    candidates = tuple(
        c for c in candidates_of(layout.scales, ("dynamics",)) if c.kind in AXIS_EFFECTS
    )
    search = Search(
        simplest_force(candidates),
        judge_of_axis(link),
        (mass_and_force(candidates),),
        progress,
        beside=math.inf,
    )
    explanation = search.explain(Residual(link.over(DISPLACEMENT_SPAN)))
    if explanation.chosen.causes:
        again = link.restarted(explanation.chosen.effects())
        there = Residual(again.over(DISPLACEMENT_SPAN))
        if refit(there, explanation.chosen).chi2 < MAX_RESTART_CHI2 * explanation.chosen.chi2:
            return search.after(explanation).explain(there), again
    return explanation, link


def _explain_compensation(
    layout: DatasetLayout,
    link: CompensationLink,
    candidates: Sequence[Candidate],
    progress: Progress | None,
    stamps: bool = False,
) -> Explanation:
    judge = judge_of_compensation(link, layout.noise)
    approximate = layout.logged is not None or any(
        "wrench_meas" in run.record.bends for run in layout.runs
    )
    search = Search(
        tuple(candidates), judge, (), _begin(progress, layout, "compensation"), bounded=approximate
    )
    left = null_fit(Residual(link)).residual
    # what a shift would better then are the errors of bridged rows or written digits
    follows = square(left) < np.count_nonzero(left)
    if stamps and not follows and (stamped := exactly_stamped(Residual(link), search)):
        return search.explain(stamped)
    led = [
        link.noise_gain() * layout.noise.get(name.replace("comp", "meas"), 0.0)
        for name in link.channels
    ]
    return explain_with_timing(
        Residual(link), search, weigh=lambda residual: residual.with_noise(np.array(led))
    )


def _with_noise_of_residual(layout: DatasetLayout, path: BestPath) -> DatasetLayout:
    """The layout with the noise of a latched mechanism's force beside its believed contact."""
    if not any(r.scenario.mechanism.captured for r in layout.runs):
        return layout
    link = choose_steps(choose_ring(choose_lever(make_wrench_link(layout, path, layout.whole))))
    shown = link.shown_in_all()
    known = [np.asarray(np.isfinite(run.sigma).any(axis=1)) for run in link.runs]
    return with_noise_beside(
        layout, [np.where(k[:, None], s, np.nan) for k, s in zip(known, shown, strict=True)]
    )


def _investigate_wrench(
    layout: DatasetLayout,
    path: BestPath,
    found: dict[str, Explanation],
    whole: dict[str, ModelLink],
    progress: Progress | None,
) -> str | None:
    """Contact and sensor, which the data cannot separate into two links; and the compensation again
    if the record is stamped late.

    Returns the reason why the data do not allow it; None where they do.
    """
    if why := too_divergent(layout, path):
        return why
    link = make_wrench_link(layout, path, layout.rows, decimate="compensation" not in found)
    link = choose_steps(choose_ring(choose_lever(_as_stamped(link, found))))
    scales = replace(layout.scales, lines=lines(link), jumps=link.jumps is not None)
    unseen = ("platform",) if link.commands else ()  # its response then is in the path
    candidates = candidates_of(
        scales,
        (*WRENCH_LINKS, *unseen) if "compensation" in found else (*WRENCH_LINKS, *unseen, "log"),
    )
    given = stamped_late(layout, link, found.get("compensation"))
    if given and _by_its_stamp(layout, link, found, whole, given[0], progress):
        given = []
    if given:
        # an estimate, which the contact alone cannot tell from a late sensor
        if given[0].causes[0].names:
            candidates = tuple(c for c in candidates if c.kind != "sensor.delay")
        levered = wrench_link_of(lever_under(Residual(link), given[0]))
        if levered is not link:
            link, given = levered, stamped_late(layout, levered, found["compensation"]) or given
    residual = Residual(link)
    search = Search(
        candidates,
        special=(jitter_beside, hum_beside),
        progress=_begin(progress, layout, "wrench"),
        reread=reinterpreted,
    )
    late = given[0] if given else None
    explanation = explain_with_timing(
        residual,
        search,
        lambda s, there: s.explain(there, late),
        not given and timing_departs(found),
    )
    if levered := other_lever(explanation):
        residual = Residual(levered)
        given = given and (stamped_late(layout, levered, found["compensation"]) or given)
        late = given[0] if given else None
        explanation = search.after(explanation).explain(residual, late)
    if not given and (stepped := other_steps(explanation)):
        explanation = search.after(explanation).explain(Residual(stepped))
    if not given and (pointed := with_point_contact(explanation)):
        explanation = search.after(explanation).explain(Residual(pointed))
    if given and other_reading_betters(explanation, given[1]):
        late = given[1]
        explanation = search.explain(residual, late)
    elif not given and (other := with_time_grid(explanation)):
        explanation = search.after(explanation).explain(Residual(other))
    chosen = wrench_link_of(explanation.residual)
    if other := path_under(layout, path, chosen, explanation.chosen.effects()):
        path = other
        link = make_wrench_link(layout, path, layout.rows).as_interpreted(chosen)
        explanation = search.after(explanation).explain(Residual(link), late)
    if given:
        explanation = replace(explanation, candidates=(*candidates, *given[0].causes))
    chosen = wrench_link_of(explanation.residual)
    if tuple(run.rows for run in chosen.runs) != tuple(layout.rows):
        everything = make_wrench_link(layout, path, layout.rows)
        explanation = refit_on_all_rows(explanation, everything.as_interpreted(chosen))
    found["wrench"] = explanation
    whole["wrench"] = make_wrench_link(layout, path, layout.whole).as_interpreted(chosen)
    if given:
        _settle_compensation(layout, path, found, whole, progress)
    return None


def _as_stamped(link: WrenchLink, found: Mapping[str, Explanation]) -> WrenchLink:
    """The link with the stamps of wrench_meas that the compensation shows."""
    stamps = stamps_known(found)
    return link.stamped(before=stamps["wrench_meas"]) if "wrench_meas" in stamps else link


def _choose_path(
    layout: DatasetLayout,
    found: dict[str, Explanation],
    whole: dict[str, ModelLink],
    progress: Progress | None,
) -> BestPath:
    """The path that fits contact and sensor best; and the platform explained to match it."""
    best = best_path(layout, found.get("platform"))
    if other := path_without_delay(layout, found.get("platform"), best):
        links = [
            make_wrench_link(layout, with_clocks_off(layout, path), layout.rows)
            for path in (best, other)
        ]
        links = [choose_lever(_as_stamped(link, found)) for link in links]
        resembling = [
            c
            for c in candidates_of(layout.scales, WRENCH_LINKS)
            if c.kind in SHIFT_LOOK_ALIKES and not c.variant
        ]
        if best_placed(links, resembling):
            best = other
            found["platform"], whole["platform"] = _stamped_elsewhere(layout, found, progress)
    off = timing_departs(found) or any(r.record.bends for r in layout.runs)
    return with_filter_error(layout, with_clocks_off(layout, best) if off else best)


def _stamped_platform(layout: DatasetLayout, found: Mapping[str, Explanation]) -> PlatformLink:
    """The platform with the stamps of pose_cmd that the numerical model shows."""
    link, stamps = platform_link(layout, layout.rows), stamps_known(found)
    return link.stamped(before=-stamps["pose_cmd"]) if "pose_cmd" in stamps else link


def _stamped_elsewhere(
    layout: DatasetLayout, found: Mapping[str, Explanation], progress: Progress | None
) -> tuple[Explanation, ModelLink]:
    """The platform, if what little it is late is its stamp: explained again, and on whole runs."""
    platform = found["platform"]
    timing = platform.residual.link.timing
    for effect in platform.chosen.effects():
        if may_be_stamp(effect, platform.residual.link):
            timing = timing.plus(Timing(delay=effect.parameters()["delay"]))
    link = _stamped_platform(layout, found).with_timing(timing)
    return _explain_platform(layout, link, _begin(progress, layout, "platform"))


def _by_its_stamp(
    layout: DatasetLayout,
    link: WrenchLink,
    found: dict[str, Explanation],
    whole: dict[str, ModelLink],
    late: Fit,
    progress: Progress | None,
) -> bool:
    """Whether wrench_comp is stamped early, and not wrench_meas late: contact and sensor depart
    more if the record is ``late``.

    In that case the compensation is explained again.
    """
    skew = log_parameters(found["compensation"].chosen.effects()).skew
    residual = Residual(link)
    told = square(residual([c.at(np.full(len(c.names), skew)) for c in late.causes]))
    refuted = (
        log_parameters(late.effects()).skew < MIN_SKEW_SHARE * skew
        or told > null_fit(residual).chi2 + DETECTION
    )
    if skew > MAX_STAMP_SHIFT_ROWS * layout.scales.tick or not refuted:
        return False
    early = compensation_link(layout, layout.rows).with_timing(Timing(delay=-skew))
    found["compensation"] = _explain_compensation(
        layout, early, candidates_of(layout.scales, ("compensation",)), progress
    )
    whole["compensation"] = _whole(compensation_link, layout, found["compensation"])
    return True


def _settle_compensation(
    layout: DatasetLayout,
    path: BestPath,
    found: dict[str, Explanation],
    whole: dict[str, ModelLink],
    progress: Progress | None,
) -> None:
    """The compensation under the readings that the loop used, if the contact shows these late."""
    explanation = found["wrench"]
    effects = explanation.chosen.effects()
    skew = log_parameters(effects).skew
    if not skew or not explanation.adequate:
        return
    ticks, chosen = round(skew / layout.scales.tick), wrench_link_of(explanation.residual)
    in_time = [e for e in effects if e.link != "log"]
    links = []
    for rows in (layout.rows, layout.whole):
        wrench = make_wrench_link(layout, path, rows).as_interpreted(chosen)
        late, prompt = wrench.shown_in_all(effects), wrench.shown_in_all(in_time)
        used = [
            used_readings(run, a, b, ticks)
            for run, a, b in zip(wrench.runs, late, prompt, strict=True)
        ]
        link = compensation_link(layout, rows)
        links.append(link.on_used(used, [without_end(run, ticks) for run in link.runs]))
    late_record = Candidate(
        EFFECTS["log.skew"], (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"delay": skew}
    )  # as found on the contact
    candidates = (*candidates_of(layout.scales, ("compensation",)), late_record)
    found["compensation"] = _explain_compensation(layout, links[0], candidates, progress)
    whole["compensation"] = links[1].with_timing(found["compensation"].residual.link.timing)


def _settle_platform(
    layout: DatasetLayout,
    found: dict[str, Explanation],
    whole: dict[str, ModelLink],
    progress: Progress | None,
) -> DatasetLayout:
    """The platform explained again, if the sensor reads another wrench than the drives bear; and
    the layout with the latter.

    The recorded wrench is corrected by the difference of two replays, with the sensor's effects and
    without: errors of the replayed contact are the same in both.
    """
    explanation, platform = found["wrench"], found.get("platform")
    effects = explanation.chosen.effects()
    in_truth = [e for e in effects if e.link not in ("sensor", "log")]
    if (
        platform is None
        or not platform.departs
        or not explanation.adequate
        or len(in_truth) == len(effects)
        or all(follows_exactly(r.scenario) for r in layout.runs)
    ):
        return layout
    wrench = whole["wrench"]
    shown, borne = wrench.shown_in_all(effects), wrench.shown_in_all(in_truth)
    readings = [
        r.record.filled("wrench_meas") + b - s
        for r, b, s in zip(layout.runs, borne, shown, strict=True)
    ]
    again = with_readings(layout, readings)
    if again is None:
        return layout
    begun = _begin(progress, again, "platform", "platform under the force found")
    found["platform"], whole["platform"] = _explain_platform(
        again, _stamped_platform(again, found), begun
    )
    return again
