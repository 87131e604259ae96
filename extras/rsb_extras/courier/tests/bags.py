"""Recordings that a robot has, and what is in any."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

BEGAN = 1_785_406_500_000_000_000
SECOND = 1_000_000_000
_DEFINITION = ("ros2msg", b"string data\n")


def channel(topic: str, publisher: str = "") -> StoredChannel:
    profiles = "- history: keep_last\n  depth: 10\n"
    return StoredChannel(topic, "std_msgs/msg/String", "cdr", profiles, _DEFINITION, f"RIHS01_{'a' * 64}", publisher)


def messages(
    seconds: int, size: int = 1000, topics: Iterable[str] = ("/scan", "/tf"), seed: int = 1
) -> Iterator[StoredMessage]:
    """Yield messages that no compression makes smaller: of each topic two at each tenth of a second, by the same time.

    In the middle is one that is larger than a piece.
    """
    random = Random(seed)
    for tenth in range(10 * seconds):
        time = BEGAN + tenth * SECOND // 10
        for topic in topics:
            for at in range(2):
                length = 700_000 if (tenth, at) == (5 * seconds, 1) else size
                content = b"\0\1\0\0" + random.randbytes(length)
                number = 2 * tenth + at + 1
                yield StoredMessage(channel(topic, f"/node{at}"), time, time - at, number, memoryview(content))


def write_bag(path: Path, content: Iterable[StoredMessage]) -> list[StoredMessage]:
    """Write a recording, and return its messages."""
    written = [*content]
    with new_recording(path) as recording:
        for each in written:
            recording.copy(each)
    return written


def in_bag(path: Path) -> list[StoredMessage]:
    return [*OpenRecording(path).messages()]
