"""Stage "replay": the path of A in P on which contact and sensor are replayed.

The measured pose is that path, and contains all that the platform did. Differentiated, however, its noise hides the force: 2 um at 1 kHz
in a damper of 400 N s/m are 1 N. So where it adds more than a share of the force's own noise, the noise-free response of the explained
platform to its command replaces it; where the platform is not explained, the measured pose is smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.bridged import interpolation_errors, rms_differences
from hiltestbed.diagnosis.decimation import decimated
from hiltestbed.diagnosis.layout import Layout, platform_link, wrench_link
from hiltestbed.diagnosis.links import WrenchLink, flat_pose
from hiltestbed.diagnosis.links.base import NO_SHIFT, Timing
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import (
    BLOCK_ROWS,
    COPY_PERTURBATION,
    DIVERGED_TIME,
    DIVERGENCE_THRESHOLD,
    LEVER_ARM,
    MAX_PATH_NOISE,
    MODEL_ERROR,
    PERTURBED_COPIES,
    SMOOTHING_ROWS,
)
from hiltestbed.diagnosis.timing import may_be_stamp
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import finest_noise
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.replay import follows_exactly, moves_linearly
from hiltestbed.replay.compensation import central_rates


@dataclass(frozen=True)
class Path:
    """The path of A in each run.

    Attributes:
        poses: (N, 7) at t_k. rates: (N, 6) twist at t_k; None: the slope of the tick that ends there.
        place, rate: white noise of poses [m] and rates [m/s], of an attitude times its lever arm. source: the group it comes from.
        rates_measured: whether the rates are on record. rounding: (N, 3) of each run, 1 sigma of the rounding error of the positions [m];
        empty: there is none.
    """

    poses: Sequence[Array]
    rates: Sequence[Array] | None
    place: float = 0.0
    rate: float = 0.0
    source: str = "pose_act"
    rates_measured: bool = False
    rounding: Sequence[Array] = ()


@dataclass(frozen=True)
class BestPath:
    """The path on which contact and sensor are replayed.

    Attributes:
        path_noise: (N, 6) of each run, noise of the reading that is due to the path; None: none. jumps: (N,) of each run, distance by which
            a platform with stiction jumped [m] in the tick that ends at each row; None: it has no stiction.
        clocks_off: whether channels are stamped, or instants lie, between rows.
    """

    path: Path
    path_noise: Sequence[Array] | None
    jumps: Sequence[Array] | None
    clocks_off: bool = False


def best_path(layout: Layout, platform: Explanation | None) -> BestPath:
    """The path with the least noise that the data allow, with the poses as they are stamped."""
    explained = platform is not None and platform.adequate
    known = [(path, _noise_of(layout, path)) for path in _measured(layout)]
    measured, path_noise = min(known, key=lambda k: max(_noise_ratio(layout, k[1]), MAX_PATH_NOISE), default=(None, None))
    if measured is not None and path_noise is not None and not _replay_is_better(layout, measured, path_noise, explained):
        path, extra = measured, path_noise
    elif platform is not None and platform.adequate:
        poses = platform_link(layout, layout.whole).with_timing(platform.residual.link.timing).paths(platform.chosen.effects())
        rounding = [r.record.unsmoothed() for r in layout.runs]
        path = Path(poses, _central_rates(layout, poses), source="pose_cmd", rounding=rounding)
        extra = _command_noise(layout, path)
    else:
        poses = _smooth_paths(layout, platform)
        path = Path(poses, None if platform is not None else _central_rates(layout, poses))
        noisy = platform is not None or any(r.record.has("pose_act") for r in layout.runs)
        extra = [_smoothed_noise(layout, run) for run in layout.runs] if noisy else None
        if _only_commanded(layout) and not all(follows_exactly(r.scenario) for r in layout.runs):
            extra = _deflection_noise(layout, path)
    if not all(sides_of(r.scenario.mechanism).rigid for r in layout.runs):
        extra = extra or [np.zeros((n, 6)) for n in layout.whole]
        extra = [np.where(parted[:, None], np.inf, e) for parted, e in zip(diverged(layout, path), extra, strict=True)]
    return BestPath(path, extra, _jumped(platform, path))


def compared_share(layout: Layout, best: BestPath) -> float:
    """Share of the rows in contact whose replay on a path can be compared."""
    if best.path_noise is None:
        return 1.0
    inside = [np.asarray(np.isfinite(b).all(axis=1))[r.touching(len(b))] for r, b in zip(layout.runs, best.path_noise, strict=True)]
    return float(np.mean(np.concatenate(inside)))


def path_without_delay(layout: Layout, platform: Explanation | None, best: BestPath) -> BestPath | None:
    """The path if fractions of a tick between pose_act and its command are only its stamp's; None where there are none.

    A path that is resampled between rows is flatter than the one that was taken.
    """
    if platform is None or not platform.adequate or best.path.source != "pose_cmd":
        return None
    found = platform.residual.link
    effects = [e for e in platform.chosen.effects() if not may_be_stamp(e, found)]
    if len(effects) == len(platform.chosen.causes) and found.timing == NO_SHIFT:
        return None
    loop = Timing(obeyed=found.timing.obeyed, before=found.timing.before if "before" in found.known else 0.0)
    poses = platform_link(layout, layout.whole).with_timing(loop).paths(effects)
    path = Path(poses, _central_rates(layout, poses), source="pose_cmd", rounding=best.path.rounding)
    return BestPath(path, best.path_noise, _jumped(platform, path))


def with_clocks_off(layout: Layout, best: BestPath) -> BestPath:
    """The same path with added noise for channels that are stamped between rows, where a reading is not on record and interpolation smooths
    the motion. The error is alike over many rows, and counts like noise that is larger by the root of a block. The instant at which a
    facility takes the rate of the contact is not known either, see :meth:`WrenchLink.with_unknown_rate`."""
    error = [math.sqrt(BLOCK_ROWS) * MODEL_ERROR * np.abs(np.nan_to_num(r.record.data["wrench_meas"])) for r in layout.runs]
    noise = [np.hypot(e, b) for e, b in zip(error, best.path_noise or [0.0] * len(error), strict=True)]
    return replace(best, path_noise=noise, clocks_off=True)


def with_filter_error(layout: Layout, best: BestPath) -> BestPath:
    """The same path with added noise for a logger's filter, which is known to about one order: as smooth as filtered noise."""
    if layout.logged is None:
        return best
    missed = [layout.logged.colour * layout.logged.missed(r.record.filled("wrench_meas")) for r in layout.runs]
    return replace(best, path_noise=[np.hypot(m, b) for m, b in zip(missed, best.path_noise or [0.0] * len(missed), strict=True)])


def _jumped(platform: Explanation | None, path: Path) -> list[Array] | None:
    """`jumps` of :class:`BestPath`."""
    sticks = platform is not None and platform.adequate and "platform.friction" in platform.chosen.kinds
    return [_jumps(p) for p in path.poses] if sticks else None


def make_wrench_link(layout: Layout, best: BestPath, rows: Sequence[int], decimate: bool = False) -> WrenchLink:
    """Contact and sensor on a path; ``decimate``: in fewer rows, where that loses nothing and no other link continues from them."""
    link = wrench_link(layout, best.path.poses, rows, best.jumps, best.path.rates, best.path_noise)
    link = link.through(layout.logged).with_rounding(best.path.rounding)
    if best.clocks_off:
        link = link.with_unknown_rate()
    if _only_commanded(layout):
        assert layout.deflection is not None  # else the link is missing
        return link.commanded(_followed(layout), [found.yielded for found in layout.deflection])
    return decimated(link) if decimate and best.jumps is None else link


def _only_commanded(layout: Layout) -> bool:
    """Whether only the command shows where A went."""
    return all(r.record.has("pose_cmd") and not r.record.has("pose_act") for r in layout.runs)


def _followed(layout: Layout) -> list[Array]:
    """(N, 7) of each run: the command, moved by what the believed drives make of it without a force; row k is reached at t_(k+1).

    Effects of the platform act before the drives, which are linear: in either order they give the same path.
    """
    assert layout.deflection is not None  # else the link is missing
    out = []
    for run, found in zip(layout.runs, layout.deflection, strict=True):
        command = np.array(run.record.filled("pose_cmd"))
        free = found.away - found.yielded
        command[:, :3] += np.concatenate([free[1:, :3], free[-1:, :3]])
        out.append(command)
    return out


def _measured(layout: Layout) -> list[Path]:
    """The measured poses with measured rates, and with rates by differentiation; none where a pose is missing."""
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
        out.insert(0, Path(poses, twists, place, max(_finest(r, "twist_act") for r in runs), rates_measured=True))
    return out


def _replay_is_better(layout: Layout, measured: Path, path_noise: Sequence[Array], explained: bool) -> bool:
    """Whether the replayed platform has less noise than the measured pose or, where it is not explained, the smoothed pose has."""
    share = _noise_ratio(layout, path_noise)
    if share < MAX_PATH_NOISE:
        return False
    if not explained or layout.deflection is None:  # a simulated mechanism diverges at the smallest difference, on any path
        return share > 1.0 and all(sides_of(r.scenario.mechanism).rigid for r in layout.runs)
    return max(d.noise for d in layout.deflection) < measured.place


def _noise_ratio(layout: Layout, path_noise: Sequence[Array]) -> float:
    """Noise of the reading due to the path over that of the force, rms in contact, on the force axis where it is largest."""
    inside = [b[r.touching(len(b)), :3] for r, b in zip(layout.runs, path_noise, strict=True)]
    squares = np.mean(np.concatenate(inside) ** 2, axis=0)
    own = max(layout.noise.get("wrench_meas.fz", 0.0), layout.least_force)
    return float(np.sqrt(squares.max())) / own if np.isfinite(squares).all() else math.inf


def _noise_of(layout: Layout, path: Path) -> list[Array]:
    """(N, 6) noise of the reading of each run that a path adds: by replays of perturbed copies, and by interpolation between samples."""
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

    link, away = _perturbed(layout, path, moved)
    squares = [np.mean(np.square(a), axis=0) for a in away]
    noise = [np.sqrt(np.maximum(uniform_filter1d(s, SMOOTHING_ROWS, axis=0), 0.0)) for s in squares]
    if (
        link.simulated and path.rates is not None and not path.rates_measured
    ):  # how A was integrated is not known; the error lasts many rows
        missed = rms_differences(link, wrench_link(layout, path.poses, layout.whole))
        noise = [np.hypot(n, math.sqrt(BLOCK_ROWS) * m) for n, m in zip(noise, missed, strict=True)]
    if not _interpolated(layout, path):
        return noise
    return [np.hypot(n, d) for n, d in zip(noise, _between_samples(layout, path), strict=True)]


def _perturbed(
    layout: Layout, path: Path, moved: Callable[[Array, Array | None], tuple[Array, Array | None]]
) -> tuple[WrenchLink, list[list[Array]]]:
    """Contact and sensor on a path, and for each run the changes (N, 6) of its readings on copies of the path, whose poses and
    rates ``moved`` gives."""
    runs = range(len(layout.runs))
    link = wrench_link(layout, path.poses, layout.whole, None, path.rates)
    copies = [moved(path.poses[i], None if path.rates is None else path.rates[i]) for _ in range(PERTURBED_COPIES) for i in runs]
    rates = [r for _, r in copies if r is not None]
    many = WrenchLink([link.runs[i] for _ in range(PERTURBED_COPIES) for i in runs], [p for p, _ in copies], None, rates or None)
    shown, found = link.predict([(i, ()) for i in runs]), many.predict([(i, ()) for i in range(len(copies))])
    return link, [[found[n] - shown[i] for n in range(i, len(copies), len(layout.runs))] for i in runs]


def diverged(layout: Layout, path: Path) -> list[np.ndarray]:
    """(N,) bool of each run: rows at which barely perturbed copies of a path have diverged, and for some time after.

    Bodies that slide or swing may reverse at the smallest difference: the record took one branch there, each copy takes another, and none
    of them shows the law.
    """
    rng = np.random.default_rng(1)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        if rates is not None:
            return pose, rates + COPY_PERTURBATION * rng.standard_normal(rates.shape) * np.abs(np.gradient(rates, axis=0))
        out = pose.copy()
        out[:, :3] += (
            COPY_PERTURBATION * rng.standard_normal((len(pose), 3)) * np.abs(np.gradient(np.gradient(pose[:, :3], axis=0), axis=0))
        )
        return out, None

    link, away = _perturbed(layout, path, moved)
    level = np.maximum([layout.noise.get(c, 0.0) for c in link.channels], layout.least_force)
    out = [~np.all([np.abs(d) <= DIVERGENCE_THRESHOLD * level for d in a], axis=(0, 2)) for a in away]
    back = round(DIVERGED_TIME / layout.scales.tick)
    return [np.asarray(maximum_filter1d(o, back + SMOOTHING_ROWS, origin=(back - SMOOTHING_ROWS) // 2)) for o in out]


def _command_noise(layout: Layout, path: Path) -> list[Array] | None:
    """(N, 6) noise of the reading of each run due to a command with few digits, or logged between ticks; None: there is none.

    The largest of its rounding errors counts everywhere: rounding errors of a slow motion are alike over many rows.
    """
    written = max(float(r.record.rounding(path.source)[:, :3].max()) for r in layout.runs)
    if not written and not _interpolated(layout, path):
        return None
    return _noise_of(layout, replace(path, place=written, rate=math.sqrt(0.5) * written / layout.scales.tick))


def _interpolated(layout: Layout, path: Path) -> bool:
    """Whether a path was interpolated between the rows of a log whose rows are not the ticks of the loop."""
    return any(b.any() for b in interpolation_errors(layout.runs, path.source, layout.whole))


def _between_samples(layout: Layout, path: Path) -> list[Array]:
    """(N, 6) change of the readings of each run with linear interpolation between the samples."""
    bends = interpolation_errors(layout.runs, path.source, layout.whole)
    straight = [np.column_stack([p[:, :3] - b[:, :3], p[:, 3:]]) for p, b in zip(path.poses, bends, strict=True)]
    rates = path.rates and _central_rates(layout, straight)
    links = [wrench_link(layout, poses, layout.whole, None, r) for poses, r in ((path.poses, path.rates), (straight, rates))]
    return rms_differences(*links)


def _finest(run: MeasuredRun, group: str) -> float:
    """Noise of a pose [m] or of a twist [m/s]: the largest of its axes, of an attitude times its lever arm."""
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
    """(N,) distance [m] that a tip with stiction moved along path (N, 7) in the tick that ends at each row."""
    return np.linalg.norm(np.diff(path[:, :3], axis=0, prepend=path[:1, :3]), axis=1)


def _smooth_paths(layout: Layout, platform: Explanation | None) -> list[Array]:
    """(N, 7) of each run: the measured pose, smoothed about the best explanation of the platform where there is one."""
    near = None
    if platform is not None:
        near = platform_link(layout, layout.whole).with_timing(platform.residual.link.timing).paths(platform.chosen.effects())
    out = []
    for i, run in enumerate(layout.runs):
        if not run.record.has("pose_act"):  # the commanded pose one row later, and what the believed drives make of it
            assert layout.deflection is not None  # else the link is missing
            told = np.concatenate([approach_state(run.scenario)[None, :7], run.record.filled("pose_cmd")[:-1]])
            away = layout.deflection[i].away
            out.append(poses_of(flat_pose(told) + away) if away.any() else told)
            continue
        measured = run.record.filled("pose_act")
        about = measured if near is None else near[i]
        places = measured[:, :3] - (0.0 if near is None else about[:, :3])
        smooth = np.asarray(savgol_filter(places, SMOOTHING_ROWS, 3, axis=0)) + (0.0 if near is None else about[:, :3])
        turns = _attitude(run) if near is None else about[:, 3:]
        out.append(np.concatenate([smooth, turns], axis=1))
    return out


def _attitude(run: MeasuredRun) -> Array:
    """(N, 4) the commanded attitude one row later, where there is one; else the measured one, smoothed."""
    if run.record.has("pose_cmd"):
        start = approach_state(run.scenario)[None, :7]
        return np.concatenate([start, run.record.filled("pose_cmd")[:-1]])[:, 3:]
    flat = flat_pose(run.record.filled("pose_act"))
    flat[:, 3:] = savgol_filter(flat[:, 3:], SMOOTHING_ROWS, 3, axis=0)
    return poses_of(flat)[:, 3:]


def _deflection_noise(layout: Layout, path: Path) -> list[Array]:
    """(N, 6) noise of the reading of each run due to the uncertainty of the deflection of drives whose pose was not measured.

    A contact before the drives' initial state has decayed is not compared.
    """
    assert layout.deflection is not None  # else the link is missing
    doubts = [found.doubt for found in layout.deflection]
    known = [np.asarray(np.isfinite(doubt).all(axis=1)) for doubt in doubts]
    off = [np.where(k[:, None], d, 0.0) for d, k in zip(doubts, known, strict=True)]
    poses = [poses_of(flat_pose(p) + d) for p, d in zip(path.poses, off, strict=True)]
    links = [wrench_link(layout, p, layout.whole, None, path.rates) for p in (path.poses, poses)]
    noise = rms_differences(*links)
    return [np.where((r.touching(len(n)) & ~k)[:, None], np.inf, n) for r, n, k in zip(layout.runs, noise, known, strict=True)]


def _smoothed_noise(layout: Layout, run: MeasuredRun) -> Array:
    """(N, 6) noise of k x + c v due to the noise of a smoothed pose, in contact [N]."""
    noise, contact = layout.noise.get("pose_act.pz", 0.0), run.scenario.mechanism.contact
    place = float(np.linalg.norm(savgol_coeffs(SMOOTHING_ROWS, 3))) * noise
    rate = float(np.linalg.norm(savgol_coeffs(SMOOTHING_ROWS, 3, deriv=1))) * noise / layout.scales.tick
    extra = 2.0 * math.hypot(contact.stiffness * place, contact.damping * rate)
    return np.where(run.touching(run.record.ticks)[:, None] & (np.arange(6) < 3), extra, 0.0)
