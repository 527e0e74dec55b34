"""Logs that are messages on topics: MCAP files of anybody, and bags of ROS 1 and ROS 2."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import EvidenceError, meant, shortened
from ...schemas.file.logs import LogMapping

Floats = NDArray[np.float64]
PART = re.compile(r"([A-Za-z]\w*)((?:\[[0-9]+\])*)")
"""A field of a message: its name, and the places in an array."""
STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"), ("seconds", "nanos"))
"""The fields of a time, in seconds and nanoseconds."""
SECOND = 10**9
MAX_MESSAGES = 10_000_000


class Signal(NamedTuple):
    """A column of a log with its own times."""

    times: Floats
    """Seconds (T,)."""
    values: Floats


class Message(NamedTuple):
    """A message of a log."""

    topic: str
    time: int
    """When it was logged, in ns."""
    decode: Callable[[], Any]


@dataclass(slots=True)
class _Column:
    """A column while its log is read."""

    topic: str
    path: tuple[str | int, ...]
    stamps: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


class _Log(NamedTuple):
    topics: Sequence[str]
    messages: Callable[[frozenset[str]], Iterator[Message]]


def read_messages(path: Path, mapping: LogMapping, names: Sequence[str]) -> tuple[int, dict[str, Signal]]:
    """Return the columns of the system in a log, and the stamp in ns from which their times count.

    Raises:
        EvidenceError: it cannot be read, or a topic or a field is missing, or is no number.

    """
    with _opened(path) as log:
        columns = {name: _found(path, mapping.title(name), name, log.topics) for name in names}
        time = None if mapping.time is None else _parts(path, mapping.time, mapping.time)
        by_topic: dict[str, list[tuple[str, _Column]]] = {}
        for name, column in columns.items():
            by_topic.setdefault(column.topic, []).append((name, column))
        for count, message in enumerate(log.messages(frozenset(by_topic))):
            if count >= MAX_MESSAGES:
                raise EvidenceError(f"{path}: more than {MAX_MESSAGES:,} messages; cut it")
            decoded = message.decode()
            stamp = message.time if time is None else _stamp(_value(decoded, time, path, mapping.time or ""), path)
            for name, column in by_topic[message.topic]:
                column.stamps.append(stamp)
                column.values.append(_number(_value(decoded, column.path, path, mapping.title(name)), path, name))
    for name, column in columns.items():
        if not column.stamps:
            raise EvidenceError(f"{path}: there is no message on {column.topic}, which has {name}")
    base = min(column.stamps[0] for column in columns.values())
    # From whole nanoseconds: since 1970 they are more than a double holds.
    return base, {
        name: Signal(np.array([stamp - base for stamp in each.stamps]) / SECOND, np.array(each.values))
        for name, each in columns.items()
    }


def is_of_messages(path: Path) -> bool:
    """Whether a log has messages: a folder of rosbag2, a bag or an MCAP file."""
    return path.is_dir() or path.suffix.lower() in (".mcap", ".bag")


def _found(path: Path, source: str, name: str, topics: Sequence[str]) -> _Column:
    """Return the column of `TOPIC.FIELD`; the topic may be left out where there is one."""
    for topic in sorted(topics, key=len, reverse=True):  # /a.b is a topic as well where there is /a
        if source.startswith((f"{topic}.", f"{topic}[")):
            return _Column(topic, _parts(path, source[len(topic) :].lstrip("."), source))
    if len(topics) == 1 and not source.startswith("/"):
        return _Column(topics[0], _parts(path, source, source))
    near = meant(source.partition(".")[0], topics)
    listed = shortened(", ".join(topics), 200) or "none"
    raise EvidenceError(
        f"{path}: {name}: no topic is named in {source!r}; {near}give logs.columns.{name} as TOPIC.FIELD; its topics: "
        f"{listed}"
    )


def _parts(path: Path, source: str, whole: str) -> tuple[str | int, ...]:
    found: list[str | int] = []
    for part in source.split("."):
        if not (match := PART.fullmatch(part)):
            raise EvidenceError(f"{path}: {whole!r} names no field of a message; write TOPIC.FIELD.FIELD[0]")
        found += [match[1], *map(int, re.findall("[0-9]+", match[2]))]
    return tuple(found)


def _value(message: Any, parts: Sequence[str | int], path: Path, whole: str) -> Any:
    for part in parts:
        try:
            by_name = isinstance(part, str) and not isinstance(message, Mapping)
            message = getattr(message, str(part)) if by_name else message[part]
        except (AttributeError, LookupError, TypeError, ValueError):
            named = list(message) if isinstance(message, Mapping) else _fields(message)
            raise EvidenceError(
                f"{path}: {whole}: a message has no {part!r}; it has {shortened(', '.join(map(str, named)), 200)}"
            ) from None
    return message


def _fields(message: Any) -> list[str]:
    of_protobuf = getattr(getattr(message, "DESCRIPTOR", None), "fields_by_name", ())
    names = getattr(message, "__dataclass_fields__", None) or of_protobuf
    return [str(name) for name in names if not str(name).startswith("_")] or [f"a {type(message).__name__}"]


def _number(value: Any, path: Path, name: str) -> float:
    if isinstance(value, bool | int | float | np.number | np.bool_):
        return float(value)
    raise EvidenceError(f"{path}: {name} is {shortened(repr(value), 40)} in place of a number; name a field of it")


def _stamp(value: Any, path: Path) -> int:
    """Return a time of a message in ns: of seconds and nanoseconds, or of seconds."""
    for whole, part in STAMPS:
        seconds, rest = (
            value.get(each) if isinstance(value, Mapping) else getattr(value, each, None) for each in (whole, part)
        )
        if seconds is not None and rest is not None:
            return int(seconds) * SECOND + int(rest)
    if isinstance(value, int | float | np.number) and not isinstance(value, bool) and np.isfinite(value):
        return round(float(value) * SECOND) if isinstance(value, float | np.floating) else int(value) * SECOND
    raise EvidenceError(f"{path}: logs.time: {shortened(repr(value), 40)} is no time; name a field of seconds")


class _opened:  # noqa: N801  (used as a function)
    """A log that is open inside a `with` block; what its reader raises names the file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._close: Callable[[], object] = lambda: None

    def __enter__(self) -> _Log:
        if self._path.suffix.lower() == ".mcap" and not self._path.is_dir():
            return _mcap(self._path)
        if self._path.is_dir() and not (self._path / "metadata.yaml").exists():
            raise EvidenceError(f"{self._path}: a folder without metadata.yaml, and so no rosbag2; name a log")
        from rosbags.highlevel import AnyReader  # noqa: PLC0415  (an extra)
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

        reader: Any = AnyReader([self._path], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
        self._close = reader.close

        def messages(wanted: frozenset[str]) -> Iterator[Message]:
            chosen = [each for each in reader.connections if each.topic in wanted]
            for connection, time, raw in reader.messages(chosen):
                kind = connection.msgtype
                yield Message(connection.topic, time, partial(reader.deserialize, raw, kind))

        return _Log(sorted(reader.topics), messages)

    def __exit__(self, *_: object) -> None:
        self._close()


def _mcap(path: Path) -> _Log:
    from mcap.reader import NonSeekingReader  # noqa: PLC0415

    # Twice, and whole: which topics there are decides what a path means, and a file without its end is no log.
    with path.open("rb") as file:
        topics = sorted({channel.topic for _, channel, _ in NonSeekingReader(file).iter_messages(log_time_order=False)})

    def messages(wanted: frozenset[str]) -> Iterator[Message]:
        decoders: dict[int, Callable[[bytes], Any]] = {}
        with path.open("rb") as file:
            reader = NonSeekingReader(file, validate_crcs=True)
            for schema, channel, message in reader.iter_messages(topics=wanted):
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, channel.topic, channel.message_encoding, schema)
                yield Message(channel.topic, message.log_time, partial(decoders[channel.id], message.data))

    return _Log(topics, messages)


def _decoder(path: Path, topic: str, encoding: str, schema: Any) -> Callable[[bytes], Any]:
    if encoding == "json":
        return json.loads
    if schema is not None and encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory  # noqa: PLC0415  (an extra)

        found: Callable[[bytes], Any] | None = DecoderFactory().decoder_for("protobuf", schema)
        if found is not None:
            return found
    if schema is not None and (encoding, schema.encoding) in {
        ("cdr", "ros2msg"),
        ("ros1", "ros1msg"),
        ("cdr", "ros2idl"),
    }:
        from rosbags import typesys  # noqa: PLC0415  (an extra)

        store = typesys.get_typestore(typesys.Stores.EMPTY)
        text = schema.data.decode()
        store.register(
            typesys.get_types_from_idl(text)
            if schema.encoding == "ros2idl"
            else typesys.get_types_from_msg(text, _full_name(schema.name))
        )
        decode = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
        return lambda data: decode(data, _full_name(schema.name))
    raise EvidenceError(
        f"{path}: {topic} has messages in {encoding or 'no'} encoding, which cannot be read; known are json, protobuf, "
        "cdr and ros1"
    )


def _full_name(name: str) -> str:
    """Return the name of a type as ROS 2 writes it.

    >>> _full_name("geometry_msgs/Twist"), _full_name("geometry_msgs/msg/Twist")
    ('geometry_msgs/msg/Twist', 'geometry_msgs/msg/Twist')
    """
    package, _, rest = name.partition("/")
    return name if "/" in rest else f"{package}/msg/{rest}"
