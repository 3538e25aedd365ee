"""The energy that the rig makes, from the trace of a run."""

from __future__ import annotations

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, twist_between
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.scenario import Scenario
from hiltestbed.signals import RunTrace


def energy_generated(trace: RunTrace, scenario: Scenario) -> Array:
    """``(ticks,)`` [J] made by the rig so far: the integral of F v_act - F_used v_cmd, as
    :class:`hiltestbed.analysis.metrics.Tally` adds it up.
    """
    tick = 1.0 / scenario.rate
    slope = np.zeros_like(trace["twist_act"])
    _slopes(trace["pose_act"], tick, slope)
    # for t_k, when the wrench is used
    commanded = np.concatenate([approach_state(scenario)[None, :7], trace["pose_cmd"][:-1]])
    force, used = (
        _about_A(trace["wrench_true"], trace["pose_act"]),
        _about_A(trace["wrench_comp"], commanded),
    )
    rate = trace["twist_cmd"]
    before = np.concatenate([approach_state(scenario)[None, 7:], rate[:-1]])
    taken = np.zeros(len(trace.t))
    taken[1:] = np.einsum("ij,ij->i", force[1:] + force[:-1], slope[1:])
    return 0.5 * tick * np.cumsum(taken - np.einsum("ij,ij->i", used, rate + before))


def _about_A(wrench: Array, pose: Array) -> Array:
    """``(ticks, 6)`` wrenches at P's origin, with their moments about A's origin, so that they are
    conjugate to A's twist.
    """
    return np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(pose[:, :3], wrench[:, :3])])


@njit(cache=True)
def _slopes(pose, tick, out):
    for k in range(1, pose.shape[0]):
        twist_between(pose[k - 1], pose[k], tick, out[k])
