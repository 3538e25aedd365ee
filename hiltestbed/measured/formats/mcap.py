"""MCAP with messages in JSON or of ROS 2: the field ``fz`` of topic ``/wrench_meas`` is
``wrench_meas.fz``; its clock is ``header.stamp`` of a ROS 2 message, else the log time, or the
publish time if that is the more regular one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.measured.columns import (
    BROKEN,
    SAMPLE_LIMIT,
    Columns,
    column_of,
    refuse_large,
    unreadable,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.measured.formats.ros2 import Decoder, clock_of
from hiltestbed.plugins import register


@register
class Mcap(DataFormat):
    """MCAP: topics with messages in JSON or of ROS 2."""

    kind: Literal["mcap"] = "mcap"
    suffixes: ClassVar[tuple[str, ...]] = (".mcap",)

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The numbers ``wanted``; times count from the first message. Raises InputError,
        MissingExtra.
        """
        try:
            from mcap.exceptions import McapError
            from mcap.reader import make_reader
            from zstandard import ZstdError
        except ImportError as error:
            raise MissingExtra(f"{path}: MCAP", "mcap") from error
        # log time, publish time and header.stamp [ns], value
        samples: dict[str, list[tuple[int, int, int | None, float]]] = {}
        spelled = {column_of(name): name for name in wanted}
        decoder = Decoder(path, wanted)
        start: int | None = None
        count = 0
        try:
            with path.open("rb") as file:
                for schema, channel, message in make_reader(file).iter_messages():
                    topic, stamp = column_of(channel.topic), None
                    if channel.message_encoding == "json":
                        decoder.topics[topic] = "json"
                        numbers = dict(_numbers(topic, json.loads(message.data)))
                    else:
                        how = channel.message_encoding, schema
                        numbers, stamp = decoder.numbers(topic, *how, message.data)
                    if numbers and start is None:
                        start = message.log_time
                    for name, value in numbers.items():
                        name = name if name in wanted else spelled.get(name, name)
                        kept = samples.setdefault(name, [])
                        if name in wanted:
                            kept.append((message.log_time, message.publish_time, stamp, value))
                            count += 1
                    # a Python tuple takes about eight times the memory of the number in it
                    if count > SAMPLE_LIMIT // 8:
                        refuse_large(path, count, 8)
        except (McapError, ZstdError, *BROKEN) as error:
            raise unreadable(
                path, f"is not a whole MCAP file ({error})", "copy or record it again"
            ) from error
        return _columns(samples, start or 0, decoder)


def _columns(
    samples: Mapping[str, list[tuple[int, int, int | None, float]]], start: int, decoder: Decoder
) -> Columns:
    kept = {name: rows for name, rows in samples.items() if rows}
    data = {name: np.array([value for *_, value in rows]) for name, rows in kept.items()}
    log, publish, stamps = (
        {
            name: np.array([t - start for t in times if t is not None], dtype=np.float64) * 1e-9
            for name, rows in kept.items()
            if None not in (times := [r[k] for r in rows])
        }
        for k in (0, 1, 2)
    )
    notes = ()
    if _unevenness(publish) < 0.5 * _unevenness(log):
        log = publish
        notes = (
            "the log times are those of a buffer, the publish times are even: the latter are used",
        )
    clock, said = clock_of(log, stamps, decoder.topics)
    return Columns(
        tuple(samples),
        data,
        clock,
        others=decoder.others,
        notes=(said,) if said else notes,
        topics=decoder.topics,
    )


def _unevenness(clock: Mapping[str, Array]) -> float:
    """Mean departure of the steps of each clock from their median, in means; infinite if one does
    not run or goes backwards.
    """
    spread = 0.0
    for steps in (np.diff(t) for t in clock.values() if len(t) > 2):
        mean = float(steps.mean())
        if mean <= 0.0 or steps.min() < 0.0:
            return float("inf")
        spread += float(np.abs(steps - np.median(steps)).mean()) / mean
    return spread


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
