"""ROS 2 messages in an MCAP file: the numbers of a message by the names of its fields, its stamp,
and which times of a bag are the clock.

``wrench.force.z`` on the topic ``/ft`` is the column ``ft.wrench.force.z`` (or
``/ft/wrench/force/z``). An element of an array is named by its index, or by its label where the
message has as many of them: ``joint_states.position.elbow`` or ``joint_states.position.2``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array
from hiltestbed.measured.columns import column_of, is_under
from hiltestbed.run_folder.folders import is_folder

LABELS = ("name", "joint_names", "interface_names")  # of arrays beside or below them
LONGEST = 64  # elements of an array that are listed as columns, if none of them is wanted


def data_file(path: Path) -> Path:
    """The file of a run: ``path``, or the only MCAP file of a bag's folder."""
    files = sorted(path.glob("*.mcap")) if is_folder(path) else []
    return files[0] if len(files) == 1 else path


def no_file(path: Path) -> str:
    """What to do if ``path`` is no file."""
    if not is_folder(path):
        return f"looked for {path}"
    return (
        f"{path} is a folder with {len(list(path.glob('*.mcap')))} MCAP files; allowed is a bag "
        f"with one: `ros2 bag convert` makes it of .db3 files, or of several"
    )


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
        found = dict(_numbers(topic, message, (), longest))
        if not wanted <= found.keys():
            found |= {n: v for n, v in _numbers(topic, message, None, longest) if n in wanted}
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


def _numbers(
    name: str, value: Any, labels: tuple[tuple[str, ...], ...] | None, longest: int | None
) -> Iterator[tuple[str, float]]:
    """The numbers in a message. labels: lists of names that messages around it hold, outermost
    first; None: elements are named by their indices.
    """
    if isinstance(value, (bool, str, bytes)):
        return
    if isinstance(value, (int, float)):
        yield name, float(value)
    elif isinstance(value, (list, tuple, np.ndarray)):
        if longest is not None and len(value) > longest:
            return
        fitting = [own for own in labels or () if len(own) == len(value)]
        keys = fitting[-1] if fitting else range(len(value))
        for key, inner in zip(keys, value, strict=True):
            yield from _numbers(f"{name}.{key}", inner, labels, longest)
    else:
        fields = {key: getattr(value, key) for key in value.__slots__}
        if labels is not None:
            own = (fields.get(key) for key in LABELS)
            labels += tuple(tuple(names) for names in own if isinstance(names, list) and names)
        for key, inner in fields.items():
            yield from _numbers(f"{name}.{key}", inner, labels, longest)


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
