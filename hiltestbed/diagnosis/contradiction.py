"""Stage "decide": whether the runs contradict each other, and where in position a residual sits:
what can be said of a departure that no effect explains.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit
from hiltestbed.diagnosis.plain import listed
from hiltestbed.diagnosis.search import Explanation, first_of_each
from hiltestbed.diagnosis.settings import DETECTION, PENALTY
from hiltestbed.frames import Array

BINS = 100  # of the travel; a range is then known to 1 % of it
HALF = 0.5  # of the sum of squares of a residual


def contradiction(found: Explanation) -> str:
    """One effect that leaves only noise in each run alone, with sizes that differ, in words; empty
    where no single effect does, or where there is one run.

    Sizes differ where those of their own take more off chi-square than so many more parameters of
    any effect have to: the threshold of a further effect, and the penalty of each parameter.
    """
    if len(found.residual.runs) < 2:
        return ""
    for known in first_of_each([f for f in found.singles if f.causes], "kinds"):
        alone = _in_each_run(found, known)
        if not alone:
            continue
        joint = fit(found.residual, known.causes, [known.theta], tries=1)
        if joint.chi2 - sum(f.chi2 for f in alone) > DETECTION + PENALTY * len(known.theta) * (
            len(alone) - 1
        ):
            sizes = ", ".join(
                f"{listed(f.effects()[0].parameters())} in run {i}"
                for i, f in zip(found.residual.runs, alone, strict=True)
            )
            return (
                f"the runs contradict each other: {known.kinds[0]} explains each of them alone, "
                f"with a size that changes from run to run, or with what differs between them "
                f"({sizes})"
            )
    return ""


def _in_each_run(found: Explanation, known: Fit) -> list[Fit] | None:
    """The fits of one cause to each run alone; None where one of them leaves more than noise."""
    if JITTER in known.kinds:
        return None
    out = []
    for i in found.residual.runs:
        run = found.residual.on([i])
        alone = fit(run, known.causes, [known.theta], tries=1)
        if not noise_alone(contact_leftovers(run, alone.effects())):
            return None
        out.append(alone)
    return out


def range_of_half(position: Array, residual: Array) -> tuple[float, float]:
    """The shortest range of ``position`` (N,) that holds half of the sum of squares of a
    ``residual`` (N,).
    """
    squares, edges = np.histogram(position, bins=BINS, weights=residual**2)
    total = np.concatenate([[0.0], np.cumsum(squares)])
    ends = np.searchsorted(total, total[:-1] + HALF * total[-1])
    widths = np.where(ends <= BINS, ends - np.arange(BINS), BINS + 1)
    first = int(np.argmin(widths))
    return float(edges[first]), float(edges[min(int(ends[first]), BINS)])
