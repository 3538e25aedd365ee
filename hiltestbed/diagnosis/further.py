"""Runs that were not made: further runs of a scenario, simulated and laid out as measured data."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hiltestbed.build import runnable_from
from hiltestbed.config.dataset import Dataset, LoadedDataset, RunEntry
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.measured import MeasuredDataset, examine
from hiltestbed.measured.record import MEASURED_GROUPS
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import GROUPS
from hiltestbed.simulation import simulate

MOST_PROPOSED = 3  # runs
MEASURED = frozenset(c for group in MEASURED_GROUPS for c in GROUPS[group].columns)
FACTOR = 4.0  # of a stiffness or mass: its frequency is then twice or half the nominal one
SPEED_FACTOR = 3.0  # half a decade; the peak force grows as much
# of the approach speed, across it: 9 mm/s at 0.03 m/s, where friction is regularised below 0.1 mm/s
SLIDING = 0.3
TILT = 2.0  # [deg] a tip 0.1 m off the axis then touches 3.5 mm early


class Further(NamedTuple):
    """A further run that may be proposed: in words, as settings, and its scenario."""

    words: str
    set: dict[str, Any]
    scenario: Scenario


Pair = TypeVar("Pair", bound=Hashable)


def chosen(
    count: int, left: Set[Pair], settled: Callable[[Sequence[int]], Mapping[Pair, float]]
) -> list[tuple[int, dict[Pair, float]]]:
    """Those of so many further runs that tell most of the pairs ``left`` apart, each beside those
    before it, with these pairs. settled: pairs that some of the runs together tell apart, and by
    how much.
    """
    out: list[tuple[int, dict[Pair, float]]] = []
    while left and count and len(out) < MOST_PROPOSED:
        runs, found = [k for k, _ in out], []
        for k in range(count):
            apart = {pair: x for pair, x in settled([*runs, k]).items() if pair in left}
            found.append((len(apart), min(apart.values(), default=0.0), -k, apart))
        *_, last, apart = max(found, key=lambda f: f[:3])
        if not apart:
            break
        out.append((-last, apart))
        left = left - set(apart)
    return out


def possible(scenario: Scenario, seed: int) -> Iterator[Further]:
    """Those of the further runs that the facility can make, each with its own noise."""
    believed = resolved(scenario)
    for i, (words, settings) in enumerate(alternatives(scenario)):
        try:
            other = runnable_from(believed, settings | {"seed": seed + i})
        except InputError:  # the facility, or the mechanism, does not allow it
            continue
        yield Further(words, settings, other)


def alternatives(scenario: Scenario) -> list[tuple[str, dict[str, Any]]]:
    """Further runs of a scenario, in words and as settings: other springs and masses, longer,
    tilted, and where it approaches, other speeds and sliding.
    """
    approach, duration, craft = scenario.approach, scenario.duration, scenario.spacecraft
    speed, k = approach.velocity[2], scenario.mechanism.contact.stiffness
    light, heavy = craft.chaser.mass / FACTOR, FACTOR * craft.target.mass
    out: list[tuple[str, dict[str, Any]]] = []
    for spring in (FACTOR * k, k / FACTOR):
        longer = duration * max(1.0, (k / spring) ** 0.5)  # a contact lasts as 1/sqrt(k)
        settings = {"mechanism.contact.stiffness": spring, "duration": longer}
        out.append((f"on a known spring of {spring:.3g} N/m", settings))
    out += [
        (f"with a chaser of {light:.3g} kg in the model", {"spacecraft.chaser.mass": light}),
        (f"with a target of {heavy:.3g} kg in the model", {"spacecraft.target.mass": heavy}),
        (f"for {FACTOR * duration:.3g} s", {"duration": FACTOR * duration}),
        (f"tilted by {TILT:g} degrees", {"approach.attitude_deg.1": TILT}),
    ]
    for factor in (SPEED_FACTOR, 1.0 / SPEED_FACTOR) if speed else ():
        settings = {"approach.velocity.2": factor * speed, "approach.gap": factor * approach.gap}
        out.append((f"at {factor * speed:.3g} m/s", settings))
    if speed:
        across = SLIDING * speed
        out.append((f"sliding at {across:.3g} m/s", {"approach.velocity.0": across}))
    return out


def with_noise(scenario: Scenario, noise: Mapping[str, float], seed: int) -> Scenario:
    """A scenario whose sensor has the noise on record; of another ``seed`` in each run, since noise
    that all runs share is none.
    """
    levels: dict[str, Any] = {"seed": seed}
    for key, prefix in (("noise", "wrench_meas.f"), ("torque_noise", "wrench_meas.t")):
        if known := [level for column, level in noise.items() if column.startswith(prefix)]:
            levels[f"sensor.{key}"] = float(np.median(known))
    return runnable_from(resolved(scenario), levels)


def noise_on_record(data: MeasuredDataset) -> dict[str, float]:
    """Column to the standard deviation of its noise, the median over the runs."""
    each = [run.survey.noise for run in data.runs]
    columns = dict.fromkeys(column for noise in each for column in noise)
    return {c: float(np.median([n[c].white for n in each if c in n])) for c in columns}


def as_measured(
    believed: Sequence[Scenario],
    acting: Sequence[Scenario],
    noise: Mapping[str, float],
    columns: Set[str],
) -> tuple[MeasuredDataset | None, tuple[str, ...]]:
    """Runs as they would be on record if scenarios act that the facility believes to be others,
    None where none of them can be made; and of each in words why not, empty where it can.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = [folder / f"{i}.parquet" for i in range(len(acting))]
        trouble = tuple(
            _simulate(scenario, file, noise, columns)
            for scenario, file in zip(acting, files, strict=True)
        )
        there = [i for i, why in enumerate(trouble) if not why]
        if not there:
            return None, trouble
        data = LoadedDataset(
            Dataset(scenario="plan", runs=tuple(RunEntry(file=files[i].name) for i in there)),
            folder / "plan.yaml",
            believed[0],
            tuple(believed[i] for i in there),
            tuple(files[i] for i in there),
        )
        # simulated by these scenarios: no finding of the check forbids a diagnosis
        return examine(data), trouble


def _simulate(scenario: Scenario, file: Path, noise: Mapping[str, float], columns: Set[str]) -> str:
    """Write a run to a ``file`` as its log would have it: the ``columns`` that are measured, with
    the noise of a measured pose; that of the force has gone through the loop.

    Returns:
        In words why there is no run; empty where it is written.
    """
    try:
        batch = simulate([scenario], trace=True)
    except HiltestbedError as error:
        return str(error)
    if batch.trouble or batch.trace is None:
        return batch.trouble[0][2] if batch.trouble else "it has no trace"
    rng = np.random.default_rng(scenario.seed)
    logged = {name: v for name, v in batch.trace.run(0).items() if name in columns | {"t"}}
    for name, values in logged.items():
        if name.startswith("pose_act."):
            logged[name] = values + noise.get(name, 0.0) * rng.standard_normal(len(values))
    pq.write_table(pa.table(logged), file)
    return ""
