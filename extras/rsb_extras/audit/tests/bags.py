"""Bags as rosbag2 and others write them."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from rsb_extras.audit.tests.written import START

NONE = QosTime(0, 0)
POLICIES = (QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, NONE, NONE)
QOS = [Qos(*POLICIES, QosLiveliness.AUTOMATIC, NONE, False)]


def string(number: int) -> bytes:
    content = f"message {number}".encode()
    return b"\0\1\0\0" + struct.pack("<I", len(content) + 1) + content + b"\0"


def write_bag(
    path: Path, plugin: StoragePlugin, mode: CompressionMode, *, age: float = 0.0, lost: int | None = None
) -> None:
    """Write a bag as rosbags does, which knows rosbag2's own files."""
    bag = Writer(path, version=9, storage_plugin=plugin)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    types = get_typestore(Stores.ROS2_JAZZY)
    with bag:
        topic = bag.add_connection("/scan", "std_msgs/msg/String", typestore=types, offered_qos_profiles=QOS)
        for number in range(100):
            if number != lost:
                bag.write(topic, round((START + 2 + age + number * 0.1) * 1e9), string(number))


def old_bag(path: Path, *, columns: str = "", values: str = "", log: bool = False) -> sqlite3.Connection:
    """Return a sqlite3 bag as rosbag2 wrote it until Iron: without definitions, at first without QoS."""
    bag = sqlite3.connect(path)
    if log:
        bag.execute("PRAGMA journal_mode = WAL")
    bag.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        f" serialization_format TEXT NOT NULL{columns});"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        f"INSERT INTO topics VALUES (1, '/scan', 'std_msgs/msg/String', 'cdr'{values});"
    )
    return bag


def add(bag: sqlite3.Connection, number: int, content: bytes, age: float = 0.02) -> None:
    time = round((START + 2 + age + number * 0.1) * 1e9)
    bag.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", (time, content))
