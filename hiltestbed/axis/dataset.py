"""The file that describes measured runs of one axis, a drive, a servo or a damper, or of an arm.

axis: drive
nominal: {mass: 95.1}
runs: [{file: trapezoid.csv}, {file: pulses.csv}]
channels: {t: {column: t}, input: {column: force}, output: {column: position, unit: mm}}

axis: arm
model: arm.urdf
joints: {shoulder: {}, elbow: {gain: 10.1}}
runs: [{file: sweep.csv}, {file: circle.csv}, {file: rest.csv}]
channels: {shoulder.position: {column: q1, unit: deg}, shoulder.input: {column: tau1}, ...}
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from hiltestbed.axis.arm import Arm, ArmModel, ArmRun, read_arm
from hiltestbed.axis.effects.base import AXIS_EFFECTS, AxisEffect, AxisKind, BodyEffect
from hiltestbed.axis.models import AxisModel, AxisRun, model_of
from hiltestbed.axis.motion import noise_of
from hiltestbed.axis.records import RecordFormat, Signal, read_record
from hiltestbed.config.dataset import Channel, RunFile, missing_files
from hiltestbed.config.validation import NotNegative, Positive, Strictly, validate
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.errors import Fault, InputError
from hiltestbed.frames import Array
from hiltestbed.measured.formats import AnyFormat
from hiltestbed.plugins import OneOf, depends

# standard deviations of its noise below which a force is none; the share of the range over which a
# displacement then changes by more than a loaded damper's does where it turns
FREE_SIGMA, FREE_TRAVEL = 5.0, 0.02
# what each kind of axis relates, by the SI units of an axis that slides and of one that turns
QUANTITIES: dict[AxisKind, tuple[tuple[str, str], tuple[str, str]]] = {
    "drive": (("N", "N m"), ("m", "rad")),
    "servo": (("m", "rad"), ("m", "rad")),
    "damper": (("m", "rad"), ("N", "N m")),
    "arm": (("m", "rad"), ("N", "N m")),
}


class Nominal(Strictly):
    """What the owner believes of the axis; what is left out is none."""

    mass: Positive | None = Field(
        default=None, description="of a drive: moved mass [kg], or inertia [kg m^2] where it turns"
    )
    gain: Positive = Field(
        default=1.0, description="of a drive: force or torque per unit of its input, such as N/A"
    )
    viscous: NotNegative = Field(default=0.0, description="of a drive: viscous friction [N s/m]")
    coulomb: NotNegative = Field(default=0.0, description="of a drive: dry friction [N]")
    offset: float = Field(default=0.0, description="of a drive: constant force against it [N]")
    delay: NotNegative = Field(default=0.0, description="of a servo: from command to position [s]")
    bandwidth: Positive | None = Field(
        default=None, description="of a servo: natural frequency [Hz]; left out: it follows"
    )
    damping_ratio: Positive = Field(default=0.7, description="of a servo with a bandwidth")
    stiffness: float = Field(default=0.0, description="of a damper [N/m]")
    damping: NotNegative = Field(default=0.0, description="of a damper [N s/m]")
    preload: float = Field(default=0.0, description="of a damper: constant force [N]")


NUMBERS: dict[AxisKind, tuple[str, ...]] = {
    "drive": ("mass", "gain", "viscous", "coulomb", "offset"),
    "servo": ("delay", "bandwidth", "damping_ratio"),
    "damper": ("stiffness", "damping", "preload"),
}


class JointNumbers(Strictly):
    """What the owner believes of a joint; what is left out is what the arm's model states."""

    gain: Positive | None = Field(
        default=None, description="torque or force per unit of its input, such as N m/A; else 1"
    )
    viscous: NotNegative | None = Field(default=None, description="viscous friction [N m s/rad]")
    coulomb: NotNegative | None = Field(default=None, description="dry friction [N m]")
    offset: float | None = Field(default=None, description="constant torque against it [N m]")
    armature: NotNegative | None = Field(
        default=None, description="inertia of the rotor at the joint [kg m^2]"
    )


class _Runs(Strictly):
    """What the files of an axis and of an arm have in common."""

    axis: str
    name: str = Field(default="", description="Name of the axis or arm")
    description: str = Field(default="", description="Where the data come from")
    effects: Annotated[
        tuple[Annotated[AxisEffect, OneOf(AXIS_EFFECTS)], ...], Field(strict=False)
    ] = Field(
        default=(), description="departures that are known; of an arm, each with its joint or body"
    )
    runs: Annotated[tuple[RunFile, ...], Field(strict=False, min_length=1)] = Field(
        description="the measured runs, one file each"
    )
    channels: dict[str, Channel] = Field(
        default={},
        description="columns of t, input and output, or of t and, of each joint of an arm, "
        "JOINT.position and JOINT.input; left out: columns of that name",
    )
    rate: Positive | None = Field(
        default=None, description="sample rate [Hz] of files without a column of times"
    )
    format: AnyFormat | None = Field(default=None, description="how the files are written")


class ArmDataset(_Runs):
    """Measured runs of an arm of several joints, and the model of it."""

    axis: Literal["arm"] = Field(description="arm: motion of its joints to their torques")
    model: Annotated[str, Field(min_length=1)] = Field(
        description="URDF (.urdf) or MJCF of the arm, relative to the folder of this file: bodies, "
        "gravity, and what it states of friction"
    )
    joints: Annotated[dict[str, JointNumbers], Field(min_length=1)] = Field(
        description="the recorded joints, each with what is believed beside the model; the others "
        "of the model stay at zero"
    )


class AxisDataset(_Runs):
    """Measured runs of one axis, and what its owner believes of it."""

    axis: Literal["drive", "servo", "damper"] = Field(
        description="drive: force or current to position; servo: command to position; damper: "
        "displacement to force"
    )
    rotates: bool = Field(
        default=False, description="whether it turns: positions in rad, forces as torques in N m"
    )
    nominal: Nominal = Field(default=Nominal(), description="what is believed of it")


@depends
def _rebuild() -> None:
    for model in (AxisDataset, ArmDataset):
        model.model_rebuild(force=True)


@dataclass(frozen=True)
class LoadedAxis:
    """A valid file with its records.

    Attributes:
        spec: what the file says. path: of the file. source: its tree. records: one of each run.
            remarks: on the data. arm: the nominal arm, if it is one.
    """

    spec: AxisDataset | ArmDataset
    path: Path
    source: Source
    records: tuple[Any, ...]
    remarks: tuple[str, ...]
    arm: Arm | None = None

    @property
    def name(self) -> str:
        return self.spec.name or self.path.parent.resolve().name

    def units(self) -> tuple[str, str]:
        """The SI units of input and output; of an arm with joints of both kinds, of either."""
        a, b = QUANTITIES[self.spec.axis]
        if isinstance(self.spec, AxisDataset):
            return a[self.spec.rotates], b[self.spec.rotates]
        turns = sorted(set(self.arm.turns.values())) if self.arm is not None else ()
        return " or ".join(a[k] for k in turns), " or ".join(b[k] for k in turns)

    def model(self) -> AxisModel:
        """The nominal model of the records."""
        spec = self.spec
        if isinstance(spec, ArmDataset):
            assert self.arm is not None
            return ArmModel(self.records, self.arm, spec.effects)
        return model_of(spec.axis, self.records, nominal_of(spec), spec.rotates, spec.effects)


def nominal_of(spec: AxisDataset) -> dict[str, float]:
    """The numbers that its owner believes, by name."""
    given = spec.nominal.model_dump()
    return {k: given[k] for k in NUMBERS[spec.axis] if given[k] is not None}


def is_axis(source: Source) -> bool:
    """Whether a file describes an axis."""
    return isinstance(source.data, dict) and "axis" in source.data


def load_axis(path: str | Path | Source, data: bool = True) -> LoadedAxis:
    """The runs of an axis or an arm in a YAML file. data: whether the records are read.

    Raises:
        InputError: with every fault of the file and of its data.
    """
    source = path if isinstance(path, Source) else read_source(path)
    of_arm = isinstance(source.data, dict) and source.data.get("axis") == "arm"
    spec: AxisDataset | ArmDataset = validate(ArmDataset if of_arm else AxisDataset, source)
    faults, arm = [], None
    try:
        arm = arm_of(spec, source) if isinstance(spec, ArmDataset) else None
    except InputError as error:
        faults.append(source.fault(("model",), str(error)))
    else:
        faults += _misplaced(spec, arm, source)
    faults += _faults(spec, source)
    if faults:
        raise InputError(faults)
    records, remarks = [], []
    for index, run in enumerate(spec.runs if data else ()):
        try:
            record, found = _read(spec, run, source, arm)
        except InputError as error:
            faults += error.faults or (source.fault(("runs", index), str(error)),)
            continue
        records.append(record)
        remarks += found
    if faults:
        raise InputError(faults)
    names = [r.name for r in records]
    if len(set(names)) < len(names):
        records = [r._replace(name=f"{i}: {r.name}") for i, r in enumerate(records)]
    return LoadedAxis(spec, Path(source.file), source, tuple(records), tuple(remarks), arm)


def arm_of(spec: ArmDataset, source: Source) -> Arm:
    """The nominal arm of a file. Raises InputError as :func:`read_arm`."""
    given = {n: j.model_dump(exclude_none=True) for n, j in spec.joints.items()}
    return read_arm(source.folder / os.path.expandvars(spec.model), given)


def _misplaced(spec: AxisDataset | ArmDataset, arm: Arm | None, source: Source) -> Iterator[Fault]:
    """Channels that are none of the axis, and effects of joints and bodies that the arm lacks."""
    joints = arm.joints if arm is not None else ()
    signals = ["t", *(f"{j}.{s}" for j in joints for s in ("position", "input"))]
    signals = signals if arm is not None else ["t", "input", "output"]
    for where, channels in (
        (("channels",), spec.channels),
        *((("runs", i, "channels"), run.channels) for i, run in enumerate(spec.runs)),
    ):
        for name in channels:
            if name not in signals:
                allowed = ", ".join(signals)
                yield source.fault((*where, name), f"is no signal; allowed: {allowed}")
    if arm is None:
        return
    for index, effect in enumerate(spec.effects):
        if "arm" not in effect.axes:
            continue
        key, allowed = (
            ("body", arm.bodies) if isinstance(effect, BodyEffect) else ("joint", arm.joints)
        )
        if getattr(effect, key) not in allowed:
            yield source.fault(
                ("effects", index, key),
                f"is none of the arm (got {getattr(effect, key)!r}); allowed: {', '.join(allowed)}",
            )


def _faults(spec: AxisDataset | ArmDataset, source: Source) -> Iterator[Fault]:
    if isinstance(spec, AxisDataset):
        allowed = NUMBERS[spec.axis]
        for key in spec.nominal.model_fields_set:
            if key not in allowed:
                yield source.fault(
                    ("nominal", key),
                    f"is no number of a {spec.axis}; allowed: {', '.join(allowed)}",
                )
        if spec.axis == "drive" and spec.nominal.mass is None:
            yield source.fault(
                ("nominal",), "lacks mass, the moved mass [kg] or inertia [kg m^2] that is believed"
            )
        for index, effect in enumerate(spec.effects):
            for key in {"joint", "body"} & effect.model_fields_set:
                yield source.fault(
                    ("effects", index, key), f"is of an arm alone; leave it out of a {spec.axis}"
                )
    for index, effect in enumerate(spec.effects):
        if spec.axis not in effect.axes:
            kinds = [k for k, e in AXIS_EFFECTS.items() if spec.axis in e.axes]
            yield source.fault(
                ("effects", index, "kind"),
                f"does not act on {'an' if spec.axis == 'arm' else 'a'} {spec.axis} "
                f"(got {effect.kind}); allowed: {', '.join(kinds)}",
            )
    yield from missing_files(spec.runs, source)


def _read(
    spec: AxisDataset | ArmDataset, run: RunFile, source: Source, arm: Arm | None
) -> tuple[AxisRun | ArmRun, list[str]]:
    path = run.path(source)
    how = RecordFormat({**spec.channels, **run.channels}, run.format or spec.format, spec.rate)
    quantities = QUANTITIES[spec.axis]
    if isinstance(spec, AxisDataset):
        given, reached = (q[spec.rotates] for q in quantities)
        signals = (Signal("input", given, held=spec.axis != "damper"), Signal("output", reached))
        t, (u, y), remarks = read_record(path, signals, how)
        free = _unloaded(u, y) if spec.axis == "damper" else 0
        if free:
            remarks.append(
                f"{path.name}: the displacement changes over {free} rows without a force; if "
                f"nothing touches there, cut the record to the rows in contact"
            )
        return AxisRun(path.name, t, u, y), remarks
    assert arm is not None
    places, efforts = quantities
    t, values, remarks = read_record(
        path,
        [
            *(Signal(f"{j}.input", efforts[turns], held=True) for j, turns in arm.turns.items()),
            *(Signal(f"{j}.position", places[turns]) for j, turns in arm.turns.items()),
        ],
        how,
    )
    inputs, moved = np.split(np.array(values), 2)
    return ArmRun(path.name, t, moved.T, inputs.T), remarks


def _unloaded(u: Array, y: Array) -> int:
    """Rows of the longest stretch over which a displacement changes without a force; 0: none."""
    still = np.r_[False, np.abs(y) < FREE_SIGMA * noise_of(y), False]
    begins, ends = np.flatnonzero(np.diff(still)).reshape(-1, 2).T
    moved = [np.ptp(u[a:b]) > FREE_TRAVEL * np.ptp(u) for a, b in zip(begins, ends, strict=True)]
    return int(max((ends - begins)[moved], default=0))
