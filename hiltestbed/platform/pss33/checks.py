"""Checks that the 3-3 PSS platform can reach a scenario's start."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hiltestbed.config.validation import Problem
from hiltestbed.platform.pss33.settings import pss33_of

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

# [m/s] highest approach speed at which the upper platform is clamped before the first touch
UPPER_SPEED = 0.3


def _workspace(scenario: ScenarioLike) -> tuple[float, float]:
    """Reach from home along [m] and about [deg] each axis."""
    workspace = pss33_of(scenario).workspace
    return workspace.translation, workspace.rotation_deg


def start_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    """The start must be in the workspace around the nominal first touch, and the controller's cycle
    a whole number of ticks.
    """
    for path, message in pss33_of(scenario).command.problems(scenario.rate):
        yield ("rig", "platform", "command", *path), message
    approach, (reach, turn) = scenario.approach, _workspace(scenario)
    if scenario.rig.upper.kind == "prs3":
        yield from _nine_axis_problems(scenario)
        return
    lowest = -reach if scenario.mechanism.captured else 0.0
    limits = [(("approach", "gap"), approach.gap, lowest, reach, "m")]
    limits += [
        (("approach", "offset", axis), value, -reach, reach, "m")
        for axis, value in enumerate(approach.offset)
    ]
    limits += [
        (("approach", "attitude_deg", axis), value, -turn, turn, "deg")
        for axis, value in enumerate(approach.attitude_deg)
    ]
    for path, value, low, high, unit in limits:
        if not low <= value <= high:
            yield (
                path,
                f"starts outside the workspace (got {value:g} {unit}); allowed is {low:g} to "
                f"{high:g} {unit}",
            )


def _nine_axis_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    """With the upper platform the gap may be as large as its heave; the lower platform's share of
    the start must be in its workspace.
    """
    import numpy as np

    from hiltestbed.frames import quat_from_attitude_deg, rotation_vectors
    from hiltestbed.platform.prs3.allocation import LONGEST, lower_pose

    approach = scenario.approach
    reach, widest = _workspace(scenario)
    lowest = -reach if scenario.mechanism.captured else 0.0
    if not lowest <= approach.gap <= LONGEST:
        yield (
            ("approach", "gap"),
            f"starts outside the workspace (got {approach.gap:g} m); allowed is {lowest:g} to "
            f"{LONGEST:g} m",
        )
        return
    if not abs(approach.velocity[2]) <= UPPER_SPEED:
        yield (
            ("approach", "velocity", 2),
            "is too fast for the upper platform to come to rest before the touch (got "
            f"{approach.velocity[2]:g} m/s); allowed is -{UPPER_SPEED:g} to {UPPER_SPEED:g} m/s",
        )
    pose = np.array(
        [[*approach.offset, -approach.gap, *quat_from_attitude_deg(approach.attitude_deg)]]
    )
    lower = lower_pose(pose)
    place, turn = np.abs(lower[0, :3]), np.degrees(np.abs(rotation_vectors(lower[:, 3:])[0]))
    if not (place.max() <= reach and turn.max() <= widest):
        where = ", ".join(f"{value:.3g}" for value in lower[0, :3])
        yield (
            ("approach",),
            f"starts outside the workspace (the lower platform would be at {where} m, rotated by "
            f"up to {turn.max():.3g} deg); allowed are {reach:g} m and {widest:g} deg on each "
            "axis: take a smaller offset or attitude_deg",
        )
