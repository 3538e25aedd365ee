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
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hiltestbed.config.validation import Strictly, refuse, validate
from hiltestbed.config.yaml_source import Source, read_source
from hiltestbed.devices import poses
from hiltestbed.devices.interface import Array

CODES = {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
CRC = {"crc16": "H", "crc32": "I"}
FORCE = ("fx", "fy", "fz", "tx", "ty", "tz")
POSITION, QUATERNION, ROTATION = ("px", "py", "pz"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz")
# tolerance of a quaternion's length: 32-bit numbers deviate by 1e-7, wrong bytes by more
UNIT_LENGTH = 1e-2
LARGEST = 1472  # [byte] of a record: the payload of one Ethernet frame

Name = Literal[
    "const", "pad", "crc", "sequence", "time", "status", "stop",
    "fx", "fy", "fz", "tx", "ty", "tz", "px", "py", "pz", "qx", "qy", "qz", "qw", "rx", "ry", "rz",
]  # fmt: skip
Type = Literal[
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "float32",
    "float64",
    "crc16",
    "crc32",
]


class FieldOfRecord(Strictly):
    """One field of a record."""

    name: Name
    type: Type
    scale: float = Field(default=1.0, description="SI value of 1 on the wire")
    value: int | None = Field(default=None, description="value of a const field")
    size: int = Field(
        default=1, ge=1, le=256, description="number of fields of this type, for padding"
    )


class Layout(Strictly):
    """The three records; a device needs those for its kind."""

    byte_order: Literal["little", "big"] = "little"
    sensor: list[FieldOfRecord] = Field(default_factory=list)
    state: list[FieldOfRecord] = Field(default_factory=list)
    command: list[FieldOfRecord] = Field(default_factory=list)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        refuse(
            [
                ((record, *path), message)
                for record in ("sensor", "state", "command")
                for path, message in _faults(self, record)
            ]
        )
        return self


def _faults(layout: Layout, record: str) -> list[tuple[tuple, str]]:
    """Faults of a record as a whole: (path below it, message)."""
    fields: list[FieldOfRecord] = getattr(layout, record)
    names = [field.name for field in fields]
    needed = [FORCE] if record == "sensor" else [(*POSITION, *QUATERNION), (*POSITION, *ROTATION)]
    allowed = {
        "const",
        "pad",
        "crc",
        "sequence",
        "time",
        *(("stop",) if record == "command" else ("status",)),
    }.union(*needed)
    found: list[tuple[tuple, str]] = []
    for i, field in enumerate(fields):
        if field.name not in allowed:
            found.append(
                (
                    (i, "name"),
                    f"does not belong in a {record} record (got {field.name!r}); allowed: "
                    f"{', '.join(sorted(allowed))}",
                )
            )
        if field.name not in ("const", "pad") and names.index(field.name) != i:
            found.append(
                ((i, "name"), f"is given twice (got {field.name!r}); each value may stand once")
            )
        if (field.name == "crc") != (field.type in CRC) or (
            field.name == "crc" and i != len(fields) - 1
        ):
            found.append(
                (
                    (i, "type"),
                    f"does not fit (got {field.name!r} of type {field.type!r}); a crc is the last "
                    f"field, of crc16 or crc32",
                )
            )
        if (field.name == "const") != (field.value is not None) or (
            field.name == "const" and not _fits(field)
        ):
            found.append(
                (
                    (i,),
                    "a const field needs a whole number as value that fits its type, and no other "
                    "field has a value",
                )
            )
        if field.name in ("sequence", "status", "stop") and not field.type.startswith("uint"):
            found.append(
                (
                    (i, "type"),
                    f"does not fit {field.name} (got {field.type!r}); allowed: uint8, uint16, "
                    f"uint32, uint64",
                )
            )
        if field.scale == 0.0:
            found.append(((i, "scale"), "is 0; the value would be lost"))
        if field.size != 1 and field.name != "pad":
            found.append(
                (
                    (i, "size"),
                    f"is only for padding (got {field.size}); give each value its own field",
                )
            )
    if fields and not any(set(group) <= set(names) for group in needed):
        found.append(
            (
                (),
                f"is incomplete (got {', '.join(names)}); needed: "
                f"{' or '.join(' '.join(group) for group in needed)}",
            )
        )
    return found


def _fits(field: FieldOfRecord) -> bool:
    if field.value is None or field.type in ("float32", "float64") or field.type in CRC:
        return False
    try:
        struct.pack("<" + CODES[field.type], field.value)
    except struct.error:
        return False
    return True


def read_layout(path: str | Path) -> Layout:
    """The layout in a YAML file. Raises InputError with every fault, by line and column."""
    return validate(Layout, read_source(path))


def _default() -> dict[str, Any]:
    head = [{"name": "sequence", "type": "uint32"}, {"name": "time", "type": "float64"}]
    tail = [{"name": "crc", "type": "crc32"}]
    values = {"sensor": FORCE, "state": POSITION + QUATERNION, "command": POSITION + QUATERNION}
    flags = {"sensor": "status", "state": "status", "command": "stop"}
    return {
        record: [
            *head,
            {"name": flags[record], "type": "uint32"},
            *({"name": n, "type": "float64"} for n in names),
            *tail,
        ]
        for record, names in values.items()
    }


def default_layout() -> Layout:
    """Little endian: sequence uint32, time float64 [s], status (command: stop) uint32, the values
    float64, crc32.
    """
    return validate(Layout, Source("the default layout", _default()))


class Record:
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

    def __init__(self, layout: Layout, kind: Literal["sensor", "state", "command"]) -> None:
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
        self.sequence_bits, self.clock_bits = (
            sum(
                8 * struct.calcsize(CODES[field.type])
                for field in body
                if field.name == name and field.type.startswith("uint")
            )
            for name in ("sequence", "time")
        )
        self._names = (
            FORCE
            if kind == "sensor"
            else POSITION + (QUATERNION if "qw" in {f.name for f in body} else ROTATION)
        )
        self._turned = self._names[-1] == "rz" and kind != "sensor"
        self._flag = "stop" if kind == "command" else "status"
        self.sequence, self.time, self.flag = 0, math.nan, 0
        self.clock: float | None = None
        self.values: Array = np.zeros(6 if kind == "sensor" else 7)

    def unpack(self, data: bytes | bytearray | memoryview) -> bool:
        """Unpack a record; for anything else return False and change nothing."""
        if len(data) != self.size:
            return False
        if self._crc is not None and self._crc.unpack_from(data, self._body.size)[0] != self._check(
            data[: self._body.size]
        ):
            return False
        wire = self._body.unpack_from(data)
        found, clock = {}, None
        for field, raw in zip(self._fields, wire, strict=True):
            if field.name == "const":
                if raw != field.value:
                    return False
                continue
            found[field.name] = (
                raw if field.name in ("sequence", "status", "stop") else raw * field.scale
            )
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
        self.sequence, self.time, self.flag = (
            found.get("sequence", self.sequence + 1),
            time,
            found.get(self._flag, 0),
        )
        return True

    def pack(self, values: Array, sequence: int, time: float, flag: int = 0) -> bytes:
        """The record of a wrench (6,) or a pose (7,); an integer field is rounded, and clipped at
        its limits.
        """
        values = poses.rotation_vector_from_pose(values) if self._turned else values
        known = dict(zip(self._names, values.tolist(), strict=True)) | {
            "time": time,
            "sequence": sequence,
            self._flag: flag,
        }
        body = self._body.pack(*(_on_wire(field, known) for field in self._fields))
        return body + self._crc.pack(self._check(body)) if self._crc else body

    def _check(self, body: bytes | bytearray | memoryview) -> int:
        return zlib.crc32(body) if self._wide else binascii.crc_hqx(body, 0xFFFF)


def _on_wire(field: FieldOfRecord, known: dict[str, float]) -> float | int:
    if field.name == "const":
        return field.value or 0
    if field.name in ("sequence", "status", "stop"):
        return int(known[field.name]) & ((1 << 8 * struct.calcsize(CODES[field.type])) - 1)
    value = known[field.name] / field.scale
    if field.type.startswith("float"):
        return value
    bits = 8 * struct.calcsize(CODES[field.type])
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1)
        if field.type.startswith("int")
        else (0, (1 << bits) - 1)
    )
    return min(max(round(value), low), high) if math.isfinite(value) else 0
