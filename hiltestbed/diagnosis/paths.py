"""Stage "replay": the path of A in P on which contact and sensor are replayed.

The measured pose is that path, and contains all that the platform did. Differentiated, however, its
noise hides the force: 2 um at 1 kHz in a damper of 400 N s/m are 1 N. So where it adds more than a
share of the force's own noise, the noise-free response of the explained platform to its command
replaces it; where the platform is not explained, the measured pose is smoothed.

What a description leaves open of how a facility computes its contact (where between tip and surface
the force acts, whether a latch resists turning, how a mount is integrated) the data decide: with a
wrong interpretation a search finds departures that are not there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.lacking import all_axes
from hiltestbed.diagnosis.links import WrenchLink, flat_pose
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.path_noise import (
    Path,
    both,
    central_rates_of,
    command_noise,
    deflection_noise,
    diverged,
    misread,
    moves_uniformly,
    noise_of,
    not_where_unsettled,
    rate_noise,
    smoothed,
    smoothed_noise,
)
from hiltestbed.diagnosis.recorded import DatasetLayout, platform_link, wrench_link
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import LEVER_ARM, SIGNIFICANT
from hiltestbed.diagnosis.yielding import told_pose, yielded_under
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import finest_noise
from hiltestbed.replay import follows_exactly
from hiltestbed.signals import GROUPS

# derived: share of the force noise that a measured path may add: half a percent of the noise
MAX_PATH_NOISE = 0.1
# chosen: of force and yielding in turn: with drives ten times as stiff as the contact, the noise
# falls by 1000
CONTACT_ROUNDS = 4
# chosen: share of the rows in contact, on which perturbed copies of a path have to agree
MIN_COMPARED = 0.05
# derived: chi-square: choice between two equally likely interpretations
INTERPRETATION_PENALTY = 2.0 * math.log(2.0)
LEVERS = (0.5, 0.0, 1.0)  # chosen: that are tried first: the middle, the surface, the tip


def best_path(layout: DatasetLayout, platform: Explanation | None) -> Path:
    """The path with the least noise that the data allow, with the poses as they are stamped."""
    explained = platform if platform is not None and platform.adequate else None
    path = _least_noisy(layout)
    if path is None or _replay_is_better(layout, path, explained is not None):
        if explained is not None:
            path = _replayed(layout, explained)
        else:
            path = _smoothed(layout, platform)
    if not all(sides_of(r.scenario.mechanism).rigid for r in layout.runs):
        noise = path.noise or [np.zeros((n, 6)) for n in layout.whole]
        pairs = zip(diverged(layout, path), noise, strict=True)
        noise = [np.where(parted[:, None], np.inf, n) for parted, n in pairs]
        path = replace(path, noise=noise)
    if logged := layout.logged:  # a filter is known to about one order
        readings = [r.record.filled("wrench_meas") for r in layout.runs]
        missed = [logged.colour * logged.missed(r) for r in readings]
        path = replace(path, noise=both(missed, path.noise))
    sticks = explained is not None and "platform.friction" in explained.kinds
    return replace(path, jumps=[_jumps(p) for p in path.poses] if sticks else None)


def _replayed(layout: DatasetLayout, platform: Explanation) -> Path:
    """What the explained platform reaches."""
    poses = _explained(layout, platform)
    rounding = [r.record.unsmoothed() for r in layout.runs]
    unknown = [list(np.moveaxis(c, 2, 0)) for c in layout.open_commands]
    rates = central_rates_of(layout, poses)
    path = Path(poses, rates, source="pose_cmd", rounding=rounding, unknown=unknown)
    noise = command_noise(layout, path)
    if not all(follows_exactly(r.scenario.rig, r.scenario.compensation) for r in layout.runs):
        noise = both(deflection_noise(layout, path), noise)
    return replace(path, noise=noise)


def _smoothed(layout: DatasetLayout, platform: Explanation | None) -> Path:
    """The smoothed pose, or where only the command is on record what the drives make of it."""
    poses, flattened = _smooth_paths(layout, platform)
    unknown = [[f] for f in flattened] if any(f.any() for f in flattened) else ()
    path = Path(poses, central_rates_of(layout, poses), unknown=unknown)
    if platform is not None or any(r.record.has("pose_act") for r in layout.runs):
        path = replace(path, noise=smoothed_noise(layout, path, platform is not None))
    if all(r.record.has("pose_cmd") and not r.record.has("pose_act") for r in layout.runs):
        assert layout.deflection is not None  # else the link is missing
        path = replace(path, yielded=[found.yielded for found in layout.deflection])
        if not all(follows_exactly(r.scenario.rig, r.scenario.compensation) for r in layout.runs):
            noise = both(deflection_noise(layout, path), rate_noise(layout, path))
            path = _under_the_contact(layout, path, not_where_unsettled(layout, noise))
    return path


def _explained(layout: DatasetLayout, platform: Explanation) -> list[Array]:
    """(N, 7) the poses of each run that the explained platform reaches."""
    link = platform_link(layout, layout.whole).with_timing(platform.timing())
    return link.paths(platform.effects())


def too_divergent(layout: DatasetLayout, path: Path) -> str | None:
    """Why contact and sensor are not judged, where too few rows in contact can be compared."""
    if path.noise is None:
        return None
    inside = [
        np.asarray(np.isfinite(b).all(axis=1))[r.touching(len(b))]
        for r, b in zip(layout.runs, path.noise, strict=True)
    ]
    part = float(np.mean(np.concatenate(inside)))
    if part >= MIN_COMPARED:
        return None
    return (
        f"the smallest difference decides how the mechanism moves after the touch: "
        f"{part:.0%} of the rows in contact could be replayed"
    )


def make_wrench_link(layout: DatasetLayout, path: Path, rows: Sequence[int]) -> WrenchLink:
    """Contact and sensor on a path."""
    link = wrench_link(layout, path.poses, rows, path.jumps, path.rates, path.noise)
    link = link.through(layout.logged).with_rounding(path.rounding)
    if path.differentiated and path.jumps is None:
        link = link.with_unknown_rate()
    if path.unknown:
        link = link.with_unknown_paths(path.unknown)
    if path.yielded:
        return link.commanded(_followed(layout), path.yielded)
    return link


def _under_the_contact(layout: DatasetLayout, path: Path, noise: Sequence[Array]) -> Path:
    """A commanded ``path`` with its ``noise``, its yielding to a force, and changes for a force
    misread: with the force of the believed contact, where the readings then show no more than with
    the force of the given path.

    The noise of the recorded force is in a path that yields to it as well as in the readings, and
    what filters it would explain them. The force and the yielding to it are found in turn, which
    settles unless the contact is stiffer than the drives.
    """
    assert layout.deflection is not None  # else the link is missing
    level, tick = layout.noise.get("wrench_meas.fz", 0.0), layout.scales.tick
    out = tried = replace(path, noise=noise)
    least = math.inf
    for _ in range(CONTACT_ROUNDS):
        link = wrench_link(layout, tried.poses, layout.whole, None, tried.rates, noise)
        link = link.commanded(_followed(layout), tried.yielded)
        link = choose_steps(choose_ring(choose_lever(link)))
        each = zip(layout.runs, layout.deflection, link.shown_in_all(), strict=True)
        again = [yielded_under(*one, level) for one in each]
        tried = replace(tried, unknown=misread(again, tick))
        left = square(Residual(link.with_unknown_paths(tried.unknown))(()))
        if left > least + SIGNIFICANT:
            break
        out, least = tried, min(left, least)
        pairs = zip(tried.poses, again, tried.yielded, strict=True)
        poses = [poses_of(flat_pose(p) + a - y) for p, a, y in pairs]
        tried = replace(tried, poses=poses, rates=central_rates_of(layout, poses), yielded=again)
    return out


def _followed(layout: DatasetLayout) -> list[Array]:
    """(N, 7) of each run: the command, moved by what the believed drives make of it without a
    force; row k is reached at t_(k+1).

    Effects of the platform act before the drives, which are linear: in either order they give the
    same path.
    """
    assert layout.deflection is not None  # else the link is missing
    out = []
    for run, found in zip(layout.runs, layout.deflection, strict=True):
        command = np.array(run.record.filled("pose_cmd"))
        free = found.away - found.yielded
        command[:, :3] += np.concatenate([free[1:, :3], free[-1:, :3]])
        out.append(command)
    return out


def _measured(layout: DatasetLayout) -> list[Path]:
    """The measured poses with measured rates, and with differences; none if an axis is missing."""
    runs, tick = layout.runs, layout.scales.tick
    if not all(r.record.whole("pose_act") and all_axes(r, "pose_act") for r in runs):
        return []
    poses = [r.record.filled("pose_act") for r in runs]
    place = max(_finest(r, "pose_act") for r in runs)
    if moves_uniformly(layout):
        return [Path(poses, None, place, math.sqrt(2.0) * place / tick)]
    out = [Path(poses, central_rates_of(layout, poses), place, math.sqrt(0.5) * place / tick)]
    if all(r.record.whole("twist_act") and all_axes(r, "twist_act") for r in runs):
        twists = [r.record.filled("twist_act") for r in runs]
        rate = max(_finest(r, "twist_act") for r in runs)
        out.insert(0, Path(poses, twists, place, rate, rates_measured=True))
    return out


def _least_noisy(layout: DatasetLayout) -> Path | None:
    """The first measured path whose noise is small, or else the one with the least."""
    tried: list[Path] = []
    for path in _measured(layout):
        tried.append(replace(path, noise=noise_of(layout, path, path.place, path.rate)))
        if _noise_ratio(layout, tried[-1]) <= MAX_PATH_NOISE:
            break
    return min(tried, key=lambda p: _noise_ratio(layout, p), default=None)


def _replay_is_better(layout: DatasetLayout, measured: Path, explained: bool) -> bool:
    """Whether the replayed platform, or the smoothed pose, has less noise than the measured."""
    share = _noise_ratio(layout, measured)
    if share < MAX_PATH_NOISE:
        return False
    # a simulated mechanism diverges at the smallest difference, on any path
    if not explained or layout.deflection is None:
        return share > 1.0 and all(sides_of(r.scenario.mechanism).rigid for r in layout.runs)
    return max(d.noise for d in layout.deflection) < measured.place


def _noise_ratio(layout: DatasetLayout, path: Path) -> float:
    """Noise due to the path over that of the force, rms in contact, on its largest force axis."""
    pairs = zip(layout.runs, path.noise or (), strict=True)
    inside = [n[r.touching(len(n)), :3] for r, n in pairs]
    squares = np.mean(np.concatenate(inside) ** 2, axis=0)
    own = max(layout.noise.get("wrench_meas.fz", 0.0), layout.least_force)
    return float(np.sqrt(squares.max())) / own if np.isfinite(squares).all() else math.inf


def _finest(run: MeasuredRun, group: str) -> float:
    """Noise of a pose [m] or twist [m/s]: the largest of its axes, attitude times lever arm."""
    levels = [finest_noise(column) for column in run.record.filled(group).T]
    turned = 2.0 if group.startswith("pose") else 1.0
    return max([*levels[:3], *(turned * LEVER_ARM * v for v in levels[3:])])


def _jumps(path: Array) -> Array:
    """(N,) distance [m] that a tip moved along path (N, 7) in the tick that ends at each row."""
    return np.linalg.norm(np.diff(path[:, :3], axis=0, prepend=path[:1, :3]), axis=1)


def _smooth_paths(
    layout: DatasetLayout, platform: Explanation | None
) -> tuple[list[Array], list[Array]]:
    """(N, 7) of each run: the measured pose, smoothed about the best explanation of the platform
    where there is one; and (N, 6) what that cut off, roughly: what it cuts off once more (J. W.
    Tukey, Exploratory Data Analysis, 1977, "twicing").

    Axes that were not measured are those of the explanation, or were commanded.
    """
    near = None if platform is None else _explained(layout, platform)
    out, flattened = [], []
    for i, run in enumerate(layout.runs):
        told = told_pose(run) if run.record.has("pose_cmd") else None
        if not run.record.has("pose_act"):  # what the believed drives make of the command
            assert layout.deflection is not None  # else the link is missing
            assert told is not None
            away = layout.deflection[i].away
            out.append(poses_of(flat_pose(told) + away) if away.any() else told)
            flattened.append(np.zeros_like(away))
            continue
        flat = flat_pose(run.record.filled("pose_act"))
        about = told if near is None else near[i]
        centre, kept = np.zeros_like(flat), np.zeros(6, dtype=bool)
        if near is not None:
            centre[:, :3] = near[i][:, :3]
        if about is not None:
            kept[:3] = [name in run.record.absent for name in GROUPS["pose_act"].columns[:3]]
            kept[3:] = True
        smooth = smoothed(flat - centre)
        flattened.append(np.where(kept, 0.0, smooth - smoothed(smooth)))
        pose = poses_of(smooth + centre)
        if about is not None:
            pose[:, :3] = np.where(kept[:3], about[:, :3], pose[:, :3])
            pose[:, 3:] = about[:, 3:]
        out.append(pose)
    return out, flattened


def choose_lever(link: WrenchLink) -> WrenchLink:
    """The link with the lever that fits the torques best."""
    if not link.acts_across():
        return link

    def cost(lever: float) -> float:
        r = Residual(link.interpreted(lever=lever))(())
        return float(np.sum(np.minimum(r * r, 100.0)))

    costs = {lever: cost(lever) for lever in LEVERS}
    best = min(costs, key=lambda key: costs[key])
    found: Any = minimize_scalar(
        cost,
        bounds=(max(best - 0.5, 0.0), min(best + 0.5, 1.0)),
        method="bounded",
        options={"xatol": 0.01},
    )
    better = found.fun < costs[best] - INTERPRETATION_PENALTY
    return link.interpreted(lever=float(found.x) if better else best)


def choose_ring(link: WrenchLink) -> WrenchLink:
    """The link with a latch that turns freely if the torques show that; else the latch is believed
    to resist turning, which its stiffness does not state.
    """
    if not any(r.scenario.mechanism.captured for r in link.runs):
        return link
    free = link.interpreted(ring=0.0)
    if square(Residual(free)(())) < square(Residual(link)(())) - INTERPRETATION_PENALTY:
        return free
    return link


def choose_steps(link: WrenchLink) -> WrenchLink:
    """The link with a mount stepped as by MuJoCo, or integrated exactly, whichever leaves less."""
    if not link.stepped:
        return link
    exact = choose_lever(link.interpreted(exact=True))
    better = square(Residual(exact)(())) < square(Residual(link)(())) - INTERPRETATION_PENALTY
    return choose_lever(exact.with_unknown_steps()) if better else link
