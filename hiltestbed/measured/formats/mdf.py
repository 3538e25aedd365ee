"""MDF4 (and 3) through asammdf: the clock of each channel is the master of its group."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Any, ClassVar, Literal

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import (
    Arrays,
    Columns,
    as_numbers,
    is_under,
    refuse_large,
    unreadable,
    whole,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register


@register
class Mdf(DataFormat):
    """ASAM MDF 3 and 4: channels and arrays of channels, with their units."""

    kind: Literal["mdf"] = "mdf"
    suffixes: ClassVar[tuple[str, ...]] = (".mf4", ".mdf")

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The channels ``wanted``. Raises InputError, also if in several groups; MissingExtra."""
        try:
            from asammdf import MDF
            from asammdf.blocks.utils import MdfException
        except ImportError as error:
            raise MissingExtra(f"{path}: MDF4", "mdf") from error
        with whole(path, "MDF", "copy or export it again", MdfException):
            with path.open("rb") as stream, MDF(stream) as file:
                masters = {index for index in file.masters_db.items()}
                places = {
                    name: [p for p in found if p not in masters]
                    for name, found in file.channels_db.items()
                }
                names = [name for name, found in places.items() if found]
                here = [name for name in names if any(is_under(w, name) for w in wanted)]
                for name in here:
                    if len(places[name]) > 1:
                        what = f"has channel {name!r} in {len(places[name])} groups"
                        raise unreadable(path, what, "export it once, under one name")
                rows = (file.groups[places[n][0][0]].channel_group.cycles_nr for n in here)
                refuse_large(path, max(rows, default=0), 2 * len(here))
                signals = {name: file.get(name, *places[name][0]) for name in here}
            return _columns(path, wanted, names, signals)


def _columns(path: Path, wanted: Set[str], names: list[str], signals: dict[str, Any]) -> Columns:
    arrays, clock = Arrays(), {}
    for name, signal in signals.items():
        samples, before = signal.samples, set(arrays.places)
        if samples.dtype.names:  # an array of channels: its values are the field of its own name
            samples = samples[samples.dtype.names[0]]
        arrays.add(name, samples, signal.unit or "")
        stamps = as_numbers(path, name, signal.timestamps)
        clock |= {column: stamps for column in arrays.places if column not in before}
    found = arrays.columns(path, wanted, (name for name in names if name not in arrays.places))
    found.clock = {name: clock[name] for name in found.data if name in clock}
    return found
