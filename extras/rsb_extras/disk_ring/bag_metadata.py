"""The metadata.yaml of a folder of MCAP files, as rosbag2 writes it since its version 9 (Jazzy)."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

_VERSION = 9
NAME = "metadata.yaml"


class _Topic(NamedTuple):
    """A topic as its messages were published; one with two QoS is two of these, as readers match them by it."""

    name: str
    type_name: str
    type_hash: str
    profiles: str


class _File(NamedTuple):
    path: Path
    begin: int  # ns since the epoch
    end: int
    counts: Counter[_Topic]

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
    """

    messages: int
    topics: int
    seconds: float


def bag_metadata(files: Sequence[Path], custom: Mapping[str, str]) -> tuple[str, BagFigures]:
    """Return the metadata of MCAP files, and what is in those that are whole.

    Args:
        custom: what rosbag2 calls ``custom_data``.

    Raises:
        OSError: one cannot be read.
    """
    read = [_read(path) for path in files]
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
        "relative_file_paths": [path.name for path in files],
        "files": [each.information for each in read],
        "custom_data": dict(custom),
        "ros_distro": "rosbag2_cpp",
    }
    text: str = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False, allow_unicode=True)
    return text, BagFigures(counts.total(), len({each.name for each in counts}), (end - begin) / 1e9)


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


def _read(path: Path) -> _File:
    from mcap.reader import make_reader  # noqa: PLC0415 -- bridges that record nothing do without

    counts: Counter[_Topic] = Counter()
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        if summary is None or summary.statistics is None:
            return _File(path, 0, 0, Counter())
        for number, count in summary.statistics.channel_message_counts.items():
            channel = summary.channels[number]
            type_hash, profiles = (channel.metadata.get(key, "") for key in ("topic_type_hash", "offered_qos_profiles"))
            counts[_Topic(channel.topic, summary.schemas[channel.schema_id].name, type_hash, profiles)] += count
    except OSError:
        raise
    except Exception:  # noqa: BLE001 -- the disk has damaged it: a reader says so, and the ring has to go on
        return _File(path, 0, 0, Counter())
    return _File(path, summary.statistics.message_start_time, summary.statistics.message_end_time, counts)
