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
    names_of_types = ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    state, header, stamp = (store.types[each] for each in names_of_types)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        for topic, (names, times, fields) in topics.items():
            connection = writer.add_connection(topic, state.__msgtype__, typestore=store)
            for k, time in enumerate(times):
                at = START_NS + int(time)
                own = {each: values[k] for each, values in fields.items()}
                arrays = [np.array(own.get(each, []), dtype=float) for each in ("position", "velocity", "effort")]
                own_header = header(stamp(sec=at // 10**9, nanosec=at % 10**9), frame_id="")
                message = state(own_header, list(names), *arrays)
                writer.write(connection, at + 700_000, store.serialize_cdr(message, state.__msgtype__))
    return folder
