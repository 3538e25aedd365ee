"""A motor-driven axis: mass, viscous and dry friction and offset from the same two records, by
mujoco.sysid and by hiltestbed.

    pip install 'mujoco[sysid]'
    python axis.py [--ripple N] [--pitch M]

mujoco.sysid gets a MuJoCo model of a slide with damping, frictionloss and a constant force, in
three forms: as in its examples; with stiff friction and a sensor delay as a fifth parameter; and
with stiff friction, a Runge-Kutta integrator, and the state itself in place of the
sensor. The last two avoid the errors of the first: soft friction, and a rollout that stamps a
sensor reading one step late.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mujoco import sysid
from sides import Side, by_diagnosis, by_fit, by_sysid, of_diagnosis, scaled, table

from hiltestbed.diagnosis.driven import axis_link
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.measured import load_dataset

EXAMPLE = Path(__file__).parents[1] / "driven_axis"
sys.path.append(str(EXAMPLE))
import generate  # noqa: E402  # type: ignore[import-not-found]

Record = dict[str, np.ndarray]
BELIEVED = 100.0  # [kg]
START = {"mass": BELIEVED, "viscous": 100.0, "coulomb": 10.0, "offset": 0.0}
BOUNDS = {
    "mass": (1.0, 1000.0),
    "viscous": (0.0, 2000.0),
    "coulomb": (0.0, 200.0),
    "offset": (-50.0, 50.0),
}
STIFF = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 .001 .5 2"'
MODEL = """
<mujoco>
  <option timestep="0.001" integrator="{integrator}" gravity="0 0 0">
    <flag contact="disable"/>
  </option>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="100" diaginertia="1 1 1"/>
      <joint name="way" type="slide" axis="0 0 1" damping="100" frictionloss="10" {friction}/>
    </body>
  </worldbody>
  <actuator><general name="motor" joint="way" biastype="affine"/></actuator>
  <sensor><jointpos name="position" joint="way"/></sensor>
</mujoco>
"""


def parameters() -> sysid.ParameterDict:
    def first(of: Any, value: float) -> Any:
        out = np.array(of)
        out[0] = value
        return out

    def damping(spec: Any, p: Any) -> None:
        joint = spec.joint("way")
        joint.damping = first(joint.damping, p.value[0])

    def offset(spec: Any, p: Any) -> None:
        motor = spec.actuator("motor")
        motor.biasprm = first(motor.biasprm, -p.value[0])

    modifiers = {
        "mass": lambda spec, p: setattr(spec.body("carriage"), "mass", p.value[0]),
        "viscous": damping,
        "coulomb": lambda spec, p: setattr(spec.joint("way"), "frictionloss", p.value[0]),
        "offset": offset,
    }
    out = sysid.ParameterDict()
    for name, modifier in modifiers.items():
        out.add(sysid.Parameter(name, START[name], *BOUNDS[name], modifier=modifier))
    return out


def fitted(
    name: str,
    records: dict[str, Record],
    integrator: str,
    friction: str,
    delay: bool = False,
    state: bool = False,
) -> Side:
    """Fit of one form of the model to both records, and to each one to predict the other."""
    spec = mujoco.MjSpec.from_string(MODEL.format(integrator=integrator, friction=friction))
    seen = "way_qpos" if state else "position"

    def residual(names: list[str]) -> Any:
        model, sequences = spec.compile(), []
        for n in names:
            r = records[n]
            start = sysid.create_initial_state(model, r["position"][:1], np.zeros(1))
            place = sysid.TimeSeries.from_names(r["t"], r["position"][:, None], model, names=[seen])
            sequences.append(
                sysid.ModelSequences(
                    "axis", spec, n, start, sysid.TimeSeries(r["t"], r["force"][:, None]), place
                )
            )
        more = {"modify_residual": transform.apply} if delay else {}
        return sysid.build_residual_fn(models_sequences=sequences, **more)

    transform, params = sysid.SignalTransform(), parameters()
    if delay:
        params.add(sysid.Parameter("stamp", 0.0, -0.003, 0.003))
        transform.delay("position", params["stamp"])
    names = list(records)
    side, _ = by_sysid(name, params.copy(), residual(names))
    left, spent = [], side.seconds
    for out in names:
        one, x = by_sysid(name, params.copy(), residual([n for n in names if n != out]))
        _, shown, measured = residual([out])(x, params.copy())
        left.append(1e3 * float(np.sqrt(np.mean((shown[0][0].data - measured[0][0].data) ** 2))))
        spent += one.seconds
    return replace(side, left=left, seconds=spent)


def hiltestbed_sides(records: dict[str, Record], folder: Path) -> list[Side]:
    for name, columns in records.items():
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
    for name in ("dataset.yaml", "nominal.yaml"):
        shutil.copy(EXAMPLE / name, folder)
    os.environ["DRIVEN_AXIS"] = str(folder)
    found, seconds = by_diagnosis(folder / "dataset.yaml")
    dataset = load_dataset(folder / "dataset.yaml")
    unit = 1e3 * float(np.min(axis_link(dataset.runs).runs[0].sigma))  # [mm] of a residual
    left = (
        [unit * after for _, after in found.finding.heldout.per_run.values()]
        if found.finding.heldout
        else []
    )
    e = investigate(dataset).explanations["dynamics"]
    causes = tuple(c for c in e.candidates if c.kind == "dynamics.mass")[:1]
    force = next(c for c in e.candidates if c.kind == "dynamics.force")
    start = [1.0, *(START.get(n, float(force.grid[0][i])) for i, n in enumerate(force.names))]
    alone, spent = by_fit(e.residual, (*causes, force), start)
    return [
        Side("hiltestbed, the fit alone", _named(alone), spent),
        Side("hiltestbed, diagnosis", _named(of_diagnosis(found)), seconds, left),
    ]


def _named(found: Any) -> dict[str, tuple[float, float]]:
    out = {
        n.removeprefix("dynamics.force "): v
        for n, v in found.items()
        if n.startswith("dynamics.force ")
    }
    factor = found.get("dynamics.mass factor")
    return out | ({"mass": scaled(factor, BELIEVED)} if factor else {})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--ripple",
        type=float,
        default=0.0,
        help="force ripple over position [N], which no friction law describes",
    )
    parser.add_argument("--pitch", type=float, default=0.01, help="wavelength of the ripple [m]")
    given = parser.parse_args()
    axis = generate.Axis(ripple=given.ripple, pitch=given.pitch)
    true = {
        "mass": axis.mass,
        "viscous": axis.viscous,
        "coulomb": axis.coulomb,
        "offset": axis.offset,
    }
    records = generate.records(axis)
    with tempfile.TemporaryDirectory() as folder:
        ours = hiltestbed_sides(records, Path(folder))
    sides = [
        fitted("sysid, 4 numbers", records, "Euler", ""),
        fitted("sysid, stiff friction, and a delay", records, "Euler", STIFF, delay=True),
        fitted("sysid, stiff friction, Runge-Kutta, state", records, "RK4", STIFF, state=True),
        *ours,
    ]
    print(table(f"ripple {given.ripple:g} N over {1e3 * given.pitch:g} mm", true, sides))


if __name__ == "__main__":
    main()
