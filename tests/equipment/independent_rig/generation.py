"""Generates the records and logs of a facility's runs, with hidden effects and the facility's way
of computing; and the strength of an effect in them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig.closed_loop import simulate
from tests.equipment.independent_rig.docking_facility import SIX
from tests.equipment.independent_rig.facility import Facility
from tests.equipment.independent_rig.foreign import FOREIGN, IN_DOCKING
from tests.equipment.independent_rig.hidden import EFFECTS, changed
from tests.equipment.independent_rig.links import Noise, Records, Rig, silence
from tests.equipment.independent_rig.log import Log, log_of
from tests.equipment.independent_rig.noise_kinds import NOISE_KINDS
from tests.equipment.independent_rig.nuisances import PLAIN as AS_TODAY
from tests.equipment.independent_rig.nuisances import Nuisances, restamped, with_nuisances
from tests.equipment.independent_rig.rig import docking_rig, nominal_rig, overridden, with_held

# links of effects whose family has another name
LINKS = {"frame": "contact", "loop": "compensation"}
PLAIN = {"coarse": False, "quiet_zone": False, "lever": 1.0, "frame_rate": 0.0, "mode_read": False}
# largest force over the expected peak: above it the set is unstable and cannot be diagnosed
MOST_OVERLOAD = 2.5
LEAST_LOAD = 0.2  # smallest likewise
ALL_FOREIGN = FOREIGN | IN_DOCKING
MODEL_NOISE = 2e-6  # m, reference for pose_cmd, which is computed and has no noise
RUNS = (1, 3, 4)  # runs that are evaluated


def link_of(kind: str) -> str:
    """The link of the loop that an effect, of the vocabulary or foreign, belongs to."""
    if kind in ALL_FOREIGN:
        return ALL_FOREIGN[kind].link
    family = kind.split(".")[0]
    return LINKS.get(family, family)


def with_effect(rig: Rig, effect: dict[str, Any], run: int = 0) -> Rig:
    """The rig of a run with an effect of the vocabulary or a foreign one in it."""
    given = {name: value for name, value in effect.items() if name != "kind"}
    if effect["kind"] in ALL_FOREIGN:
        return with_held(ALL_FOREIGN[effect["kind"]].apply(rig, given | {"run": run}))
    return with_held(EFFECTS[effect["kind"]](rig, given))


def rig_of(
    facility: Facility,
    run: int,
    effects: list[dict[str, Any]],
    variants: dict[str, Any],
    nuisances: Nuisances = AS_TODAY,
) -> Rig:
    """The rig of a run of the facility."""
    scenario = overridden(facility.scenario, facility.runs[run])
    rig = docking_rig(scenario) if SIX in facility.design else nominal_rig(scenario)
    rig = changed(rig, "platform", coarse=variants["coarse"])
    rig = changed(rig, "sensor", quiet_zone=variants["quiet_zone"])
    of_contact = {name: variants[name] for name in ("lever", "frame_rate", "mode_read")}
    rig = changed(rig, "contact", **of_contact)
    for effect in effects:
        rig = with_effect(rig, effect, run)
    return with_held(with_nuisances(rig, nuisances))


def draw_variants(rng: Generator) -> dict[str, Any]:
    """Random interpretations of the definitions.

    coarse: the platform's filters advance by semi-implicit Euler in each sub-step, not exactly.
    quiet_zone: noise is added after the dead zone and the saturation of the sensor.
    lever: the force acts at the tip (1) or at the undeformed surface (0).
    frame_rate: a compliant frame reduces the forces of spring and damper equally (0), that of the
        damper twice (1) or not at all (-1).
    mode_read: the sensor is below the vibrating mass.
    """
    return {
        "coarse": bool(rng.random() < 0.5),
        "quiet_zone": bool(rng.random() < 0.3),
        "lever": float(rng.choice([0.0, 0.5, 1.0])),
        "frame_rate": float(rng.choice([0.0, 0.0, 1.0, -1.0])),
        "mode_read": bool(rng.random() < 0.5),
    }


def sigma_of(facility: Facility) -> np.ndarray:
    """(6,) standard deviation of the facility's white noise [N, N m]."""
    return np.array([facility.noise] * 3 + [facility.torque_noise] * 3)


def draw_noise(rng: Generator, facility: Facility, ticks: int) -> Noise:
    """White noise for a run of the facility."""
    scale = sigma_of(facility)
    pose = np.array([facility.pose_noise] * 3 + [facility.turn_noise] * 3)
    reading, still = rng.standard_normal((ticks, 6)) * scale, rng.standard_normal((ticks, 6)) * pose
    return Noise(reading, still, rng.standard_normal(ticks), rng.random(ticks))


def record(
    rng: Generator,
    facility: Facility,
    rigs: list[Rig],
    nuisances: Nuisances,
    noise: tuple[str, float] | None,
) -> tuple[list[Records], list[Log]]:
    """Records of all runs in closed loop, and the facility's logs of them, with `noise`."""
    runs = [_simulated(rng, facility, i, rig, noise) for i, rig in enumerate(rigs)]
    runs = [restamped(records, nuisances.stamps) for records in runs]
    rate = facility.scenario["rate"]
    logs = [log_of(records, rate, sigma_of(facility), i) for i, records in enumerate(runs)]
    if noise is not None and NOISE_KINDS[noise[0]].place == "log":
        logs = [NOISE_KINDS[noise[0]](log, noise[1], rng) for log in logs]
    return runs, logs


def _simulated(
    rng: Generator, facility: Facility, run: int, rig: Rig, noise: tuple[str, float] | None
) -> Records:
    """A run with noise in the loop; what depends on the reading is drawn from one without noise."""
    drawn = draw_noise(rng, facility, rig.ticks)
    if noise is None or NOISE_KINDS[noise[0]].place == "log":
        return simulate(rig, drawn)
    kind, strength = noise
    # quantisation in the sensor itself, so that every reading is quantised
    if kind == "converter_steps":
        return simulate(rig._replace(sensor=rig.sensor._replace(quantum=strength)), drawn)
    quiet = drawn._replace(reading=np.zeros_like(drawn.reading))
    clean = simulate(rig, quiet)
    log = log_of(clean._replace(wrench_meas=clean.used), rig.rate, sigma_of(facility), run)
    noisy = NOISE_KINDS[kind](log, strength, rng)
    return simulate(rig, drawn._replace(reading=noisy.wrench_meas - log.wrench_meas))


def stable(facility: Facility, runs: list[Records]) -> bool:
    """Whether a facility would have accepted the set: finite, with forces of the expected size."""
    axes = slice(0 if SIX in facility.design else 2, 3)
    for run, records in enumerate(runs):
        expected, force = facility.expected_peak(run), np.abs(records.physical[:, axes]).max()
        finite = np.all(np.isfinite(records.pose_cmd))
        if not (finite and LEAST_LOAD * expected <= force <= MOST_OVERLOAD * expected):
            return False
    return True


def strength(
    facility: Facility, effects: list[dict[str, Any]], which: int, variants: dict[str, Any]
) -> float:
    """Size of effect `which` relative to the noise in its link's records, in the run where it is
    largest; see `HiddenSet`.
    """
    rest = [e for i, e in enumerate(effects) if i != which]
    return max(
        _strength(facility, run, effects, rest, link_of(effects[which]["kind"]), variants)
        for run in RUNS
    )


def _strength(
    facility: Facility, run: int, effects: list, rest: list, link: str, variants: dict[str, Any]
) -> float:
    without, full = (rig_of(facility, run, e, variants) for e in (rest, effects))
    drawn = draw_noise(np.random.default_rng(run), facility, full.ticks)
    quiet = silence(full.ticks)._replace(delay=drawn.delay, repeat=drawn.repeat)
    plain = simulate(without, quiet)
    cut = simulate(full, quiet, pose_cmd=plain.pose_cmd, wrench_comp=plain.wrench_comp)
    forces = sigma_of(facility)
    if link == "platform":
        change = (cut.pose_act - plain.pose_act)[:, :3] / facility.pose_noise
    elif link == "dynamics":
        change = (cut.pose_cmd - plain.pose_cmd)[:, :3] / MODEL_NOISE
    elif link == "compensation":
        comp = full.compensator  # by whose lead the noise of a row is amplified
        lead = (comp.t1 * full.rate + 1.0) / (comp.t2 * full.rate + 1.0)
        change = (cut.wrench_comp - plain.wrench_comp) / forces / lead
    else:
        change = (cut.wrench_meas - plain.wrench_meas) / forces
    on = plain.touching | cut.touching
    return float(np.sqrt(np.max(np.mean(change[on] ** 2, axis=0)))) if on.any() else 0.0
