"""Stage "replay": the link platform: pose_cmd to pose_act."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links.base import (
    Effects,
    Lane,
    LinkRun,
    ModelLink,
    Timing,
    flat_channels,
    flat_pose,
    moved,
    padded,
    padded_by,
    perturbed,
    smoothed,
)
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.platform.effects.response import PlatformDelay
from hiltestbed.platform.effects.tracking import PlatformFriction
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.replay import replay_platform
from hiltestbed.replay.stiction import ON_AN_INSTANT

# ticks: largest error of the instant of a jump, since how a facility divides a tick, and at which
# instant it reads the pose, is not known
JUMP = 0.5


class PlatformLink(ModelLink):
    """The motion platform: its response to the command, and the believed deflection."""

    name = "platform"
    channels = flat_channels("pose_act")

    def __init__(
        self, runs: Sequence[LinkRun], commands: Sequence[Array], deflection: Sequence[Array]
    ) -> None:
        """commands: (N, 7) of each run. deflection: (N, 6) of the believed drives [m, rad]."""
        self.runs, self.commands, self.deflection = runs, commands, deflection
        self._padded = padded(commands)
        starts = [approach_state(r.scenario)[None, :7] for r in runs]
        self._attitude = [
            flat_pose(np.concatenate([s, c[:-1]]))[:, 3:]
            for s, c in zip(starts, commands, strict=True)
        ]

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        poses = zip(self._reached(lanes), lanes, strict=True)
        return [self._between(i, pose, self.timing_with(effects)) for pose, (i, effects) in poses]

    def _reached(self, lanes: Sequence[Lane]) -> list[Array]:
        """(N, 6) of each lane, what the platform reaches on its commands as they are stamped."""
        out = []
        for place, (i, effects) in zip(self.places(lanes), lanes, strict=True):
            turned = moved(self._attitude[i], self.timing_with(effects).obeyed / self.tick)
            pose = np.concatenate([place[: self.runs[i].rows], turned], axis=1)
            out.append(pose + self.deflection[i])
        return out

    def places(self, lanes: Sequence[Lane]) -> Array:
        """(L, N, 3) positions [m] that are reached in each lane, without the deflection."""
        run = np.array([i for i, _ in lanes])
        scenarios = [self.runs[i].scenario for i in run]
        believed = [PlatformParameters.believed(s) for s in scenarios]
        parameters = [p.with_effects(own) for p, (_, own) in zip(believed, lanes, strict=True)]
        timing = [self.timing_with(effects) for _, effects in lanes]
        obeyed, early = np.array([t.obeyed for t in timing]), np.array([t.before for t in timing])
        # rows before the first command
        lost = np.ceil(np.maximum(-early / self.tick - ON_AN_INSTANT, 0.0)).astype(int)
        commands, at = self._padded, run
        if lost.any():
            pairs = zip(commands[run], lost, strict=True)
            commands, at = np.stack([padded_by(c[n:], n) for c, n in pairs]), np.arange(len(run))
        early = early + lost * self.tick
        found = replay_platform(scenarios, parameters, commands, at, obeyed, early)
        pairs = zip(found, lost, strict=True)
        return np.stack(
            [np.concatenate([np.repeat(p[:1], n, axis=0), p])[: len(p)] for p, n in pairs]
        )

    def _with_errors(self, i: int) -> PlatformLink:
        commands = perturbed(self.commands[i], self.rounding[i])
        runs, still = [self.runs[i]] * len(commands), [self.deflection[i]] * len(commands)
        return PlatformLink(runs, commands, still).with_timing(self.timing)

    def smoothing(self, effects: Effects) -> float:
        return smoothed(self.timing_with(effects).before / self.tick)

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """(N, 6) uncertainty of where a platform jumps, bends or stops.

        With stiction: its change in rows whose jump may have come sooner or later. Where its input
        is stamped between rows: what interpolation cuts off its bend, which is most half way. None
        otherwise.
        """
        if any(isinstance(e, PlatformFriction) for e in effects):
            late = [PlatformDelay.hypothesis({}, delay=d * self.tick) for d in (-JUMP, JUMP)]
            early, after = self.predict([(i, [*effects, d]) for d in late])
            return np.abs(after - early)
        part = abs(self.timing_with(effects).before / self.tick) % 1.0
        if not part:
            return None
        half = [Timing(delay=d * self.tick) for d in (-0.5, 0.5)]
        early, after, now = self.predict([*((i, [*effects, d]) for d in half), (i, effects)])
        return 4.0 * part * (1.0 - part) * np.abs(early + after - 2.0 * now)

    def paths(self, effects: Effects) -> list[Array]:
        """(N, 7) poses reached in each run, with the commanded attitude, as stamped."""
        reached = self._reached([(i, effects) for i in range(len(self.runs))])
        late = (self.timing.delay + self.timing.before) / self.tick
        return [poses_of(moved(r, late)) for r in reached]


def poses_of(flat: Array) -> Array:
    """(N, 7) poses of positions and small rotations (N, 6), the inverse of :func:`flat_pose`."""
    half = 0.5 * flat[:, 3:]
    w = np.sqrt(np.maximum(1.0 - np.sum(half * half, axis=1, keepdims=True), 0.0))
    return np.concatenate([flat[:, :3], half, w], axis=1)
