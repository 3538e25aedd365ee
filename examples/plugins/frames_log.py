"""A user-defined data format: a binary log of frames of doubles, little-endian, without a header.

hiltestbed check dataset.yaml --plugin examples/plugins/frames_log.py, with a dataset that names
files *.frames and, for their channels, format: {kind: frames, channels: [t, pose_act.pz, ...]}
"""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.measured.columns import Columns, unreadable
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register


@register
class Frames(DataFormat):
    """Frames of doubles, one number a channel."""

    kind: Literal["frames"] = "frames"
    suffixes: ClassVar[tuple[str, ...]] = (".frames",)
    apart: ClassVar[bool] = False  # nothing in it can crash or hang

    channels: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=("t", "pose_act.pz", "wrench_meas.fz"), description="channels, in their order"
    )

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The channels ``wanted``. Raises InputError if the last frame is not whole."""
        numbers = np.fromfile(path, dtype="<f8")
        if len(numbers) % len(self.channels):
            raise unreadable(
                path,
                f"holds {len(numbers)} numbers, which is no multiple of {len(self.channels)}",
                "name every channel of a frame under format: {kind: frames, channels: [...]}",
            )
        frames = numbers.reshape(-1, len(self.channels))
        data = {name: frames[:, k] for k, name in enumerate(self.channels) if name in wanted}
        return Columns(self.channels, data)
