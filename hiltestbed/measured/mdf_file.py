"""MDF4 (and 3) through asammdf: the clock of each channel is the master of its group."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import BROKEN, Columns, as_numbers, refuse_large, unreadable


def read(path: Path, wanted: Set[str]) -> Columns:
    """The channels ``wanted`` of an MDF file. Raises InputError, also for a wanted name in several
    groups; MissingExtra.
    """
    try:
        from asammdf import MDF
        from asammdf.blocks.utils import MdfException
    except ImportError as error:
        raise MissingExtra(f"{path}: MDF4", "mdf") from error
    try:
        with path.open("rb") as stream, MDF(stream) as file:
            masters = {index for index in file.masters_db.items()}
            places = {
                name: [p for p in found if p not in masters]
                for name, found in file.channels_db.items()
            }
            names = tuple(name for name, found in places.items() if found)
            here = [name for name in names if name in wanted]
            for name in here:
                if len(places[name]) > 1:
                    raise unreadable(
                        path,
                        f"has channel {name!r} in {len(places[name])} groups",
                        "export it once, under one name",
                    )
            refuse_large(
                path,
                max(
                    (file.groups[places[n][0][0]].channel_group.cycles_nr for n in here), default=0
                ),
                2 * len(here),
            )
            signals = {name: file.get(name, *places[name][0]) for name in here}
    except (MdfException, *BROKEN) as error:
        raise unreadable(
            path, f"is not a whole MDF file ({error})", "copy or export it again"
        ) from error
    data = {name: as_numbers(path, name, signal.samples) for name, signal in signals.items()}
    clock = {name: as_numbers(path, name, signal.timestamps) for name, signal in signals.items()}
    return Columns(names, data, clock)
