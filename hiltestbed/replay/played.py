"""Contacts whose wrench does not follow from the pose of A in P alone, exerted along recorded paths by the physics itself.

Parts that move on their side, phases of a capture and pairs that MuJoCo collides have no closed form. The sides are carried along the
path as under ideal tracking (:mod:`hiltestbed.platform.ideal`), from the first row on, under the law that a hypothesis asks for.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from hiltestbed.effects.base import Effect
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array, twist_between
from hiltestbed.platform.kinds import PLATFORMS
from hiltestbed.platform.plant import Plant, alike
from hiltestbed.platform.settings import Rig
from hiltestbed.replay.felt import Kept
from hiltestbed.scenario import Scenario

TOGETHER = 32  # lanes that are stepped in one batch


class Played:
    """Recorded paths, and the sides that are carried along them.

    Attributes:
        poses: (R, N, 7) of A in P at t_k. tick: [s]. substeps: instants of the physics a tick.
        kept: what contacts exerted in the latest replays.
    """

    def __init__(self, scenarios: Sequence[Scenario], poses: Array, before: Array) -> None:
        """``scenarios`` of the R runs, as believed; ``before``: (R, 7) the pose at t_(-1)."""
        self.poses, self._before = poses, before
        self.tick, self.substeps = scenarios[0].tick, scenarios[0].substeps
        self.kept = Kept()
        self._carried = [_carried(s) for s in scenarios]
        self._depths: dict[int, Array] = {}

    def instants(self, grid: int | None) -> int:
        """How many instants a tick are computed: those of the physics."""
        return self.substeps

    def exerted(self, wanted: Sequence[tuple[int, Sequence[Effect]]]) -> list[Array]:
        """(N, m, 6) of each run under effects what its contact exerts [N, N m] at the instants of the tick that ends at each row."""
        return [wrench for wrench, _ in self._play(wanted)]

    def depth(self, run: int) -> Array:
        """(N,) [m] of the deepest contact of a run at each row, as the mechanism is believed to be; negative while apart."""
        if run not in self._depths:
            self._depths[run] = self._play([(run, ())])[0][1]
        return self._depths[run]

    def _play(self, wanted: Sequence[tuple[int, Sequence[Effect]]]) -> list[tuple[Array, Array]]:
        """Wrenches (N, m, 6) and depths (N,) of each."""
        neutral = EFFECTS["contact.stiffness"].model_validate({"factor": 1.0})  # an effect at all has every contact written out
        scenarios = [self._carried[run].model_copy(update={"effects": (neutral, *effects)}) for run, effects in wanted]
        groups: dict[Hashable, list[int]] = {}
        for i, scenario in enumerate(scenarios):
            groups.setdefault(alike(scenario), []).append(i)
        out: dict[int, tuple[Array, Array]] = {}
        for members in groups.values():
            for first in range(0, len(members), TOGETHER):
                some = members[first : first + TOGETHER]
                played = self._together([wanted[i][0] for i in some], [scenarios[i] for i in some])
                out |= zip(some, zip(*played, strict=True), strict=True)
        return [out[i] for i in range(len(wanted))]

    def _together(self, runs: Sequence[int], scenarios: Sequence[Scenario]) -> tuple[Array, Array]:
        """(L, N, m, 6) and (L, N) of runs under scenarios that are ``alike``."""
        plant = Plant(scenarios)
        paths = np.ascontiguousarray(self.poses[list(runs)].swapaxes(0, 1))
        count, lanes = paths.shape[:2]
        wrench, depth = np.empty((lanes, count, self.substeps, 6)), np.full((lanes, count), -1.0)
        still, start = np.zeros((lanes, 6)), np.empty((lanes, 6))
        for i, run in enumerate(runs):
            twist_between(self._before[run], paths[0, i], self.tick, start[i])
        plant.reset(paths[0], start)
        met = plant.contacts().met
        for k in range(count):
            if k:
                plant.advance(paths[k], still, still)
            wrench[:, k] = plant.wrench_sub
            depth[:, k] = met[:, :, 0].max(axis=1, initial=-1.0)
        return wrench, depth


def _carried(scenario: Scenario) -> Scenario:
    """The scenario whose mechanism is carried along a path."""
    ideal = PLATFORMS["pss33"].model_validate({"kind": "pss33", "tracking": "ideal"})
    return scenario.model_copy(update={"rig": Rig(platform=ideal), "effects": ()})
