"""The path of A in P on which contact and sensor are replayed.

The measured pose is the path, and hides nothing that the platform did. Differentiated, its noise drowns the force: 2 um at 1 kHz in a
damper of 400 N s/m make 1 N. So where it brings more than a part of the force's own noise the explained platform's answer to the command
takes its place, which carries none; and where the platform is not explained, the measured pose smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.bridged import bends_of, differences
from hiltestbed.diagnosis.decimation import decimated
from hiltestbed.diagnosis.layout import Layout, platform_link, wrench_link
from hiltestbed.diagnosis.links import WrenchLink, flat_pose
from hiltestbed.diagnosis.links.base import PROMPT, Later
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import APART, BARELY, BLOCK, CLEAN_PATH, LEVER_ARM, MODEL_ERROR, PARTED, SHAKEN_PATHS, SMOOTHING
from hiltestbed.diagnosis.timing import part_of_a_tick
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import finest_noise
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.replay import follows_exactly, moves_linearly
from hiltestbed.replay.compensation import central_rates


@dataclass(frozen=True)
class Path:
    """Where A went in each run.

    Attributes:
        poses: (N, 7) at t_k. rates: (N, 6) twist at t_k; None: the slope of the tick that ends. place, rate: noise of both [m], [m/s],
        an attitude's by its lever; how it is spread over the rows is known where it is white. source: the group that it comes from. told:
        whether the rates are on record.
    """

    poses: Sequence[Array]
    rates: Sequence[Array] | None
    place: float = 0.0
    rate: float = 0.0
    source: str = "pose_act"
    told: bool = False


@dataclass(frozen=True)
class BestPath:
    """The path that contact and sensor are replayed on.

    Attributes:
        brought: (N, 6) of each run the noise of the reading that the path brings; None: none. jumps: (N,) of each run how far a platform
        that sticks jumped [m] in the tick that ends at each row; None: it does not stick.
    """

    path: Path
    brought: Sequence[Array] | None
    jumps: Sequence[Array] | None


def best_path(layout: Layout, platform: Explanation | None) -> BestPath:
    """The best path that the data give, as the poses are stamped."""
    explained = platform is not None and platform.adequate
    known = [(path, _noise_of(layout, path)) for path in _measured(layout)]
    measured, brought = min(known, key=lambda k: max(_share(layout, k[1]), CLEAN_PATH), default=(None, None))
    if measured is not None and brought is not None and not _replays_better(layout, measured, brought, explained):
        path, extra = measured, brought
    elif platform is not None and platform.adequate:
        poses = platform_link(layout, layout.whole).stamped(platform.residual.link.timing).paths(platform.chosen.effects())
        path = Path(poses, _central_rates(layout, poses), source="pose_cmd")
        extra = _brought_by_command(layout, path)
    else:
        poses = _smooth_paths(layout, platform)
        path = Path(poses, None if platform is not None else _central_rates(layout, poses))
        noisy = platform is not None or any(r.record.has("pose_act") for r in layout.runs)
        extra = [_smoothed_noise(layout, run) for run in layout.runs] if noisy else None
    if not all(sides_of(r.scenario.mechanism).rigid for r in layout.runs):
        extra = extra or [np.zeros((n, 6)) for n in layout.whole]
        extra = [np.where(parted[:, None], np.inf, e) for parted, e in zip(apart(layout, path), extra, strict=True)]
    return BestPath(path, extra, _jumped(platform, path))


def compared(layout: Layout, best: BestPath) -> float:
    """Part of the rows in contact whose replay on a path tells anything."""
    if best.brought is None:
        return 1.0
    inside = [np.asarray(np.isfinite(b).all(axis=1))[r.touching(len(b))] for r, b in zip(layout.runs, best.brought, strict=True)]
    return float(np.mean(np.concatenate(inside)))


def unmoved(layout: Layout, platform: Explanation | None, best: BestPath) -> BestPath | None:
    """The path where parts of a tick by which pose_act is later or earlier than its command are its stamp's alone; None where it is none.

    Between two rows a resampled path is flatter than the one that was taken.
    """
    if platform is None or not platform.adequate or best.path.source != "pose_cmd":
        return None
    effects = [e for e in platform.chosen.effects() if not part_of_a_tick(e, layout.scales.tick)]
    if len(effects) == len(platform.chosen.causes) and platform.residual.link.timing == PROMPT:
        return None
    obeyed = Later(obeyed=platform.residual.link.timing.obeyed)
    poses = platform_link(layout, layout.whole).stamped(obeyed).paths(effects)
    path = Path(poses, _central_rates(layout, poses), source="pose_cmd")
    return BestPath(path, best.brought, _jumped(platform, path))


def between_rows(layout: Layout, best: BestPath) -> BestPath:
    """The same path where channels are stamped parts of a row off: what lies between rows is not on record, and a motion that was read
    there is smoother than it was."""
    error = [MODEL_ERROR * np.abs(np.nan_to_num(r.record.data["wrench_meas"])) for r in layout.runs]
    return replace(best, brought=[np.hypot(e, b) for e, b in zip(error, best.brought or [0.0] * len(error), strict=True)])


def filtered(layout: Layout, best: BestPath) -> BestPath:
    """The same path where the logger filtered the force, which is known to about an order of its filter."""
    if layout.logged is None:
        return best
    missed = [layout.logged.missed(r.record.filled("wrench_meas")) for r in layout.runs]
    return replace(best, brought=[np.hypot(m, b) for m, b in zip(missed, best.brought or [0.0] * len(missed), strict=True)])


def _jumped(platform: Explanation | None, path: Path) -> list[Array] | None:
    """See :class:`BestPath`."""
    sticks = platform is not None and platform.adequate and "platform.friction" in platform.chosen.kinds
    return [_jumps(p) for p in path.poses] if sticks else None


def make_wrench_link(layout: Layout, best: BestPath, rows: Sequence[int], decimate: bool = False) -> WrenchLink:
    """Contact and sensor on a path; ``decimate``: in fewer rows, where nothing is lost and no other link goes on from them."""
    link = wrench_link(layout, best.path.poses, rows, best.jumps, best.path.rates, best.brought).through(layout.logged)
    if _nobody_saw(layout):
        return link.commanded([np.ascontiguousarray(r.record.filled("pose_cmd")) for r in layout.runs])
    return decimated(link) if decimate and best.jumps is None else link


def _nobody_saw(layout: Layout) -> bool:
    """Whether only the command tells where A went, on a platform that is believed to follow it."""
    return all(r.record.has("pose_cmd") and not r.record.has("pose_act") and follows_exactly(r.scenario) for r in layout.runs) and all(
        moves_linearly(r.scenario) for r in layout.runs
    )


def _measured(layout: Layout) -> list[Path]:
    """The measured poses, with the rates that were measured and with those of the poses themselves; none where some were not measured."""
    runs, tick = layout.runs, layout.scales.tick
    if not all(r.record.whole("pose_act") for r in runs):
        return []
    poses = [r.record.filled("pose_act") for r in runs]
    place = max(_finest(r, "pose_act") for r in runs)
    if _uniform(layout):
        return [Path(poses, None, place, math.sqrt(2.0) * place / tick)]
    out = [Path(poses, _central_rates(layout, poses), place, math.sqrt(0.5) * place / tick)]
    if all(r.record.whole("twist_act") for r in runs):
        twists = [r.record.filled("twist_act") for r in runs]
        out.insert(0, Path(poses, twists, place, max(_finest(r, "twist_act") for r in runs), told=True))
    return out


def _replays_better(layout: Layout, measured: Path, brought: Sequence[Array], explained: bool) -> bool:
    """Whether the replayed platform carries less noise than the measured pose, or, where it is not explained, the smoothed pose does."""
    share = _share(layout, brought)
    if share < CLEAN_PATH:
        return False
    if not explained or layout.deflection is None:  # what is played turns about on the least of causes, on any path
        return share > 1.0 and all(sides_of(r.scenario.mechanism).rigid for r in layout.runs)
    return max(d.noise for d in layout.deflection) < measured.place


def _share(layout: Layout, brought: Sequence[Array]) -> float:
    """The noise that a path brings over that of the force, rms in contact, of the force axis where it is largest."""
    inside = [b[r.touching(len(b)), :3] for r, b in zip(layout.runs, brought, strict=True)]
    squares = np.mean(np.concatenate(inside) ** 2, axis=0)
    own = max(layout.noise.get("wrench_meas.fz", 0.0), layout.least_force)
    return float(np.sqrt(squares.max())) / own if np.isfinite(squares).all() else math.inf


def _noise_of(layout: Layout, path: Path) -> list[Array]:
    """(N, 6) noise of the reading of each run that the noise of a path brings, by replays of paths that are shaken by as much, and what
    lies between its samples."""
    rng = np.random.default_rng(0)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        out = pose.copy()
        out[:, :3] += path.place * rng.standard_normal((len(pose), 3))
        out[:, 3:6] += 0.5 * path.place / LEVER_ARM * rng.standard_normal((len(pose), 3))
        if rates is None:
            return out, None
        noise = rng.standard_normal((len(pose), 6)) * path.rate
        noise[:, 3:] /= LEVER_ARM
        return out, rates + noise

    link, away = _shaken(layout, path, moved)
    squares = [np.mean(np.square(a), axis=0) for a in away]
    noise = [np.sqrt(np.maximum(uniform_filter1d(s, SMOOTHING, axis=0), 0.0)) for s in squares]
    if link.played and path.rates is not None and not path.told:  # how A was stepped is not known, and goes the same way for many rows
        missed = differences(link, wrench_link(layout, path.poses, layout.whole))
        noise = [np.hypot(n, math.sqrt(BLOCK) * m) for n, m in zip(noise, missed, strict=True)]
    if not _bent(layout, path):
        return noise
    return [np.hypot(n, d) for n, d in zip(noise, _between_samples(layout, path), strict=True)]


def _shaken(
    layout: Layout, path: Path, moved: Callable[[Array, Array | None], tuple[Array, Array | None]]
) -> tuple[WrenchLink, list[list[Array]]]:
    """Contact and sensor on a path, and of each run by how much (N, 6) its readings on each of some copies differ, which ``moved`` makes of
    its poses and rates."""
    runs = range(len(layout.runs))
    link = wrench_link(layout, path.poses, layout.whole, None, path.rates)
    copies = [moved(path.poses[i], None if path.rates is None else path.rates[i]) for _ in range(SHAKEN_PATHS) for i in runs]
    rates = [r for _, r in copies if r is not None]
    many = WrenchLink([link.runs[i] for _ in range(SHAKEN_PATHS) for i in runs], [p for p, _ in copies], None, rates or None)
    shown, found = link.predict([(i, ()) for i in runs]), many.predict([(i, ()) for i in range(len(copies))])
    return link, [[found[n] - shown[i] for n in range(i, len(copies), len(layout.runs))] for i in runs]


def apart(layout: Layout, path: Path) -> list[np.ndarray]:
    """(N,) bool of each run: rows at which copies of a path that differ by next to nothing part, and for a while from there.

    What slides on a side of its own, or swings against it, may turn about on the least of causes: the record went one way there, each copy
    goes another, and none tells what the law is.
    """
    rng = np.random.default_rng(1)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        if rates is not None:
            return pose, rates + BARELY * rng.standard_normal(rates.shape) * np.abs(np.gradient(rates, axis=0))
        out = pose.copy()
        out[:, :3] += BARELY * rng.standard_normal((len(pose), 3)) * np.abs(np.gradient(np.gradient(pose[:, :3], axis=0), axis=0))
        return out, None

    link, away = _shaken(layout, path, moved)
    level = np.maximum([layout.noise.get(c, 0.0) for c in link.channels], layout.least_force)
    out = [~np.all([np.abs(d) <= APART * level for d in a], axis=(0, 2)) for a in away]
    back = round(PARTED / layout.scales.tick)
    return [np.asarray(maximum_filter1d(o, back + SMOOTHING, origin=(back - SMOOTHING) // 2)) for o in out]


def _brought_by_command(layout: Layout, path: Path) -> list[Array] | None:
    """(N, 6) noise of the reading of each run that a command with few digits, or logged between ticks, brings; None: it brings none."""
    written = max(float(r.record.rounding(path.source)[:, :3].max()) for r in layout.runs)
    if not written and not _bent(layout, path):
        return None
    return _noise_of(layout, replace(path, place=written, rate=math.sqrt(0.5) * written / layout.scales.tick))


def _bent(layout: Layout, path: Path) -> bool:
    """Whether a path lies between the rows of a log that has other ones than the loop's ticks."""
    return any(b.any() for b in bends_of(layout.runs, path.source, layout.whole))


def _between_samples(layout: Layout, path: Path) -> list[Array]:
    """(N, 6) of each run by how much a reading on straight lines between the samples differs."""
    bends = bends_of(layout.runs, path.source, layout.whole)
    straight = [np.column_stack([p[:, :3] - b[:, :3], p[:, 3:]]) for p, b in zip(path.poses, bends, strict=True)]
    rates = path.rates and _central_rates(layout, straight)
    links = [wrench_link(layout, poses, layout.whole, None, r) for poses, r in ((path.poses, path.rates), (straight, rates))]
    return differences(*links)


def _finest(run: MeasuredRun, group: str) -> float:
    """[m] of the noise of a pose, or [m/s] of a twist: the largest of its axes, the attitude's by its lever."""
    values = run.record.data[group]
    levels = [finest_noise(values[:, j]) for j in range(values.shape[1])]
    turned = 2.0 if group.startswith("pose") else 1.0
    return max([*levels[:3], *(turned * LEVER_ARM * v for v in levels[3:])])


def _central_rates(layout: Layout, paths: Sequence[Array]) -> list[Array] | None:
    """(N, 6) twists at t_k, the mean of the slopes before and after; None where A moves uniformly within a tick."""
    if _uniform(layout):
        return None
    return [central_rates(run.scenario, path) for run, path in zip(layout.runs, paths, strict=True)]


def _uniform(layout: Layout) -> bool:
    """Whether A is known to move uniformly within a tick: a facility that was commanded is believed to; of a motion that was only measured
    nothing is known but that it is smooth."""
    return any(r.record.has("pose_cmd") for r in layout.runs) and all(moves_linearly(r.scenario) for r in layout.runs)


def _jumps(path: Array) -> Array:
    """(N,) how far a tip that sticks and jumps along path (N, 7) moved [m] in the tick that ends at each row."""
    return np.linalg.norm(np.diff(path[:, :3], axis=0, prepend=path[:1, :3]), axis=1)


def _smooth_paths(layout: Layout, platform: Explanation | None) -> list[Array]:
    """(N, 7) of each run: the measured pose, smoothed about the best explanation of the platform where there is one."""
    near = None
    if platform is not None:
        near = platform_link(layout, layout.whole).stamped(platform.residual.link.timing).paths(platform.chosen.effects())
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


def _smoothed_noise(layout: Layout, run: MeasuredRun) -> Array:
    """(N, 6) what the noise of a smoothed pose makes of k x + c v: noise of the forces in contact [N]."""
    noise, contact = layout.noise.get("pose_act.pz", 0.0), run.scenario.mechanism.contact
    place = float(np.linalg.norm(savgol_coeffs(SMOOTHING, 3))) * noise
    rate = float(np.linalg.norm(savgol_coeffs(SMOOTHING, 3, deriv=1))) * noise / layout.scales.tick
    extra = 2.0 * math.hypot(contact.stiffness * place, contact.damping * rate)
    return np.where(run.touching(run.record.ticks)[:, None] & (np.arange(6) < 3), extra, 0.0)
