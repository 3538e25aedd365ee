"""FMI 3.0 for co-simulation: the physical side packed as an FMU, and a user's FMU stepped from
Python.

Modelica Association, "Functional Mock-up Interface Specification", version 3.0, sections 2 and 4.
Packing is done by PythonFMU3, reading and stepping by FMPy; both come with the extra ``fmi``. A
packed FMU holds neither Python nor hiltestbed: the tool that loads it must be able to load a Python
in which hiltestbed is installed (on Linux, with its libpython among the global symbols).

Inputs are held over a communication step, outputs are those at its end. A tool that exchanges them
once per step therefore adds up to one communication step of delay to the loop.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hiltestbed.config.validation import nearest
from hiltestbed.devices.interface import Array, DeviceError
from hiltestbed.errors import Fault, HiltestbedError, InputError, MissingExtra
from hiltestbed.run_folder.folders import is_file

POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
WHOLE = 1e-6  # of a tick: largest deviation of a communication step from a whole number of ticks
SCENARIO = "scenario.yaml"  # its name among the FMU's resources

_SCRIPT = """\
from pathlib import Path

from pythonfmu3 import Fmi3Slave, Fmi3Status, Fmi3StepResult

from hiltestbed.devices.fmu import PackedSide


class {name}(Fmi3Slave):
    description = "{description}"
    generation = "hiltestbed"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.side = PackedSide(self, "{factory}", Path(self.resources) / "{scenario}")

    def do_step(self, current_time, step_size):
        problem = self.side.advance(step_size)
        if problem:
            self.log(problem, Fmi3Status.error)
        return Fmi3StepResult(status=Fmi3Status.error if problem else Fmi3Status.ok)
"""


class PhysicalSide(Protocol):
    """The physical side to be packed: rig, mechanism and force sensor, stepped tick by tick.

    Attributes:
        period: of a tick [s].
        pose: (7,) reached now. wrench: (6,) that the sensor reads now.
    """

    period: float
    pose: Array
    wrench: Array

    def step(self, pose_cmd: Array) -> None:
        """Advance by one tick, at whose end ``pose_cmd`` (7,) is to be reached."""
        ...


class PackedSide:
    """The physical side inside an FMU: registers its variables with the slave and steps it."""

    def __init__(self, slave: Any, factory: str, scenario: Path) -> None:
        self.side = _made(factory)(scenario)
        self._command: Array = np.array(self.side.pose, dtype=float)
        self._register(slave)

    def advance(self, step: float) -> str:
        """Advance by a communication step [s]; returns an error message or "", since an exception
        would end the tool that steps the FMU.
        """
        ticks = round(step / self.side.period)
        if ticks < 1 or abs(step / self.side.period - ticks) > WHOLE:
            return (
                f"the communication step is not a whole number of ticks (got {step:g} "
                f"s); allowed: multiples of {self.side.period:g} s"
            )
        try:
            for _ in range(ticks):
                self.side.step(self._command)
        except HiltestbedError as error:
            return str(error)
        return ""

    def _register(self, slave: Any) -> None:
        from pythonfmu3 import Float64, Fmi3Causality

        self.time = 0.0
        slave.register_variable(
            Float64("time", causality=Fmi3Causality.independent, getter=lambda: self.time)
        )
        groups: list[tuple[str, Sequence[str], Callable[[], Array], bool]] = [
            ("pose_cmd", POSE, lambda: self._command, True),
            ("pose_act", POSE, lambda: self.side.pose, False),
            ("wrench_meas", WRENCH, lambda: self.side.wrench, False),
        ]
        for group, names, values, settable in groups:
            for i, name in enumerate(names):
                causality = Fmi3Causality.input if settable else Fmi3Causality.output
                setter = _setter(values, i) if settable else None
                slave.register_variable(
                    Float64(
                        f"{group}.{name}",
                        causality=causality,
                        getter=_getter(values, i),
                        setter=setter,
                    ),
                    nested=False,
                )


def _getter(values: Callable[[], Array], i: int) -> Callable[[], float]:
    return lambda: float(values()[i])


def _setter(values: Callable[[], Array], i: int) -> Callable[[float], None]:
    return lambda value: values().__setitem__(i, value)


def _made(factory: str) -> Callable[[Path], PhysicalSide]:
    """The function named ``module:function``. Raises InputError."""
    module, _, name = factory.partition(":")
    try:
        return getattr(import_module(module), name)
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
) -> Path:
    """Write ``folder/name.fmu``; returns its path.

    Args:
        factory: ``module:function``, called inside the FMU with the path of its copy of the
            scenario; returns a
            :class:`PhysicalSide`.

    Raises:
        MissingExtra, InputError.
    """
    if find_spec("pythonfmu3") is None:
        raise MissingExtra("packing an FMU", "fmi")
    from pythonfmu3.builder import FmuBuilder

    if not name.isidentifier() or not name.isascii():
        raise InputError(
            f"name: is no name of an FMU (got {name!r}); allowed: letters, digits and _, "
            f"beginning with a letter"
        )
    _made(factory)
    with tempfile.TemporaryDirectory() as work:
        script = Path(work) / f"{name.lower()}_slave.py"
        text = _SCRIPT.format(
            name=name, factory=factory, scenario=SCENARIO, description=description.replace('"', "'")
        )
        script.write_text(text, encoding="utf-8")
        copied = Path(work) / SCENARIO
        shutil.copyfile(scenario, copied)
        return FmuBuilder.build_FMU(script, folder, [copied])


class CoSimulation:
    """An FMU that is stepped from Python: ``open``, then ``step`` by ``step``, then ``close``."""

    def __init__(self, path: Path, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """``inputs`` and ``outputs``: names of Float64 variables of the FMU. Raises MissingExtra;
        InputError with every fault.
        """
        if find_spec("fmpy") is None:
            raise MissingExtra("stepping an FMU", "fmi")
        self.path = path
        self._description = _described(path)
        self._inputs = self._references(inputs, "input")
        self._outputs = self._references(outputs, "output")
        self._slave: Any = None
        self._unpacked = ""
        self._time = 0.0

    def open(self) -> None:
        """Unpack and start at time 0. Raises DeviceError if the FMU does not start."""
        import fmpy
        from fmpy.fmi3 import FMU3Slave

        self._unpacked = fmpy.extract(str(self.path))
        identifier = self._description.coSimulation.modelIdentifier
        self._time = 0.0
        try:
            self._slave = FMU3Slave(
                guid=self._description.guid,
                unzipDirectory=self._unpacked,
                modelIdentifier=identifier,
                instanceName=identifier,
            )
            self._slave.instantiate(logMessage=_silent)
            self._slave.enterInitializationMode(startTime=0.0)
            self._slave.exitInitializationMode()
        except Exception as error:  # FMPy raises no narrower class
            self._slave = None
            self.close()
            raise DeviceError(
                f"{self.path}: the FMU does not start ({error}); check what its exporting tool "
                f"requires"
            ) from error

    def step(self, values: Array, period: float) -> Array:
        """Set the inputs, step by ``period`` [s], and return the outputs at its end. Raises
        DeviceError if the FMU fails.
        """
        from fmpy.fmi1 import FMICallException

        if self._slave is None:
            raise DeviceError(f"{self.path}: is not open")
        try:
            self._slave.setFloat64(self._inputs, values.tolist())
            self._slave.doStep(self._time, period)
            outputs = np.array(self._slave.getFloat64(self._outputs))
        except FMICallException as error:
            # after an error the FMU must not be called again, not even to terminate it
            self._slave = None
            raise DeviceError(
                f"{self.path}: the FMU failed at t = {self._time:.6f} s ({error})"
            ) from None
        self._time += period
        if not all(map(math.isfinite, outputs)):
            raise DeviceError(
                f"{self.path}: the FMU gave a value that is not finite at t = {self._time:.6f} s"
            )
        return outputs

    def outputs(self) -> Array:
        """The present outputs. Raises DeviceError."""
        if self._slave is None:
            raise DeviceError(f"{self.path}: is not open")
        return np.array(self._slave.getFloat64(self._outputs))

    def close(self) -> None:
        """Terminate the FMU and remove the unpacked files; may be called twice."""
        if self._slave is not None:
            self._slave.terminate()
            self._slave.freeInstance()
            self._slave = None
        if self._unpacked:
            shutil.rmtree(self._unpacked, ignore_errors=True)
            self._unpacked = ""

    def __enter__(self) -> CoSimulation:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _references(self, names: Sequence[str], causality: str) -> list[int]:
        known = {
            v.name: v
            for v in self._description.modelVariables
            if v.causality == causality and v.type == "Float64"
        }
        faults = []
        for name in names:
            if name not in known:
                message = (
                    f"is no {causality} of type Float64{nearest(name, known)}; "
                    f"allowed: {', '.join(known) or 'none'}"
                )
                faults.append(Fault(str(self.path), None, None, name, message))
        if faults:
            raise InputError(faults)
        return [known[name].valueReference for name in names]


def _silent(*_: object) -> None:
    """Discard an FMU's log messages."""


def _described(path: Path) -> Any:
    """The description of an FMU that can be stepped here. Raises InputError with every problem that
    FMPy finds.
    """
    import fmpy
    from fmpy.validation import validate_fmu

    if not is_file(path) or not zipfile.is_zipfile(path):
        raise InputError(
            Fault(
                str(path),
                None,
                None,
                "",
                "is not an FMU; give a file that a simulation tool has exported",
            )
        )
    problems = validate_fmu(str(path))
    if problems:
        raise InputError(
            [Fault(str(path), None, None, "modelDescription", str(problem)) for problem in problems]
        )
    description: Any = fmpy.read_model_description(str(path), validate=False)
    if description.fmiVersion != "3.0" or description.coSimulation is None:
        message = (
            f"is not an FMU of FMI 3.0 for co-simulation (got FMI "
            f"{description.fmiVersion}); export it as one"
        )
        raise InputError(Fault(str(path), None, None, "", message))
    if fmpy.platform not in fmpy.supported_platforms(str(path)):
        have = ", ".join(fmpy.supported_platforms(str(path))) or "none"
        raise InputError(
            Fault(
                str(path),
                None,
                None,
                "",
                f"has no binary for {fmpy.platform} (got {have}); export it for this platform",
            )
        )
    return description
