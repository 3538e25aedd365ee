"""Sets of measured data with something hidden in them: drawn, generated, judged for strength, written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import Generator

from hiltestbed.bench.independent_rig.closed_loop import simulate
from hiltestbed.bench.independent_rig.links import Noise, Records, Rig, silence
from hiltestbed.bench.independent_rig.facility import Facility, draw_facility
from hiltestbed.bench.independent_rig.foreign import FOREIGN
from hiltestbed.bench.independent_rig.hidden import EFFECTS
from hiltestbed.bench.independent_rig.rig import nominal_rig, overridden
from hiltestbed.bench.independent_rig.sizes import NEEDS, SIZES, alike

Kind = Literal["healthy", "single", "pair", "foreign"]
POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
LINKS = {"frame": "contact", "loop": "compensation"}  # where the name of the effect is not that of its link
MODEL_NOISE = 2e-6  # m, what pose_cmd, which is computed, is measured by
MOST_OVERLOAD = 2.5  # a set whose force grows beyond this part of the expected peak is unstable, not diagnosable


@dataclass(frozen=True)
class HiddenSet:
    """A set and the truth about it.

    Attributes:
        kind: healthy, single, pair or foreign.
        effects: what is hidden, as in a scenario's `effects`; foreign ones have a kind `unknown.*`.
        links: of the effects, in their order.
        strengths: of the effects, in their order: rms of what the effect changes in its link's records during contact, in
            units of their noise, the loop cut before the link. Unobservable below some 0.3.
        variants: readings of the definitions, where they leave a choice: see `draw_set`.
        runs: the records of each run, with noise, in the order of the facility's runs.
    """

    kind: Kind
    facility: Facility
    effects: list[dict[str, Any]]
    links: list[str]
    strengths: list[float]
    variants: dict[str, Any]
    runs: list[Records] = field(repr=False)

    @property
    def truth(self) -> dict[str, Any]:
        """What `truth.yaml` holds."""
        weak = [e["kind"] for e, s in zip(self.effects, self.strengths, strict=True) if s < 0.3]
        return {
            "kind": self.kind, "effects": self.effects, "links": self.links, "strengths": self.strengths, "unobservable": weak,
            "variants": self.variants, "design": sorted(self.facility.design),
        }  # fmt: skip


def link_of(kind: str) -> str:
    """The link of the loop that an effect, of the vocabulary or foreign, belongs to."""
    if kind in FOREIGN:
        return FOREIGN[kind].link
    family = kind.split(".")[0]
    return LINKS.get(family, family)


def with_effect(rig: Rig, effect: dict[str, Any]) -> Rig:
    """The rig with an effect of the vocabulary or a foreign one in it."""
    given = {name: value for name, value in effect.items() if name != "kind"}
    return FOREIGN[effect["kind"]].apply(rig, given) if effect["kind"] in FOREIGN else EFFECTS[effect["kind"]](rig, given)


def rig_of(facility: Facility, run: int, effects: list[dict[str, Any]], variants: dict[str, Any]) -> Rig:
    """The rig of a run of the facility."""
    rig = nominal_rig(overridden(facility.scenario, facility.runs[run]))
    rig = rig._replace(
        platform=rig.platform._replace(coarse=variants["coarse"]),
        sensor=rig.sensor._replace(quiet_zone=variants["quiet_zone"]),
        contact=rig.contact._replace(lever=variants["lever"], frame_rate=variants["frame_rate"], mode_read=variants["mode_read"]),
    )
    for effect in effects:
        rig = with_effect(rig, effect)
    return rig


PLAIN = {"coarse": False, "quiet_zone": False, "lever": 1.0, "frame_rate": 0.0, "mode_read": False}


def draw_variants(rng: Generator) -> dict[str, Any]:
    """Readings of the definitions, at random.

    coarse: the platform's filters advance by semi-implicit Euler, sub-step by sub-step, not exactly. quiet_zone: noise comes after
    the dead zone and the saturation of the sensor. lever: the force acts at the tip (1) or at the undeformed surface (0).
    frame_rate: a frame that gives lowers the force of spring and damper alike (0), that of the damper twice (1) or not at all (-1).
    mode_read: the sensor lies under the ringing mass.
    """
    return {
        "coarse": bool(rng.random() < 0.5), "quiet_zone": bool(rng.random() < 0.3), "lever": float(rng.choice([0.0, 0.5, 1.0])),
        "frame_rate": float(rng.choice([0.0, 0.0, 1.0, -1.0])), "mode_read": bool(rng.random() < 0.5),
    }  # fmt: skip


def draw_noise(rng: Generator, facility: Facility, ticks: int) -> Noise:
    """Noise for a run of the facility."""
    scale = np.array([facility.noise] * 3 + [facility.torque_noise] * 3)
    pose = np.array([facility.pose_noise] * 3 + [facility.turn_noise] * 3)
    reading, still = rng.standard_normal((ticks, 6)) * scale, rng.standard_normal((ticks, 6)) * pose
    return Noise(reading, still, rng.standard_normal(ticks), rng.random(ticks))


def draw_set(
    rng: Generator, kind: Kind, names: tuple[str, ...] = (), scale: float = 1.0, least_strength: float = 3.0, literal: bool = False
) -> HiddenSet:
    """A set with something hidden in it.

    Args:
        names: the effects to hide, of the vocabulary or foreign; empty: as `kind` asks, at random.
        scale: of the departures. At other than 1 the strength is not looked at.
        least_strength: below it the set is drawn again, with another facility.
        literal: the plain reading of every definition, no variants.
    """
    for attempt in range(200):
        chosen = names or _names(rng, kind)
        facility = draw_facility(rng, _design(rng, chosen))
        effects = draw_effects(rng, chosen, facility, scale)
        variants = dict(PLAIN) if literal else draw_variants(rng)
        strengths = [strength(facility, effects, i, variants) for i in range(len(effects))]
        if scale == 1.0 and attempt < 150 and any(s < least_strength for s in strengths):
            continue
        runs = generate(rng, facility, effects, variants)
        if _stable(facility, runs):
            links = [link_of(e["kind"]) for e in effects]
            return HiddenSet(kind, facility, effects, links, [round(s, 3) for s in strengths], variants, runs)
    raise RuntimeError(f"no stable set with {names or kind} at scale {scale} in 200 draws")


def draw_effects(rng: Generator, names: tuple[str, ...], facility: Facility, scale: float = 1.0) -> list[dict[str, Any]]:
    """The effects `names`, of the vocabulary or foreign, at moderate sizes for the facility, times `scale`."""
    draws = [FOREIGN[name].draw if name in FOREIGN else SIZES[name] for name in names]
    found = [draw(rng, facility, scale) for draw in draws]
    short = [{k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in given.items()} for given in found]
    return [{"kind": name, **given} for name, given in zip(names, short, strict=True)]


def generate(rng: Generator, facility: Facility, effects: list[dict[str, Any]], variants: dict[str, Any]) -> list[Records]:
    """The records of all runs, in closed loop, with noise."""
    rigs = [rig_of(facility, i, effects, variants) for i in range(len(facility.runs))]
    return [simulate(rig, draw_noise(rng, facility, rig.ticks)) for rig in rigs]


def strength(facility: Facility, effects: list[dict[str, Any]], which: int, variants: dict[str, Any]) -> float:
    """How far effect `which` stands above the noise in its link's records, in the run where it shows most; see `HiddenSet`."""
    rest = [e for i, e in enumerate(effects) if i != which]
    return max(_strength(facility, run, effects, rest, link_of(effects[which]["kind"]), variants) for run in (1, 3, 4))


def _strength(facility: Facility, run: int, effects: list, rest: list, link: str, variants: dict[str, Any]) -> float:
    without, full = (rig_of(facility, run, e, variants) for e in (rest, effects))
    drawn = draw_noise(np.random.default_rng(run), facility, full.ticks)
    quiet = silence(full.ticks)._replace(delay=drawn.delay, repeat=drawn.repeat)
    plain = simulate(without, quiet)
    cut = simulate(full, quiet, pose_cmd=plain.pose_cmd, wrench_comp=plain.wrench_comp)
    forces = np.array([facility.noise] * 3 + [facility.torque_noise] * 3)
    if link == "platform":
        change = (cut.pose_act - plain.pose_act)[:, :3] / facility.pose_noise
    elif link == "dynamics":
        change = (cut.pose_cmd - plain.pose_cmd)[:, :3] / MODEL_NOISE
    elif link == "compensation":
        comp = full.compensator
        change = (cut.wrench_comp - plain.wrench_comp) / forces / ((comp.t1 * full.rate + 1.0) / (comp.t2 * full.rate + 1.0))
    else:
        change = (cut.wrench_meas - plain.wrench_meas) / forces
    on = np.any((plain.physical != 0.0) | (cut.physical != 0.0), axis=1)
    return float(np.sqrt(np.max(np.mean(change[on] ** 2, axis=0)))) if on.any() else 0.0


def write_set(folder: str | Path, hidden: HiddenSet, truth: bool = False) -> Path:
    """Write nominal.yaml, dataset.yaml and run_N.parquet; with `truth` also truth.yaml."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from ruamel.yaml import YAML

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    yaml = YAML(typ="safe")
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    rate = hidden.facility.scenario["rate"]
    entries = []
    for i, (records, changes) in enumerate(zip(hidden.runs, hidden.facility.runs, strict=True)):
        columns = {"t": np.arange(len(records.pose_cmd)) / rate}
        for name, parts in (("pose_cmd", POSE), ("pose_act", POSE), ("wrench_meas", WRENCH), ("wrench_comp", WRENCH)):
            columns |= {f"{name}.{part}": getattr(records, name)[:, j].copy() for j, part in enumerate(parts)}
        pq.write_table(pa.table(columns), folder / f"run_{i}.parquet")
        entries.append({"file": f"run_{i}.parquet", "set": changes})
    pages = {"nominal.yaml": hidden.facility.scenario, "dataset.yaml": {"scenario": "nominal.yaml", "runs": entries}}
    for name, content in (pages | ({"truth.yaml": hidden.truth} if truth else {})).items():
        with (folder / name).open("w", encoding="utf-8") as file:
            yaml.dump(_plain(content), file)
    return folder


def _plain(value: Any) -> Any:
    """Without NumPy's types, which YAML cannot write."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def _names(rng: Generator, kind: Kind) -> tuple[str, ...]:
    if kind == "healthy":
        return ()
    if kind == "foreign":
        return (str(rng.choice(list(FOREIGN))),)
    first = str(rng.choice(list(EFFECTS)))
    if kind == "single":
        return (first,)
    return (first, str(rng.choice([name for name in EFFECTS if not alike(first, name)])))


def _design(rng: Generator, names: tuple[str, ...]) -> frozenset[str]:
    """What the runs excite: all that the effects need, and at random what they do not, so that the design gives nothing away."""
    design = {"slide"} | ({"offset"} if rng.random() < 0.25 else set())
    if not names and rng.random() < 0.05:
        design |= {"latched"}
    for name in names:
        design |= NEEDS.get(name, frozenset())
    return frozenset(design - {"offset"} if "latched" in design else design)


def _stable(facility: Facility, runs: list[Records]) -> bool:
    for run, records in enumerate(runs):
        factor = np.sqrt(facility.runs[run].get("mechanism.contact.stiffness", facility.stiffness) / facility.stiffness)
        expected = factor * facility.peak * facility.speeds[run] / facility.middle_speed
        force = np.abs(records.physical[:, 2])
        if not np.all(np.isfinite(records.pose_cmd)) or force.max() > MOST_OVERLOAD * expected or force.max() < 0.2 * expected:
            return False
    return True
