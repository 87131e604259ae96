"""Recordings that tests play."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from rsb_bridge.cdr.description import hash_of_text, text_of
from rsb_extras.recording.reading.defined_types import defined_type, rosidl_description

BEGIN = 1_700_000_000_000_000_000  # ns since the epoch
ODD_TYPE, ODD = "tests_of_playing/msg/Odd", "uint64 number\nfloat32[3] rest\n"
"""A type that is installed nowhere."""
ODD_HASH = hash_of_text(text_of(rosidl_description(defined_type(ODD_TYPE, ODD))))
LATCHED = "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local\n"
RELIABLE = "- history: keep_last\n  depth: 10\n  reliability: reliable\n  durability: volatile\n"


def string(text: str) -> bytes:
    """Return a String whose length needs no padding, which Fast DDS adds to others."""
    padded = f"{text:<{-(-(len(text) + 1) // 4) * 4 - 1}}"
    return b"\0\1\0\0" + struct.pack("<I", len(padded) + 1) + padded.encode() + b"\0"


def odd(number: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<Q3f", number, 1.5, 2.5, number / 8)


class Recorded:
    """A recording that a test writes; times are s from `BEGIN`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("wb")
        self._writer: Any = Writer(self._file, chunk_size=2000)
        self._writer.start(profile="ros2", library="a test")
        self._channels: dict[str, int] = {}
        self.sent: dict[str, list[bytes]] = {}

    def topic(
        self,
        name: str,
        type_name: str = "std_msgs/msg/String",
        definition: str = "string data",
        profiles: str = RELIABLE,
        encoding: str = "cdr",
        publisher: str = "",
    ) -> str:
        schema = self._writer.register_schema(type_name, "ros2msg", definition.encode())
        metadata = {"offered_qos_profiles": profiles, "publisher": publisher}
        self._channels[name] = self._writer.register_channel(name, encoding, schema, metadata)
        self.sent[name] = []
        return name

    def add(self, name: str, at: float, content: bytes) -> None:
        time = BEGIN + round(at * 1e9)
        self._writer.add_message(self._channels[name], time, content, time)
        self.sent[name].append(content)

    def done(self) -> Path:
        self._writer.finish()
        self._file.close()
        return self.path
