"""The metadata.yaml of a folder of MCAP files, as rosbag2 writes it since its version 9 (Jazzy)."""

from __future__ import annotations

import errno
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

_VERSION = 9
NAME = "metadata.yaml"
_LASTING = errno.EIO, errno.EACCES, errno.EPERM
"""Errors of a file that will not read later either. Others pass, and its messages are there."""


class _Topic(NamedTuple):
    """A topic as its messages were published; one with two QoS is two of these, as readers match them by it."""

    name: str
    type_name: str
    type_hash: str
    profiles: str


class _File(NamedTuple):
    """A file and what is in it.

    Attributes:
        unread: why nothing of it can be read, or empty.
    """

    path: Path
    begin: int  # ns since the epoch
    end: int
    counts: Counter[_Topic]
    unread: str = ""

    @property
    def information(self) -> dict[str, Any]:
        return {
            "path": self.path.name,
            "starting_time": {"nanoseconds_since_epoch": self.begin},
            "duration": {"nanoseconds": self.end - self.begin},
            "message_count": self.counts.total(),
        }


class BagFigures(NamedTuple):
    """What is in a folder.

    Attributes:
        seconds: from the first message to the last.
        unread: why files cannot be read that are there.
    """

    messages: int
    topics: int
    seconds: float
    unread: tuple[str, ...]


def bag_metadata(files: Sequence[Path], custom: Mapping[str, str]) -> tuple[str, BagFigures]:
    """Return the metadata of those MCAP files that are there, and what is in them, as far as it can be read.

    Args:
        custom: what rosbag2 calls ``custom_data``.

    Raises:
        OSError: one cannot be read now.
    """
    read = [each for path in files if (each := _read(path)) is not None]
    filled = [each for each in read if each.counts] or read
    begin, end = min((each.begin for each in filled), default=0), max((each.end for each in filled), default=0)
    counts = sum((each.counts for each in read), Counter[_Topic]())
    information = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": counts.total(),
        "topics_with_message_count": [*_topics(counts)],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [each.path.name for each in read],
        "files": [each.information for each in read],
        "custom_data": dict(custom),
        "ros_distro": "rosbag2_cpp",
    }
    text: str = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False, allow_unicode=True)
    unread = tuple(each.unread for each in read if each.unread)
    return text, BagFigures(counts.total(), len({each.name for each in counts}), (end - begin) / 1e9, unread)


def _topics(counts: Mapping[_Topic, int]) -> Iterable[dict[str, Any]]:
    for topic, count in sorted(counts.items()):
        metadata = {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": yaml.safe_load(topic.profiles),
            "type_description_hash": topic.type_hash,
        }
        yield {"topic_metadata": metadata, "message_count": count}


def _read(path: Path) -> _File | None:
    """Return what is in a file, or None if it is gone; raises OSError if it cannot be read now."""
    counts: Counter[_Topic] = Counter()
    try:
        recording = OpenRecording(path)
    except RecordingError as error:
        cause = error.__cause__
        if isinstance(cause, FileNotFoundError):
            return None
        if isinstance(cause, OSError) and cause.errno not in _LASTING:
            raise cause from None
        unread = str(error).replace(f"{path.parent}/", "")  # which has another name soon
        return _File(path, 0, 0, counts, unread)  # a reader says so, too, and the ring has to go on
    for channel, count in recording.counts.items():
        if count:
            counts[_Topic(channel.topic, channel.type_name, channel.type_hash, channel.profiles)] += count
    return _File(path, recording.summary.begin, recording.summary.end, counts)
