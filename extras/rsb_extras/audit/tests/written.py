"""Recordings with known contents, as rosbag2 writes them."""

from __future__ import annotations

import struct
from collections.abc import Collection
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

START = 1_700_000_000.0  # s since the epoch
LATCHED = "transient_local"


def text(number: int, size: int = 20) -> bytes:
    """Return a message of CDR whose content is a number."""
    return b"\0\1\0\0" + struct.pack("<Q", number).ljust(size, b".")


class Written:
    """A recording that a test writes. Times are s from `START`.

    Args:
        ahead: s that its clock is ahead.
    """

    def __init__(self, path: Path, ahead: float = 0.0, compression: CompressionType = CompressionType.ZSTD) -> None:
        self.path = path
        self._ahead = ahead
        self.file = path.open("wb")
        self._writer: Any = Writer(self.file, chunk_size=20_000, compression=compression)
        self._writer.start(profile="ros2", library="a test")
        self._channels: dict[tuple[str, str], int] = {}

    def topic(
        self,
        name: str,
        type_name: str = "std_msgs/msg/String",
        reliability: Any = "reliable",
        durability: Any = "volatile",
        publishers: int = 1,
        publisher: str = "",
        definition: str = "string data",
        encoding: str = "ros2msg",
    ) -> str:
        """Have a topic, before its first message. Without a reliability, nothing is known of its QoS."""
        schema = self._writer.register_schema(type_name, encoding, definition.encode())
        profile = f"- history: keep_last\n  depth: 10\n  reliability: {reliability}\n  durability: {durability}\n"
        metadata = {"offered_qos_profiles": profile * publishers if reliability else ""}
        if publisher:
            metadata["publisher"] = publisher
        self._channels[name, publisher] = self._writer.register_channel(name, "cdr", schema, metadata)
        return name

    def add(self, name: str, at: float, content: bytes | int, publisher: str = "") -> None:
        time = round(START) * 1_000_000_000 + round((at + self._ahead) * 1e9)
        data = content if isinstance(content, bytes) else text(content)
        self._writer.add_message(self._channels[name, publisher], time, data, time)

    def spans(self, end: float) -> None:
        """Have it last from 0 to `end`, by messages of a topic of its own."""
        name = self.topic(f"/only/{self.path.stem}", "std_msgs/msg/Empty", "best_effort")
        for number, at in enumerate((0.0, end)):
            self.add(name, at, number)

    def done(self) -> None:
        self._writer.finish()
        self.file.close()


def write_sides(near: str, far: str, topics: Collection[str]) -> None:
    """Write a recording of each side, of a bridge that loses nothing."""
    for path, age in ((near, 0.0), (far, 0.02)):
        side = Written(Path(path))
        for topic in topics:
            side.topic(topic)
            for number in range(20):
                side.add(topic, number * 0.5 + age, number)
        side.done()
