"""Stage "replay": the link platform: pose_cmd to pose_act."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links.base import (
    Effects,
    Lane,
    LinkRun,
    ModelLink,
    flat_channels,
    flat_pose,
    moved,
    padded,
    perturbed,
)
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state, approach_states
from hiltestbed.platform.effects.response import PlatformDelay
from hiltestbed.platform.effects.tracking import PlatformFriction
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.replay import replay_platform

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
        starts = [approach_state(r.scenario.approach)[None, :7] for r in runs]
        self._attitude = [
            flat_pose(np.concatenate([s, c[:-1]]))[:, 3:]
            for s, c in zip(starts, commands, strict=True)
        ]

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        pairs = zip(self._reached(lanes), lanes, strict=True)
        return [moved(p, self.timing_with(own).delay / self.tick) for p, (_, own) in pairs]

    def _reached(self, lanes: Sequence[Lane]) -> list[Array]:
        """(N, 6) of each lane, what the platform reaches on its commands as they are stamped."""
        out = []
        for place, (i, effects) in zip(self._places(lanes), lanes, strict=True):
            turned = moved(self._attitude[i], self.timing_with(effects).obeyed / self.tick)
            pose = np.concatenate([place[: self.runs[i].rows], turned], axis=1)
            out.append(pose + self.deflection[i])
        return out

    def _places(self, lanes: Sequence[Lane]) -> Array:
        """(L, N, 3) positions [m] that are reached in each lane, without the deflection."""
        run = np.array([i for i, _ in lanes])
        scenarios = [self.runs[i].scenario for i in run]
        believed = [PlatformParameters(s.tick) for s in scenarios]
        parameters = [p.with_effects(own) for p, (_, own) in zip(believed, lanes, strict=True)]
        obeyed = np.array([self.timing_with(effects).obeyed for _, effects in lanes])
        start = approach_states(s.approach for s in scenarios)
        substeps = [s.substeps for s in scenarios]
        return replay_platform(parameters, start, substeps, self._padded, run, obeyed)

    def _with_errors(self, i: int) -> PlatformLink:
        commands = perturbed(self.commands[i], self.rounding[i])
        runs, still = [self.runs[i]] * len(commands), [self.deflection[i]] * len(commands)
        return PlatformLink(runs, commands, still).with_timing(self.timing)

    def with_open_commands(self, changes: Sequence[Array]) -> PlatformLink:
        """The same link on commands that may differ by ``changes`` (N, 6, D) of each run [m, rad],
        one standard deviation each.
        """
        own, terms = self.shown_in_all(), [np.zeros_like(c) for c in changes]
        for d in range(changes[0].shape[2]):
            pairs = zip(self.commands, changes, strict=True)
            other = [poses_of(flat_pose(pose) + c[:, :, d]) for pose, c in pairs]
            shown = PlatformLink(self.runs, other, self.deflection).shown_in_all()
            for term, a, b in zip(terms, shown, own, strict=True):
                term[:, :, d] = a - b
        runs = [r.with_nuisances(t) for r, t in zip(self.runs, terms, strict=True)]
        return PlatformLink(runs, self.commands, self.deflection)

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """(N, 6) uncertainty of where a platform with stiction jumps: its change in rows whose jump
        may have come sooner or later. None without stiction.
        """
        if not any(isinstance(e, PlatformFriction) for e in effects):
            return None
        late = [PlatformDelay.hypothesis({}, delay=d * self.tick) for d in (-JUMP, JUMP)]
        early, after = self.predict([(i, [*effects, d]) for d in late])
        return np.abs(after - early)

    def paths(self, effects: Effects) -> list[Array]:
        """(N, 7) poses reached in each run, with the commanded attitude, as stamped."""
        reached = self._reached([(i, effects) for i in range(len(self.runs))])
        late = self.timing.delay / self.tick
        return [poses_of(moved(r, late)) for r in reached]


def poses_of(flat: Array) -> Array:
    """(N, 7) poses of positions and small rotations (N, 6), the inverse of :func:`flat_pose`."""
    half = 0.5 * flat[:, 3:]
    w = np.sqrt(np.maximum(1.0 - np.sum(half * half, axis=1, keepdims=True), 0.0))
    return np.concatenate([flat[:, :3], half, w], axis=1)
