"""TDMS through npTDMS: channel ``fz`` of group ``wrench_meas`` is ``wrench_meas.fz``, and also
``fz`` if only one group has it.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Set
from pathlib import Path

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import BROKEN, Columns, as_numbers, refuse_large, unreadable


def read(path: Path, wanted: Set[str]) -> Columns:
    """The channels ``wanted`` of a TDMS file; a waveform's increment is its clock. Raises
    InputError, MissingExtra.
    """
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as error:
        raise MissingExtra(f"{path}: TDMS", "tdms") from error
    log_manager.set_level(logging.ERROR)  # its warnings quote the bytes that it cannot read
    try:
        with TdmsFile.open(path) as file:
            channels = {
                f"{group.name}.{channel.name}": channel
                for group in file.groups()
                for channel in group.channels()
            }
            single = Counter(channel.name for channel in channels.values())
            channels |= {
                channel.name: channel
                for channel in list(channels.values())
                if single[channel.name] == 1
            }
            here = [name for name in channels if name in wanted]
            refuse_large(path, max((len(channels[name]) for name in here), default=0), len(here))
            data = {name: as_numbers(path, name, channels[name][:]) for name in here}
            clock = {
                name: as_numbers(path, name, channels[name].time_track())
                for name in here
                if "wf_increment" in channels[name].properties
            }
    except BROKEN as error:
        raise unreadable(
            path, f"is not a whole TDMS file ({error})", "copy or export it again"
        ) from error
    return Columns(tuple(channels), data, clock)
