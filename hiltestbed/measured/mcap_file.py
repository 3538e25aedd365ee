"""MCAP with JSON messages: the field ``fz`` of topic ``/wrench_meas`` is ``wrench_meas.fz``; its
clock is the message's log time.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import BROKEN, SAMPLE_LIMIT, Columns, refuse_large, unreadable


def read(path: Path, wanted: Set[str]) -> Columns:
    """The numbers ``wanted`` of an MCAP file; log times count from the first message. Raises
    InputError, MissingExtra.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from zstandard import ZstdError
    except ImportError as error:
        raise MissingExtra(f"{path}: MCAP", "mcap") from error
    samples: dict[str, list[tuple[int, float]]] = {}
    start: int | None = None
    count = 0
    try:
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                if channel.message_encoding != "json":
                    what = f"has topic {channel.topic!r} encoded as {channel.message_encoding!r}"
                    raise unreadable(
                        path,
                        what,
                        "allowed is json; export the topics as JSON, or as CSV or Parquet",
                    )
                start = message.log_time if start is None else start
                for name, value in _numbers(
                    channel.topic.strip("/").replace("/", "."), json.loads(message.data)
                ):
                    kept = samples.setdefault(name, [])
                    if name in wanted:
                        kept.append((message.log_time - start, value))
                        count += 1
                # a Python tuple takes about eight times the memory of the number in it
                if count > SAMPLE_LIMIT // 8:
                    refuse_large(path, count, 8)
    except (McapError, ZstdError, *BROKEN) as error:
        raise unreadable(
            path, f"is not a whole MCAP file ({error})", "copy or record it again"
        ) from error
    data = {name: np.array([value for _, value in kept]) for name, kept in samples.items() if kept}
    clock = {
        name: np.array([stamp for stamp, _ in kept], dtype=np.float64) * 1e-9
        for name, kept in samples.items()
        if kept
    }
    return Columns(tuple(samples), data, clock)


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """The numbers in a message; nested fields are named with dots."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}", inner)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _numbers(f"{name}.{index}", inner)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield name, float(value)
