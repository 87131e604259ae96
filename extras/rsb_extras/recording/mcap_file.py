"""Recordings in files: MCAP with the profile ``ros2``, as `ros2 bag` writes it."""

from __future__ import annotations

import contextlib
import hashlib
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import yaml

from rsb_bridge.config.files import whole_file
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.qos import TIMES
from rsb_extras.recording.message_definition import message_definition

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Qos
    from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

_LONGEST = (1 << 64) - 1  # ns; a time of MCAP
_NUMBERS = 1 << 32  # of messages, after which they begin again
_NEVER = {"sec": 9223372036, "nsec": 854775807}
"""A deadline, lifespan or lease where there is none, as rmw has it."""


class McapText(Wording):
    """The reason why there can be no recording."""

    NOT_INSTALLED = "mcap is not installed: pip install 'rsb-console[record]' on the bridge's machine"


class McapError(Exception):
    """There can be no recording; the message says why, and what to do."""


class RecordedTopic(NamedTuple):
    """A topic as one publisher or one link has it.

    Attributes:
        type_name: ``pkg/msg/Name``.
        description: of the type, with its hash (`rsb_bridge.cdr.description`), or empty if nobody describes it.
        publisher: name of a node or a link, or empty for any.
    """

    topic: str
    type_name: str
    type_hash: str
    description: str
    qos: Qos
    publisher: str = ""


class McapFile:
    """Writes the messages of one recording. Each topic becomes a channel with its first message.

    Args:
        file: is written to from its beginning, and not closed.
        is_compressed: whether by zstd, which nearly halves what numbers take, and takes a core for 250 MB/s of images.
        metadata: records of MCAP's metadata by their names.

    Attributes:
        messages: number of those that are written.

    Raises:
        McapError: MCAP's library is not installed.
    """

    def __init__(
        self, file: IO[bytes], *, is_compressed: bool = True, metadata: Mapping[str, dict[str, str]] | None = None
    ) -> None:
        try:
            from mcap.writer import CompressionType, IndexType, Writer  # noqa: PLC0415 -- bridges that record nothing do without
        except ImportError:
            raise McapError(McapText.NOT_INSTALLED()) from None
        self.messages = 0
        compression = CompressionType.ZSTD if is_compressed else CompressionType.NONE
        indexes = IndexType.CHUNK | IndexType.MESSAGE  # no empty groups
        if metadata:
            indexes |= IndexType.METADATA
        self._writer: Any = Writer(file, compression=compression, index_types=indexes)
        self._writer.start(profile="ros2", library="rsb-console")
        for name, values in (metadata or {}).items():
            self._writer.add_metadata(name, values)
        self._schemas: dict[str, int] = {}
        self._channels: dict[RecordedTopic, int] = {}
        self._copied: dict[StoredChannel, int] = {}

    def add(self, topic: RecordedTopic, content: bytes, time: int, published: int, number: int = 0) -> None:
        """Write a message.

        Args:
            content: the serialized message (CDR).
            time: ns since the epoch, when it came to the place that records.
            published: ns since the epoch, when it was published. If that is later, by another clock or an estimate,
                `time` is written.
            number: among its publisher's messages, from 1, or 0 if unknown.

        Raises:
            DescriptionError: no message file can describe the topic's type. Nothing is written.
            OSError: the file cannot be written.
        """
        channel = self._channels.get(topic) or self._channel(topic)
        # Clocks of publishers may say anything.
        logged, stamp = (min(max(0, each), _LONGEST) for each in (time, min(time, published)))
        self._writer.add_message(channel, logged, content, stamp, number % _NUMBERS)
        self.messages += 1

    def flush(self) -> None:
        """Hand what is added so far to the system, as a chunk that can be read without the end of the file."""
        self._writer.flush()

    def copy(self, message: StoredMessage) -> None:
        """Write a message of another recording with all that stands there; raises OSError."""
        channel = self._copied.get(message.channel)
        if channel is None:
            channel = self._copied[message.channel] = self._copied_channel(message.channel)
        time, published, number = message.time, message.published, message.number % _NUMBERS
        self._writer.add_message(channel, time, bytes(message.content), published, number)
        self.messages += 1

    def _copied_channel(self, stored: StoredChannel) -> int:
        encoding, definition = stored.definition
        key = f"{stored.type_name}\0{encoding}\0{hashlib.sha256(definition).hexdigest()}"
        schema = self._schemas.get(key)
        if schema is None:
            schema = self._schemas[key] = self._writer.register_schema(stored.type_name, encoding, definition)
        metadata = {
            "offered_qos_profiles": stored.profiles,
            "topic_type_hash": stored.type_hash,
            "publisher": stored.publisher,
        }
        known = {name: value for name, value in metadata.items() if value}
        channel: int = self._writer.register_channel(stored.topic, stored.encoding, schema, known)
        return channel

    def finish(self) -> None:
        """Write the end of the file: index and statistics."""
        self._writer.finish()

    def _channel(self, topic: RecordedTopic) -> int:
        key = topic.description or topic.type_name
        schema = self._schemas.get(key)
        if schema is None:
            # As rosbag2, of a type without a definition: its name, and nothing else.
            definition = message_definition(topic.description) if topic.description else ""
            encoding = "ros2msg" if definition else ""
            schema = self._writer.register_schema(topic.type_name, encoding, definition.encode())
            self._schemas[key] = schema
        metadata = {"offered_qos_profiles": qos_profiles(topic.qos), "topic_type_hash": topic.type_hash}
        if topic.publisher:
            metadata["publisher"] = topic.publisher
        channel: int = self._writer.register_channel(topic.topic, "cdr", schema, metadata)
        self._channels[topic] = channel
        return channel


def qos_profiles(qos: Qos) -> str:
    """Return a QoS as rosbag2 writes it since its version 9 (Jazzy)."""
    profile: dict[str, object] = {
        "history": qos.history,
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "liveliness": qos.liveliness,
        "avoid_ros_namespace_conventions": False,
    }
    for name in TIMES:
        seconds, rest = divmod(round(getattr(qos, name) * 1e9), 1_000_000_000)
        profile[name] = {"sec": seconds, "nsec": rest} if seconds or rest else dict(_NEVER)
    text: str = yaml.safe_dump([profile], sort_keys=False)
    return text


@contextlib.contextmanager
def new_recording(path: Path, *, metadata: Mapping[str, dict[str, str]] | None = None) -> Iterator[McapFile]:
    """A recording in a file that is not there yet (`rsb_bridge.config.files.whole_file`), with `McapFile`'s metadata.

    Raises:
        McapError: MCAP's library is not installed.
        OSError: the file is there, or it cannot be written.
    """
    with whole_file(path) as file:
        recording = McapFile(file, metadata=metadata)
        yield recording
        recording.finish()
