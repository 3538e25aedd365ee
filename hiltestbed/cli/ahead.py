"""Compiles, in a background process, the kernels that a first run needs later.

The first run after an install compiles its blocks in the order in which a tick calls them, on one
core. The identification and the recording of figures and rows do not depend on the blocks before
them, so a second core can compile them meanwhile; Numba then
finds them on disk. Nothing waits for this process: the run itself compiles whatever is still
missing.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.compiled.warm import compiled, cores

if TYPE_CHECKING:
    from hiltestbed.loop import Side
    from hiltestbed.scenario import Scenario

# referenced: Python warns if a Popen is garbage-collected while its process runs
_running: list[subprocess.Popen[bytes]] = []


def begin(scenario: Path, sets: list[str] | None, case: int | None) -> None:
    """Start the process for the arguments of `run`, unless the kernels are compiled already or
    there is only one core.
    """
    if compiled() or cores() < 2:
        return
    with contextlib.suppress(OSError):
        order = [sys.executable, "-m", __name__]
        process = subprocess.Popen(
            order, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        assert process.stdin is not None
        process.stdin.write(json.dumps([str(scenario), sets, case]).encode())
        process.stdin.close()
        _running.append(process)


def compile_later_blocks(scenario: Scenario) -> None:
    """Call the blocks of a loop that do not depend on its rig, then the recording's, and the
    measurement of the rig that follows a run.

    The identification takes longest and comes first: it is done when the run reaches it. The loop
    itself comes last, since the run compiles the start of its numerical model meanwhile.
    """
    from hiltestbed.analysis.rig_response import measured_response
    from hiltestbed.identification.settings import IDENTIFIERS
    from hiltestbed.loop import Loop
    from hiltestbed.signals import Trace
    from hiltestbed.viewer.spacecraft import place_chaser

    sensor, rig, safety = side = _no_rig([scenario])
    if estimate := IDENTIFIERS[scenario.identification.kind].start([scenario]):
        estimate.source.captured = rig.captured
        estimate.update(sensor.reading, rig.pose_act, rig.twist_act)
    place_chaser(np.zeros((1, 7)), np.zeros((2, 7)), np.zeros((1, 7)), np.zeros((1, 7)))
    safety.passed(rig, rig.pose_act.copy(), np.zeros(1))
    loop = Loop([scenario], side=lambda scenarios, nthread: side)
    loop._kept(Trace(1, 1, scenario.rate, rig.units))(0)
    measured_response(scenario)


def _no_rig(scenarios: Sequence[Scenario]) -> Side:
    """Static arrays with the shapes and types of a rig's."""
    from hiltestbed.sensor.sensor import Sensor
    from hiltestbed.supervision.safety import Safety

    wrench, pose, twist, joints, no = (
        np.zeros(shape) for shape in ((1, 2, 6), (1, 7), (1, 6), (1, 3), (1,))
    )
    rig: Any = SimpleNamespace(
        pose_act=pose,
        pose_W=pose,
        twist_act=twist,
        wrench_sub=wrench,
        contact=no > 0.0,
        captured=no > 0.0,
        diverged=no > 0.0,
        slider_cmd=joints,
        slider_act=joints.copy(),
        upper_cmd=joints.copy(),
        upper_act=joints.copy(),
        units=("m",) * 3,
        phases=None,
        physical=False,
        reset=lambda pose, twist: None,
        joint_limit_passed=lambda: False,
    )
    return (
        Sensor(scenarios, [np.random.default_rng(s.seed) for s in scenarios]),
        rig,
        Safety(scenarios),
    )


def main() -> None:
    """Entry point. The check of the parts' relative position at the start is skipped: its kernels
    are compiled, and the run does it.
    """
    from hiltestbed.cli.options import read_scenario
    from hiltestbed.contact import findings

    findings.faults = lambda scenario: ()
    scenario, sets, case = json.load(sys.stdin)
    compile_later_blocks(read_scenario(Path(scenario), sets, case))


if __name__ == "__main__":
    main()
