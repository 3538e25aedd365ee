"""MCAP with JSON messages: the field ``fz`` of topic ``/wrench_meas`` is ``wrench_meas.fz``; its
clock is the message's log time, or its publish time if that is the more regular one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.measured.columns import BROKEN, SAMPLE_LIMIT, Columns, refuse_large, unreadable
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register


@register
class Mcap(DataFormat):
    """MCAP: topics with JSON messages."""

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
        # log time, publish time, value
        samples: dict[str, list[tuple[int, int, float]]] = {}
        others: dict[str, str] = {}
        start: int | None = None
        count = 0
        try:
            with path.open("rb") as file:
                for _, channel, message in make_reader(file).iter_messages():
                    topic = channel.topic.strip("/").replace("/", ".")
                    if channel.message_encoding != "json":
                        others[topic] = (
                            f"is encoded as {channel.message_encoding!r}; allowed is json: export "
                            f"the topic as JSON, or as CSV or Parquet"
                        )
                        continue
                    start = message.log_time if start is None else start
                    for name, value in _numbers(topic, json.loads(message.data)):
                        kept = samples.setdefault(name, [])
                        if name in wanted:
                            times = message.log_time - start, message.publish_time - start
                            kept.append((*times, value))
                            count += 1
                    # a Python tuple takes about eight times the memory of the number in it
                    if count > SAMPLE_LIMIT // 8:
                        refuse_large(path, count, 8)
        except (McapError, ZstdError, *BROKEN) as error:
            raise unreadable(
                path, f"is not a whole MCAP file ({error})", "copy or record it again"
            ) from error
        return _columns(samples, others)


def _columns(
    samples: Mapping[str, list[tuple[int, int, float]]], others: dict[str, str]
) -> Columns:
    kept = {name: rows for name, rows in samples.items() if rows}
    data = {name: np.array([value for _, _, value in rows]) for name, rows in kept.items()}
    log, publish = (
        {
            name: np.array([r[k] for r in rows], dtype=np.float64) * 1e-9
            for name, rows in kept.items()
        }
        for k in (0, 1)
    )
    notes = ()
    if _unevenness(publish) < 0.5 * _unevenness(log):
        log = publish
        notes = (
            "the log times are those of a buffer, the publish times are even: the latter are used",
        )
    return Columns(tuple(samples), data, log, others=others, notes=notes)


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
