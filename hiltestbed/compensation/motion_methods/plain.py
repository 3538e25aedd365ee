"""The platform is told the numerical model's pose itself."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.plugins import register


@register
class NoMotionCompensation(MotionMethod):
    """No compensation: the platform is commanded with the pose alone."""

    kind: Literal["none"] = "none"
    reads: ClassVar[frozenset[Input]] = frozenset()
    tells_model_pose: ClassVar[bool] = True


@register
class Feedforward(MotionMethod):
    """Feed-forward: the platform's servo is told velocity and acceleration, too."""

    kind: Literal["feedforward"] = "feedforward"
    reads: ClassVar[frozenset[Input]] = frozenset()
    feeds: ClassVar[bool] = True
    tells_model_pose: ClassVar[bool] = True
