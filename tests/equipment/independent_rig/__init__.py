"""A second rig that shares no code with the simulation, as a source of data for testing the
diagnosis.

Two free bodies, platform, contact, sensor and compensator, implemented independently from their
definitions, with different sub-steps from
the simulation: `closed_loop` is the tick of a tip on a plane (three axes), `six_axes` that of probe
and cone, bumper or latch, rigid or on a compliant mount. Every effect of the vocabulary can be
hidden in it, alone and in combination, and so can foreign effects, which are outside the
vocabulary.

    rng = np.random.default_rng(7) hidden = draw_set(rng, "single")                        # healthy
    | single | pair | triple | foreign | alike hidden = draw_set(rng, "pair",
    names=("contact.preload", "sensor.hum")) hidden = draw_set(rng, "single",
    names=("sensor.delay",), scale=0.2)      # how small can it be? hidden = draw_set(rng, "single",
    design="docking")      # bumper | docking | mounted (on a compliant mount) | held (by a latch)
    hidden = draw_set(rng, "healthy", noise=("coloured", 0.1), nuisances=draw_nuisances(rng),
    compensation="smith_predictor") hidden = draw_set(rng, "alike", pair=("sensor.delay",
    "contact.damping"))  # the first hidden, the other in `hidden.rival` write_set("folder", hidden)
    # nominal.yaml, dataset.yaml, run_0.parquet ... run_5.parquet hidden.effects, hidden.links,
    hidden.strengths          # the truth; `write_set(..., truth=True)` writes truth.yaml too

`acting_in(design)` lists the effects that can be hidden in a design, `foreign_in(design)` the
foreign effects, `NOISE_KINDS` the kinds of noise and their strengths, `LOOK_ALIKES` the pairs,
`METHODS` the compensation methods, `Nuisances` the choices of a facility in its computations; by
default sets are those of the plain rig with white noise.

Contact and sensor (and the frame) affect the same records, pose_act and wrench_meas: either is a
right link for an effect of the other. `hidden.strengths` gives the size of each effect relative to
the noise of its link's records: drawn sets (scale 1) have at least 3. `hidden.variants` lists how
the rig interprets what the definitions leave open (`draw_variants`); `literal=True` uses the plain
ones.

One run by hand:

    rig = nominal_rig(scenario)  # or docking_rig(scenario)
    rig = with_effect(rig, {"kind": "contact.preload", "force": 12.0})
    # no noise; pose_cmd=..., wrench_comp=... cut the loop
    records = simulate(rig, silence(rig.ticks))
"""

from tests.equipment.independent_rig.closed_loop import simulate
from tests.equipment.independent_rig.compensation import METHODS
from tests.equipment.independent_rig.docking_facility import DockingFacility, draw_docking_facility
from tests.equipment.independent_rig.facility import Facility, draw_facility
from tests.equipment.independent_rig.foreign import FOREIGN, foreign_in
from tests.equipment.independent_rig.hidden import EFFECTS
from tests.equipment.independent_rig.links import Noise, Records, Rig, silence
from tests.equipment.independent_rig.log import Log, log_of, write_set
from tests.equipment.independent_rig.look_alikes import LOOK_ALIKES, draw_look_alike
from tests.equipment.independent_rig.noise_kinds import NOISE_KINDS, NoiseKind
from tests.equipment.independent_rig.nuisances import Nuisances, draw_nuisances, with_nuisances
from tests.equipment.independent_rig.rig import docking_rig, nominal_rig, overridden
from tests.equipment.independent_rig.sets import (
    HiddenSet,
    acting_in,
    draw_effects,
    draw_noise,
    draw_set,
    generate,
    link_of,
    strength,
    with_effect,
)
from tests.equipment.independent_rig.sizes import SIZES, alike

__all__ = [
    "EFFECTS",
    "FOREIGN",
    "LOOK_ALIKES",
    "METHODS",
    "NOISE_KINDS",
    "SIZES",
    "DockingFacility",
    "Facility",
    "HiddenSet",
    "Log",
    "Noise",
    "NoiseKind",
    "Nuisances",
    "Records",
    "Rig",
    "acting_in",
    "alike",
    "docking_rig",
    "draw_docking_facility",
    "draw_effects",
    "draw_facility",
    "draw_look_alike",
    "draw_noise",
    "draw_nuisances",
    "draw_set",
    "foreign_in",
    "generate",
    "link_of",
    "log_of",
    "nominal_rig",
    "overridden",
    "silence",
    "simulate",
    "strength",
    "with_effect",
    "with_nuisances",
    "write_set",
]
