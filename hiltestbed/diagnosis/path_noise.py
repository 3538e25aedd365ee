"""The noise that the path of A in P adds to the reading of contact and sensor: by replays of paths
that differ as much, of a measured pose, of a smoothed one, of a command, and of drives whose
deflection is computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.links import WrenchLink, flat_pose
from hiltestbed.diagnosis.links.platform import poses_of
from hiltestbed.diagnosis.recorded import (
    DatasetLayout,
    interpolation_error,
    smoothed_rms,
    wrench_link,
)
from hiltestbed.diagnosis.settings import (
    BLOCK_ROWS,
    LEVER_ARM,
    PERTURBED_COPIES,
    SIGNIFICANCE_SIGMA,
    SMOOTHING_ROWS,
)
from hiltestbed.diagnosis.yielding import MAX_GAIN_ERROR, MAX_READING_SHIFT
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.noise import MAD_TO_SIGMA
from hiltestbed.platform.build import nearest_bandwidth
from hiltestbed.replay import moves_linearly
from hiltestbed.replay.compensation import central_rates
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import Scenario

# chosen: share of the change of a rate, or of a pose's slope, in a tick: perturbation of the copies
COPY_PERTURBATION = 2e-3
# derived: of the force noise, above which copies have diverged; less adds 4 % to the noise
DIVERGENCE_THRESHOLD = 0.3
DIVERGED_TIME = 0.25  # chosen: [s] for which copies are not used after they have diverged

Copy = Sequence[tuple[Array, Array | None]]  # the pose and rates of each run


@dataclass(frozen=True)
class Path:
    """The path of A in each run, on which contact and sensor are replayed.

    Attributes:
        poses: (N, 7) at t_k. rates: (N, 6) twist at t_k; None: the slope of the tick that ends
            there.
        place, rate: white noise of poses [m] and rates [m/s], of an attitude times its lever arm.
            source: the group it comes from. rates_measured: whether the rates are on record.
        rounding: (N, 3) 1 sigma of the rounding error of the positions [m]; empty: there is none.
        unknown: of each run, changes of the poses (N, 6) [m, rad] that the data leave open, one
            standard deviation each; empty: there are none.
        yielded: (N, 6) [m, rad], part of the path by which drives yielded to a force, where only
            the command is on record.
        noise: (N, 6) of the reading, that is due to the path; None: none. jumps: (N,) distance by
            which a platform with stiction jumped [m] in the tick that ends at each row; None: it
            has no stiction.
    """

    poses: Sequence[Array]
    rates: Sequence[Array] | None
    place: float = 0.0
    rate: float = 0.0
    source: str = "pose_act"
    rates_measured: bool = False
    rounding: Sequence[Array] = ()
    unknown: Sequence[Sequence[Array]] = ()
    yielded: Sequence[Array] = ()
    noise: Sequence[Array] | None = None
    jumps: Sequence[Array] | None = None

    @property
    def each(self) -> Copy:
        return list(zip(self.poses, self.rates or [None] * len(self.poses), strict=True))

    @property
    def differentiated(self) -> bool:
        """Whether rates are differences of poses, though A does not move uniformly in a tick."""
        return self.rates is not None and not self.rates_measured


def changes(layout: DatasetLayout, path: Path, copies: Sequence[Copy]) -> list[Array]:
    """(K, N, 6) changes of the readings of each run on copies of its path."""
    link = wrench_link(layout, path.poses, layout.whole, None, path.rates)
    poses = [pose for copy in copies for pose, _ in copy]
    rates = [rate for copy in copies for _, rate in copy if rate is not None]
    many = WrenchLink([*link.runs] * len(copies), poses, None, rates or None)
    shown, found = link.shown_in_all(), many.shown_in_all()
    return [np.array(found[i :: len(shown)]) - shown[i] for i in range(len(shown))]


def _noise_by(layout: DatasetLayout, path: Path, copies: Sequence[Copy]) -> list[Array]:
    """(N, 6) rms of the changes of the readings of each run."""
    return [smoothed_rms(c) for c in changes(layout, path, copies)]


def both(noise: Sequence[Array], other: Sequence[Array] | None) -> list[Array]:
    """Root of the sum of squares of two noises (N, 6) of each run; the second may be None."""
    if other is None:
        return list(noise)
    return [np.hypot(a, b) for a, b in zip(noise, other, strict=True)]


def noise_of(layout: DatasetLayout, path: Path, place: float, rate: float) -> list[Array]:
    """(N, 6) noise of the reading of each run due to white noise of poses, ``place`` [m], and of
    rates [m/s], to interpolation between samples, and to rates that are differences.
    """
    rng = np.random.default_rng(0)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        out = pose.copy()
        out[:, :3] += place * rng.standard_normal((len(pose), 3))
        out[:, 3:6] += 0.5 * place / LEVER_ARM * rng.standard_normal((len(pose), 3))
        if rates is None:
            return out, None
        noise = rng.standard_normal((len(pose), 6)) * rate
        noise[:, 3:] /= LEVER_ARM
        return out, rates + noise

    copies = [[moved(*one) for one in path.each] for _ in range(PERTURBED_COPIES)]
    noise = both(_noise_by(layout, path, copies), rate_noise(layout, path))
    if not _interpolated(layout, path):
        return noise
    straight = [
        _displaced(p, -interpolation_error(r.record, path.source)[:, :3])
        for r, p in zip(layout.runs, path.poses, strict=True)
    ]
    return both(noise, _noise_by(layout, path, [on_poses(layout, path, straight)]))


def rate_noise(layout: DatasetLayout, path: Path) -> list[Array] | None:
    """(N, 6) noise of the reading of each run because how A moved within a tick is not on record:
    its rate at t_k is known to a tick.

    None where the rate is known, or where its effect on the force is one number a run, see
    :meth:`WrenchLink.with_unknown_rate`. The error is alike over many rows, and counts like noise
    that is larger by the root of a block.
    """
    if not path.differentiated or not any(_reacts_sharply(r.scenario) for r in layout.runs):
        return None
    earlier = [(p, np.concatenate([r[:1], r[:-1]])) for p, r in path.each if r is not None]
    return [math.sqrt(BLOCK_ROWS) * m for m in _noise_by(layout, path, [earlier])]


def _reacts_sharply(scenario: Scenario) -> bool:
    """Whether a force depends on the rate by dry friction, or by parts that move."""
    return not sides_of(scenario.mechanism).rigid or scenario.mechanism.contact.friction > 0.0


def diverged(layout: DatasetLayout, path: Path) -> list[np.ndarray]:
    """(N,) bool of each run: rows at which barely perturbed copies of a path have diverged, and for
    some time after.

    Bodies that slide or swing may reverse at the smallest difference: the record took one branch
    there, each copy takes another, and none of them shows the law.
    """
    rng = np.random.default_rng(1)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        by = np.gradient(pose[:, :3] if rates is None else rates, axis=0)
        by = np.abs(np.gradient(by, axis=0) if rates is None else by)
        error = COPY_PERTURBATION * rng.standard_normal(by.shape) * by
        return (_displaced(pose, error), None) if rates is None else (pose, rates + error)

    copies = [[moved(*one) for one in path.each] for _ in range(PERTURBED_COPIES)]
    level = np.maximum(layout.level("wrench_meas"), layout.least_force)
    found = changes(layout, path, copies)
    out = [~np.all(np.abs(d) <= DIVERGENCE_THRESHOLD * level, axis=(0, 2)) for d in found]
    back = round(DIVERGED_TIME / layout.scales.tick)
    size, origin = back + SMOOTHING_ROWS, (back - SMOOTHING_ROWS) // 2
    return [np.asarray(maximum_filter1d(o, size, origin=origin)) for o in out]


def command_noise(layout: DatasetLayout, path: Path) -> list[Array] | None:
    """(N, 6) noise of the reading of each run due to a command with few digits, or logged between
    ticks; None: there is none.

    The largest of its rounding errors counts everywhere: rounding errors of a slow motion are alike
    over many rows.
    """
    written = max(float(r.record.rounding(path.source)[:, :3].max()) for r in layout.runs)
    if not written and not _interpolated(layout, path):
        return rate_noise(layout, path)
    return noise_of(layout, path, written, math.sqrt(0.5) * written / layout.scales.tick)


def _interpolated(layout: DatasetLayout, path: Path) -> bool:
    """Whether a path lies between the rows of a log whose rows are not the ticks of the loop."""
    return any(interpolation_error(r.record, path.source).any() for r in layout.runs)


def on_poses(layout: DatasetLayout, path: Path, poses: Sequence[Array]) -> Copy:
    """A path on other ``poses`` (N, 7), differentiated where the path has rates."""
    rates = central_rates_of(layout, poses) if path.rates else None
    return list(zip(poses, rates or [None] * len(poses), strict=True))


def smoothed(values: Array) -> Array:
    """(N, ...) values, smoothed by cubics (A. Savitzky, M. J. E. Golay, Anal. Chem. 36, 1964)."""
    return np.asarray(savgol_filter(values, SMOOTHING_ROWS, 3, axis=0))


def smoothed_noise(layout: DatasetLayout, path: Path, commanded: bool) -> list[Array]:
    """(N, 6) noise of the reading of each run due to a smoothed pose: to its noise, and to the
    bends of a ``commanded`` motion, which smoothing cuts off; a motion that was only measured is
    taken as smooth.

    Both errors are alike over the rows whose noise the filter averages, and count like noise that
    is larger by the root of their number.
    """
    rng = np.random.default_rng(0)
    place = layout.noise.get("pose_act.pz", 0.0)

    def moved(pose: Array, rates: Array | None) -> tuple[Array, Array | None]:
        error = smoothed(place * rng.standard_normal((len(pose), 3)))
        slope = np.gradient(error, layout.scales.tick, axis=0)
        return _displaced(pose, error), None if rates is None else _displaced(rates, slope)

    noise = _noise_by(
        layout, path, [[moved(*one) for one in path.each] for _ in range(PERTURBED_COPIES)]
    )
    if commanded:
        pairs = zip(layout.runs, path.poses, strict=True)
        bends = [_cut_off(run, pose) for run, pose in pairs]
        if any(b.any() for b in bends):
            bent = [_displaced(p, b) for p, b in zip(path.poses, bends, strict=True)]
            noise = both(noise, _noise_by(layout, path, [on_poses(layout, path, bent)]))
    alike = 1.0 / float(np.sum(savgol_coeffs(SMOOTHING_ROWS, 3) ** 2))
    return both([math.sqrt(alike) * n for n in noise], rate_noise(layout, path))


def _displaced(values: Array, error: Array) -> Array:
    """Poses (N, 7) or twists (N, 6) with an ``error`` (N, 3) of the position or velocity."""
    return np.concatenate([values[:, :3] + error, values[:, 3:]], axis=1)


def _cut_off(run: MeasuredRun, smooth: Array) -> Array:
    """(N, 3) what smoothing cut off the positions, near rows where its block mean exceeds noise."""
    off = uniform_filter1d(run.record.filled("pose_act")[:, :3] - smooth[:, :3], BLOCK_ROWS, axis=0)
    bends = np.abs(off) > SIGNIFICANCE_SIGMA * MAD_TO_SIGMA * np.median(np.abs(off), axis=0)
    return np.where(maximum_filter1d(bends, SMOOTHING_ROWS, axis=0), off, 0.0)


def deflection_noise(layout: DatasetLayout, path: Path) -> list[Array]:
    """(N, 6) noise of the reading of each run due to the uncertainty of the deflection of drives
    whose pose was not measured, or was too noisy. What is not known of it varies with the bandwidth
    of the drives, and so makes the rate uncertain as well.
    """
    assert layout.deflection is not None  # else the link is missing
    copy = []
    for run, found, (pose, rates) in zip(layout.runs, layout.deflection, path.each, strict=True):
        off = np.where(np.isfinite(found.doubt), found.doubt, 0.0)
        band = 2.0 * math.pi * nearest_bandwidth(run.scenario)
        other = poses_of(flat_pose(pose) + off)
        copy.append((other, None if rates is None else rates + band * off))
    return _noise_by(layout, path, [copy])


def misread(yielded: Sequence[Array], tick: float) -> list[list[Array]]:
    """(N, 6) changes of the path of each run, one standard deviation each: for a force that the
    drives bore earlier, and for a larger one.

    yielded: (N, 6) of each run, what the drives yielded to the force of the believed contact: what
        they made of the recorded force follows its noise, and would explain it.
    """
    return [[shifted(y, MAX_READING_SHIFT / tick) - y, MAX_GAIN_ERROR * y] for y in yielded]


def not_where_unsettled(layout: DatasetLayout, noise: Sequence[Array]) -> list[Array]:
    """The ``noise`` (N, 6) of each run; infinite in contact before the drives have settled."""
    assert layout.deflection is not None  # else the link is missing
    settled = [np.isfinite(found.doubt).all(axis=1) for found in layout.deflection]
    return [
        np.where((r.touching(len(n)) & ~s)[:, None], np.inf, n)
        for r, n, s in zip(layout.runs, noise, settled, strict=True)
    ]


def central_rates_of(layout: DatasetLayout, paths: Sequence[Array]) -> list[Array] | None:
    """(N, 6) twists at t_k by central differences; None where A moves uniformly within a tick."""
    if moves_uniformly(layout):
        return None
    return [
        central_rates(run.scenario.approach, run.scenario.tick, path)
        for run, path in zip(layout.runs, paths, strict=True)
    ]


def moves_uniformly(layout: DatasetLayout) -> bool:
    """Whether A is known to move uniformly within a tick: a facility that was commanded is believed
    to; of a motion that was only measured nothing is known but that it is smooth.
    """
    return any(r.record.has("pose_cmd") for r in layout.runs) and all(
        moves_linearly(r.scenario.rig) for r in layout.runs
    )
