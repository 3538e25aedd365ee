"""Assessment of a run from its figures: whether the rig was passive and by what margin, warnings,
advice.

Everything is derived from the summary, so that a run read from disk is assessed like one that has
just ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hiltestbed.analysis.limits import BEYOND, in_words
from hiltestbed.run_folder.folders import number

# of the approach energy: the relative change of e is half of it over e^2, as for a 0.5 % gain error
# of the force sensor
NEUTRAL = 5e-3
CLOSE = 0.02  # |ln(e/e_ref)| up to which the rebound counts as correct: 2 % of the rebound speed
# times e_ref^2: energy gain of a rebound that is CLOSE too fast; a smaller gain gives no warning
ACTIVE = math.expm1(2.0 * CLOSE)
# relative error of an identified stiffness or damping, above which there is a warning
UNSURE = 0.10

# of the legs of an active ring
RING_FAULTS = {
    "force": "a leg reached its largest force",
    "stroke": "a leg reached the end of its stroke, and stands on its stop",
    "timeout": "the phase has not ended in its time",
}


# headers of delays_of and estimates_of
DELAYS = ("source", "delay [ms]", "as damping [N s/m]")
ESTIMATES = ("axis", "k ± sd", "true", "error", "c ± sd", "true", "error", "samples")


@dataclass(frozen=True)
class Assessment:
    """Assessment of a run.

    Attributes:
        passive: whether the rig made no energy; None if it is within the tolerance or nothing
            touched.
        energy: meaning of the energy figure. headline: what happened, in a sentence.
        warnings: for the user's attention. advice: what to do next.
    """

    passive: bool | None
    energy: str
    headline: str
    warnings: tuple[str, ...]
    advice: tuple[str, ...]


def assess(summary: dict[str, Any]) -> Assessment:
    """Assess a run from the contents of its summary.json."""
    passive, energy = _energy(summary)
    return Assessment(
        passive, energy, _headline(summary), tuple(_warnings(summary)), tuple(_advice(summary))
    )


def monitored(summary: dict[str, Any]) -> tuple[str, str] | None:
    """Result of process monitoring: events in order, and wear; None if it is not requested."""
    found = summary.get("monitoring")
    if not found:
        return None
    events = sorted(
        (found[name], name) for name in ("touch", "seat", "capture") if found[name] is not None
    )
    wear = found["wear"]
    note = ""
    if wear is not None:
        changed = {name: wear[f"{name}_change"] for name in ("stiffness", "damping")}
        sizes = [
            f"{n} {100.0 * change:+.2g} %" for n, change in changed.items() if change is not None
        ]
        note = f"{'worn' if wear['alarm'] else 'not worn'}: {', '.join(sizes)}"
    return ", ".join(f"{name} at {at:.3f} s" for at, name in events) or "nothing", note


def figures_of(summary: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Name, value and meaning of each figure of a run, as texts."""
    cor, reference, count = summary["cor"], summary["cor_reference"], summary["contacts"]
    contacts = f"{count} contact{'' if count == 1 else 's'}"
    if (captured := summary["captured_at"]) is not None:
        contacts += f", latched at {captured:.3f} s"
    known = "" if reference is None else f"reference {reference:.4f} (no delay, ideal)"
    missed = "" if cor is not None else "no rebound to measure"
    rows = [
        ("outcome", summary["outcome"].replace("_", " "), contacts),
        ("coefficient of restitution", number(cor), "; ".join(filter(None, (missed, known)))),
    ]
    if (error := summary["cor_log_error"]) is not None:
        off = f"{100.0 * math.expm1(error):+z.1f} %"
        predicted = summary.get("cor_log_error_predicted")
        off += "" if predicted is None else f"; the delay ledger predicts {predicted:+.4f}"
        rows.append(("  ln of the ratio", f"{error:+.4f}", off))
    elif (along := summary.get("cor_normal")) is not None:
        reference = number(summary.get("cor_normal_reference"))
        note = f"of the first contact, speed after over before; reference {reference}"
        rows.append(("  along the impulse", number(along), note))
    made = number(summary["energy_generated"], 4, "J")
    rows.append(("energy made by the rig", made, _energy(summary)[1]))
    if stability := summary.get("stability"):
        judged = {True: "stable", False: "unstable", None: "not judged"}[stability["stable"]]
        why = stability["verdict"].removeprefix(f"{judged}: ").removeprefix(f"{judged} ")
        rows.append(("the loop in contact", judged, why))
    lasted = summary["contact_duration"]
    rows += [
        ("peak force", number(summary["peak_force"], 4, "N"), ""),
        ("contact time", number(lasted, 4, "s"), "" if lasted else "the ports did not touch"),
    ]
    if (share := summary.get("limits_share")) is not None:
        most = f"the most, {100.0 * share:.3g} %, by {summary['limits_worst']}"
        rows.append(("limits", "exceeded" if share > BEYOND else "kept", most))
    if (legs := summary.get("active_ring")) is not None:
        rows.append(("active ring", *_ring(legs, summary["phases"])))
    if (seen := monitored(summary)) is not None:
        rows.append(("process monitoring", *seen))
    return rows


def _ring(legs: dict[str, Any], phases: list[dict[str, Any]]) -> tuple[str, str]:
    """The phase that an active ring has reached, and what its legs did."""
    begun = [phase["name"].replace("_", " ") for phase in phases if phase["at"] is not None]
    low, high = (1e3 * travel for travel in legs["leg_travel"])
    return begun[-1] if begun else "not captured", (
        f"a leg at most {legs['leg_force']:.4g} N, {low:+.3g} to {high:+.3g} mm; "
        f"{legs['energy_absorbed']:.3g} J absorbed"
    )


def energy_share(summary: dict[str, Any]) -> float | None:
    """Energy made by the rig over the kinetic energy of the approach (or, for a mechanism latched
    from the start, the energy stored at the peak force); None if nothing touched or neither is
    known.
    """
    reference = summary.get("energy_reference", summary.get("approach_energy"))
    return None if not reference else summary["energy_generated"] / reference


def is_active(summary: dict[str, Any]) -> bool:
    """Whether the rig made enough energy for a warning: more than that of a rebound that is 2 % too
    fast.

    A contact with coefficient e_ref keeps e_ref^2 of the energy, so a rebound that is :data:`CLOSE`
    too fast has gained ``e_ref^2 (exp(2 CLOSE) - 1)`` of it. The threshold is at least
    :data:`NEUTRAL`, and at least the resolution of the sum over ticks.
    """
    share = energy_share(summary)
    if share is None or not summary["contact_duration"]:
        return False
    references = [summary.get(name) for name in ("cor_reference", "cor_normal_reference")]
    kept = next((min(e, 1.0) for e in references if e is not None), 1.0)
    return share > max(NEUTRAL, ACTIVE * kept**2) and summary["energy_generated"] > summary.get(
        "energy_resolution", 0.0
    )


def _energy(summary: dict[str, Any]) -> tuple[bool | None, str]:
    made = summary["energy_generated"]
    if not summary["contact_duration"]:
        return None, "no contact"
    share = energy_share(summary)
    if share is None and made == 0.0:
        return None, "neither gained nor lost"
    if share is None:
        return made < 0.0, "gained: active" if made > 0.0 else "lost: passive"
    size = f"{100.0 * abs(share):.2g} % of the approach energy"
    if abs(share) <= NEUTRAL:
        return None, f"neutral: within {100.0 * NEUTRAL:g} % of the approach energy"
    if abs(made) <= (resolved := summary.get("energy_resolution", 0.0)):
        return None, f"neutral: within {resolved:.2g} J, the resolution of the sum over ticks"
    return (False, f"gained, {size}: active") if made > 0.0 else (True, f"lost, {size}: passive")


def _headline(summary: dict[str, Any]) -> str:
    if summary["status"] == "no_reference":
        return f"The run has no reference: {summary['stop_reason']}."
    if summary["status"] != "completed":
        ended = "diverged" if summary["status"] == "diverged" else "was stopped"
        return f"The run {ended}: {summary['stop_reason']}."
    ended = {
        "captured": "The ports were captured.",
        "rebound": "The ports touched and separated.",
        "in_contact": "The ports were still in contact when the run ended.",
        "miss": "The ports did not touch.",
    }
    text = ended.get(summary["outcome"], f"Outcome: {summary['outcome']}.")
    if (cor := summary["cor"]) is not None:
        reference = summary["cor_reference"]
        text += f" They separated at {cor:.4g} times the approach speed"
    elif (along := summary.get("cor_normal")) is not None:
        reference = summary.get("cor_normal_reference")
        text += f" The first contact ended at {along:.4g} times its speed along its impulse"
    else:
        return text
    if reference is None:
        return f"{text}."
    return f"{text}; without delay and with ideal tracking it is {reference:.4g} times."


def _warnings(summary: dict[str, Any]) -> list[str]:
    out = []
    cor, reference, error = summary["cor"], summary["cor_reference"], summary["cor_log_error"]
    if cor is not None and cor > 1.0 and (reference is None or cor > reference * math.exp(CLOSE)):
        out.append(
            f"the rebound is faster than the approach (e = {cor:.4g}): the loop feeds energy into "
            f"the contact"
        )
    elif error is not None and abs(error) > CLOSE:
        out.append(f"the rebound is {100.0 * math.expm1(error):+z.1f} % off the reference")
    elif error is None and abs(along := summary.get("cor_normal_log_error") or 0.0) > CLOSE:
        out.append(
            f"the rebound of the first contact, along its impulse, is "
            f"{100.0 * math.expm1(along):+z.1f} % off the reference"
        )
    if is_active(summary):
        share = energy_share(summary)
        size = "" if share is None else f", {100.0 * share:.2g} % of the approach energy"
        out.append(f"the rig is active: it made {summary['energy_generated']:.3g} J{size}")
    late = summary.get("force_delay")
    if late and late["half_width"]:
        out.append(
            f"the force is {1e3 * late['estimated']:.4g} ms (+-{1e3 * late['half_width']:.2g} ms) "
            f"late, not the {1e3 * late['told']:.4g} ms of sensor.delay: the contact refused them"
        )
    out += [
        f"active ring: {RING_FAULTS[fault['what']]} at {fault['at']:.4g} s, in {fault['phase']}"
        for fault in summary.get("active_ring", {}).get("faults", ())
    ]
    rows = summary.get("limits", ())
    out += [f"limits: {in_words(row)}" for row in rows if (row["share"] or 0.0) > BEYOND]
    stability = summary.get("stability")
    if stability and stability["stable"] is False:
        out.append(f"the loop is {stability['verdict']}")
    for axis, values in identified(summary).items():
        for quantity in ("stiffness", "damping"):
            found, true = values[quantity], values[f"{quantity}_true"]
            if found is not None and true and abs(found / true - 1.0) > UNSURE:
                out.append(
                    f"{quantity} along {axis} was identified as {found:.4g}; the true value is "
                    f"{true:.4g}"
                )
    return out


def identified(summary: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The estimates on each axis that has one, and along the normal of a curved contact."""
    every = summary["identification"] | (
        {"normal": summary["identification_normal"]} if "identification_normal" in summary else {}
    )
    return {axis: values for axis, values in every.items() if values["stiffness"] is not None}


def estimates_of(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    """Cells below :data:`ESTIMATES`: identified with its sd, true, and the error in per cent."""
    rows = []
    for axis, values in identified(summary).items():
        cells = [axis]
        for quantity in ("stiffness", "damping"):
            value, true, sd = (values.get(quantity + part) for part in ("", "_true", "_sd"))
            sure = "" if sd is None else f" ± {sd:.0f}" if sd >= 10.0 else f" ± {sd:.2g}"
            error = f"{100.0 * (value / true - 1.0):+z.2f} %" if value is not None and true else ""
            cells += [number(value, 6) + sure * (value is not None), number(true, 6), error]
        rows.append((*cells, str(values["samples"])))
    return rows


def delays_of(summary: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Cells of the delay ledger below :data:`DELAYS`."""
    return [
        (e["source"], f"{1e3 * e['delay']:+.4f}", f"{e['equivalent_damping']:+.2f}")
        for e in summary["delay_ledger"]
    ]


def largest_delay(summary: dict[str, Any]) -> dict[str, Any] | None:
    """The delay ledger entry (except the total) with the largest delay after subtraction of the
    compensation of sensor and platform; None if there is no delay.
    """
    entries = [entry for entry in summary["delay_ledger"] if entry["source"] != "total"]
    taken = {
        entry["source"]: -entry["delay"]
        for entry in entries
        if entry["source"].startswith("compensation.")
    }
    off = {"platform": taken.pop("compensation.platform", 0.0), "sensor": sum(taken.values())}
    left = []
    for entry in entries:
        link = entry["source"].partition(".")[0]
        less = min(off.get(link, 0.0), entry["delay"])
        off[link] = off.get(link, 0.0) - less
        left.append(entry | {"delay": entry["delay"] - less})
    return max(
        (entry for entry in left if entry["delay"] > 0.0),
        key=lambda entry: entry["delay"],
        default=None,
    )


def _cure(source: str, ledger: list[dict[str, Any]]) -> str:
    """How to remove the delay of the ledger entry ``source``."""
    if source.startswith("effects."):
        return (
            "the loop does not know it; add it to the description of the rig in the scenario, or "
            "have it estimated with "
            "--set 'compensation.force={kind: resynchronised, delay: estimate}'"
        )
    if source.startswith("platform."):
        return (
            "remove it with --set 'compensation.force={kind: resynchronised}', which also "
            "compensates the platform; the lag of a servo "
            "without feed-forward also with --set 'compensation.motion={kind: feedforward}'"
        )
    if any(entry["source"] == "compensation.resynchronised" for entry in ledger):
        return "no further compensation removes it; make it smaller"
    return "compensate it, for example with --set 'compensation.force={kind: resynchronised}'"


def _advice(summary: dict[str, Any]) -> list[str]:
    if summary["status"] == "no_reference":
        return ["Correct what makes energy in the reference: the run is compared with it."]
    if summary["status"] != "completed":
        if summary["status"] == "diverged":
            cure = (
                "Make the delay shorter, or take a compensation that knows it (`hiltestbed rank` "
                "tries all); a lower approach speed does not help a loop that diverges."
            )
        else:
            cure = (
                "Lower the approach speed, or raise the limit under `safety` if the rig allows it; "
                "what a drive cannot exert, no limit gives: ask less of it by another compensation "
                "(`hiltestbed rank` tries all)."
            )
        return [
            "Replay the last ticks with hiltestbed.replay_failure(FOLDER) and see which quantity "
            "grows first.",
            cure,
        ]
    if summary["outcome"] == "miss":
        return [
            "Raise `duration`, lower `approach.gap`, or aim with `approach.offset` and "
            "`approach.velocity`."
        ]
    error, largest = summary["cor_log_error"], largest_delay(summary)
    total = summary["delay_ledger"][-1] if summary["delay_ledger"] else None
    out = []
    if (is_active(summary) or (error is not None and abs(error) > CLOSE)) and total is not None:
        if largest is not None and total["delay"] > 0.0:
            out.append(
                f"The remaining delays add up to {1e3 * total['delay']:.3g} ms, the largest is "
                f"{largest['source']} "
                f"({1e3 * largest['delay']:.3g} ms): "
                f"{_cure(largest['source'], summary['delay_ledger'])}."
            )
        later = [
            way.get("rig_energy") or 0.0
            for way in (summary.get("stability") or {}).get("directions", ())
            if way["direction"].endswith("later touch")
        ]
        if is_active(summary) and max(later, default=0.0) > NEUTRAL:
            out.append(
                "In a later touch, elsewhere on the surface, the compensation does not know the "
                "line of the force yet, so the platform's "
                "lag counts: remove it with --set 'compensation.motion={kind: feedforward}'."
            )
        out.append(
            "Map where this rig diverges with a campaign over sensor.delay and "
            "mechanism.contact.stiffness (hiltestbed sweep)."
        )
    if not out and summary["outcome"] in ("rebound", "captured"):
        out.append(
            "The loop reproduces the contact. Vary the least known parameters, delay and "
            "stiffness first, with hiltestbed sweep."
        )
    return out
