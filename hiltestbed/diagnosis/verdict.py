"""Stage "decide": from the explanations of the links to one `Verdict` and its causes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.investigate import Findings
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.settings import MIN_DEPARTURE, MIN_EXPLAINED, MIN_RUN_SHARE
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import Confirmed
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit, independent
from hiltestbed.inference.model import Model, places

MAX_RIVALS = 2  # that are listed for a cause; a set of more than three identifies nothing
# share of a cause's size by which it may differ from run to run where something else acts as well
MAX_SIZE_SPREAD = 0.15
MIN_RUNS = 3  # of which two may agree by chance


@dataclass(frozen=True)
class Named:
    """One named cause, and the link whose explanation it is a part of."""

    link: str
    cause: Confirmed

    @property
    def effect(self) -> str:
        return self.cause.cause.kind

    @property
    def fitted(self) -> Effect:
        return self.cause.effect

    @property
    def rivals(self) -> tuple[tuple[str, PosteriorFit], ...]:
        """The effects that explain the data as well, each with the whole explanation."""
        return tuple(zip(self.cause.rivals, self.cause.others, strict=True))[:MAX_RIVALS]

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        return tuple(kind for kind, _ in self.rivals)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a dataset.

    Attributes:
        verdict: no_discrepancy, named, ambiguous, named_in_part, unknown or inconclusive. link:
            that departs, or None. causes: strongest first. not_judged: link to the reason.
    """

    verdict: str
    link: str | None
    causes: tuple[Named, ...]
    not_judged: dict[str, str]


def decide(findings: Findings) -> Verdict:
    """The verdict on all links: named where causes explain each one that departs, in part where
    they do so on the one that departs most and leave more than noise.
    """
    explanations, missing = findings.explanations, findings.missing
    causes: list[Named] = []
    for name in (n for n in LINK_NAMES if n in explanations):
        e = explanations[name]
        found = e.causes if e.adequate else holding(e)
        causes += [Named(name, c) for c in found]
    # contact and sensor, which come first, determine a stamp delay better
    once = [c for i, c in enumerate(causes) if c.effect not in {o.effect for o in causes[:i]}]
    causes = sorted(once, key=lambda c: -c.cause.gain)
    if unexplained := {n: e for n, e in explanations.items() if not e.adequate}:
        name = max(unexplained, key=lambda n: (unexplained[n].excess, n))
        both = [explanations.get(n) for n in ("wrench", "compensation")]
        # the record, where both links of the measured force depart, one of them by a stamp delay
        stamped = any(e is not None and "log.skew" in e.kinds for e in both)
        if stamped and all(e is not None and e.departs for e in both):
            link = "log"
        else:
            link = _contact_or_sensor(explanations[name]) if name == "wrench" else name
        in_part = any(c.link == name for c in causes)
        return Verdict("named_in_part" if in_part else "unknown", link, tuple(causes), missing)
    if not causes:
        return Verdict("inconclusive" if missing else "no_discrepancy", None, (), missing)
    ambiguous = any(c.rivals for c in causes)
    link = EFFECTS[causes[0].effect].link
    return Verdict("ambiguous" if ambiguous else "named", link, tuple(causes), missing)


def _contact_or_sensor(e: Explanation) -> str:
    """`sensor` where only its effects were chosen and show outside contact too; else `contact`."""
    parts = zip(e.model.groups, e.conclusion.null.left, strict=False)
    free = np.concatenate([np.zeros(0), *(x for (_, _, inside), x in parts if not inside)])
    shows = bool(len(free)) and float(np.mean(free**2)) > MIN_DEPARTURE
    return (
        "sensor" if shows and {effect.link for effect in e.effects()} == {"sensor"} else "contact"
    )


def holding(e: Explanation) -> tuple[Confirmed, ...]:
    """The causes of an explanation that hold although more than noise is left: they have the same
    size in most runs, each fitted alone, and in both halves of these; none where they explain too
    little on left-out runs, or there are too few.

    A stand-in for an effect outside the vocabulary fits only what it was fitted to: its size
    differs from run to run, or between loading and unloading. That of a cause is a constant of the
    rig.
    """
    count, fit = len(e.model.members), e.fit
    if count < MIN_RUNS or explained(e) < MIN_EXPLAINED:
        return ()
    alone = [e.alone(n, fit)[1].of.theta for n in range(count)]
    halves = [_fitted(half, fit) for half, _ in e.model.halves()]
    where = {c.key: own for c, own in zip(fit.causes, places(fit.causes), strict=True)}

    def same(cause: Candidate) -> bool:
        own = where[cause.key]
        parts = ([x[own] for x in fits] for fits in (alone, halves))
        return all(_same(cause, fit.of.theta[own], part) for part in parts)

    return tuple(c for c in e.causes if same(c.cause))


def _fitted(model: Model, fit: PosteriorFit) -> Array:
    """The numbers of the causes of a fit, fitted to another model."""
    likelihood = Likelihood(model, independent(model.residuals(fit.of), noise_known=True))
    return likelihood.fit(fit.causes, [fit.of.theta], fit.of.nuisances).of.theta


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
