"""The believed compensation run over a record, for the methods that need no more than the measured wrench."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hiltestbed.compensation import ForceCompensation
from hiltestbed.compensation.dead_zone import DeadZone
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.phase_lead import lead_and_lag
from hiltestbed.compensation.polynomial import PolynomialExtrapolation
from hiltestbed.compensation.second_order_lead import SecondOrderLead
from hiltestbed.diagnosis.chain import lead_record
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

METHODS: dict[str, Callable[[Sequence[Scenario]], ForceCompensation]] = {
    "second_order_lead": SecondOrderLead,
    "polynomial": PolynomialExtrapolation,
    "dead_zone": DeadZone,
}
REPLAYED = ("none", "phase_lead", *METHODS)
LARGE = 1e9  # [N] an impulse that no dead zone holds back
MEMORY = 400  # rows, within which the answer to an impulse has passed


def uncomputed(scenarios: Sequence[Scenario]) -> str | None:
    """Why the compensation cannot be replayed: the other methods know more than the record tells, or drive the model themselves."""
    if any(s.compensation.motion.kind == "contact_correction" for s in scenarios):
        return "not replayed with compensation.motion contact_correction, which adds to the wrench what the platform lacks"
    kinds = sorted({s.compensation.force.kind for s in scenarios} - set(REPLAYED))
    return f"not replayed with compensation.force {', '.join(kinds)}; allowed: {', '.join(REPLAYED)}" if kinds else None


def compensated(scenario: Scenario, wrench: Array) -> Array:
    """(N, 6) what the compensation makes of the readings ``wrench`` (N, 6)."""
    kind = scenario.compensation.force.kind
    if kind == "none":
        return wrench
    out = np.empty_like(wrench)
    if kind == "phase_lead":
        lead_record(wrench, *lead_and_lag(scenario), scenario.tick, out)
        return out
    method, unknown = METHODS[kind]([scenario]), np.full((1, 6), np.nan)
    measurement = Measurement(wrench[:1], np.zeros((1, 7)), np.zeros((1, 6)), unknown, unknown, np.zeros(1, dtype=bool))
    for k in range(len(wrench)):
        measurement.wrench = wrench[k : k + 1]
        out[k] = method.compensate(measurement)[0]
    return out


def noise_gain(scenario: Scenario) -> float:
    """By how much white noise of the readings is raised."""
    impulse = np.zeros((MEMORY, 6))
    impulse[MEMORY // 4] = LARGE  # not at the start, which a method may take for the past
    return float(np.linalg.norm(compensated(scenario, impulse)[:, 0])) / LARGE
