"""Recordings of robots, in MCAP files and ROS 2 bags: messages flow in, one table under their topics' names flows out.

Each number or text of a message is a column ``/topic.field``, of an array ``/topic.field[0]``, and where an array
``name`` of the message names the entries, as in a JointState, ``/topic.field[NAME]``. The topic with most messages
gives the clock; of every other one a row holds the newest value not later than its instant. The libraries that read
such files are imported where one is read, as most studies read none.
"""

import dataclasses
import json
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

SUFFIX, METADATA = ".mcap", "metadata.yaml"
TIME = "time_s"
MOST_ENTRIES = 64
"""Entries of an array beyond which it is no set of signals."""
SAME_CLOCK_NS = 1e9
"""Usual difference of a message's stamp from when it was logged, beyond which the two are different clocks."""

ARRAYS = (list, tuple, np.ndarray)
Nanoseconds = NDArray[np.int64]
Message = tuple[str, int, Any]
"""Topic, when it was logged (ns), and what it says."""


@dataclass(frozen=True)
class Topic:
    """All messages of one topic: their (N,) times, ns, in their order in the file, and a table with a row for each.

    `stamped` says whether the times are those in the messages' headers, not those of the log.
    """

    times: Nanoseconds
    table: pd.DataFrame
    stamped: bool


@dataclass(frozen=True)
class Bag:
    """The topics with columns, by name, and remarks: how times are taken and topics joined, and what is left alone."""

    topics: dict[str, Topic]
    remarks: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """All columns, the time first."""
        return [TIME, *(str(name) for topic in self.topics.values() for name in topic.table)]

    def join(self, names: Collection[str] | None = None) -> pd.DataFrame:
        """Return the columns of these names, or all, on the clock of the one of their topics with most messages."""
        wanted = [
            (topic, [str(name) for name in topic.table if names is None or name in names])
            for topic in self.topics.values()
        ]
        used = [each for each in wanted if each[1]] or wanted
        clock = max((topic.times for topic, _ in used), key=len)
        columns = {TIME: pd.Series((clock - clock.min()) / 1e9)} if names is None or TIME in names else {}
        for topic, own in used:
            columns |= _hold(topic, own, clock)
        return pd.DataFrame(columns, index=range(len(clock)))


def is_bag(path: Path) -> bool:
    """Return whether a path is that of an MCAP file or of a ROS 2 bag."""
    return path.suffix.lower() == SUFFIX if not path.is_dir() else (path / METADATA).is_file()


def read_bag(path: Path) -> Bag:
    """Read an MCAP file, or the folder of a ROS 2 bag; a `ValueError` tells that no message holds numbers."""
    files = [path] if path.is_file() else sorted(path.iterdir())
    return _read(path, tuple((each.name, each.stat().st_size, each.stat().st_mtime_ns) for each in files))


@lru_cache(maxsize=4)
def _read(path: Path, state: object) -> Bag:
    left: dict[str, str] = {}
    messages = _list_mcap(path, left) if path.is_file() else _list_bag(path)
    found: dict[str, list[tuple[int, int, dict[str, Any]]]] = defaultdict(list)
    for topic, time, message in messages:
        found[topic].append((time, _read_stamp(message), dict(_flatten(topic, message, left))))
    tables = {topic: pd.DataFrame([row for *_, row in told]) for topic, told in sorted(found.items())}
    tables = {topic: table for topic, table in tables.items() if not table.empty}
    if not tables:
        raise ValueError("; ".join(["expected messages with numbers, got none", *_describe_left(left)]))
    times = {topic: np.array([told[:2] for told in found[topic]], dtype=np.int64) for topic in tables}
    stamped, why = {topic: bool(times[topic][:, 1].all()) for topic in tables}, ""
    offset = [topic for topic in tables if stamped[topic] and np.median(np.abs(np.diff(times[topic]))) >= SAME_CLOCK_NS]
    if offset and not all(stamped.values()):
        stamped = dict.fromkeys(tables, False)
        why = f"; header.stamp of {offset[0]} is of another clock, and not every topic has one"
    topics = {topic: Topic(times[topic][:, int(stamped[topic])], tables[topic], stamped[topic]) for topic in tables}
    return Bag(topics, (*_describe_times(topics, why), *_describe_left(left)))


def _list_bag(path: Path) -> Iterator[Message]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, time, raw in reader.messages():
            yield connection.topic, time, reader.deserialize(raw, connection.msgtype)


def _list_mcap(path: Path, left: dict[str, str]) -> Iterator[Message]:
    """Yield an MCAP file's messages in the order of their times, as far as it was written."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    records, stores = [], dict[int, Any]()
    with path.open("rb") as handle:
        try:
            for each in NonSeekingReader(handle).iter_messages(log_time_order=False):
                records.append(each)
        except EndOfFile:
            left["what comes after the last whole chunk"] = "the file is cut off, as one of a recorder that was killed"
    for schema, channel, message in sorted(records, key=lambda each: each[2].log_time):
        if channel.message_encoding == "json":
            yield channel.topic, message.log_time, json.loads(message.data)
        elif channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
            yield channel.topic, message.log_time, _decode(schema, message.data, stores)
        else:
            told = f"its messages are in {channel.message_encoding or 'no known form'}, expected json or cdr"
            left[channel.topic] = told


def _decode(schema: Any, data: bytes, stores: dict[int, Any]) -> Any:
    """Return a message of ROS 2, read by the definition that comes with it; the stores of types are filled."""
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
    if schema.id not in stores:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        stores[schema.id] = get_typestore(Stores.EMPTY)
        stores[schema.id].register(get_types_from_msg(schema.data.decode(), name))
    return stores[schema.id].deserialize_cdr(data, name)


def _fields(value: Any) -> dict[str, Any] | None:
    """Return the fields of a message, from JSON or a library's dataclass; None of what is no message."""
    if isinstance(value, Mapping):
        return {str(name): each for name, each in value.items()}
    if not dataclasses.is_dataclass(value):
        return None
    names = [each.name for each in dataclasses.fields(value) if not each.name.startswith("__")]
    return {name: getattr(value, name) for name in names}


def _read_stamp(message: Any) -> int:
    """Return the stamp in a message's header, ns; 0 where there is none."""
    header = (_fields(message) or {}).get("header")
    told = _fields((_fields(header) or {}).get("stamp")) or {}
    return int(told.get("sec", 0)) * 1_000_000_000 + int(told.get("nanosec", told.get("nsec", 0)))


def _flatten(name: str, value: Any, left: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the numbers and texts in a value under their full names."""
    fields = _fields(value)
    if fields is not None:
        named: Any = fields.get("name")
        texts = isinstance(named, list | tuple) and all(isinstance(each, str) for each in named)
        named = named if texts and len(set(named)) == len(named) else []
        arrays = [each for each, told in fields.items() if each != "name" and isinstance(told, ARRAYS)]
        beside = [each for each in arrays if named and len(fields[each]) == len(named)]
        for each, told in fields.items():
            if each == "header" or (each == "name" and beside):
                continue
            if each in beside:
                yield from ((f"{name}.{each}[{its}]", one) for its, one in zip(named, _list(told), strict=True))
            else:
                yield from _flatten(f"{name}.{each}", told, left)
    elif isinstance(value, bool | int | float | str) or value is None:
        yield name, value
    elif isinstance(value, ARRAYS):
        if len(value) > MOST_ENTRIES:
            left[name] = f"{len(value)} entries"
            return
        for k, each in enumerate(_list(value)):
            yield from _flatten(f"{name}[{k}]", each, left)
    else:
        left[name] = "neither numbers nor text"


def _list(values: Any) -> list[Any]:
    return values.tolist() if isinstance(values, np.ndarray) else list(values)


def _hold(topic: Topic, names: Sequence[str], clock: Nanoseconds) -> dict[str, pd.Series]:
    """Return columns on a clock, each row with the newest value not later than it; missing before the first one."""
    if topic.times is clock:
        return {name: topic.table[name] for name in names}
    order = np.argsort(topic.times, kind="stable")
    at = np.searchsorted(topic.times[order], clock, side="right") - 1
    held = topic.table.iloc[order[np.maximum(at, 0)]].reset_index(drop=True)
    return {name: held[name].where(at >= 0) for name in names}


def _describe_times(topics: Mapping[str, Topic], why: str) -> Iterator[str]:
    stamped = ", ".join(each for each, topic in topics.items() if topic.stamped)
    other = ", ".join(each for each, topic in topics.items() if not topic.stamped)
    if stamped:
        yield f"times from header.stamp{f' of {stamped}' if other else ''}"
    if other:
        yield f"times from the log{f' of {other}' if stamped else ''}{why}"
    if len(topics) > 1:
        usual = {each: np.median(np.diff(topic.times)) if len(topic.times) > 1 else 0 for each, topic in topics.items()}
        told = ", ".join(f"{each} {1e9 / step if step else np.nan:.4g} Hz" for each, step in usual.items())
        yield (
            f"{len(topics)} topics ({told}) on the clock of the one with most messages of those that are used, "
            "each with its newest value"
        )


def _describe_left(left: Mapping[str, str]) -> Iterator[str]:
    return (f"{name} is left alone: {why}" for name, why in left.items())
