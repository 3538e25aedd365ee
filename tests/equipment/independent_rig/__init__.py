"""A second rig that shares no code with the simulation, as a source of data for testing the
diagnosis.

Two free bodies, platform, contact, sensor and compensator, implemented independently from their
definitions, with different sub-steps from the simulation; `closed_loop` is the tick. The mechanism
is a point on a plane, a bumper, probe and cone, or a latch, rigid or on a compliant mount. Every
effect of the vocabulary can be hidden in it, alone and in combination, and so can foreign effects,
which are outside the vocabulary.

    rng = np.random.default_rng(7)
    hidden = draw_set(rng, "single")  # healthy | single | pair | triple | foreign | alike
    hidden = draw_set(rng, "pair", names=("contact.preload", "sensor.hum"), design="docking")
    hidden = draw_set(rng, "healthy", noise=("coloured", 0.1), nuisances=draw_nuisances(rng))
    write_set("folder", hidden)  # nominal.yaml, dataset.yaml, run_0.parquet ... run_5.parquet
    hidden.effects, hidden.links, hidden.strengths  # the truth; strengths relative to the noise

Contact and sensor (and the frame) affect the same records, pose_act and wrench_meas: either is a
right link for an effect of the other.

One run by hand:

    rig = nominal_rig(scenario)  # or docking_rig(scenario)
    rig = with_effect(rig, {"kind": "contact.preload", "force": 12.0})
    # no noise; pose_cmd=..., wrench_comp=... cut the loop
    records = simulate(rig, silence(rig.ticks))
"""

from tests.equipment.independent_rig.closed_loop import simulate
from tests.equipment.independent_rig.docking_facility import DockingFacility, draw_docking_facility
from tests.equipment.independent_rig.facility import Facility, draw_facility
from tests.equipment.independent_rig.foreign import FOREIGN, foreign_in
from tests.equipment.independent_rig.generation import PLAIN, link_of, rig_of, with_effect
from tests.equipment.independent_rig.hidden import EFFECTS
from tests.equipment.independent_rig.links import silence
from tests.equipment.independent_rig.log import Log, write_set
from tests.equipment.independent_rig.look_alikes import LOOK_ALIKES, draw_look_alike
from tests.equipment.independent_rig.noise_kinds import NOISE_KINDS
from tests.equipment.independent_rig.nuisances import Nuisances, draw_nuisances
from tests.equipment.independent_rig.rig import docking_rig, nominal_rig, overridden
from tests.equipment.independent_rig.sets import HiddenSet, acting_in, draw_effects, draw_set
from tests.equipment.independent_rig.sizes import DOCKING_SIZES, NEEDS, SIZES, alike

__all__ = [
    "DOCKING_SIZES",
    "EFFECTS",
    "FOREIGN",
    "LOOK_ALIKES",
    "NEEDS",
    "NOISE_KINDS",
    "PLAIN",
    "SIZES",
    "DockingFacility",
    "Facility",
    "HiddenSet",
    "Log",
    "Nuisances",
    "acting_in",
    "alike",
    "docking_rig",
    "draw_docking_facility",
    "draw_effects",
    "draw_facility",
    "draw_look_alike",
    "draw_nuisances",
    "draw_set",
    "foreign_in",
    "link_of",
    "nominal_rig",
    "overridden",
    "rig_of",
    "silence",
    "simulate",
    "with_effect",
    "write_set",
]
