"""A message of a recording, and why a recording is not read, or up to some place only."""

from __future__ import annotations

import contextlib
import hashlib
from typing import TYPE_CHECKING, NamedTuple

import zstandard

from rsb_bridge.feature_api import Wording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LONGEST = 64 << 20
"""Bytes of one record, unpacked. A round figure: chunks of rosbag2 have 1 MB, or one longer message."""
ZSTD = b"\x28\xb5\x2f\xfd"
"""The first bytes of what zstd has compressed. No CDR begins so."""


class Damage(Wording):
    """Reasons why a recording is read up to some place only."""

    BROKEN = "it is cut off or damaged ({kind})"
    BROKEN_BAG = "it is cut off or damaged ({reason}): `sqlite3 FILE .recover` may save more"
    TOO_LONG = "a record or message has more than {limit} MiB"
    TOO_MANY = "it has more records than bytes"
    TOPICS = "it has more than {limit:,} topics"
    HEADS = "the definitions and QoS of its topics have more than {limit} MiB"
    NO_BAG = "it has not the tables of rosbag2"
    FOLLOWS = "what stands behind its end is no recording"
    DISORDERED = "its index has other times than its messages: `mcap recover` makes a new one"
    OVERLAPPING = "chunks of more than {limit} MiB have the same times: `mcap sort` separates them"


class UnreadableRecording(Wording):
    """Reasons why a recording cannot be read."""

    NOT_INSTALLED = "mcap is not installed: pip install 'rsb-console[record]'"
    NOT_THERE = "{path} cannot be read: {reason}"
    NO_RECORDING = "{path} is no recording: give a file *.mcap or *.db3 of `ros2 bag record`"
    NONE_WITHIN = "{path} has no file *.mcap or *.db3: give a folder of `ros2 bag record`"
    SEVERAL = "{path} has recordings of several names: give one of its files"
    COMPRESSED = "{path} is compressed as a whole: unpack it with `zstd -d`"
    EMPTY = "{path} has no message{cut}"
    NO_FILE = "{path} is no plain file: save it as one"


class RecordingError(Exception):
    """A recording cannot be read; the message says why, and what to do."""


class DamageError(RecordingError):
    """A recording cannot be read further; the message says why."""


class StoredChannel(NamedTuple):
    """A topic as one publisher has it, in one file.

    Attributes:
        type_name: ``pkg/msg/Name``.
        encoding: of the messages.
        profiles: QoS of the publishers, as rosbag2 writes it, or empty.
        definition: of the type: its encoding and text.
        type_hash: as the recording has it, or empty.
        publisher: name that tells publishers apart, or empty.
    """

    topic: str
    type_name: str
    encoding: str
    profiles: str
    definition: tuple[str, bytes]
    type_hash: str
    publisher: str


class StoredMessage(NamedTuple):
    """A message of a recording.

    Attributes:
        time: ns since the epoch, when it was recorded.
        published: ns since the epoch; `time` if unknown.
        number: among its publisher's messages, or 0 if unknown.
        content: serialized, not compressed.
    """

    channel: StoredChannel
    time: int
    published: int
    number: int
    content: memoryview


def content_key(content: bytes | memoryview, *, is_cdr: bool) -> int:
    """Return a number of 64 bits by which messages with the same content are found.

    Of CDR, the two bytes of options do not count, and neither does whether the end is padded to a multiple of 4, as
    some middlewares do.
    """
    if not is_cdr or len(content) < 4:
        made = hashlib.blake2b(content, digest_size=8)
    else:
        made = hashlib.blake2b(content[4:], digest_size=8, salt=content[:2])
        if len(content) % 4:
            made.update(bytes(-len(content) % 4))
    return int.from_bytes(made.digest(), "little", signed=True)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise what reading a file may raise as `RecordingError`: one class for the libraries of MCAP, zstd and lz4."""
    try:
        yield
    except RecordingError:
        raise
    except ImportError:
        raise RecordingError(UnreadableRecording.NOT_INSTALLED()) from None
    except OSError as error:
        raise RecordingError(UnreadableRecording.NOT_THERE(path=path, reason=error.strerror or error)) from error
    except Exception as error:  # noqa: BLE001
        raise DamageError(Damage.BROKEN(kind=type(error).__name__)) from None


_UNPACK = zstandard.ZstdDecompressor(max_window_size=LONGEST)


def unpacked_message(content: bytes | memoryview) -> memoryview:
    """Unpack a message that rosbag2 has compressed (`--compression-mode message`).

    Raises:
        DamageError: it has too many bytes.
        zstandard.ZstdError: it cannot be unpacked.
    """
    # The library reserves what the message asks for.
    size = zstandard.get_frame_parameters(content).content_size
    if size > LONGEST and size != zstandard.CONTENTSIZE_UNKNOWN:
        raise DamageError(Damage.TOO_LONG(limit=LONGEST >> 20))
    return memoryview(_UNPACK.decompress(content, max_output_size=LONGEST))
