"""A mechanism is the same however its MJCF divides it into bodies: geoms and ports in child bodies
without joints, at any depth, beyond joints, on either side.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import simulate

pytestmark = pytest.mark.usefixtures("in_this_process")

INERTIA = '<inertial pos="0 0 0.05" mass="10" diaginertia="0.2 0.2 0.1"/>'
PART = '<inertial pos="0 0 0" mass="3" diaginertia="0.02 0.02 0.01"/>'
STROKE = '<joint type="slide" axis="0 0 1" stiffness="20000" damping="100"/>'
# a hexagonal cup, concave: the ball meets its floor or its wall
CUP = [
    (np.cos(a) * r, np.sin(a) * r, z)
    for r, z in ((0.10, 0.0), (0.12, -0.04), (0.16, -0.04), (0.16, 0.05))
    for a in np.arange(6) * np.pi / 3
]
SURFACES = {  # in the port's frame, its face at z = 0 near the ball
    "sphere": 'type="sphere" size="0.3" pos="0.01 0 0.3"',
    "capsule": 'type="capsule" size="0.1 0.2" pos="0 0 0.1" euler="0 90 0"',
    "box": 'type="box" size="0.2 0.2 0.01" pos="0 0 0.01"',
    "cylinder": 'type="cylinder" size="0.2 0.01" pos="0 0 0.01"',
    "ellipsoid": 'type="ellipsoid" size="0.3 0.2 0.1" pos="0 0 0.1"',
    "mesh": 'type="mesh" mesh="cup"',
}
BALL = 'type="sphere" size="0.05" pos="0 0 -0.05"'
ROD = 'type="capsule" size="0.03 0.05" pos="0 0 -0.0387" euler="0 80 0"'
BRICK = 'type="box" size="0.03 0.03 0.03" pos="0.03 0 -0.03"'


def cup() -> str:
    ring = [range(6 * k, 6 * k + 6) for k in range(4)]
    vertices = [*CUP, (0.0, 0.0, 0.0), (0.0, 0.0, 0.05)]
    faces = []
    for low, high in pairwise(ring):
        for k in range(6):
            a, b, c, d = low[k], low[(k + 1) % 6], high[(k + 1) % 6], high[k]
            faces += [(a, c, b), (a, d, c)]
    for k in range(6):
        faces += [(24, ring[0][k], ring[0][(k + 1) % 6]), (25, ring[3][(k + 1) % 6], ring[3][k])]
    faces = [(a, c, b) for a, b, c in faces]
    return "".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces
    )


def nested(content: str, depth: int) -> str:
    """The elements ``content`` at the same place, in as many bodies in each other, each turned."""
    place, turn = np.zeros(3), Rotation.identity()
    opened = ""
    for k in range(depth):
        step, bend = np.array([0.02, -0.03, 0.04 + 0.01 * k]), Rotation.from_rotvec([0.4, 0.2, -k])
        q = bend.as_quat()[[3, 0, 1, 2]]
        opened += f'<body pos="{words(step)}" quat="{words(q)}" gravcomp="1">'
        place, turn = place + turn.apply(step), turn * bend
    back = turn.inv()
    q = back.as_quat()[[3, 0, 1, 2]]
    frame = f'<frame pos="{words(-back.apply(place))}" quat="{words(q)}">'
    return f"{opened}{frame}{content}</frame>{'</body>' * depth}"


def words(numbers: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def side(port: str, geom: str, moves: bool, depth: int) -> str:
    """One side: its geom, on a part that moves if ``moves``, ``depth`` bodies deep, and its port."""
    content = f'<geom name="touching" mass="0" {geom}/><site name="hold" pos="0.01 0 0.02"/>'
    touching = nested(content, depth)
    if moves:
        touching = f'<body name="part" gravcomp="1">{PART}{STROKE}{touching}</body>'
    site = nested(f'<site name="{port}"/>', depth // 2)  # not in the body of the geom
    return (
        '<mujoco><asset><mesh name="cup" file="cup.obj"/></asset><worldbody>'
        f'<body name="side">{INERTIA}{touching}{site}</body></worldbody></mujoco>'
    )


SCENARIO = """name: tree
duration: 0.24
rate: 1000
physics_rate: 4000
spacecraft:
  chaser: {{mass: 80, inertia: [30, 30, 25], port: {{position: [0, 0, 1.0]}}}}
  target: {{mass: 300, inertia: [150, 150, 120], port: {{position: [0, 0, -1.2]}}}}
approach: {{gap: 0.002, velocity: [0.01, 0, 0.05], offset: [0.004, 0.003]}}
mechanism:
  kind: mjcf
  active: active.xml
  passive: passive.xml
  pairs: [{{active: touching, passive: touching, stiffness: 1.0e5, damping: 100, friction: {0}}}]
rig: {{platform: {{tracking: ideal}}}}
compensation: {{force: {{kind: none}}}}
"""


CAPTURE = """  capture:
    - name: hold
      when: {{pairs: [[hold, hold]], within: 0.1, speed: 1.0, lasting: 0.05}}
      close: {{kind: {0}, active: hold, passive: hold, stiffness: 5.0e4, damping: 300.0{1}}}
"""


def written(
    folder: Path,
    active: str,
    passive: str,
    moves: str,
    depth: int,
    capture: str = "",
) -> Scenario:
    folder.mkdir(exist_ok=True)
    (folder / "cup.obj").write_text(cup())
    (folder / "active.xml").write_text(side("A", active, "A" in moves, depth))
    (folder / "passive.xml").write_text(side("P", passive, "P" in moves, depth))
    (folder / "mine.yaml").write_text(SCENARIO.format(0.1).replace("rig:", f"{capture}rig:"))
    return load_scenario(folder / "mine.yaml")


CASES = [
    *((BALL, surface, "") for surface in ("sphere", "capsule", "ellipsoid")),
    (BALL, "mesh", "A"),
    (BALL, "cylinder", "P"),
    (ROD, "cylinder", "A"),
    (ROD, "mesh", ""),
    (BRICK, "box", ""),
]


@pytest.mark.parametrize(("active", "surface", "moves"), CASES)
def test_flat_and_nested_are_one_mechanism(
    tmp_path: Path, active: str, surface: str, moves: str
) -> None:
    """To 1e-9 of the peak; ``moves``: sides whose geom is on a part that moves."""
    peak = same_trace(tmp_path, active, SURFACES[surface], moves)
    assert 20.0 < peak < 2.0 * 0.05 * np.sqrt(1.0e5 * 63.2)


@pytest.mark.parametrize(
    ("closure", "moves"),
    [(("weld", ", radius: 0.1"), "A"), (("connect", ""), "P"), (("connect", ""), "")],
)
def test_a_latch_holds_sites_of_child_bodies(
    tmp_path: Path, closure: tuple[str, str], moves: str
) -> None:
    """To 1e-6 of the peak: contacts and a latch at once are solved iteratively."""
    capture = CAPTURE.format(*closure)
    same_trace(tmp_path, BALL, SURFACES["box"], moves, capture, within=1e-6)


def same_trace(folder: Path, *what: object, within: float = 1e-9) -> float:
    """The peak of the wrench [N, N m] of a mechanism, the same written flat and nested."""
    active, passive, moves, *capture = what
    traces = []
    for depth in (0, 2):
        place = folder / str(depth)
        scenario = written(place, active, passive, moves, depth, *capture)  # type: ignore[arg-type]
        batch = simulate([scenario], trace=True)
        assert not batch.trouble
        traces.append(batch.trace.run(0)["wrench_true"])
    peak = float(np.abs(traces[0]).max())
    np.testing.assert_allclose(traces[1], traces[0], rtol=0.0, atol=within * peak)
    return peak
