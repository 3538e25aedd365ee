"""The sequence of a commissioning: observe, tare, move in free space, press, fit; and its result
folder: the scenarios, a dataset of the motions, the figures.

Nothing moves unless it is armed; every command passes the same guard as in a run. If anything goes
wrong, the platform is held, retracted or stopped as the scenario specifies, and nothing is written.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.build import runnable_from
from hiltestbed.config.yaml_source import dump_yaml
from hiltestbed.devices.commission.motions import SETTLED, TestMotion, motions
from hiltestbed.devices.commission.platform import (
    SIGNIFICANT,
    PlatformFit,
    TestedPath,
    fit_platform,
)
from hiltestbed.devices.commission.sensor import Expected, SensorFit, Shown, fit_sensor
from hiltestbed.devices.interface import DeviceError
from hiltestbed.devices.live import rehearse
from hiltestbed.devices.mounting import Mounting
from hiltestbed.devices.session import Observed, Options, Row, Session
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, attitude_deg_from_quat, quat_from_attitude_deg
from hiltestbed.run_folder.store import whole_folder, write_trace
from hiltestbed.run_folder.versions import versions
from hiltestbed.scenario import Scenario, dump_scenario, resolved
from hiltestbed.sensor.effects import SensorRotation
from hiltestbed.signals import AXES, RunTrace

# relative difference of misfit within which two fits with equally many numbers are equivalent
# (decides only the axes named)
ALIKE = 1e-3
LEAST_SCALE = 2e-3  # smallest error of a scale that is reported: 8 um of a press of 4 mm
SHORTEST = 1e-4  # [s] smallest delay that is reported: a fifth of a tick at 2 kHz
RESULT, DATASET = "commission.json", "dataset.yaml"
NOMINAL, BELIEVED = "nominal.yaml", "believed.yaml"
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Commissioned:
    """The results.

    Attributes:
        believed: the given scenario, with the mounting and the noise of the sensor as measured,
            which no simulation could predict.
        nominal: the scenario with everything that was measured. paths: the recorded motions, by
            name, with the wrench for the sensor's mounting in `believed`.
        departures: effects that a diagnosis of the motions against `believed` should find, as under
            `effects:` in a scenario.
    """

    believed: Scenario
    nominal: Scenario
    observed: Observed
    sensor: SensorFit
    platform: PlatformFit
    paths: dict[str, TestedPath]
    departures: tuple[dict[str, Any], ...] = ()


def commission(
    scenario: Scenario,
    options: Options,
    force: float = 100.0,
    progress: Progress = lambda step: None,
) -> Commissioned:
    """Measure the devices of ``scenario`` with presses of about ``force`` [N].

    Raises:
        InputError: it is not armed, or the force exceeds the scenario's limit. DeviceError: it was
            stopped.
    """
    limit = scenario.safety.force
    if not options.armed:
        raise InputError("commission moves the platform; read docs/safety.md, then give --arm")
    if limit is not None and force > 0.8 * limit:
        raise InputError(
            f"force: is too large (got {force:g} N); allowed is 0.8 of safety.force, "
            f"{0.8 * limit:g} N"
        )
    progress("rehearsal")
    rehearse(scenario)
    session = Session(scenario, options)
    planned = motions(scenario, force)
    rows: dict[str, list[Row]] = {motion.name: [] for motion in planned}
    with session.connected():
        observed = session.observe()
        session.guarded(lambda: _play(session, planned, rows, progress))
    if session.rig.stop is not None:
        raise DeviceError(f"stopped: {session.rig.stop}; nothing was written")
    progress("fits")
    return _fitted(scenario, planned, rows, observed)


def _play(
    session: Session, planned: Sequence[TestMotion], rows: dict[str, list[Row]], progress: Progress
) -> None:
    home = session.rig.last.copy()
    for motion in planned:
        progress(motion.name)
        followed = session.travel(motion.start)
        if not followed or not session.follow(motion.poses(), rows=rows[motion.name]):
            return
    session.travel(home)


def _fitted(
    scenario: Scenario,
    planned: Sequence[TestMotion],
    rows: dict[str, list[Row]],
    observed: Observed,
) -> Commissioned:
    touched, noise = [], observed.shown_noise
    for motion in planned:
        if motion.touches:
            poses = np.array([row.pose for row in rows[motion.name]])
            shown = np.array([row.shown for row in rows[motion.name]]) - observed.shown
            touched.append(Shown(Expected(scenario, poses), shown))
    sensor = fit_sensor(touched, np.array(scenario.devices.sensor.position), noise)
    begin = round(SETTLED / scenario.tick)  # excludes what remains of the travel to the start

    def paths(mounted: Scenario) -> dict[str, TestedPath]:
        mounting = Mounting(mounted.devices)
        return {m.name: _path(m, rows[m.name][begin:], mounting, observed.shown) for m in planned}

    believed = _mounted(scenario, sensor, noise)
    found = paths(believed)
    platform = fit_platform(list(found.values()), scenario.tick)
    nominal = explained = _nominal(believed, sensor, platform)
    turned = _turned(scenario, sensor, touched, noise)
    if turned is not None:
        sensor, believed = turned, _mounted(scenario, None, noise)
        found, explained = paths(believed), _nominal(believed, turned, platform)
    departures = [effect.model_dump(mode="json") for effect in explained.effects]
    late = explained.sensor.delay - believed.sensor.delay
    if late > _least_delay(sensor.delay_ci95):
        departures.insert(0, {"kind": "sensor.delay", "delay": late})
    return Commissioned(
        believed,
        nominal,
        observed,
        sensor,
        platform,
        found,
        tuple(departures),
    )


def _turned(
    scenario: Scenario, sensor: SensorFit, touched: Sequence[Shown], noise: Array
) -> SensorFit | None:
    """The sensor fitted with gains and crosstalk in its own axes; None if these are not slightly
    rotated against those in the scenario, or if gains in P's axes fit better.
    """
    mounted = scenario.devices.sensor
    if sensor.sign != mounted.sign:
        return None
    attitude = quat_from_attitude_deg(mounted.attitude_deg)
    found = fit_sensor(touched, np.array(mounted.position), noise, attitude)
    most = SensorRotation.searched("angles_deg")[1]
    if not found.turned() or max(map(abs, found.turn_deg or ())) > most:
        return None
    worst = len(sensor.numbers), (1.0 + ALIKE) * sensor.misfit
    return found if (len(found.numbers), found.misfit) <= worst else None


def _path(motion: TestMotion, rows: list[Row], mounting: Mounting, tare: Array) -> TestedPath:
    wrench = np.zeros((len(rows), 6))
    for k, row in enumerate(rows):
        mounting.wrench_in_P(row.shown - tare, wrench[k])
    command, pose = (np.array([getattr(row, name) for row in rows]) for name in ("command", "pose"))
    return TestedPath(command, pose, wrench, motion.start, motion.touches)


def _mounted(scenario: Scenario, sensor: SensorFit | None, noise: Array) -> Scenario:
    """The scenario with the measured noise and, if ``sensor`` is given, its sign and attitude."""
    data = resolved(scenario)
    if sensor is not None:
        data["devices"]["sensor"] |= {
            "attitude_deg": attitude_deg_from_quat(sensor.attitude).tolist(),
            "sign": sensor.sign,
        }
    data["sensor"] |= {"noise": float(np.max(noise[:3])), "torque_noise": float(np.max(noise[3:]))}
    return runnable_from(data)


def _nominal(believed: Scenario, sensor: SensorFit, platform: PlatformFit) -> Scenario:
    data, lowpass = resolved(believed), believed.sensor.lowpass
    filtered = 1.0 / (2.0 * math.pi * lowpass) if lowpass else 0.0
    data["sensor"]["delay"] = max(sensor.delay - filtered, 0.0)
    measured = ("sensor.", "platform.")
    kept = [effect for effect in data["effects"] if not effect["kind"].startswith(measured)]
    return runnable_from(data | {"effects": kept + effects_of(sensor, platform)})


def effects_of(sensor: SensorFit, platform: PlatformFit) -> list[dict[str, Any]]:
    """Rotation, gains, crosstalk, delay and scale as effects, where they are significant."""
    found: list[dict[str, Any]] = []
    if sensor.turned():
        found.append({"kind": "sensor.rotation", "angles_deg": list(sensor.turn_deg or ())})
    gains = {n.axis: n.value for n in sensor.numbers if n.source == n.axis}
    for axis, value in gains.items():
        found.append({"kind": "sensor.gain", "axis": axis, "factor": value})
    # crosstalk after the gains, since it is relative to the source's reading
    for n in sensor.numbers:
        if n.source != n.axis:
            where, ratio = {"source": n.source, "axis": n.axis}, n.value / gains.get(n.source, 1.0)
            found.append({"kind": "sensor.crosstalk", **where, "ratio": ratio})
    if platform.delay > _least_delay(platform.delay_ci95):
        found.append({"kind": "platform.delay", "delay": platform.delay})
    scales = platform.scale or (), platform.scale_ci95 or ()
    for axis, value, ci95 in zip("xyz", *scales, strict=False):
        if abs(value - 1.0) > max(LEAST_SCALE, SIGNIFICANT * ci95):
            found.append({"kind": "platform.scale", "axis": axis, "factor": value})
    return found


def _least_delay(ci95: float) -> float:
    """Smallest significant delay [s], given the half width of its 95 % interval."""
    return max(SHORTEST, SIGNIFICANT * ci95)


def write_commission(result: Commissioned, path: Path) -> Path:
    """Write the folder and return its path. Raises InputError if it cannot be written."""
    with whole_folder(path, mark=RESULT) as folder:
        (folder / NOMINAL).write_text(dump_scenario(result.nominal), encoding="utf-8")
        (folder / BELIEVED).write_text(dump_scenario(result.believed), encoding="utf-8")
        text = json.dumps(figures(result), indent=2, allow_nan=False) + "\n"
        (folder / RESULT).write_text(text, encoding="utf-8")
        runs = []
        for number, found in enumerate(result.paths.values()):
            file, t = f"run_{number:02d}.parquet", np.arange(len(found.pose)) / result.believed.rate
            data = {"pose_cmd": found.command, "pose_act": found.pose, "wrench_meas": found.wrench}
            write_trace(RunTrace(t, data, np.zeros(len(t), dtype=bool)), folder / file)
            different = {  # a motion starts at rest
                "approach.gap": float(-found.start[2]),
                "approach.offset": [float(v) for v in found.start[:2]],
                "approach.velocity": [0.0, 0.0, 0.0],
                "approach.attitude_deg": attitude_deg_from_quat(found.start[3:7]).tolist(),
                "approach.rate_deg": [0.0, 0.0, 0.0],
                "duration": len(t) / result.believed.rate,
            }
            runs.append({"file": file, "set": different})
        name = f"commissioning of {result.believed.name}"
        dataset = {"name": name, "scenario": BELIEVED, "runs": runs}
        (folder / DATASET).write_text(dump_yaml(dataset), encoding="utf-8")
    return path


def figures(result: Commissioned) -> dict[str, Any]:
    """All measured quantities, as plain data."""
    sensor, platform = result.sensor, result.platform
    compliances = zip(platform.compliance, platform.compliance_ci95, strict=True)
    gain = next((n.value for n in sensor.numbers if n.source == n.axis == "z"), 1.0)
    return {
        "name": result.believed.name,
        "versions": versions(),
        "rate": result.observed.rate,
        "noise": dict(zip(AXES, result.observed.shown_noise.tolist(), strict=True)),
        "tare": dict(zip(AXES, result.observed.shown.tolist(), strict=True)),
        "sensor": {
            "sign": sensor.sign,
            "attitude_deg": attitude_deg_from_quat(sensor.attitude).tolist(),
            "attitude_ci95_deg": sensor.attitude_ci95_deg,
            "turn_deg": sensor.turn_deg,
            "delay": sensor.delay,
            "delay_ci95": sensor.delay_ci95,
            "gains_and_crosstalk": [vars(n) for n in sensor.numbers],
            "residual": dict(zip(AXES, sensor.residual, strict=True)),
            "reading": dict(zip(AXES, sensor.reading, strict=True)),
        },
        "platform": vars(platform),
        "stiffness": {
            "contact_as_felt": gain * result.believed.mechanism.contact.stiffness,
            "rig": [1.0 / c if c > ci95 else None for c, ci95 in compliances],
        },
        "effects": [e.model_dump(mode="json") for e in result.nominal.effects],
        "departures": list(result.departures),
    }
