"""A sensor that is mounted turned: against an independent rotation, beside gain and crosstalk, and
told from a crosstalk.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.effects import EFFECTS
from hiltestbed.sensor.parameters import SensorParameters
from tests.diagnosis.made import contact_link, effect, explained

ANGLES = (4.0, -7.0, 12.0)
WRENCH = np.array([1.0, -2.0, 300.0, 4.0, 5.0, -6.0])
GAIN = {"kind": "sensor.gain", "axis": "z", "factor": 1.1}
LEAK = {"kind": "sensor.crosstalk", "source": "z", "axis": "x", "ratio": 0.05}
TURN = {"kind": "sensor.rotation", "angles_deg": ANGLES}


def shown(*effects: dict) -> np.ndarray:
    """(6,) what a sensor without delay makes of WRENCH."""
    made = [EFFECTS[e["kind"]](**e) for e in effects]
    return SensorParameters().with_effects(made).calibration @ WRENCH


def felt(*turns: tuple[float, float, float]) -> np.ndarray:
    """(6,) WRENCH in a frame turned by each rotation vector, about the believed axes."""
    frame = Rotation.identity()
    for turn in turns:
        frame = Rotation.from_rotvec(turn, degrees=True) * frame
    return np.concatenate([frame.inv().apply(WRENCH[:3]), frame.inv().apply(WRENCH[3:])])


def test_force_and_torque_are_read_along_the_turned_axes() -> None:
    assert shown(TURN) == pytest.approx(felt(ANGLES), abs=1e-12)
    assert np.linalg.norm(shown(TURN)[:3]) == pytest.approx(np.linalg.norm(WRENCH[:3]), rel=1e-14)


def test_a_second_turn_is_about_the_axes_that_are_believed() -> None:
    second = (0.0, 90.0, 0.0)
    assert shown(TURN, {"kind": "sensor.rotation", "angles_deg": second}) == pytest.approx(
        felt(ANGLES, second), abs=1e-12
    )


@pytest.mark.parametrize(
    "order",
    list(itertools.permutations((TURN, GAIN, LEAK))),
    ids=lambda order: "-".join(e["kind"].partition(".")[2] for e in order),
)
def test_turn_then_gain_then_crosstalk_whatever_the_order_of_the_effects(
    order: tuple[dict, ...],
) -> None:
    expected = felt(ANGLES)
    expected[2] *= GAIN["factor"]
    expected[0] += LEAK["ratio"] * expected[2]
    assert shown(*order) == pytest.approx(expected, abs=1e-12)


SOUGHT = ("sensor.rotation", "sensor.crosstalk", "sensor.gain")


def test_a_turn_about_a_lateral_axis_is_found_and_none_is_made_up_about_the_axis_of_the_load() -> (
    None
):
    found = explained(
        contact_link([effect("sensor.rotation", angles_deg=(2.0, -3.0, 0.0))]), *SOUGHT
    )
    assert found.kinds == ("sensor.rotation",)
    first, second = found.causes[0].estimates  # the third is no part of it
    assert first.low < 2.0 < first.high
    assert second.low < -3.0 < second.high


def test_a_crosstalk_is_no_turn() -> None:
    """One number goes before two, where a turn about y fits but for its cosine."""
    link = contact_link([effect("sensor.crosstalk", source="z", axis="x", ratio=0.005)])
    assert explained(link, *SOUGHT).kinds == ("sensor.crosstalk",)


def test_about_the_axis_of_the_load_a_turn_changes_nothing() -> None:
    residual = Residual(contact_link())
    turned = residual([effect("sensor.rotation", angles_deg=(0.0, 0.0, 8.0))])
    assert square(turned - residual(())) < 1e-20 * square(turned)
