"""A bumper with more stiffness and damping than believed: both parameters from the same three
records, by mujoco.sysid and by hiltestbed.

    pip install 'mujoco[sysid]'
    python contact.py [--seed N]

A mass of 100 kg meets a spring and a damper at three speeds. Position and force are computed in
closed form at 2 kHz; the contact ends where the force has fallen to zero. Both signals have white
noise and no delay. Both programs are given mass, gap and speeds, and start from the nominal 100
kN/m and 300 N s/m. mujoco.sysid simulates a ball on a plane with the contact's stiffness and
damping in ``solref`` (direct, at an impedance of 1e-4, so that the force is k x + c v), with a
Runge-Kutta integrator. Its residuals are in units of the noise, which is given to it. The position
is compared with the state, and the force at the instant at which MuJoCo computes it, one step
before its stamp in a rollout.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mujoco import sysid
from sides import Side, by_diagnosis, by_fit, by_sysid, of_diagnosis, scaled, table

from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.measured import load_dataset

TRUE = {"stiffness": 1.08e5, "damping": 460.0}  # [N/m], [N s/m]
BELIEVED = {"stiffness": 1.0e5, "damping": 300.0}
MASS, GAP, SPEEDS = 100.0, 0.0023, (0.021, 0.038, 0.06)  # [kg], [m], [m/s]
RATE, SECONDS = 2000, 0.5  # [Hz], [s]
PLACE_NOISE, FORCE_NOISE = 5e-7, 0.2  # [m], [N]
MODEL = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="0 0 0" cone="elliptic"/>
  <worldbody>
    <geom name="plate" type="plane" size="1 1 .1"/>
    <body name="ball" pos="0 0 0.1">
      <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
      <joint name="way" type="slide" axis="0 0 -1"/>
      <geom name="tip" size="0.1" mass="0"/>
      <site name="around" type="sphere" size="0.3"/>
    </body>
  </worldbody>
  <contact><pair geom1="plate" geom2="tip" condim="1" solimp="1e-4 1e-4 .001 .5 1"/></contact>
  <actuator><motor joint="way"/></actuator>
  <sensor><jointpos name="position" joint="way"/><touch name="force" site="around"/></sensor>
</mujoco>
"""
SCENARIO = f"""
name: bumper
duration: {SECONDS}
rate: {RATE}
physics_rate: {8 * RATE}
spacecraft:
  chaser: {{mass: {MASS}, inertia: [1.0, 1.0, 1.0]}}
  target: {{mass: 1.0e+9, inertia: [1.0e+9, 1.0e+9, 1.0e+9]}}
approach: {{gap: {GAP}, velocity: [0, 0, {SPEEDS[0]}]}}
mechanism: {{kind: bumper, contact: {BELIEVED}}}
rig: {{platform: {{kind: pss33, tracking: ideal}}}}
sensor: {{delay: 0.0}}
compensation: {{force: {{kind: none}}, motion: {{kind: none}}}}
identification: {{kind: none}}
""".replace("'", "")
Record = tuple[np.ndarray, np.ndarray, np.ndarray]  # t, position, force


def bounce(speed: float) -> Record:
    """Time [s], position relative to the touch [m] and force [N] of a mass that meets the
    bumper.
    """
    k, c = TRUE.values()
    d = 0.5 * c / MASS
    w = math.sqrt(k / MASS - d * d)
    t = np.arange(round(SECONDS * RATE)) / RATE
    since = t - GAP / speed
    ends = (math.pi - math.atan2(c * w, k - c * d)) / w  # where k x + c v = 0

    def motion(s: Any) -> tuple[Any, Any]:
        decay, sine, cosine = np.exp(-d * s), np.sin(w * s), np.cos(w * s)
        return speed / w * decay * sine, speed * decay * (cosine - d / w * sine)

    inside = (since > 0.0) & (since < ends)
    x, v = motion(np.clip(since, 0.0, ends))
    away, back = motion(ends)
    place = np.where(since < 0.0, speed * since, np.where(inside, x, away + back * (since - ends)))
    return t, place, np.where(inside, k * x + c * v, 0.0)


def records(seed: int) -> list[Record]:
    rng = np.random.default_rng(seed)
    out = []
    for speed in SPEEDS:
        t, place, force = bounce(speed)
        out.append(
            (
                t,
                place + PLACE_NOISE * rng.standard_normal(len(t)),
                force + FORCE_NOISE * rng.standard_normal(len(t)),
            )
        )
    return out


def parameters() -> sysid.ParameterDict:
    out = sysid.ParameterDict()
    for name, value in BELIEVED.items():
        out.add(sysid.Parameter(name, value, 0.1 * value, 10.0 * value))
    return out


def fitted(given: list[Record], finer: int) -> Side:
    """Fit by mujoco.sysid with ``finer`` integration steps per row."""
    step = 1.0 / (finer * RATE)
    spec = mujoco.MjSpec.from_string(MODEL.format(step=step, mass=MASS))

    def build(p: sysid.ParameterDict, of: Any) -> mujoco.MjModel:
        model = of.compile()
        inverse = model.body_invweight0[1][0]
        model.pair_solref[0] = (
            -p["stiffness"].value[0] * inverse,
            -p["damping"].value[0] * inverse,
        )
        return model

    def difference(
        p: Any,
        shown: sysid.TimeSeries,
        measured: sysid.TimeSeries,
        *_: Any,
        state: Any = None,
        **__: Any,
    ) -> Any:
        t = measured.times
        place = np.interp(
            t, np.concatenate([[0.0], state[:, 0]]), np.concatenate([[-GAP], state[:, 1]])
        )
        force = np.interp(t, shown.times - step, shown.data[:, 1])
        both = sysid.TimeSeries(t, np.column_stack([place, force]), measured.signal_mapping)
        return ((measured.data - both.data) / (PLACE_NOISE, FORCE_NOISE))[1:-1], both, measured

    def residual(numbers: list[int]) -> Any:
        model, sequences = spec.compile(), []
        for n in numbers:
            t, place, force = given[n]
            start = sysid.create_initial_state(model, np.array([-GAP]), np.array([SPEEDS[n]]))
            seen = sysid.TimeSeries.from_names(t, np.column_stack([place, force]), model)
            sequences.append(
                sysid.ModelSequences(
                    "bumper", spec, f"{n}", start, sysid.TimeSeries(t, np.zeros((len(t), 1))), seen
                )
            )
        return sysid.build_residual_fn(
            models_sequences=sequences, build_model=build, modify_residual=difference
        )

    every = list(range(len(given)))
    side, _ = by_sysid(
        f"sysid, {finer} step{'s' if finer > 1 else ''} per row", parameters(), residual(every)
    )
    return side


def hiltestbed_sides(given: list[Record], folder: Path) -> list[Side]:
    runs = ""
    for n, (t, place, force) in enumerate(given):
        pq.write_table(
            pa.table({"t": t, "position": place, "force": force}), folder / f"{n}.parquet"
        )
        runs += f"  - {{file: {n}.parquet, set: {{approach.velocity.2: {SPEEDS[n]}}}}}\n"
    channels = "  pose_act.pz: {column: position}\n  wrench_meas.fz: {column: force}\n"
    (folder / "believed.yaml").write_text(SCENARIO, "utf-8")
    (folder / "dataset.yaml").write_text(
        f"scenario: believed.yaml\nruns:\n{runs}channels:\n{channels}", "utf-8"
    )
    found, seconds = by_diagnosis(folder / "dataset.yaml")
    e = investigate(load_dataset(folder / "dataset.yaml")).explanations["wrench"]
    causes = [next(c for c in e.candidates if c.kind == f"contact.{name}") for name in TRUE]
    alone, spent = by_fit(e.residual, causes, [1.0, 1.0])
    return [
        Side("hiltestbed, the fit alone", _named(alone), spent),
        Side(
            f"hiltestbed, diagnosis: {found.finding.verdict}", _named(of_diagnosis(found)), seconds
        ),
    ]


def _named(found: Any) -> dict[str, tuple[float, float]]:
    factors = {name: found.get(f"contact.{name} factor") for name in TRUE}
    return {
        name: scaled(factor, BELIEVED[name])
        for name, factor in factors.items()
        if factor is not None
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    given = records(parser.parse_args().seed)
    with tempfile.TemporaryDirectory() as folder:
        ours = hiltestbed_sides(given, Path(folder))
    print(table("a bumper", TRUE, [*(fitted(given, finer) for finer in (1, 4)), *ours]))


if __name__ == "__main__":
    main()
