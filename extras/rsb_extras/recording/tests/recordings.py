"""Recordings as other programs read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from rsb_bridge.model.session import Session


class Read(NamedTuple):
    """A message of a recording, as rosbags reads it."""

    topic: str
    time: int
    message: Any


def read(path: str | Path) -> list[Read]:
    """Read all messages of a recording by rosbags, in order."""
    with AnyReader([Path(path)]) as reader:
        return [
            Read(connection.topic, time, reader.deserialize(content, connection.msgtype))
            for connection, time, content in reader.messages()
        ]


def read_strictly(path: str | Path) -> list[tuple[Any, Any, Any]]:
    """Read all messages by mcap, which checks each checksum: schema, channel and message, in order."""
    with Path(path).open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        messages = list(reader.iter_messages())
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages)
    return messages


def session(value: object) -> Session:
    """A server's session with a value of `record`."""
    return Session(
        name="robot1",
        role="server",
        key_file="robot1.key",
        server_ip="127.0.0.1",
        server_port=7060,
        domain_id=1,
        features={"record": value},
    )
