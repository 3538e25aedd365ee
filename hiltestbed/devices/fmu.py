"""The physical side, or the force sensor alone, packed as an FMU of FMI 3.0 for co-simulation. A
user's FMU is stepped by :mod:`hiltestbed.devices.cosimulation`.

Modelica Association, "Functional Mock-up Interface Specification", version 3.0, sections 2 and 4.
Packing is done by PythonFMU3, which comes with the extra ``fmi``. A packed FMU holds neither Python
nor hiltestbed: the tool that loads it must be able to load a Python in which hiltestbed is
installed (on Linux, with its libpython among the global symbols).

Inputs are held over a communication step, outputs are those at its end. A tool that exchanges them
once per step therefore adds up to one communication step of delay to the loop.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.devices.cosimulation import POSE, WRENCH
from hiltestbed.devices.interface import UNIT_LENGTH, Array
from hiltestbed.errors import HiltestbedError, InputError, of_extra

WHOLE = 1e-6  # of a tick: largest deviation of a communication step from a whole number of ticks
SCENARIO = "scenario.yaml"  # its name among the FMU's resources

_SCRIPT = """\
from pathlib import Path

from pythonfmu3 import DefaultExperiment, Fmi3Slave, Fmi3Status, Fmi3StepResult

from hiltestbed.devices.fmu import {packed}


class {name}(Fmi3Slave):
    description = "{description}"
    generation = "hiltestbed"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.side = {packed}(self, "{factory}", Path(self.resources) / "{scenario}")
        self.default_experiment = DefaultExperiment(start_time=0.0, step_size=self.side.period)

    def to_xml(self, *options):
        root = super().to_xml(*options)
        root.find("CoSimulation").set("fixedInternalStepSize", repr(self.side.period))
        return root

    def do_step(self, current_time, step_size):
        problem = self.side.advance(current_time, step_size)
        if problem:
            self.log(problem, Fmi3Status.error)
        return Fmi3StepResult(status=Fmi3Status.error if problem else Fmi3Status.ok)
"""


Variables = Sequence[tuple[str, Sequence[str], Callable[[], Array], bool]]


class Packed:
    """Something stepped tick by tick inside an FMU.

    Attributes:
        time: [s] of the tool that steps the FMU; 0 until its first step, since PythonFMU3 does not
            pass the start time on. period: of a tick [s].
    """

    def __init__(self, slave: Any, period: float, variables: Variables) -> None:
        """``variables``: name, parts and present values of each group, whether it is an input."""
        from pythonfmu3 import Float64
        from pythonfmu3 import Fmi3Causality as Causality

        self.time, self.period = 0.0, period
        slave.register_variable(
            Float64("time", causality=Causality.independent, getter=lambda: self.time)
        )
        for group, names, values, settable in variables:
            for i, name in enumerate(names):
                causality = Causality.input if settable else Causality.output
                get, put = _access(values, i)
                ports = {"getter": get, "setter": put if settable else None}
                variable = Float64(f"{group}.{name}", causality=causality, **ports)
                slave.register_variable(variable, nested=False)

    def advance(self, current: float, step: float) -> str:
        """Advance from ``current`` by a communication step [s]; an error message or "": an
        exception would end the tool that steps the FMU.
        """
        ratio = step / self.period
        ticks = round(ratio) if math.isfinite(ratio) else 0
        if ticks < 1 or abs(ratio - ticks) > WHOLE:
            return (
                f"the communication step is not a whole number of ticks (got {step:g} "
                f"s); allowed: multiples of {self.period:g} s"
            )
        try:
            problem = self._run(ticks)
        except HiltestbedError as error:
            return str(error)
        if not problem:
            self.time = current + step
        return problem

    def _run(self, ticks: int) -> str:
        """Advance by whole ticks; returns an error message or ""."""
        raise NotImplementedError


class PackedSide(Packed):
    """The physical side inside an FMU: pose_cmd in, pose_act and wrench_meas out.

    ``side``, made by ``factory``, has the ``period`` of a tick [s], the ``pose`` (7,) reached now,
    the ``wrench`` (6,) that the sensor reads now, and ``step(pose_cmd)``, which advances it by a
    tick at whose end the command is to be reached.
    """

    def __init__(self, slave: Any, factory: str, scenario: Path) -> None:
        self.side = _made(factory)(scenario)
        self._command: Array = np.array(self.side.pose, dtype=float)
        variables: Variables = [
            ("pose_cmd", POSE, lambda: self._command, True),
            ("pose_act", POSE, lambda: self.side.pose, False),
            ("wrench_meas", WRENCH, lambda: self.side.wrench, False),
        ]
        super().__init__(slave, self.side.period, variables)

    def _run(self, ticks: int) -> str:
        length = math.hypot(*self._command[3:])
        # false for NaN as well
        if not (abs(length - 1.0) <= UNIT_LENGTH and np.isfinite(self._command).all()):
            given = ", ".join(f"{value:.6g}" for value in self._command)
            return (
                f"pose_cmd is no pose (got {given}); allowed: finite numbers, and a quaternion of "
                f"length 1 (qx, qy, qz, qw)"
            )
        for _ in range(ticks):
            self.side.step(self._command)
        return ""


class PackedSensor(Packed):
    """A :class:`hiltestbed.sensor.ForceSensor` inside an FMU: wrench in, wrench_meas out."""

    def __init__(self, slave: Any, factory: str, scenario: Path) -> None:
        self.sensor = _made(factory)(scenario)
        self._wrench, self._reading = np.zeros(6), np.zeros(6)
        variables: Variables = [
            ("wrench", WRENCH, lambda: self._wrench, True),
            ("wrench_meas", WRENCH, lambda: self._reading, False),
        ]
        super().__init__(slave, 1.0 / self.sensor.rate, variables)

    def _run(self, ticks: int) -> str:
        if not np.isfinite(self._wrench).all():
            given = ", ".join(f"{value:.6g}" for value in self._wrench)
            return f"wrench is not finite (got {given}); allowed: finite numbers [N, N m]"
        for _ in range(ticks):
            self._reading = self.sensor(self._wrench)
        return ""


def _access(values: Callable[[], Array], i: int) -> tuple[Callable, Callable]:
    """What reads the ``i``-th value, and what sets it."""
    return lambda: float(values()[i]), lambda value: values().__setitem__(i, value)


def _made(factory: str) -> Callable[[Path], Any]:
    """The function named ``module:function``. Raises InputError."""
    module, _, name = factory.partition(":")
    try:
        return attrgetter(name)(import_module(module))
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"physical side: {factory!r} names no function ({error}); give it as module:function"
        ) from None


def pack(
    factory: str,
    scenario: Path,
    folder: Path,
    name: str = "Rig",
    description: str = "hardware-in-the-loop contact rig",
    packed: type[Packed] = PackedSide,
) -> Path:
    """Write ``folder/name.fmu``; returns its path.

    ``factory``: ``module:function``, called inside the FMU with the path of its copy of the
    scenario; returns what ``packed`` packs, a physical side or a force sensor. Raises MissingExtra,
    InputError.
    """
    builder = of_extra("pythonfmu3.builder", "packing an FMU", "fmi").FmuBuilder
    if not name.isidentifier() or not name.isascii():
        raise InputError(
            f"name: is no name of an FMU (got {name!r}); allowed: letters, digits and _, "
            f"beginning with a letter"
        )
    _made(factory)
    with tempfile.TemporaryDirectory() as work:
        script, copied = Path(work) / f"{name.lower()}_slave.py", Path(work) / SCENARIO
        named = {"name": name, "factory": factory, "scenario": SCENARIO, "packed": packed.__name__}
        text = _SCRIPT.format(**named, description=description.replace('"', "'"))
        script.write_text(text, encoding="utf-8")
        shutil.copyfile(scenario, copied)
        return builder.build_FMU(script, folder, [copied])
