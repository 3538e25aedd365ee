"""Settings of the resynchronised prediction."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.compensation.resynchronised.drive import ResynchronisedDrive
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario.like import ScenarioLike


class KnownContact(Strictly):
    """A contact model identified beforehand."""

    stiffness: Positive = Field(
        description="Stiffness of the contact, as identified beforehand [N/m]"
    )
    damping: NotNegative = Field(
        default=0.0, description="Damping of the contact, as identified beforehand [N s/m]"
    )
    touch: float = Field(
        default=0.0, description="Position pz of the first touch along the insertion [m]"
    )


@register
class Resynchronised(ForceMethod):
    """Resynchronised prediction: the measured wrench drives a delayed model, from which a predictor
    computes the present state.
    """

    kind: Literal["resynchronised"] = "resynchronised"
    contact: KnownContact | None = Field(
        default=None,
        description="Contact model identified beforehand; null: the contact is identified during "
        "the run",
    )
    delay: Literal["known", "estimate"] = Field(
        default="estimate",
        description="Delay of the force. known: sensor.delay is taken as exact; estimate: it is "
        "fitted together with the contact, and replaced if the samples refuse it",
    )
    blending: Positive = Field(
        default=0.002,
        description="Time constant with which corrections of the prediction are blended into the "
        "command [s]; a correction for which half the force of a drive is too little takes longer",
    )
    reads: ClassVar[frozenset[Input]] = frozenset(
        {"wrench", "pose", "twist", "identified", "captured", "model"}
    )
    corrects_platform: ClassVar[bool] = True

    @classmethod
    def start(cls, scenarios: Sequence[ScenarioLike], model: NumericalModel) -> ResynchronisedDrive:
        from hiltestbed.compensation.force_methods.reconstruction import CapturedContact
        from hiltestbed.compensation.resynchronised.drive import (
            PredictionParameters,
            ResynchronisedDrive,
        )
        from hiltestbed.platform.build import demand_of

        given = []
        for force, scenario in zip(force_of(scenarios, cls), scenarios, strict=True):
            c, drives = force.contact, demand_of(scenario)
            shares = np.zeros((0, 6)) if drives is None else drives.shares
            known = None if c is None else (c.stiffness, c.damping, c.touch)
            estimate = force.delay == "estimate"
            given.append(
                PredictionParameters(force.blending, estimate, known, shares, scenario.sensor)
            )
        first, delay = scenarios[0], np.array([s.sensor.delay for s in scenarios])
        # a plane has no latches
        captured = None if first.mechanism.flat else CapturedContact(delay, first.rate)
        prescribed = first.rig.platform.prescribed
        return ResynchronisedDrive(model, given, first.substeps, prescribed, captured)

    def removes(self, scenario: ScenarioLike) -> Mapping[str, float]:
        sensor = scenario.sensor
        # the predictor models the low-pass as well
        lowpass = 0.0 if sensor.lowpass is None else 1.0 / (2.0 * math.pi * sensor.lowpass)
        out = {self.kind: sensor.delay + lowpass}
        if self.delay == "estimate":
            out[f"{self.kind}.estimate"] = sum(
                e.parameters()["delay"] for e in scenario.effects if e.kind == "sensor.delay"
            )
        return out

    def idle(self, scenario: ScenarioLike) -> Iterable[Problem]:
        if scenario.mechanism.captured:
            yield (
                ("blending",),
                "the mechanism is captured from the start: there is no first contact that would "
                "cause a correction",
            )

    def memory(self) -> float:
        return self.blending
