"""An FMU of FMI 2.0 or 3.0 for co-simulation, stepped from Python, and the names and units of its
variables.

Modelica Association, "Functional Mock-up Interface Specification", version 3.0, sections 2 and 4.
Reading and stepping is done by FMPy, which comes with the extra ``fmi``.
"""

from __future__ import annotations

import logging
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.config.validation import nearest
from hiltestbed.devices.interface import Array, DeviceError
from hiltestbed.devices.url import refused
from hiltestbed.errors import Fault, InputError, of_extra
from hiltestbed.measured.units import UNITS
from hiltestbed.run_folder.folders import is_file

POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
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
    fmpy = of_extra("fmpy", "stepping an FMU", "fmi")
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
