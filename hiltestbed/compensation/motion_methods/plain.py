"""Motion methods whose command is the numerical model's pose itself."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.plugins import register


@register
class NoMotionCompensation(MotionMethod):
    """No compensation: the platform receives only the pose."""

    kind: Literal["none"] = "none"
    reads: ClassVar[frozenset[Input]] = frozenset()
    tells_model_pose: ClassVar[bool] = True


@register
class Feedforward(MotionMethod):
    """Feed-forward: the platform's servo also receives velocity and acceleration."""

    kind: Literal["feedforward"] = "feedforward"
    reads: ClassVar[frozenset[Input]] = frozenset()
    feeds: ClassVar[bool] = True
    tells_model_pose: ClassVar[bool] = True
