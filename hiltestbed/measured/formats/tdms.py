"""TDMS through npTDMS: channel ``fz`` of group ``wrench_meas`` is ``wrench_meas.fz``, and also
``fz`` if only one group has it.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.measured.columns import Columns, as_numbers, refuse_large, unreadable, whole
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register

UNIT = ("unit_string", "NI_UnitDescription")


@register
class Tdms(DataFormat):
    """NI TDMS: channels of groups, with units and start times of waveforms."""

    kind: Literal["tdms"] = "tdms"
    suffixes: ClassVar[tuple[str, ...]] = (".tdms",)

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The channels ``wanted``, a waveform with its clock. Raises InputError, MissingExtra."""
        try:
            from nptdms import TdmsFile
            from nptdms.log import log_manager
        except ImportError as error:
            raise MissingExtra(f"{path}: TDMS", "tdms") from error
        log_manager.set_level(logging.ERROR)  # its warnings quote the bytes that it cannot read
        with whole(path, "TDMS", "copy or export it again"):
            with TdmsFile.open(path) as file:
                found = [(g.name, c) for g in file.groups() for c in g.channels()]
                single = Counter(c.name for _, c in found)
                channels = {f"{group}.{c.name}": c for group, c in found}
                channels |= {c.name: c for _, c in found if single[c.name] == 1}
                here = {name: c for name, c in channels.items() if name in wanted}
                _refuse_unscaled(path, here, file.properties)
                refuse_large(path, max(map(len, here.values()), default=0), len(here))
                data = {name: as_numbers(path, name, c[:]) for name, c in here.items()}
                clock, notes = _clocks(path, here)
                units = {n: str(c.properties[k]) for n, c in here.items() for k in UNIT
                         if k in c.properties}  # fmt: skip
            return Columns(tuple(channels), data, clock, units, notes=notes)


def _refuse_unscaled(path: Path, channels: Mapping[str, Any], of_file: Mapping[str, Any]) -> None:
    """Refuse channels whose scaling the library does not know: it would give their raw counts."""
    from nptdms.scaling import get_scaling

    for name, channel in channels.items():
        kinds = [str(v) for k, v in channel.properties.items() if k.endswith("_Scale_Type")]
        done = channel.properties.get("NI_Scaling_Status") == "scaled"
        if kinds and not done and get_scaling(channel.properties, {}, of_file) is None:
            what = f"{name} is scaled by {', '.join(kinds)}, which cannot be computed here"
            raise unreadable(path, what, "export it with scaled values, or as CSV")


def _clocks(path: Path, channels: Mapping[str, Any]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Clock of each waveform, counted from the earliest start of them, if all have a start."""
    waves = {n: c for n, c in channels.items() if "wf_increment" in c.properties}
    clock = {name: as_numbers(path, name, c.time_track()) for name, c in waves.items()}
    starts = {n: c.properties["wf_start_time"] for n, c in waves.items()
              if "wf_start_time" in c.properties}  # fmt: skip
    if len(starts) < len(waves) or len(set(starts.values())) < 2:
        return clock, ()
    first = min(starts.values())
    late = {n: float((start - first) / np.timedelta64(1, "ns")) * 1e-9
            for n, start in starts.items()}  # fmt: skip
    said = ", ".join(f"{s:.6g} s" for s in sorted(set(late.values())) if s)
    groups = sorted({name.partition(".")[0] for name, s in late.items() if s})
    note = f"waveforms start at different times: {', '.join(groups)} {said} after the first"
    return {name: t + late[name] for name, t in clock.items()}, (note,)
