"""The law of an axis along a motion, against what it must keep."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.axis import servo
from hiltestbed.axis.law import FORCE, PLAY, SHAPE, STIFFNESS, AxisLaw
from hiltestbed.axis.models import START_ROWS, along
from hiltestbed.axis.motion import motion_of

SLIP = 100.0  # [N] of the sliders


def slider(play: float = 0.0, shape: float = 0.0) -> AxisLaw:
    """One slider of 5e4 N/m beside a spring."""
    law = AxisLaw(spring=300.0)
    law.numbers[PLAY] = play
    law.sliders[0, [FORCE, STIFFNESS, SHAPE]] = SLIP, 5e4, shape
    return law


@pytest.mark.parametrize("law", [slider(), slider(play=0.004), slider(shape=2.0)])
def test_a_record_that_begins_in_motion_goes_on_where_the_whole_one_does(law):
    t = np.linspace(0.0, 3.0, 3001)
    motion = motion_of(t, 0.02 * np.sin(2.0 * np.pi * t) + 0.005 * np.sin(8.0 * t))
    whole = along(motion, law)
    missed = []  # by sliders that are unbent at first
    for row in (300, 777, 1500, 2222):
        rest = slice(row, None)
        missed.append(np.abs(along(motion.thinned(rest), law) - whole[rest]).max())
        first = whole[rest][:START_ROWS]
        if np.ptp(first - 300.0 * motion.x[rest][:START_ROWS]) < 1e-9:
            continue  # all of these rows are within the play: they do not say where
        cut = along(motion.thinned(rest), law, first)
        np.testing.assert_allclose(cut, whole[rest], atol=0.02 * SLIP)
    assert max(missed) > 0.5 * SLIP


def test_several_sliders_share_the_force_of_a_first_stroke():
    law = AxisLaw()
    law.sliders[:2] = [[SLIP, 5e4, 0.0], [60.0, 1e4, 0.0]]
    t = np.linspace(0.0, 1.0, 2001)
    # one stroke, in which the stiff slider slips and the soft one does not, and back
    motion = motion_of(t, 0.004 * np.sin(np.pi * t))
    whole = along(motion, law)
    for row in (200, 600, 900):
        cut = along(motion.thinned(slice(row, None)), law, whole[row : row + START_ROWS])
        np.testing.assert_allclose(cut, whole[row:], atol=0.02 * SLIP)


@pytest.mark.parametrize("numbers", [{servo.SPEED: 0.5}, {servo.POLE: 0.4}])
def test_a_record_of_a_servo_may_begin_on_the_way_to_its_command(numbers):
    p = servo.following()
    for place, value in numbers.items():
        p[place] = value
    t = np.arange(300) / 100.0
    u = np.where(t < 0.5, 0.0, 1.0)
    whole = servo.response(t, u, 0.0, p, 1e-2)
    cut = servo.response(t[90:], u[90:], whole[90], p, 1e-2)
    assert 0.1 < whole[90] < 0.9
    np.testing.assert_allclose(cut, whole[90:], atol=1e-12)
