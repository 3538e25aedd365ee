"""MCAP with messages in JSON or of ROS 2: the field ``fz`` of topic ``/wrench_meas`` is
``wrench_meas.fz``; its clock is ``header.stamp`` of a ROS 2 message, else the log time, or the
publish time if that is the more regular one.

In a ROS 2 bag ``wrench.force.z`` on the topic ``/ft`` is the column ``ft.wrench.force.z`` (or
``/ft/wrench/force/z``). An element of an array is named by its index, or by its label where the
message has as many of them: ``joint_states.position.elbow`` or ``joint_states.position.2``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Set
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.measured.columns import (
    SAMPLE_LIMIT,
    Columns,
    column_of,
    is_under,
    refuse_large,
    whole,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register

LABELS = ("name", "joint_names", "interface_names")  # of arrays beside or below them
LONGEST = 64  # elements of an array that are listed as columns, if none of them is wanted


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
        with whole(path, "MCAP", "copy or record it again", McapError, ZstdError):
            with path.open("rb") as file:
                for schema, channel, message in make_reader(file).iter_messages():
                    topic, stamp = column_of(channel.topic), None
                    if channel.message_encoding == "json":
                        decoder.topics[topic] = "json"
                        numbers = dict(_fields(topic, json.loads(message.data), None, None))
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
    """Mean departure of the steps from their median, in means; infinite if a clock runs back."""
    spread = 0.0
    for steps in (np.diff(t) for t in clock.values() if len(t) > 2):
        mean = float(steps.mean())
        if mean <= 0.0 or steps.min() < 0.0:
            return float("inf")
        spread += float(np.abs(steps - np.median(steps)).mean()) / mean
    return spread


class Decoder:
    """What decodes the messages of a bag.

    Attributes:
        topics: those that were met, each with the type of its messages.
        others: topics that cannot be decoded, and why.
    """

    def __init__(self, path: Path, wanted: Set[str]) -> None:
        """``wanted``: names of columns, with dots or with strokes."""
        self.topics: dict[str, str] = {}
        self.others: dict[str, str] = {}
        self._path = path
        self._wanted = {column_of(name) for name in wanted}
        self._known: dict[str, set[str]] = {}  # wanted columns of each topic
        self._factory: Any = None

    def numbers(
        self, topic: str, encoding: str, schema: Any, data: bytes
    ) -> tuple[dict[str, float], int | None]:
        """The numbers of a message by their columns, and its stamp [ns]; none if its topic cannot
        be decoded, or is not wanted and was met before. Raises MissingExtra.
        """
        seen = topic in self.topics
        if not seen:
            self.topics[topic] = schema.name if schema is not None else encoding
            self._known[topic] = {name for name in self._wanted if is_under(name, topic)}
        wanted = self._known[topic]
        if topic in self.others or (seen and not wanted):
            return {}, None
        message = self._message(topic, encoding, schema, data)
        if message is None:
            return {}, None
        longest = None if wanted else LONGEST
        found = dict(_fields(topic, message, (), longest))
        if not wanted <= found.keys():
            found |= {n: v for n, v in _fields(topic, message, None, longest) if n in wanted}
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        ns = None if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
        return found, ns

    def _message(self, topic: str, encoding: str, schema: Any, data: bytes) -> Any:
        if encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
            how = "" if schema is None else f" of type {schema.name}, described as "
            how += "" if schema is None else repr(schema.encoding)
            self.others[topic] = (
                f"is encoded as {encoding!r}{how}; allowed are json, and cdr with messages of "
                f"ROS 2 described as 'ros2msg': export the topic as JSON, or as CSV or Parquet"
            )
            return None
        try:
            from mcap_ros2.decoder import DecoderFactory
        except ImportError as error:
            if self._known[topic]:
                raise MissingExtra(f"{self._path}: {schema.name} of ROS 2", "mcap") from error
            return None
        self._factory = self._factory or DecoderFactory()
        try:
            return self._factory.decoder_for(encoding, schema)(data)
        except Exception as error:  # mcap_ros2 raises no narrower class
            self.others[topic] = (
                f"is of type {schema.name}, which cannot be decoded ({error}); export the topic "
                f"as CSV or Parquet"
            )
            return None


def _fields(
    name: str, value: Any, labels: tuple[tuple[str, ...], ...] | None, longest: int | None
) -> Iterator[tuple[str, float]]:
    """The numbers in a message of JSON or ROS 2; nested fields are named with dots.

    labels: lists of names that messages around it hold, outermost first; None: elements are named
    by their indices. longest: elements of an array, at most, for it to be read; None: any.
    """
    if value is None or isinstance(value, (bool, str, bytes)):
        return
    if isinstance(value, (int, float)):
        yield name, float(value)
    elif isinstance(value, (list, tuple, np.ndarray)):
        if longest is not None and len(value) > longest:
            return
        fitting = [own for own in labels or () if len(own) == len(value)]
        keys = fitting[-1] if fitting else range(len(value))
        for key, inner in zip(keys, value, strict=True):
            yield from _fields(f"{name}.{key}", inner, labels, longest)
    else:
        json_object = isinstance(value, dict)
        fields = value if json_object else {key: getattr(value, key) for key in value.__slots__}
        if labels is not None:
            lists = (fields.get(key) for key in LABELS)
            labels += tuple(tuple(names) for names in lists if isinstance(names, list) and names)
        for key, inner in fields.items():
            yield from _fields(f"{name}.{key}", inner, labels, longest)


def clock_of(
    log: Mapping[str, Array], stamps: Mapping[str, Array], topics: Mapping[str, str]
) -> tuple[dict[str, Array], str]:
    """The clock of each column [s] and a sentence on it: the stamps in the messages' headers where
    they run, else the times of the log; these alone where stamps of another clock (such as that
    of a simulation) would have to be compared with them.

    log, stamps: column to (rows,) [s] from a common origin. topics: of the bag.
    """
    runs = {name: t for name, t in stamps.items() if t[-1] > t[0] or len(t) == 1}
    if not runs:
        return dict(log), ""
    rest = [name for name in log if name not in runs]
    elsewhere = [n for n, t in runs.items() if t.min() > log[n][-1] or t.max() < log[n][0]]
    if rest and elsewhere:
        of = ", ".join(_of(elsewhere, topics))
        return dict(log), (
            f"header.stamp of {of} is of another clock than the log, and "
            f"{', '.join(_of(rest, topics))} has none: the times of the log are used"
        )
    used = {**log, **runs}
    first = min(float(t[0]) for t in used.values())
    late = {topic: float(np.median(log[n] - runs[n])) for topic, n in _of(runs, topics).items()}
    said = ", ".join(f"{topic} ({1e3 * s:.3g} ms before the log)" for topic, s in late.items())
    said = f"times are those of header.stamp: {said}"
    said += f"; those of the log: {', '.join(_of(rest, topics))}" if rest else ""
    return {name: t - first for name, t in used.items()}, said


def _of(columns: Iterable[str], topics: Mapping[str, str]) -> dict[str, str]:
    """The topics of columns, each with the first of its columns."""
    found: dict[str, str] = {}
    for name in columns:
        topic = max((t for t in topics if is_under(column_of(name), t)), key=len, default=name)
        found.setdefault(f"/{topic.replace('.', '/')}", name)
    return found
