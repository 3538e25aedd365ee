"""Units that contradict what is believed of an axis: a torque in mN m, an angle in degrees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.inference.model import Hypothesis

if TYPE_CHECKING:
    from hiltestbed.axis.models import AxisModel

# between the units of one quantity lie 57.3 (degrees), 1000 (milli) and more; an owner knows an
# axis better than by this factor
FAR = 30.0
# of the squares that nothing else explains, which the nominal model explains once it is scaled
EXPLAINED = 0.5
DRIVEN = ("drive", "arm")  # what friction acts on beside the bodies that are believed


def scaling_of(model: AxisModel) -> list[tuple[str, float]]:
    """The records by name whose measurement is a multiple of what the nominal model says that is
    beyond :data:`FAR`, each with that factor.
    """
    none = Hypothesis((), np.zeros(0), np.zeros(len(model.nuisances)))
    out = []
    with np.errstate(all="ignore"):
        parts = zip(model.records, model.states(), model.residuals(none)[:-1], strict=True)
        for r, s, left in parts:
            measured = s.x if s.force is None else s.force / s.scale
            # friction, and the zero, are not what is believed of a drive
            aside = [np.ones(len(left)), *([s.v, np.sign(s.v)] if model.kind in DRIVEN else [])]
            factor, share = _factor(measured - left, measured, aside)
            if share > EXPLAINED and not 1.0 / FAR < abs(factor) < FAR:
                out.append((r.name, factor))
    return out


def _factor(believed: Array, measured: Array, aside: Sequence[Array]) -> tuple[float, float]:
    """``measured`` over ``believed`` (N,) ``aside`` from others, and the share that it explains."""
    if not len(measured):
        return 1.0, 0.0
    others = np.column_stack(aside)
    others /= np.maximum(np.abs(others).max(axis=0), 1e-300)

    def without(x: Array) -> Array:
        return x - others @ np.linalg.lstsq(others, x, rcond=None)[0]

    a, b = without(believed), without(measured)
    if not (a @ a > 0.0 and b @ b > 0.0 and np.isfinite(a @ a)):
        return 1.0, 0.0
    return float(a @ b / (a @ a)), float((a @ b) ** 2 / ((a @ a) * (b @ b)))


def scaling_remark(model: AxisModel) -> str:
    """The same in a sentence; empty where there are none."""
    found = scaling_of(model)
    if not found:
        return ""
    named = ", ".join(f"by {factor:.3g} in {name}" for name, factor in found)
    return (
        f"What was measured is a multiple of what the nominal numbers give ({named}). A factor of "
        f"57.3 is that of degrees, of 1000 that of milli-units: check the units of the channels, "
        f"and the nominal numbers."
    )
