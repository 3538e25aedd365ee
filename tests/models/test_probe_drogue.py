"""The probe with a latching head on its attenuator, and the drogue."""

from __future__ import annotations

import math

import pytest

from hiltestbed.contact.surfaces.surface import TURNED
from tests.models.rig import Rig


def test_the_drogue_is_the_funnel_of_its_dimensions() -> None:
    rig = Rig("probe_drogue")
    surface = rig.facets[0].surface
    assert surface.kind == TURNED
    arcs = surface.profile[surface.profile[:, 0] == 1.0][:, 9]
    assert sorted(arcs) == pytest.approx([0.01, 0.045], abs=1e-7)


def test_the_brake_holds_the_rod_until_it_slips() -> None:
    """Friction of 40 N in the stroke: 30 N leave it where it is, 60 N move it."""
    rig = Rig("probe_drogue")
    for force, moves in ((30.0, False), (60.0, True)):
        rig.start(0.5)
        rig.ctrl[:] = -force
        rig.run(0.3, phases=False)
        stroke = rig.qpos[rig.model.joint("active_stroke").qposadr[0]]
        assert (stroke < -1e-3) == moves


def test_a_head_that_misses_the_mouth_is_turned_away() -> None:
    """The mouth's radius is 0.38 m: at 0.45 m aside the head does not even touch the inside."""
    rig = Rig("probe_drogue", timestep=5e-4)
    rig.start(0.25, (0.0, 0.0, 0.1), (0.45 * math.cos(0.3), 0.45 * math.sin(0.3)))
    rig.run(4.0)
    assert rig.done == []
