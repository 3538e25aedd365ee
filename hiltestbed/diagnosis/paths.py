"""The path of A in P on which contact and sensor are replayed.

The measured pose is the path, and hides nothing that the platform did. Differentiated, its noise drowns the force (2 um at 1 kHz in a damper of
400 N s/m make 1 N), so where it brings more than a part of the force's own noise the explained platform's answer to the command takes its
place, which carries none; and where the platform is not explained, the measured pose smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.diagnosis.decimation import decimated
from hiltestbed.diagnosis.layout import Layout, platform_link, wrench_link
from hiltestbed.diagnosis.links import LinkRun, WrenchLink, flat_pose
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import CLEAN_PATH, LEVER_ARM, SMOOTHING
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import finest_noise
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.replay import moves_linearly
from hiltestbed.replay.compensation import slopes

CREEP = 1e-4  # [m/s] slip at which friction has most of its size


def make_wrench_link(layout: Layout, platform: Explanation | None, rows: Sequence[int], decimate: bool = False) -> WrenchLink:
    """Contact and sensor on the best path that the data give.

    ``decimate``: in fewer rows, where nothing is lost and no other link goes on from them.
    """
    stuck = platform is not None and platform.adequate and "platform.friction" in platform.chosen.kinds
    extra: Callable[[int, LinkRun], Array] | None = None
    jumps = None
    if measured_is_clean(layout):
        paths, rates = [r.record.filled("pose_act") for r in layout.runs], _measured_rates(layout)
    elif platform is not None and platform.adequate:
        paths = platform_link(layout, layout.whole).paths(platform.chosen.effects())
        rates = _central_rates(layout, paths)
    else:
        paths, rates = _smooth_paths(layout, platform), None
        if platform is not None or any(r.record.has("pose_act") for r in layout.runs):
            extra = lambda i, run: _path_noise(layout, run)  # noqa: E731
    if stuck:
        jumps = [_jumps(p) for p in paths]
    link = wrench_link(layout, paths, rows, jumps, rates, extra)
    return decimated(link) if decimate and jumps is None else link


def measured_is_clean(layout: Layout) -> bool:
    """Whether the noise of the measured poses brings next to nothing to the force that the contact makes of them."""
    runs = layout.runs
    if not all(r.record.has("pose_act") and r.record.valid["pose_act"].all() for r in runs):
        return False
    levels = [_finest(r, "pose_act") for r in runs]
    tick = layout.scales.tick
    brought = [math.hypot(_stiffness(r) * x, _damping(r) * math.sqrt(2.0) * x / tick) for r, x in zip(runs, levels, strict=True)]
    own = max(layout.noise.get("wrench_meas.fz", 0.0), layout.least_force)
    return max(brought) < CLEAN_PATH * own


def _finest(run: MeasuredRun, group: str) -> float:
    """[m] of the noise of a pose, or [m/s] of a twist: the largest of its axes, the attitude's by its lever."""
    values = run.record.data[group]
    levels = [finest_noise(values[:, j]) for j in range(values.shape[1])]
    turned = 2.0 if group.startswith("pose") else 1.0
    return max([*levels[:3], *(turned * LEVER_ARM * v for v in levels[3:])])


def _stiffness(run: MeasuredRun) -> float:
    return run.scenario.mechanism.contact.stiffness


def _damping(run: MeasuredRun) -> float:
    """[N s/m] of damper and friction together: the friction of a tip that hardly slips is a damper of mu |F|/v_0."""
    contact = run.scenario.mechanism.contact
    force = max([abs(c.peak_force or 0.0) for c in run.survey.contacts], default=0.0)
    return contact.damping + contact.friction * force / CREEP


def _measured_rates(layout: Layout) -> list[Array] | None:
    """(N, 6) twists at t_k on clean poses: as recorded, if that is as clean; else from the poses about each row."""
    if all(moves_linearly(r.scenario) for r in layout.runs):
        return None
    runs = layout.runs
    if all(r.record.has("twist_act") and r.record.valid["twist_act"].all() for r in runs):
        brought = max(_damping(r) * _finest(r, "twist_act") for r in runs)
        if brought < CLEAN_PATH * max(layout.noise.get("wrench_meas.fz", 0.0), layout.least_force):
            return [r.record.filled("twist_act") for r in runs]
    return _central_rates(layout, [r.record.filled("pose_act") for r in runs])


def _central_rates(layout: Layout, paths: Sequence[Array]) -> list[Array] | None:
    """(N, 6) twists at t_k, the mean of the slopes before and after; None where A moves uniformly within a tick."""
    if all(moves_linearly(r.scenario) for r in layout.runs):
        return None
    out = []
    for run, path in zip(layout.runs, paths, strict=True):
        start = approach_state(run.scenario)
        before = slopes(path[None], path[None, 0], run.scenario.tick)[0]
        before[0] = start[7:]
        out.append(0.5 * (before + np.concatenate([before[1:], before[-1:]])))
    return out


def _jumps(path: Array) -> Array:
    """(N,) how far a tip that sticks and jumps along path (N, 7) moved [m] in the tick that ends at each row."""
    return np.linalg.norm(np.diff(path[:, :3], axis=0, prepend=path[:1, :3]), axis=1)


def _smooth_paths(layout: Layout, platform: Explanation | None) -> list[Array]:
    """(N, 7) of each run: the measured pose, smoothed about the best explanation of the platform where there is one."""
    near = platform_link(layout, layout.whole).paths(platform.chosen.effects()) if platform is not None else None
    out = []
    for i, run in enumerate(layout.runs):
        if not run.record.has("pose_act"):  # the commanded pose, one row on: ideal tracking believed
            command = run.record.filled("pose_cmd")
            out.append(np.concatenate([approach_state(run.scenario)[None, :7], command[:-1]]))
            continue
        measured = run.record.filled("pose_act")
        about = measured if near is None else near[i]
        places = measured[:, :3] - (0.0 if near is None else about[:, :3])
        smooth = np.asarray(savgol_filter(places, SMOOTHING, 3, axis=0)) + (0.0 if near is None else about[:, :3])
        turns = _attitude(run) if near is None else about[:, 3:]
        out.append(np.concatenate([smooth, turns], axis=1))
    return out


def _attitude(run: MeasuredRun) -> Array:
    """(N, 4) the commanded attitude, one row on, where there is one; else the measured one, smoothed."""
    if run.record.has("pose_cmd"):
        start = approach_state(run.scenario)[None, :7]
        return np.concatenate([start, run.record.filled("pose_cmd")[:-1]])[:, 3:]
    flat = flat_pose(run.record.filled("pose_act"))
    flat[:, 3:] = savgol_filter(flat[:, 3:], SMOOTHING, 3, axis=0)
    return poses_of(flat)[:, 3:]


def _path_noise(layout: Layout, run: LinkRun) -> Array:
    """(N, 6) what the noise of a smoothed pose makes of k x + c v: noise of the forces in contact [N]."""
    noise, contact = layout.noise.get("pose_act.pz", 0.0), run.scenario.mechanism.contact
    place = float(np.linalg.norm(savgol_coeffs(SMOOTHING, 3))) * noise
    rate = float(np.linalg.norm(savgol_coeffs(SMOOTHING, 3, deriv=1))) * noise / layout.scales.tick
    extra = 2.0 * math.hypot(contact.stiffness * place, contact.damping * rate)
    return np.where(run.touching[:, None] & (np.arange(6) < 3), extra, 0.0)

