"""report.html of a diagnosis, from the top down: the verdict, the evidence, the gain, and the next
experiment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hiltestbed.diagnosis.certainty import Certainty, Profile
from hiltestbed.diagnosis.plain import LINK_NAMES, listed
from hiltestbed.diagnosis.report import pictures
from hiltestbed.diagnosis.report.sentence import (
    TITLES,
    gain_sentence,
    learned_sentence,
    meaning,
    partial_sentence,
    rivals_of,
    verdict_sentence,
)
from hiltestbed.diagnosis.result import (
    Cause,
    Conclusion,
    Figures,
    Finding,
    Heldout,
    Isolable,
)
from hiltestbed.effects.table import EFFECTS
from hiltestbed.report.page import Report

STRONG_CORRELATION = 0.95  # chosen: from which one estimate means nothing without the other


def report_of(diagnosis: Conclusion) -> Report:
    report = Report(f"Diagnosis of {diagnosis.name}: {TITLES[diagnosis.verdict]}")
    report.lead(verdict_sentence(diagnosis))
    for text in diagnosis.overridden:
        report.text(text)
    report.text(_summary(diagnosis))
    _causes(report, diagnosis)
    _evidence(report, diagnosis)
    _certainty(report, diagnosis.finding.certainty)
    _ranking(report, diagnosis)
    _gain(report, diagnosis)
    _next(report, diagnosis)
    _isolability(report, diagnosis.finding)
    _channels(report, diagnosis)
    _data(report, diagnosis)
    return report


def _summary(d: Conclusion) -> str:
    parts = [learned_sentence(d.finding.learned)] if d.finding.learned else []
    if d.causes or not parts:
        parts = [gain_sentence(d.heldout, d.finding.names), *parts]
    measured, nominal, extended = (
        _mean([f.cor for f in row])
        for row in (d.closed_loop.measured, d.closed_loop.nominal, d.closed_loop.extended)
    )
    if measured is not None and nominal is not None:
        runs = sum(f.cor is not None for f in d.closed_loop.measured)
        mean = (
            f"In closed loop the coefficient of restitution "
            f"is{f', on average over {runs} runs,' if runs > 1 else ''}"
        )
        text = f"{mean} {measured:.4f} measured and {nominal:.4f} simulated"
        shown = d.finding.extends and extended is not None
        parts.append(text + (f", {extended:.4f} with the extended model." if shown else "."))
    if d.next_experiment:
        parts.append(
            "What remains open, and the run that would settle it, is under Next experiment."
        )
    return " ".join(parts)


def _causes(report: Report, d: Conclusion) -> None:
    if d.causes:
        _cause_table(report, d.causes, "Cause" if len(d.causes) == 1 else "Causes")
    if d.finding.partial:
        _cause_table(report, d.finding.partial, "Nearest effects", rivals=False)
        report.text(
            "These effects of the vocabulary together explain most of the departure. Their "
            "residual is not noise: they are at most "
            "part of the cause, and the model is not extended with them."
        )
    _learned(report, d)
    if d.finding.extends:
        report.text(
            "extended.yaml in this folder is the scenario with these effects; it runs: hiltestbed "
            "run extended.yaml"
        )


def _learned(report: Report, d: Conclusion) -> None:
    learned = d.finding.learned
    if learned is None:
        return
    report.heading("A law without a name")
    report.text(learned_sentence(learned))
    report.text(f"{learned.effect}: {meaning(learned.effect)} {EFFECTS[learned.effect].equation}")
    report.figure(
        pictures.learned_curves(learned),
        "Each curve of the law, with the data after all other terms are subtracted.",
    )


def _cause_table(report: Report, causes: Sequence[Cause], title: str, rivals: bool = True) -> None:
    report.heading(title)
    for cause in causes:
        report.text(f"{cause.effect}: {meaning(cause.effect)} {EFFECTS[cause.effect].equation}")
    rows = []
    for c in causes:
        among = f"{c.probability:.2f}", ", ".join(rivals_of(c)) or "nothing else"
        rows += [(c.effect, name, p.in_words(), *among) for name, p in c.parameters.items()]
    header = ("effect", "parameter", "estimate (95 % interval)")
    header = (*header, "probability", "indistinguishable from")
    if rows:
        shown = len(header) if rivals else 3
        report.table(header[:shown], [row[:shown] for row in rows])
    if rivals and (others := [(c.effect, told) for c in causes for told in c.alternatives]):
        report.text("Explanations that fit as well, with their parameters:")
        report.table(
            ("instead of", "explanation"), [(effect, _in_words(told)) for effect, told in others]
        )


def _in_words(explanation: Sequence[Mapping[str, Any]]) -> str:
    return " and ".join(
        f"{e['kind']} [{listed({name: v for name, v in e.items() if name != 'kind'})}]"
        for e in explanation
    )


def _evidence(report: Report, d: Conclusion) -> None:
    series, compared = d.finding.series, d.compared
    if not series:
        return
    report.heading("Evidence")
    report.text(
        "Each link of the loop was replayed alone on its measured input, so that the error of one "
        "cannot leak into another. Residuals are in units of the channel's own noise: within the "
        "grey band they are noise. Contact is shaded."
    )
    report.figure(
        pictures.residuals_over_time(series, compared, d.dataset.names),
        "Residuals of the channels with the largest misfit.",
    )
    report.figure(
        pictures.channel_over_time(series, compared, d.dataset.names),
        "The channel with the largest misfit, around the contact.",
    )
    force = pictures.force_against_penetration(series, d.dataset, compared)
    if force is not None:
        report.figure(
            force,
            "Force over penetration, corrected for the sensor's nominal delay; slowest to fastest "
            "approach.",
        )
    if d.finding.left:
        report.text(f"Residual: {d.finding.left}.")


def _certainty(report: Report, certainties: Sequence[Certainty]) -> None:
    profiles = [p for c in certainties for p in c.profiles]
    if not profiles:
        return
    report.heading("Uncertainty of the estimates")
    for sentence in (*bounds_met(profiles), *tied(certainties)):
        report.text(sentence)
    report.figure(
        pictures.profile_figure(profiles),
        "Cost of holding a parameter at another value while the other parameters of its link "
        "follow: chi-square above its minimum, in units of the misfit per sample. Dashed: 3.84, "
        "the 95 % of an exact model. Shaded: the 95 % interval, which is wider where the runs "
        "contradict each other or the noise is correlated. Hatched: beyond the bounds of the "
        "search.",
    )
    for c in certainties:
        if len(c.profiles) > 1:
            report.figure(
                pictures.correlation_figure(c),
                f"Correlation of the estimates on the link {LINK_NAMES.get(c.link, c.link)}: near "
                "1 or -1 the data determine a combination of the two, not each by itself.",
            )


def bounds_met(profiles: Sequence[Profile]) -> list[str]:
    """A sentence for each estimate at a bound of the search."""
    out = []
    for p in profiles:
        if p.met is not None:
            at, unit = (
                p.bounds[0 if p.met == "lowest" else 1],
                "" if p.unit == "-" else f" {p.unit}",
            )
            out.append(
                f"{p.label} is at the {p.met} value that was searched, {at:.4g}{unit}: the data "
                "favour a value beyond it, which means another effect, or a size that was not "
                "thought possible. Its estimate is not reliable."
            )
    return out or ["No estimate is at a bound of its search."]


def tied(certainties: Sequence[Certainty]) -> list[str]:
    """A sentence for the most correlated pair of estimates of each link."""
    out = []
    for c in certainties:
        if (pair := c.strongest()) is not None:
            a, b, size = pair
            then = (
                "only a combination of them is determined"
                if abs(size) >= STRONG_CORRELATION
                else "each is determined by itself"
            )
            alike = (
                f"The most correlated estimates on the link "
                f"{LINK_NAMES.get(c.link, c.link)} are {a.label} and {b.label}"
            )
            out.append(f"{alike}, at {size:+.3f}: {then}.")
    return out


def _ranking(report: Report, d: Conclusion) -> None:
    ranking = [r for r in d.finding.ranking if math.isfinite(r.score)]
    if not ranking:
        return
    report.heading("Hypotheses that were compared")
    for link in dict.fromkeys(r.link for r in ranking):
        mine = [r for r in ranking if r.link == link]
        best, rows = min(x.score for x in mine), []
        for r in mine:
            worse = f"{r.score - best:.3g}", _number(r.heldout), _yes(r.adequate)
            rows.append((" + ".join(r.effects), r.parameters, *worse))
        header = ("hypothesis", "parameters", "worse by", "left-out rms / noise")
        report.table(
            (*header, "leaves only noise"),
            rows,
            f"Link {LINK_NAMES.get(link, link) or d.link}: chi-square with the penalty for "
            "parameters; within a few units of the best they cannot be told apart.",
        )


def _gain(report: Report, d: Conclusion) -> None:
    report.heading("Gain")
    report.text(gain_sentence(d.heldout, d.finding.names))

    def bars(gain: Heldout, caption: str) -> None:
        report.figure(pictures.heldout_bars(gain, d.dataset.names), caption)

    if d.finding.learned is not None:
        bars(d.finding.learned.heldout, "The learned law on runs that were left out of its fit.")
    if d.finding.partial_gain is not None:
        report.text(partial_sentence(d.finding.partial, d.finding.partial_gain))
        bars(d.finding.partial_gain, "The best explanation on runs that were left out of its fit.")
    if d.heldout is not None and d.heldout.per_run:
        bars(d.heldout, "Residual of the departing link on runs that were left out of the fit.")
    if not any(f != Figures() for f in d.closed_loop.measured):
        return
    sources = ("measured", "nominal", "extended") if d.finding.extends else ("measured", "nominal")
    names = {"cor": "CoR", "peak_force": "peak [N]"}
    rows = []
    for i, run in enumerate(d.closed_loop.runs):
        figures: list[Figures] = [getattr(d.closed_loop, source)[i] for source in sources]
        values = (_number(getattr(f, name), 5) for name in names for f in figures)
        rows.append([d.dataset.names[run], *values])
    report.table(
        ["run", *(f"{n} {source}" for n in names.values() for source in sources)],
        rows,
        "The same runs in closed loop, by one rule: speeds from the commanded pose.",
    )


def _next(report: Report, d: Conclusion) -> None:
    report.heading("Next experiment")
    if d.experiment is None:
        report.text("Nothing remains open that another run would settle.")
        return
    report.text(d.experiment.text)
    if d.experiment.runs:
        lines = ["runs:"] + [
            f"  - set: {{{', '.join(f'{k}: {_yaml(v)}' for k, v in run.items())}}}"
            for run in d.experiment.runs
        ]
        report.code("\n".join(lines))


def _isolability(report: Report, finding: Finding) -> None:
    table = finding.isolability
    if not table and not finding.unsized:
        return
    report.heading("What these data could detect")
    for link, why in finding.unsized.items():
        report.text(f"No sizes can be stated for the effects of the {link}: {why}.")
    if not table:
        return
    table = sorted(table, key=lambda i: (i.effect.partition(".")[0], i.effect))
    rows = [(i.effect, i.parameter, _size(i), ", ".join(i.confused_with) or "none") for i in table]
    report.table(
        ("effect", "parameter", "size that is detected", "look-alikes at that size"),
        rows,
        "From the sensitivities of the replayed links to each effect, with these runs, channels "
        "and noise. Factors: departure from 1. "
        "Look-alikes at the smallest detected size may be told apart at a larger one.",
    )


def _channels(report: Report, d: Conclusion) -> None:
    if not d.residuals:
        return
    report.heading("Every channel")
    rows = []
    for r in d.residuals:
        sizes = r.noise_floor, r.rms, r.rms_free, r.rms_contact, r.rms_after
        extended = _yes(r.white), _number(r.rms_extended), _yes(r.white_extended)
        rows.append((r.channel, r.unit, *map(_number, sizes), *extended))
    header = ("channel", "unit", "noise", "rms", "before touch", "in contact", "after")
    header = (*header, "only noise", "rms extended", "only noise")
    report.table(
        header,
        rows,
        "rms of measured less replayed; the test for white noise at the floor counts correlated "
        "samples once.",
    )


def _data(report: Report, d: Conclusion) -> None:
    report.heading("Data")
    rows = []
    for run in d.dataset.runs:
        contacts = run.survey.contacts
        peak = max((abs(c.peak_force or 0.0) for c in contacts), default=None)
        speed, spring = run.scenario.approach.velocity[2], run.scenario.mechanism.contact.stiffness
        rate = f"{run.record.sample_rate:.6g}"
        way = f"{speed:.3g}", f"{spring:.4g}", len(contacts), _number(peak)
        rows.append((run.name, run.record.ticks, rate, *way))
    report.table(
        ("run", "ticks", "samples [Hz]", "speed [m/s]", "spring [N/m]", "contacts", "peak [N]"),
        rows,
    )
    for remark in d.remarks:
        report.text(remark)
    if not d.remarks:
        report.text("The check of the data gave no remarks.")
    if d.seconds is not None:
        report.text(
            f"Diagnosed in {d.seconds:.1f} s, without the time for this page and its figures."
        )


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _yes(value: bool | None) -> str:
    return {True: "yes", False: "no", None: "-"}[value]


def _size(i: Isolable) -> str:
    """The smallest size that is found; of a frequency, a limit or a stiffness the largest."""
    if i.smallest is None:
        return "not detected"
    if not i.unit:
        return "detected"
    sign = "up to " if EFFECTS[i.effect].vanishes else "from "
    return f"{sign}{i.smallest:.3g} {'' if i.unit == '-' else i.unit}".strip()


def _yaml(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(f"{v:g}" for v in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
