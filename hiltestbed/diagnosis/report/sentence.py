"""The verdict and the gain in words."""

from __future__ import annotations

from collections.abc import Sequence

from hiltestbed.diagnosis.result import Cause, Conclusion, Heldout, Learned
from hiltestbed.effects.table import EFFECTS

TITLES = {
    "no_discrepancy": "the simulation agrees with the data",
    "named": "the cause is named",
    "ambiguous": "one of a few causes",
    "named_in_part": "part of the departure is named",
    "unknown": "a departure without a named cause",
    "inconclusive": "only a part of the loop could be judged",
}
WHERE = {
    "platform": "the motion platform (pose commanded to pose reached)",
    "contact": "the contact (pose reached to force measured)",
    "sensor": "the force sensor (pose reached to force measured)",
    "compensation": "the compensation (force measured to force used)",
    "dynamics": "the numerical model (force used to pose commanded)",
    "log": "the record alone (the loop is untouched)",
}


def verdict_sentence(diagnosis: Conclusion) -> str:
    finding = diagnosis.finding
    link = WHERE.get(finding.link or "", "the loop")
    where = _capital(link)
    left = f" {_capital(finding.left).rstrip('.')}." if finding.left else ""
    named = " and ".join(named_cause(c) for c in finding.causes)
    if finding.verdict == "no_discrepancy":
        text = (
            "The simulation explains these data: every link was judged, and the residual "
            "is noise on every channel."
        )
        return " ".join([text, *(f"But {offset.sentence()}." for offset in finding.timing)])
    if finding.verdict == "inconclusive":
        text = "No link of the loop could be judged with these channels."
        if diagnosis.residuals:
            text = (
                "Nothing departs on the links that could be judged, but these are not "
                "the whole loop."
            )
        return " ".join(
            [text, *(f"Not judged: {link} ({why})." for link, why in finding.not_judged.items())]
        )
    if finding.verdict == "unknown":
        start = f"Named: {named}. Besides, {link}" if named else where
        text = "departs from its model, and no effect of the vocabulary leaves only noise."
        return f"{start} {text}{left}"
    if finding.verdict == "named_in_part":
        share = (
            f", {100.0 * finding.explained:.0f} % of the departure on left-out runs,"
            if finding.explained
            else ""
        )
        text = f"{where} departs from its model. In part{share} this is {named}"
        return f"{text}; something else acts as well.{left}"
    parts = []
    for link in dict.fromkeys(_link(c) for c in finding.causes):
        found = " and ".join(named_cause(c) for c in finding.causes if _link(c) == link)
        parts.append(f"{WHERE.get(link, link)} departs from its model: {found}")
    text = f"{_capital('; '.join(parts))}."
    if finding.verdict == "ambiguous":
        text += " These data cannot decide which of them it is."
    return text


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"


def _link(cause: Cause) -> str:
    return EFFECTS[cause.effect].link


def named_cause(cause: Cause) -> str:
    """`sensor.delay [delay 0.0033 (0.0031 to 0.0035) s]`, and its look-alikes."""
    idle = {
        name
        for name, field in EFFECTS[cause.effect].model_fields.items()
        if not field.is_required() and field.default == 0.0
    }
    words = ", ".join(
        f"{name} {p.in_words()}"
        for name, p in cause.parameters.items()
        if name not in idle or p.estimate
    )
    rivals = (
        f", indistinguishable from {' or '.join(rivals_of(cause))}"
        if cause.indistinguishable_from
        else ""
    )
    return f"{cause.effect} [{words}]{rivals}" if words else f"{cause.effect}{rivals}"


def rivals_of(cause: Cause) -> list[str]:
    """The look-alikes of a cause: `sensor.delay`; `dynamics.mass [body target]` for the same effect
    on another body or axis.
    """
    out = list(cause.indistinguishable_from)
    for i, told in enumerate(cause.alternatives[: len(out)]):
        if out[i] == cause.effect:
            entry = next(e for e in told if e["kind"] == cause.effect)
            own = {name: p.estimate for name, p in cause.parameters.items()}
            other = [
                f"{name} {v}"
                for name, v in entry.items()
                if isinstance(v, str) and name != "kind" and own.get(name) != v
            ]
            out[i] += f" [{', '.join(other)}]"
    return out


def partial_sentence(causes: Sequence[Cause], gain: Heldout | None) -> str:
    """The best extension where no effects leave only noise, and its gain; empty without one."""
    if not causes:
        return ""
    text = f"The best extension: {' and '.join(named_cause(c) for c in causes)}."
    if gain is None:
        return f"{text} The residual is not noise."
    worth = "" if gain.significant else " That is not significant."
    return (
        f"{text} On {len(gain.runs)} runs, each left out of the fit in turn, the residual falls by "
        f"{gain.in_words()}; a wrong effect gives {_placebo(gain)}.{worth} The residual is not "
        f"noise, so that something else acts as well."
    )


def _placebo(gain: Heldout) -> str:
    return f"{round(100.0 * gain.placebo_reduction, 1) + 0.0:.1f} %"  # no -0.0


def learned_sentence(learned: Learned) -> str:
    gain = learned.heldout
    equation = f" ({learned.equation})" if learned.equation else ""
    text = (
        f"A law learned from the data, {learned.effect} with {learned.numbers} numbers{equation}, "
        f"lowers the residual of {len(gain.runs)} runs, each left out of the fit in turn, by "
        f"{gain.in_words()}; fitted to residuals shifted by half a contact, it gives "
        f"{_placebo(gain)}."
    )
    if learned.resembles:
        text += f" It resembles {' and '.join(learned.resembles)}."
    if learned.carries_over:
        return f"{text} The model is extended with it."
    return (
        f"{text} It is not the same in all runs, or explains too little, and the model "
        f"is not extended with it."
    )


def meaning(effect: str) -> str:
    return EFFECTS[effect].meaning() if effect in EFFECTS else ""


def gain_sentence(heldout: Heldout | None, extends: bool) -> str:
    """The gain on runs that were not fitted, against its placebo."""
    if heldout is None and extends:
        return "The gain was not measured on left-out runs."
    if heldout is None:
        return "The model was not extended, so there is no gain to measure."
    text = (
        f"On {len(heldout.runs)} runs, each left out of the fit in turn, the residual falls by "
        f"{heldout.in_words()}; a wrong effect of equal size gives {_placebo(heldout)}."
    )
    if heldout.significant:
        return text
    return f"{text} That is not significant: no gain is claimed and the model is not extended."
