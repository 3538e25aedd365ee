"""FMI for co-simulation: the physical side, or the force sensor alone, packed as an FMU of FMI 3.0,
and a user's FMU of FMI 2.0 or 3.0 stepped from Python.

Modelica Association, "Functional Mock-up Interface Specification", version 3.0, sections 2 and 4.
Packing is done by PythonFMU3, reading and stepping by FMPy; both come with the extra ``fmi``. A
packed FMU holds neither Python nor hiltestbed: the tool that loads it must be able to load a Python
in which hiltestbed is installed (on Linux, with its libpython among the global symbols).

Inputs are held over a communication step, outputs are those at its end. A tool that exchanges them
once per step therefore adds up to one communication step of delay to the loop.
"""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.config.validation import nearest
from hiltestbed.devices.interface import Array, DeviceError
from hiltestbed.devices.layout import UNIT_LENGTH
from hiltestbed.devices.url import refused
from hiltestbed.errors import Fault, HiltestbedError, InputError, MissingExtra
from hiltestbed.measured.units import UNITS
from hiltestbed.run_folder.folders import is_file

POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
WHOLE = 1e-6  # of a tick: largest deviation of a communication step from a whole number of ticks
SCENARIO = "scenario.yaml"  # its name among the FMU's resources
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
# SI unit by the last part of a variable's name
SI = (
    dict.fromkeys(POSE[:3], "m")
    | dict.fromkeys(POSE[3:], "1")
    | dict.fromkeys(WRENCH[:3], "N")
    | dict.fromkeys(WRENCH[3:], "N m")
    | dict.fromkeys(TWIST[:3], "m/s")
    | dict.fromkeys(TWIST[3:], "rad/s")
)
BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
DIMENSIONS = {  # exponents of the base units
    "1": (0,) * 7,
    "m": (0, 1, 0, 0, 0, 0, 0),
    "m/s": (0, 1, -1, 0, 0, 0, 0),
    "rad/s": (0, 0, -1, 0, 0, 0, 0),
    "N": (1, 1, -2, 0, 0, 0, 0),
    "N m": (1, 2, -2, 0, 0, 0, 0),
}
WARNING = 1  # fmi3Status, fmi2Status
# calls that return such a status while the FMU runs
STATUS_CALLS = (
    *("fmi3DoStep", "fmi3SetFloat64", "fmi3GetFloat64"),
    *("fmi2DoStep", "fmi2SetReal", "fmi2GetReal"),
)
_LOG = logging.getLogger(__name__)

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
        script, copied = Path(work) / f"{name.lower()}_slave.py", Path(work) / SCENARIO
        named = {"name": name, "factory": factory, "scenario": SCENARIO, "packed": packed.__name__}
        text = _SCRIPT.format(**named, description=description.replace('"', "'"))
        script.write_text(text, encoding="utf-8")
        shutil.copyfile(scenario, copied)
        return FmuBuilder.build_FMU(script, folder, [copied])


class CoSimulation:
    """An FMU that is stepped from Python: ``open``, then ``step`` by ``step``, then ``close``.

    Attributes:
        time: [s] up to which the FMU has been stepped. ended: [s] when it has ended the simulation
            (terminateSimulation); None: it has not.
    """

    def __init__(
        self,
        path: Path,
        inputs: Sequence[str],
        outputs: Sequence[str],
        parameters: Sequence[str] = (),
    ) -> None:
        """``inputs``, ``outputs`` and ``parameters``: names of Float64 (FMI 2.0: Real) variables,
        whose last part tells the quantity (:data:`SI`), set and returned in SI. Raises
        MissingExtra; InputError with every fault.
        """
        self.path = path
        self._description = described(path)
        self._inputs, self._in_unit = self._references(inputs, "input")
        self._outputs, self._out_unit = self._references(outputs, "output")
        self._parameters, self._parameter_unit = self._references(parameters, "parameter")
        self._slave: Any = None
        self._unpacked = ""
        self.time = 0.0
        self.ended: float | None = None

    def open(self, parameters: Sequence[float] = ()) -> None:
        """Unpack and start at time 0 with values of the parameters. Raises DeviceError if the FMU
        does not start.
        """
        import fmpy
        from fmpy import fmi2
        from fmpy.fmi3 import FMU3Slave

        simulation, said = self, set()
        second = self._description.fmiVersion == "2.0"
        base: Any = fmi2.FMU2Slave if second else FMU3Slave

        class Slave(base):
            """Logs what the FMU warns of, once each."""

            def _call(self, fname: str, *args: Any) -> Any:
                status = super()._call(fname, *args)
                if status == WARNING and fname in STATUS_CALLS and fname not in said:
                    said.add(fname)
                    _LOG.warning(
                        f"{simulation.path}: {fname} returned a warning at t = "
                        f"{simulation.time:.6f} s; its results are used, further warnings of this "
                        f"call are not reported"
                    )
                return status

        Slave.__name__ = base.__name__  # by which FMPy tells the version
        if second:  # FMI 2.0 by the names of 3.0
            Slave.setFloat64, Slave.getFloat64 = base.setReal, base.getReal
            Slave.doStep = lambda slave, t, h: (base.doStep(slave, t, h), False, False, t + h)
        self._unpacked = fmpy.extract(str(self.path))
        identifier = self._description.coSimulation.modelIdentifier
        self.time, self.ended = 0.0, None
        try:
            self._slave = Slave(
                guid=self._description.guid,
                unzipDirectory=self._unpacked,
                modelIdentifier=identifier,
                instanceName=identifier,
            )
            if second:
                quiet = fmi2.fmi2CallbackFunctions()
                quiet.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *_: None)
                quiet.allocateMemory = fmi2.defaultCallbacks.allocateMemory
                quiet.freeMemory = fmi2.defaultCallbacks.freeMemory
                self._slave.instantiate(callbacks=quiet)
                self._slave.setupExperiment(startTime=0.0)
            else:
                self._slave.instantiate(logMessage=lambda *_: None)
            if self._parameters:
                factor, offset = self._parameter_unit
                told = (np.asarray(parameters) - offset) / factor
                self._slave.setFloat64(self._parameters, told.tolist())
            self._slave.enterInitializationMode(**({} if second else {"startTime": 0.0}))
            self._slave.exitInitializationMode()
        except Exception as error:  # FMPy raises no narrower class
            self._slave = None
            self.close()
            raise DeviceError(
                f"{self.path}: the FMU does not start ({error}); check what its exporting tool "
                f"requires"
            ) from error

    def step(self, values: Array, period: float) -> Array:
        """Set the inputs, step by ``period`` [s], and return the outputs at its end, or where the
        FMU has ended the simulation. Raises DeviceError if it fails, or has ended it before.
        """
        if self.ended is not None:
            raise self._failure(f"has ended the simulation at t = {self.ended:.6f} s")
        with self._obeyed() as slave:
            factor, offset = self._in_unit
            slave.setFloat64(self._inputs, ((values - offset) / factor).tolist())
            self._advance(slave, period)
        return self.outputs()

    def _advance(self, slave: Any, period: float) -> None:
        """Step by ``period`` [s], in parts where the FMU returns early."""
        early, until, left = True, self.time + period, period
        while early and self.ended is None:
            _, ended, early, last = slave.doStep(self.time, left)
            if ended:
                self.time = self.ended = last if self.time <= last <= until else until
            elif not early or last >= until:
                self.time, early = until, False
            elif last > self.time:
                self.time, left = last, until - last
            else:
                raise self._failure(
                    f"returned early at t = {self.time:.6f} s without having advanced; it cannot "
                    f"be stepped to {until:.6f} s"
                )

    def outputs(self) -> Array:
        """The present outputs, in SI. Raises DeviceError."""
        with self._obeyed() as slave:
            factor, offset = self._out_unit
            outputs = np.array(slave.getFloat64(self._outputs)) * factor + offset
        if not np.isfinite(outputs).all():
            raise self._failure(f"gave a value that is not finite at t = {self.time:.6f} s")
        return outputs

    def _failure(self, what: str) -> DeviceError:
        return DeviceError(f"{self.path}: the FMU {what}")

    @contextmanager
    def _obeyed(self) -> Iterator[Any]:
        """The instance, for calls whose status is obeyed: discard, error and fatal end it."""
        from fmpy.fmi1 import FMICallException

        if self._slave is None:
            raise DeviceError(f"{self.path}: is not open")
        try:
            yield self._slave
        except FMICallException as error:
            # after an error the FMU must not be called again, not even to terminate it
            self._slave = None
            raise self._failure(f"failed at t = {self.time:.6f} s ({error})") from None

    def close(self) -> None:
        """Terminate the FMU and remove the unpacked files; may be called twice."""
        if self._slave is not None:
            with suppress(DeviceError), self._obeyed() as slave:
                slave.terminate()
                slave.freeInstance()
            self._slave = None
        if self._unpacked:
            shutil.rmtree(self._unpacked, ignore_errors=True)
            self._unpacked = ""

    def __enter__(self) -> CoSimulation:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _references(
        self, names: Sequence[str], causality: str
    ) -> tuple[list[int], tuple[Array, Array]]:
        """Value references, and factors and offsets (n,) from the FMU's units to SI."""
        known = {
            v.name: v
            for v in self._description.modelVariables
            if v.causality == causality and v.type in ("Float64", "Real")
        }
        faults, units = [], {}
        for name in names:
            try:
                if name not in known:
                    raise ValueError(
                        f"is no {causality} of type Float64{nearest(name, known)}; allowed: "
                        f"{', '.join(known) or 'none'}"
                    )
                if getattr(known[name], "dimensions", None):
                    raise ValueError("is an array; allowed is a single number")
                units[name] = self._unit(known[name])
            except ValueError as error:
                faults.append(Fault(str(self.path), None, None, name, str(error)))
        if faults:
            raise InputError(faults)
        to_si = np.array([units[name] for name in names]).reshape(-1, 2)
        return [known[name].valueReference for name in names], (to_si[:, 0], to_si[:, 1])

    def _unit(self, variable: Any) -> tuple[float, float]:
        """Factor and offset from the unit in which a variable is declared to SI (FMI 3.0, section
        2.4.3); ``displayUnit`` is not the unit. Raises ValueError for a unit of something else.
        """
        declared = variable.declaredType
        unit = variable.unit or (declared.unit if declared is not None else None)
        si = SI.get(variable.name.rpartition(".")[2])
        if unit is None or si is None:
            return 1.0, 0.0
        base = {d.name: d.baseUnit for d in self._description.unitDefinitions}.get(unit)
        if base is None:  # defined by its name only
            factor = UNITS.get(si, {}).get(unit.replace(".", " "))
            if factor is None:
                raise ValueError(
                    f"has the unit {unit!r}, which the FMU does not define by base units; define "
                    f"it there (BaseUnit), or declare {si}"
                )
            return factor, 0.0
        # a plane angle is a ratio: rad may be given or not
        exponents = tuple(getattr(base, name) for name in BASE)
        if exponents != DIMENSIONS[si]:
            given = " ".join(f"{n}^{e}" for n, e in zip(BASE, exponents, strict=True) if e) or "1"
            raise ValueError(
                f"has the unit {unit!r} ({given}), which is no unit of this quantity; declare it "
                f"in {si}, or a multiple of it"
            )
        relative = variable.relativeQuantity or getattr(declared, "relativeQuantity", None)
        return float(base.factor), 0.0 if relative else float(base.offset)


def described(path: Path) -> Any:
    """The description of an FMU that can be stepped here. Raises MissingExtra; InputError with
    every problem.
    """
    if find_spec("fmpy") is None:
        raise MissingExtra("stepping an FMU", "fmi")
    import fmpy
    from fmpy.validation import validate_fmu

    if not is_file(path) or not zipfile.is_zipfile(path):
        raise refused(str(path), "is not an FMU; give a file that a simulation tool has exported")
    problems = validate_fmu(str(path))
    if problems:
        raise InputError(Fault(str(path), None, None, "modelDescription", str(p)) for p in problems)
    description: Any = fmpy.read_model_description(str(path), validate=False)
    if description.fmiVersion not in ("2.0", "3.0") or description.coSimulation is None:
        message = (
            f"is not an FMU of FMI 2.0 or 3.0 for co-simulation (got FMI "
            f"{description.fmiVersion}); export it as one"
        )
        raise refused(str(path), message)
    have = fmpy.supported_platforms(str(path))
    if fmpy.platform not in have:
        given = ", ".join(have) or "none"
        message = f"has no binary for {fmpy.platform} (got {given}); export it for this platform"
        raise refused(str(path), message)
    return description
