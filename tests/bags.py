"""MCAP files and ROS 2 bags for tests, written by the libraries that robots' recorders use."""

import json

import numpy as np

START_NS = 1_700_000_000_000_000_000


def write_mcap(path, topics, chunk_bytes=1 << 20):
    """Write messages as JSON; by topic, pairs of the log's time (ns from `START_NS`) and the message."""
    from mcap.writer import Writer

    with path.open("wb") as handle:
        writer = Writer(handle, chunk_size=chunk_bytes)
        writer.start()
        schema = writer.register_schema("anything", "jsonschema", b'{"type": "object"}')
        for topic, messages in topics.items():
            channel = writer.register_channel(topic, "json", schema)
            for time, message in messages:
                at = START_NS + time
                writer.add_message(channel, at, json.dumps(message).encode(), at)
        writer.finish()
    return path


def write_bag(folder, topics, storage="sqlite3"):
    """Write a ROS 2 bag of JointState; by topic, names, times (ns from `START_NS`) and arrays (T, N) by field."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header, stamp = (
        store.types[f"{each}"]
        for each in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        for topic, (names, times, fields) in topics.items():
            connection = writer.add_connection(topic, state.__msgtype__, typestore=store)
            for k, time in enumerate(times):
                at = START_NS + int(time)
                arrays = {
                    each: np.array(fields[each][k], dtype=float) if each in fields else np.array([])
                    for each in ("position", "velocity", "effort")
                }
                message = state(
                    header=header(stamp=stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id=""),
                    name=list(names),
                    **arrays,
                )
                writer.write(connection, at + 700_000, store.serialize_cdr(message, state.__msgtype__))
    return folder
