"""Stiffness and damping of one contact at several speeds and delays: the force as measured, after a
phase lead, and paired with the position at which it acted.

    python docs/examples/identified.py

Prints the table of docs/explanation/lead-then-rls.md and writes its picture.
"""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from hiltestbed.bench.contacts import DELAYS, BenchContact
from hiltestbed.report.curves import PALETTE
from hiltestbed.report.page import new_figure
from hiltestbed.simulation import simulate

PICTURE = Path(__file__).resolve().parents[1] / "explained-lead-then-rls.png"
FREQUENCIES, SPEEDS = (2.0, 8.0), (0.01, 0.03, 0.1)  # [Hz], [m/s]
DAMPING_RATIO = 0.05
NOISE = 0.3  # [N] 1 sigma, whatever the speed
LAG = 0.0005  # [s] T2 of the lead, its default
QUANTITIES = ("stiffness", "damping")
WAYS = {  # compensation of the force, identification
    "as measured": ("none", "rls_raw"),
    "phase lead, then RLS": ("phase_lead", "rls_lead"),
    "paired in time": ("resynchronised", "rls"),
}


@dataclass(frozen=True)
class Found:
    """Relative errors of k and c from one bounce; None: no estimate."""

    way: str
    contact: BenchContact
    stiffness: float | None
    damping: float | None


def measured() -> list[Found]:
    """Every way on every contact."""
    grid = [BenchContact(f, d, DAMPING_RATIO, speed=v) for f, d, v in
            product(FREQUENCIES, DELAYS, SPEEDS)]  # fmt: skip
    contacts = [
        BenchContact(c.frequency, c.delay, DAMPING_RATIO, speed=c.speed, noise=NOISE / c.peak)
        for c in grid
    ]
    out = []
    for way, (force, method) in WAYS.items():
        runs = simulate([c.scenario({"kind": force}, {"kind": method}) for c in contacts])
        for contact, axes in zip(contacts, runs.identification, strict=True):
            k, c = axes["z"]["stiffness"], axes["z"]["damping"]
            errors = (None, None) if k is None else (k / contact.stiffness, c / contact.damping)
            out.append(Found(way, contact, *(None if e is None else e - 1.0 for e in errors)))
    return out


def by_phasors(contact: BenchContact, lead: bool) -> tuple[float, float]:
    """Errors of k and c at the frequency of the contact, from a force that is late by the whole
    delay, and has passed the lead (T1 s + 1)/(T2 s + 1).
    """
    s, delay = 1j * contact.w, contact.delay
    passed = cmath.exp(-s * delay)
    if lead:
        passed *= (1.0 + s * (delay + LAG)) / (1.0 + s * LAG)
    ratio = passed * (1.0 + 2j * DAMPING_RATIO)
    return ratio.real - 1.0, ratio.imag / (2.0 * DAMPING_RATIO) - 1.0


def table(found: Sequence[Found]) -> list[str]:
    """Lines of Markdown: the largest errors over the speeds, and those of the phasors."""
    raw, led, paired = WAYS
    lines = [
        f"| contact, delay | {raw}: k, c | by phasors | {led}: k, c | by phasors | {paired} |",
        "|---" * 6 + "|",
    ]
    for f, delay in product(FREQUENCIES, DELAYS):
        here = [e for e in found if (e.contact.frequency, e.contact.delay) == (f, delay)]
        of = {w: [e for e in here if e.way == w] for w in WAYS}
        found_by = {w: ", ".join(_worst([getattr(e, n) for e in of[w]]) for n in QUANTITIES)
                    for w in WAYS}  # fmt: skip
        told = [", ".join(map(_percent, by_phasors(here[0].contact, lead)))
                for lead in (False, True)]  # fmt: skip
        cells = found_by[raw], told[0], found_by[led], told[1], found_by[paired]
        lines.append(f"| {f:g} Hz, {1e3 * delay:g} ms | {' | '.join(cells)} |")
    return lines


def _percent(error: float) -> str:
    return f"{float(f'{100.0 * error:.2g}'):+g} %"


def _worst(errors: Sequence[float | None]) -> str:
    known = [e for e in errors if e is not None]
    if not known:
        return "none"
    return _percent(max(known, key=abs)) + ("" if len(known) == len(errors) else "*")


def draw(found: Sequence[Found]) -> None:
    figure, panels = new_figure(9.0, 3.6, ncols=2, sharex=True)
    marks = dict(zip(SPEEDS, ["v", "o", "^"], strict=True))
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        for (way, color), speed in product(zip(WAYS, PALETTE, strict=False), SPEEDS):
            mine = [e for e in found if e.way == way and e.contact.speed == speed]
            lag = [e.contact.w * e.contact.delay for e in mine]
            size = [100.0 * abs(v) if (v := getattr(e, quantity)) else math.nan for e in mine]
            label = f"{way}, {speed:g} m/s"
            axes.loglog(lag, size, marks[speed], color=color, markersize=4.5, label=label)
        axes.set(xlabel=r"$\omega\tau$", ylabel=f"error of the {quantity} [%]")
        axes.grid(alpha=0.3)
    panels[1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.01, 0.5))
    figure.savefig(PICTURE, dpi=90, bbox_inches="tight")


if __name__ == "__main__":
    results = measured()
    draw(results)
    sys.stdout.write("\n".join(table(results)) + "\n")
