"""What `mujoco.sysid` makes of a drive: the joint of an MJCF whose mass, damping, dry friction and
constant force it fits to the same records.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from hiltestbed.axis.dataset import AxisDataset
from hiltestbed.axis.mjcf import axis_mjcf
from hiltestbed.bench.real.device import Array, AxisRecord, Device, Predictor

RANGE = 30.0  # times a typical size, up and down, within which a parameter is fitted
SPEED_ROWS = 20  # from whose slope a record starts
LONGEST_STEP = 1e-3  # [s] of the simulation; shorter than the rows of all drives


def sysid_of(device: Device, fit: Sequence[AxisRecord]) -> Predictor | None:
    """The model fitted to records; None where the device is no drive, or the extras of
    `mujoco[sysid]` are not installed.
    """
    from mujoco import sysid

    # without its extras it is empty
    if device.kind != "drive" or not hasattr(sysid, "optimize"):
        return None
    loaded = device.loaded(fit)
    assert isinstance(loaded.spec, AxisDataset)
    spec = mujoco.MjSpec.from_string(axis_mjcf(loaded.spec)[0])
    tick = float(np.median(np.concatenate([np.diff(r.t) for r in fit])))
    spec.option.timestep = tick / np.ceil(tick / LONGEST_STEP)
    force = float(np.std(np.concatenate([r.u for r in fit]))) * device.nominal["gain"]
    speed = float(np.std(np.concatenate([np.gradient(r.y, r.t) for r in fit])))

    def moved(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.body("axis").mass = p.value[0]
        s.body("axis").inertia = np.full(3, p.value[0])  # the centre of mass is on the axis

    def damped(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.joint("axis").damping = [p.value[0], 0.0, 0.0]

    def rubbed(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.joint("axis").frictionloss = p.value[0]

    def loaded_by(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
        s.actuator("input").biastype = mujoco.mjtBias.mjBIAS_AFFINE
        s.actuator("input").biasprm[0] = p.value[0]  # [unit of the input]

    params = sysid.ParameterDict()
    for name, size, modifier in (
        ("mass", device.nominal["mass"], moved),
        ("damping", 0.3 * force / speed, damped),
        ("frictionloss", 0.3 * force, rubbed),
    ):
        ends = {"min_value": size / RANGE, "max_value": size * RANGE}
        params.add(sysid.Parameter(name, size, modifier=modifier, **ends))
    most = force / device.nominal["gain"]
    params.add(sysid.Parameter("bias", 0.0, min_value=-most, max_value=most, modifier=loaded_by))
    model, each = spec.compile(), []
    for r in fit:
        place, speed = _start(r)
        begin = sysid.create_initial_state(model, np.array([place]), np.array([speed]), np.zeros(0))
        output = sysid.TimeSeries.from_names(r.t, r.y[:, None], model)
        each.append((begin, sysid.TimeSeries(r.t, r.u[:, None]), output))
    starts, inputs, outputs = (list(part) for part in zip(*each, strict=True))
    names = [r.name for r in fit]
    measured = sysid.ModelSequences(device.name, spec, names, starts, inputs, outputs)
    residual = sysid.build_residual_fn(models_sequences=[measured])
    found, _ = sysid.optimize(params, residual, verbose=False)
    sysid.apply_param_modifiers_spec(found, spec)
    final = spec.compile()
    return lambda r: _predicted(final, r)


def _start(r: AxisRecord) -> tuple[float, float]:
    """Position and speed at the first row."""
    t, y = r.t[:SPEED_ROWS], r.y[:SPEED_ROWS]
    return float(y[0]), float(np.polyfit(t - t[0], y, 1)[0])


def _predicted(model: mujoco.MjModel, r: AxisRecord) -> Array:
    """(N,) positions under the recorded input, each value of which is held until the next."""
    data, h = mujoco.MjData(model), model.opt.timestep
    data.qpos[0], data.qvel[0] = _start(r)
    at = np.arange(r.t[0], r.t[-1] + h, h)
    u, out = r.u[np.searchsorted(r.t, at + 1e-9, side="right") - 1], np.empty(len(at))
    for k in range(len(at)):
        out[k], data.ctrl[0] = data.qpos[0], u[k]
        mujoco.mj_step(model, data)
    return np.interp(r.t, at, out)
