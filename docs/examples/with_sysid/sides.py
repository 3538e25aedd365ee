"""Common code of the comparisons with mujoco.sysid: fits by mujoco.sysid and hiltestbed with
intervals and processor time, and a table.
"""

from __future__ import annotations

import contextlib
import io
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid

from hiltestbed.diagnosis.diagnose import diagnose
from hiltestbed.diagnosis.fit import fit
from hiltestbed.diagnosis.intervals import intervals
from hiltestbed.diagnosis.report.diagnosis import Diagnosis
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.effects.search import Candidate

logging.getLogger("absl").setLevel(logging.ERROR)


@dataclass
class Side:
    """Result of one method.

    Attributes:
        found: estimate and half of the 95 % interval of each parameter. seconds: processor time of
            all threads. left: rms [mm] on each record that was left out of the fit.
    """

    name: str
    found: Mapping[str, tuple[float, float]]
    seconds: float
    left: Sequence[float] = field(default_factory=tuple)


@contextlib.contextmanager
def timed() -> Iterator[Callable[[], float]]:
    """A function that returns the processor time [s] since the block was entered."""
    began = time.process_time()
    yield lambda: time.process_time() - began


def by_sysid(
    name: str, params: sysid.ParameterDict, residual: Callable[..., Any]
) -> tuple[Side, np.ndarray]:
    """A fit with mujoco.sysid's own optimiser and intervals, and the parameter vector at which it
    ended.
    """
    # it prints a line per iteration
    with timed() as seconds, contextlib.redirect_stdout(io.StringIO()):
        fitted, result = sysid.optimize(params, residual, verbose=False)
        spent = seconds()
    left, _, _ = residual(result.x, fitted)
    _, halves = sysid.calculate_intervals(left, result.jac)
    names = params.get_non_frozen_parameter_names()
    return Side(
        name,
        {n: (float(x), float(h)) for n, x, h in zip(names, result.x, halves, strict=True)},
        spent,
    ), result.x


def by_diagnosis(dataset: Path) -> tuple[Diagnosis, float]:
    """A whole diagnosis: every effect is tested, each record left out in turn. The first, untimed
    call compiles or loads the kernels.
    """
    diagnose(dataset)
    with timed() as seconds:
        found = diagnose(dataset)
        return found, seconds()


def by_fit(
    residual: Residual, causes: Sequence[Candidate], start: Sequence[float]
) -> tuple[Mapping[str, tuple[float, float]], float]:
    """A fit of given causes from a given start, as in mujoco.sysid: estimate and half interval by
    parameter, and processor time [s].
    """
    with timed() as seconds:
        found = fit(residual, causes, [start], tries=1)
        ends = intervals(residual, found).ends
        spent = seconds()
    names = [f"{c.kind} {name}" for c in causes for name in c.names]
    return {
        n: (float(x), float(0.5 * (b - a)))
        for n, x, (a, b) in zip(names, found.theta, ends, strict=True)
    }, spent


def of_diagnosis(found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Estimate and half of the interval of the causes that a diagnosis names, by effect and
    parameter.
    """
    causes = found.finding.causes or found.finding.partial
    out = {}
    for cause in causes:
        for name, p in cause.parameters.items():
            if isinstance(p.estimate, float) and p.ci95 is not None:
                low, high = p.ci95
                out[f"{cause.effect} {name}"] = (p.estimate, 0.5 * (high - low))  # type: ignore[operator]
    return out


def scaled(pair: tuple[float, float], by: float) -> tuple[float, float]:
    """An estimate and its half interval in another unit."""
    return pair[0] * by, abs(pair[1] * by)


def table(title: str, true: Mapping[str, float], sides: Sequence[Side]) -> str:
    """Markdown table with a row per method: each estimate with half of its interval and its
    deviation from the true value.
    """
    rows = [
        f"**{title}**",
        "",
        "| | " + " | ".join(true) + " | left out [mm] | s CPU |",
        "|---|" + "---|" * (len(true) + 2),
    ]
    rows.append("| true | " + " | ".join(f"{v:g}" for v in true.values()) + " | | |")
    for side in sides:
        cells = [_cell(side.found.get(name), value) for name, value in true.items()]
        left = ", ".join(f"{x:.2g}" for x in side.left)
        rows.append(f"| {side.name} | " + " | ".join(cells) + f" | {left} | {side.seconds:.2g} |")
    return "\n".join(rows)


def _cell(found: tuple[float, float] | None, true: float) -> str:
    if found is None:
        return "not named"
    estimate, half = found
    return (
        f"{estimate:.6g} ± {half:.2g} ({100 * (estimate / true - 1):+.3f} "
        f"%{'' if abs(estimate - true) <= half else ', misses'})"
    )
