"""What the figures of a run mean: whether the rig was passive and by what margin, what to be warned of, what to do next.

Everything is derived from the summary, so that a run read from disk is judged as one that has just ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

NEUTRAL = 5e-3  # of the approach energy: e changes by half of it over e^2, about what a gain error of 0.5 % of the force sensor does
CLOSE = 0.02  # |ln(e/e_ref)| up to which the rebound counts as right: 2 % of the rebound speed
ACTIVE = math.expm1(2.0 * CLOSE)  # of e_ref^2: the energy with which a rebound is CLOSE too fast; less of it is told, not warned of
UNSURE = 0.10  # relative error of an identified stiffness or damping from which it is warned of


@dataclass(frozen=True)
class Assessment:
    """A run in words.

    Attributes:
        passive: whether the rig made no energy; None where it is within the tolerance or nothing touched.
        energy: what the energy figure means. headline: what happened, in a sentence.
        warnings: what the user must not overlook. advice: what to do next.
    """

    passive: bool | None
    energy: str
    headline: str
    warnings: tuple[str, ...]
    advice: tuple[str, ...]


def assess(summary: dict[str, Any]) -> Assessment:
    """Judge a run by the contents of its summary.json."""
    passive, energy = _energy(summary)
    return Assessment(passive, energy, _headline(summary), tuple(_warnings(summary)), tuple(_advice(summary)))


def monitored(summary: dict[str, Any]) -> tuple[str, str] | None:
    """What process monitoring says of a run: its events in order, and wear; None where the scenario does not ask for it."""
    found = summary.get("monitoring")
    if not found:
        return None
    events = sorted((found[name], name) for name in ("touch", "seat", "capture") if found[name] is not None)
    wear = found["wear"]
    if wear is None:
        note = ""
    else:
        note = "worn" if wear["alarm"] else "not worn"
        note += f": stiffness {100.0 * wear['stiffness_change']:+.2g} %, damping {100.0 * wear['damping_change']:+.2g} %"
    return ", ".join(f"{name} at {at:.3f} s" for at, name in events) or "nothing", note


def energy_share(summary: dict[str, Any]) -> float | None:
    """Energy made by the rig over the kinetic energy of the approach (what is stored at the peak force, of a mechanism that holds from the
    start); None where nothing touched or neither is known."""
    reference = summary.get("energy_reference", summary.get("approach_energy"))
    return None if not reference else summary["energy_generated"] / reference


def is_active(summary: dict[str, Any]) -> bool:
    """Whether the rig made so much energy that it must not be overlooked: more than makes a rebound 2 % too fast.

    A contact of coefficient e_ref keeps e_ref^2 of the energy, so that ``e_ref^2 (exp(2 CLOSE) - 1)`` of it is what a rebound gains that is
    :data:`CLOSE` too fast; it is never less than :data:`NEUTRAL`, and never less than what the sum over ticks resolves.
    """
    share = energy_share(summary)
    if share is None or not summary["contact_duration"]:
        return False
    references = [summary.get(name) for name in ("cor_reference", "cor_normal_reference")]
    kept = next((min(e, 1.0) for e in references if e is not None), 1.0)
    return share > max(NEUTRAL, ACTIVE * kept**2) and summary["energy_generated"] > summary.get("energy_resolution", 0.0)


def _energy(summary: dict[str, Any]) -> tuple[bool | None, str]:
    made = summary["energy_generated"]
    if not summary["contact_duration"]:
        return None, "no contact"
    share = energy_share(summary)
    if share is None:
        return (None, "neither gained nor lost") if made == 0.0 else (made < 0.0, "gained: active" if made > 0.0 else "lost: passive")
    size = f"{100.0 * abs(share):.2g} % of the approach energy"
    if abs(share) <= NEUTRAL:
        return None, f"neutral: within {100.0 * NEUTRAL:g} % of the approach energy"
    if abs(made) <= summary.get("energy_resolution", 0.0):
        return None, f"neutral: within {summary['energy_resolution']:.2g} J, which the sum over ticks resolves"
    return (False, f"gained, {size}: active") if made > 0.0 else (True, f"lost, {size}: passive")


def _headline(summary: dict[str, Any]) -> str:
    if summary["status"] != "completed":
        return f"The run {'diverged' if summary['status'] == 'diverged' else 'was stopped'}: {summary['stop_reason']}."
    ended = {
        "captured": "The ports were captured.",
        "rebound": "The ports touched and parted.",
        "in_contact": "The ports were still in contact when the run ended.",
        "miss": "The ports did not touch.",
    }
    text = ended.get(summary["outcome"], f"Outcome: {summary['outcome']}.")
    cor, reference = summary["cor"], summary["cor_reference"]
    if cor is not None:
        text += f" They parted at {cor:.4g} times the speed of approach"
        text += "." if reference is None else f"; without delay and with ideal tracking it is {reference:.4g} times."
    elif (along := summary.get("cor_normal")) is not None:
        text += f" The first contact ended at {along:.4g} times its speed along its impulse"
        reference = summary.get("cor_normal_reference")
        text += "." if reference is None else f"; without delay and with ideal tracking it is {reference:.4g} times."
    return text


def _warnings(summary: dict[str, Any]) -> list[str]:
    out = []
    cor, reference, error = summary["cor"], summary["cor_reference"], summary["cor_log_error"]
    if cor is not None and cor > 1.0 and (reference is None or cor > reference * math.exp(CLOSE)):
        out.append(f"the rebound is faster than the approach (e = {cor:.4g}): the loop feeds energy into the contact")
    elif error is not None and abs(error) > CLOSE:
        out.append(f"the rebound is {100.0 * math.expm1(error):+.1f} % off the reference")
    elif error is None and abs(along := summary.get("cor_normal_log_error") or 0.0) > CLOSE:
        out.append(f"the rebound of the first contact, along its impulse, is {100.0 * math.expm1(along):+.1f} % off the reference")
    if is_active(summary):
        share = energy_share(summary)
        size = "" if share is None else f", {100.0 * share:.2g} % of the approach energy"
        out.append(f"the rig is active: it made {summary['energy_generated']:.3g} J{size}")
    stability = summary.get("stability")
    if stability and stability["stable"] is False:
        out.append(f"the loop is {stability['verdict']}")
    for axis, values in identified(summary).items():
        for quantity in ("stiffness", "damping"):
            found, true = values[quantity], values[f"{quantity}_true"]
            if found is not None and true and abs(found / true - 1.0) > UNSURE:
                out.append(f"{quantity} along {axis} was identified as {found:.4g} where {true:.4g} is true")
    return out


def identified(summary: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What was identified on each axis, and along the normal of a contact whose surface is not one plane; those that gave an estimate."""
    every = summary["identification"] | ({"normal": summary["identification_normal"]} if "identification_normal" in summary else {})
    return {axis: values for axis, values in every.items() if values["stiffness"] is not None}


def largest_delay(summary: dict[str, Any]) -> dict[str, Any] | None:
    """The entry of the delay ledger that costs most damping, less what the compensation takes off the sensor's and the platform's, the sum
    left out; None where nothing delays."""
    entries = [entry for entry in summary["delay_ledger"] if entry["source"] != "total"]
    taken = {entry["source"]: -entry["delay"] for entry in entries if entry["source"].startswith("compensation.")}
    off = {"platform": taken.pop("compensation.platform", 0.0), "sensor": sum(taken.values())}
    left = []
    for entry in entries:
        link = entry["source"].partition(".")[0]
        less = min(off.get(link, 0.0), entry["delay"])
        off[link] = off.get(link, 0.0) - less
        left.append(entry | {"delay": entry["delay"] - less})
    return max((entry for entry in left if entry["delay"] > 0.0), key=lambda entry: entry["delay"], default=None)


def _lags_later(summary: dict[str, Any]) -> bool:
    """Whether the rig makes energy in a touch on which a compensation of the platform does not know the line in advance."""
    ways = (summary.get("stability") or {}).get("directions", ())
    return any(way["direction"].endswith("later touch") and (way.get("rig_energy") or 0.0) > NEUTRAL for way in ways)


def _cure(source: str, ledger: list[dict[str, Any]]) -> str:
    """What takes a delay out of which the ledger has the ``source``."""
    if source.startswith("effects."):
        return (
            "the loop does not know of it; state it where the scenario describes the rig, or have it estimated with "
            "--set 'compensation.force={kind: resynchronised, delay: estimate}'"
        )
    if source.startswith("platform."):
        return (
            "take it out with --set 'compensation.motion={kind: feedforward}', or with --set 'compensation.force={kind: resynchronised}', "
            "which makes up for the platform as well"
        )
    if any(entry["source"] == "compensation.resynchronised" for entry in ledger):
        return "no further compensation takes it out; make it smaller"
    return "compensate it, for example with --set 'compensation.force={kind: resynchronised}'"


def _advice(summary: dict[str, Any]) -> list[str]:
    if summary["status"] != "completed":
        return [
            "Replay the last ticks with hiltestbed.replay_failure(FOLDER) and see which quantity grows first.",
            "Lower the speed of approach, or raise the limit under `safety` if the rig allows it.",
        ]
    if summary["outcome"] == "miss":
        return ["Raise `duration`, lower `approach.gap`, or aim with `approach.offset` and `approach.velocity`."]
    error, largest = summary["cor_log_error"], largest_delay(summary)
    total = summary["delay_ledger"][-1] if summary["delay_ledger"] else None
    out = []
    if (is_active(summary) or (error is not None and abs(error) > CLOSE)) and total is not None:
        if largest is not None and total["delay"] > 0.0:
            out.append(
                f"The delays that are left add up to {1e3 * total['delay']:.3g} ms, the largest is {largest['source']} "
                f"({1e3 * largest['delay']:.3g} ms): {_cure(largest['source'], summary['delay_ledger'])}."
            )
        if is_active(summary) and _lags_later(summary):
            out.append(
                "On a later touch, elsewhere on the surface, the compensation does not know the line of the force yet, and the platform's "
                "lag counts: take it out with --set 'compensation.motion={kind: feedforward}'."
            )
        out.append("Map where this rig diverges with a campaign over sensor.delay and mechanism.contact.stiffness (hiltestbed sweep).")
    if not out and summary["outcome"] in ("rebound", "captured"):
        out.append("The loop reproduces the contact. Vary what you know least, delay and stiffness first, with hiltestbed sweep.")
    return out
