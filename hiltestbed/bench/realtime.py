"""`bench realtime`: latency, jitter and missed deadlines of the cycle on this machine, bare and
with a device on the loopback address.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.bench.result import BenchResult, Progress, silent
from hiltestbed.devices.bench import measure
from hiltestbed.report.page import Report, new_figure

RATES = (250.0, 1000.0, 2000.0)  # [Hz]
MAIN = (1000.0, True)  # [Hz], with a device
SECONDS, QUICK = 600.0, 2.0  # [s] total time, shared by the measurements


def realtime(quick: bool = False, progress: Progress = silent) -> BenchResult:
    """Measure the cycle at several rates, half of the time at 1 kHz with a device."""
    cases = [(rate, device) for rate in RATES for device in (False, True)]
    total = QUICK if quick else SECONDS
    measured: list[dict[str, Any]] = []
    for i, (rate, device) in enumerate(cases):
        seconds = total * (0.5 if (rate, device) == MAIN else 0.5 / (len(cases) - 1))
        measured.append(measure(rate, seconds, device=device))
        progress(i + 1, len(cases))
    worst = measured[cases.index(MAIN)]
    summary = {
        "missed_rate": worst["missed"] / max(worst["cycles"], 1),
        "worst_wake_up": worst["wake_up"]["worst"],
        "worst_round_trip": worst["round_trip"] and worst["round_trip"]["worst"],
        "cycles": worst["cycles"],
        "granted": worst["granted"],
        "refused": worst["refused"],
        "stolen": worst["stolen"],
    }
    lines = [(_label(m), _figures(m)) for m in measured]
    lines.append(("granted", ", ".join(worst["granted"]) or "nothing"))
    lines += [(f"refused: {name}", why) for name, why in worst["refused"].items()]
    page = _report(measured, worst, lines)
    return BenchResult("realtime", measured, summary, page, lines)


def _label(m: dict[str, Any]) -> str:
    return f"{m['rate']:g} Hz, {'with a device' if m['device'] else 'bare'}"


def _figures(m: dict[str, Any]) -> str:
    late, worst = m["wake_up"]["percentiles"], 1e6 * m["wake_up"]["worst"]
    text = (
        f"{m['missed']} of {m['cycles']} missed, wake-up median {1e6 * late['50']:.0f}, 99.9 % "
        f"{1e6 * late['99.9']:.0f}, worst {worst:.0f} us"
    )
    if m["round_trip"]:
        text += f", round trip 99.9 % {1e6 * m['round_trip']['percentiles']['99.9']:.0f} us"
    if m["stolen"]:
        text += f", {100.0 * m['stolen']:.2g} % of the processors taken by the hypervisor"
    return text


def _report(
    measured: list[dict[str, Any]], main: dict[str, Any], lines: list[tuple[str, str]]
) -> Report:
    """The measurements, with a histogram of each wake-up latency."""
    report = Report("The cycle in real time on this machine")
    report.lead(
        f"At 1 kHz with a device on the loopback address {main['missed']} of {main['cycles']} "
        f"cycles missed their deadline."
    )
    report.table(["measurement", "result"], lines)
    figure, axes = new_figure(9.0, 4.5)
    for m in measured:
        counts = np.array(m["wake_up"]["histogram"], dtype=float)
        late = 1e6 * m["wake_up"]["bin_width"] * np.arange(len(counts))
        axes.step(late, np.maximum(counts / counts.sum(), 1e-9), label=_label(m))
    axes.set(
        xlabel="wake-up latency [us]; the last bin holds all longer ones",
        ylabel="fraction of the cycles",
        yscale="log",
    )
    axes.legend()
    report.figure(figure, "Latency of the start of a cycle.")
    report.text(
        "A cycle misses its deadline if its work, or the device's response, is not complete when "
        "the next one is due. Measure on the machine and under the load of its later use; results "
        "on an idle machine are not valid for a busy one. Processor time taken by a hypervisor "
        "(steal time) cannot be recovered by any setting of this system."
    )
    return report
