"""Stage "decide": which causes of an explanation hold although more than noise is left.

A stand-in for an effect outside the vocabulary fits only the runs that it was fitted to: its size
differs from run to run. That of a cause is a constant of the rig.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.settings import MIN_EXPLAINED, MIN_RUN_SHARE
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import Confirmed
from hiltestbed.inference.likelihood import Likelihood, independent
from hiltestbed.inference.model import places

# share of a cause's size by which it may differ from run to run where something else acts as well
MAX_SIZE_SPREAD = 0.15
MIN_RUNS = 3  # of which two may agree by chance


def holding(e: Explanation) -> tuple[Confirmed, ...]:
    """The causes of the explanation that have the same size in most runs, each fitted alone; none
    where they explain too little on left-out runs, or there are too few.
    """
    count = len(e.model.members)
    if count < MIN_RUNS or explained(e) < MIN_EXPLAINED:
        return ()
    alone = []
    for n in range(count):
        model = e.model.on([n])
        likelihood = Likelihood(model, independent(model.residuals(e.fit.of), noise_known=True))
        alone.append(likelihood.fit(e.fit.causes, [e.fit.of.theta]).of.theta)
    where = {c.key: own for c, own in zip(e.fit.causes, places(e.fit.causes), strict=True)}
    return tuple(
        c
        for c in e.causes
        if _same(
            c.cause, e.fit.of.theta[where[c.cause.key]], [x[where[c.cause.key]] for x in alone]
        )
    )


def _same(cause: Candidate, size: Array, alone: list[Array]) -> bool:
    """Whether most of the runs ``alone`` give the cause the size that it has in all of them; what
    has none cannot be the same.
    """
    stems = [name.partition(".")[0] for name in cause.names]
    leading = [j for j, stem in enumerate(stems) if stem == cause.effect.leading] or slice(None)
    neutral = 1.0 if cause.effect.leading == "factor" else 0.0
    scale = float(np.linalg.norm(size[leading] - neutral))
    off = [float(np.linalg.norm((x - size)[leading])) for x in alone]
    near = sum(d <= MAX_SIZE_SPREAD * scale for d in off)
    return scale > 0.0 and near >= MIN_RUN_SHARE * len(alone)


def explained(e: Explanation) -> float:
    """Share of the departure that the causes explain on left-out runs, in mean square beyond the
    noise.
    """
    before, after = (
        max(float(np.mean(x**2)) - 1.0, 0.0) for x in (e.conclusion.before, e.conclusion.after)
    )
    return 1.0 - after / before if before > 0.0 else 0.0
