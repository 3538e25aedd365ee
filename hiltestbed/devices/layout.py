"""Records with a user-defined layout, described field by field in the order of transmission.

    byte_order: little                          # little | big
    sensor:
      - {name: const, type: uint16, value: 0x5AA5}      # every record must begin with this
      - {name: sequence, type: uint32}
      - {name: time, type: uint32, scale: 1.0e-6}       # SI = scale * what is on the wire: here
        microseconds
      - {name: status, type: uint16}                    # 0: no error
      - {name: fx, type: float32}                       # ... fy fz tx ty tz [N, N m]
      - {name: pad, type: uint8, size: 2}               # unused bytes
      - {name: crc, type: crc32}                        # crc32 (IEEE 802.3) | crc16 (CCITT, from
        0xFFFF), over all before it
    state:   [...]   # px py pz [m] and qx qy qz qw, or rx ry rz (a rotation vector) [rad]
    command: [...]   # as for state, and stop: 0 continue, 1 stop

Fields that are absent are not checked: without ``sequence`` lost records are not detected, without
``crc`` damaged ones are not.
"""

from __future__ import annotations

import binascii
import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from hiltestbed.config.validation import Strictly, refuse, validate
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.devices import poses
from hiltestbed.devices.interface import UNIT_LENGTH, Array

Whole = Literal["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]
Real = Literal["float32", "float64"]
Check = Literal["crc16", "crc32"]
REALS = get_args(Real)
CODES = dict(zip((*get_args(Whole), *REALS), "bBhHiIqQfd", strict=True))  # of struct
CRC = dict(zip(get_args(Check), "HI", strict=True))
FORCE = ("fx", "fy", "fz", "tx", "ty", "tz")
POSITION, QUATERNION, ROTATION = ("px", "py", "pz"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz")
COUNTED = ("sequence", "status", "stop")  # sent as they are, without a scale
LARGEST = 1472  # [byte] of a record: the payload of one Ethernet frame

Name = Literal[
    "const", "pad", "crc", "sequence", "time", "status", "stop",
    "fx", "fy", "fz", "tx", "ty", "tz", "px", "py", "pz", "qx", "qy", "qz", "qw", "rx", "ry", "rz",
]  # fmt: skip
RecordKind = Literal["sensor", "state", "command"]


class FieldOfRecord(Strictly):
    """One field of a record."""

    name: Name
    type: Literal[Whole, Real, Check]
    scale: float = 1.0  # SI value of 1 on the wire
    value: int | None = None  # of a const field
    size: int = Field(default=1, ge=1, le=256)  # number of fields of this type, for padding


class Layout(Strictly):
    """The three records; a device needs those for its kind."""

    byte_order: Literal["little", "big"] = "little"
    sensor: list[FieldOfRecord] = []
    state: list[FieldOfRecord] = []
    command: list[FieldOfRecord] = []

    @model_validator(mode="after")
    def _whole(self) -> Self:
        refuse(
            ((record, *path), message)
            for record in get_args(RecordKind)
            for path, message in _faults(self, record)
        )
        return self


def _faults(layout: Layout, record: RecordKind) -> Iterator[tuple[tuple, str]]:
    """Faults of a record as a whole: (path below it, message)."""
    fields: list[FieldOfRecord] = getattr(layout, record)
    names = [field.name for field in fields]
    needed = [FORCE] if record == "sensor" else [(*POSITION, *QUATERNION), (*POSITION, *ROTATION)]
    flag = "stop" if record == "command" else "status"
    allowed = {"const", "pad", "crc", "sequence", "time", flag}.union(*needed)
    for i, field in enumerate(fields):
        name, kind, crc, const = field.name, field.type, field.name == "crc", field.name == "const"
        if name not in allowed:
            yield (
                (i, "name"),
                f"does not belong in a {record} record (got {name!r}); allowed: "
                f"{', '.join(sorted(allowed))}",
            )
        if name not in ("const", "pad") and names.index(name) != i:
            yield (i, "name"), f"is given twice (got {name!r}); each value may stand once"
        if crc != (kind in CRC) or (crc and i != len(fields) - 1):
            yield (
                (i, "type"),
                f"does not fit (got {name!r} of type {kind!r}); a crc is the last field, of crc16 "
                f"or crc32",
            )
        low, high = _range(kind) if kind in get_args(Whole) else (0, -1)
        if const != (field.value is not None) or (const and not low <= (field.value or 0) <= high):
            yield (
                (i,),
                "a const field needs a whole number as value that fits its type, and no other "
                "field has a value",
            )
        if name in COUNTED and not kind.startswith("uint"):
            allowed_types = ", ".join(t for t in CODES if t.startswith("uint"))
            yield (i, "type"), f"does not fit {name} (got {kind!r}); allowed: {allowed_types}"
        if field.scale == 0.0:
            yield (i, "scale"), "is 0; the value would be lost"
        if field.size != 1 and name != "pad":
            yield (
                (i, "size"),
                f"is only for padding (got {field.size}); give each value its own field",
            )
    if fields and not any(set(group) <= set(names) for group in needed):
        groups = " or ".join(" ".join(group) for group in needed)
        yield (), f"is incomplete (got {', '.join(names)}); needed: {groups}"


def _range(kind: str) -> tuple[int, int]:
    """Smallest and largest number of a type of whole numbers."""
    return int(np.iinfo(kind).min), int(np.iinfo(kind).max)


def read_layout(path: str | Path) -> Layout:
    """The layout in a YAML file. Raises InputError with every fault, by line and column."""
    return validate(Layout, read_source(path))


def default_layout() -> Layout:
    """Little endian: sequence uint32, time float64 [s], status (command: stop) uint32, the values
    float64, crc32.
    """

    def record(flag: str, names: tuple[str, ...]) -> list[dict[str, str]]:
        types = {"sequence": "uint32", "time": "float64", flag: "uint32"}
        types |= dict.fromkeys(names, "float64") | {"crc": "crc32"}
        return [{"name": name, "type": kind} for name, kind in types.items()]

    pose = POSITION + QUATERNION
    data = {
        "sensor": record("status", FORCE),
        "state": record("status", pose),
        "command": record("stop", pose),
    }
    return validate(Layout, Source("the default layout", data))


class WireRecord:
    """One record, ready to be packed and unpacked.

    Attributes:
        size: of the record [byte].
        sequence_bits: width of the counter; 0 if there is none.
        clock_bits: width of the time on the wire if it is an unsigned counter, which wraps; else 0.
        sequence, time, flag: of the record last unpacked; ``flag`` is the status, or the stop of a
            command.
        clock: the time as on the wire; None if there is none.
        values: (6,) the wrench or (7,) the pose of the record last unpacked, and of the one to
            pack.
    """

    def __init__(self, layout: Layout, kind: RecordKind) -> None:
        fields: list[FieldOfRecord] = getattr(layout, kind)
        crc = CRC.get(fields[-1].type, "") if fields else ""
        body = [field for field in fields if field.name != "crc"]
        prefix = "<" if layout.byte_order == "little" else ">"
        codes = "".join(
            f"{struct.calcsize(CODES[f.type]) * f.size}x" if f.name == "pad" else CODES[f.type]
            for f in body
        )
        self._body = struct.Struct(prefix + codes)
        self._crc = struct.Struct(prefix + crc) if crc else None
        self._wide = crc == "I"
        self._fields = [field for field in body if field.name != "pad"]
        self.size = self._body.size + (self._crc.size if self._crc else 0)
        bits = {f.name: np.iinfo(f.type).bits for f in body if f.type.startswith("uint")}
        self.sequence_bits, self.clock_bits = bits.get("sequence", 0), bits.get("time", 0)
        attitude = QUATERNION if any(f.name == "qw" for f in body) else ROTATION
        self._names = FORCE if kind == "sensor" else POSITION + attitude
        self._turned = self._names[-1] == "rz"
        self._flag = "stop" if kind == "command" else "status"
        self.sequence, self.time, self.flag = 0, math.nan, 0
        self.clock: float | None = None
        self.values: Array = np.zeros(6 if kind == "sensor" else 7)

    def unpack(self, data: bytes | bytearray) -> bool:
        """Unpack a record; for anything else return False and change nothing."""
        if len(data) != self.size:
            return False
        if self._crc is not None:
            (given,) = self._crc.unpack_from(data, self._body.size)
            if given != self._check(data[: self._body.size]):
                return False
        wire = self._body.unpack_from(data)
        found, clock = {}, None
        for field, raw in zip(self._fields, wire, strict=True):
            if field.name == "const":
                if raw != field.value:
                    return False
                continue
            found[field.name] = raw if field.name in COUNTED else raw * field.scale
            clock = raw if field.name == "time" else clock
        values = np.array([found[name] for name in self._names])
        time = found.get("time", math.nan)
        if not np.isfinite(values).all() or not (math.isfinite(time) or clock is None):
            return False
        if self._turned:
            values = poses.pose_from_rotation_vector(values)
        elif len(values) == 7:
            length = math.hypot(*values[3:].tolist())  # of huge components, too
            if abs(length - 1.0) > UNIT_LENGTH:
                return False
            values[3:] /= length
        self.values[:], self.clock = values, clock
        self.sequence = found.get("sequence", self.sequence + 1)
        self.time, self.flag = time, found.get(self._flag, 0)
        return True

    def pack(self, values: Array, sequence: int, time: float, flag: int = 0) -> bytes:
        """The record of a wrench (6,) or pose (7,); integers are rounded and clipped."""
        values = poses.rotation_vector_from_pose(values) if self._turned else values
        known = dict(zip(self._names, values.tolist(), strict=True))
        known |= {"time": time, "sequence": sequence, self._flag: flag}
        body = self._body.pack(*(_on_wire(field, known) for field in self._fields))
        return body + self._crc.pack(self._check(body)) if self._crc else body

    def _check(self, body: bytes | bytearray) -> int:
        return zlib.crc32(body) if self._wide else binascii.crc_hqx(body, 0xFFFF)


def _on_wire(field: FieldOfRecord, known: dict[str, float]) -> float | int:
    if field.name == "const":
        return field.value or 0
    if field.name in COUNTED:
        return int(known[field.name]) & _range(field.type)[1]
    value = known[field.name] / field.scale
    if field.type in REALS:
        return value
    low, high = _range(field.type)
    return min(max(round(value), low), high) if math.isfinite(value) else 0
