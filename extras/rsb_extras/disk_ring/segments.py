"""Segments of the ring on disk: MCAP files, each of them a whole recording."""

from __future__ import annotations

import contextlib
import os
from typing import IO, TYPE_CHECKING, NamedTuple

from rsb_bridge.cdr.description import DescriptionError
from rsb_bridge.config.files import owner_only, remove_file, whole_file
from rsb_bridge.feature_api import sync_folder
from rsb_extras.recording.mcap_file import McapFile
from rsb_extras.recording.reading.mcap_records import (
    CHUNK,
    HEAD,
    MCAP_MAGIC,
    NEXT_FILE,
    ChannelTable,
    parsed_chunk,
    records,
    unpacked,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_extras.recording.mcap_file import RecordedTopic
    from rsb_extras.recording.message_ring import RingMessage
    from rsb_extras.recording.reading.stored_message import StoredMessage

SUFFIX = ".mcap"
_MESSAGE_INDEX = 7  # opcode of a record


class Segment(NamedTuple):
    """A segment that is finished.

    Attributes:
        number: of its file, which grows.
        began, ended: s on the steady clock, when its first and its last message were added.
    """

    path: Path
    number: int
    began: float
    ended: float
    size: int


class OpenSegment:
    """The segment that is being written.

    Args:
        path: of a file that is not there yet.
        began: s on the steady clock, when the first message came.

    Attributes:
        undefined: topics in it whose types it does not define.
        content: bytes of the messages in it.

    Raises:
        McapError: MCAP's library is not installed.
        OSError: it cannot be written.
    """

    def __init__(self, path: Path, number: int, began: float, *, is_compressed: bool) -> None:
        self.path, self.number, self.began, self.ended = path, number, began, began
        self.undefined: set[str] = set()
        self.content = 0
        handle = owner_only(str(path), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC)
        self._file = os.fdopen(handle, "wb")
        try:
            self._recording = McapFile(self._file, is_compressed=is_compressed)
            sync_folder(path.parent)
        except BaseException:
            self._file.close()
            raise

    def add(self, topic: RecordedTopic, message: RingMessage, time: int) -> None:
        """Write a message with a log time (ns since the epoch)."""
        if not topic.description:
            self.undefined.add(topic.topic)
        with contextlib.suppress(DescriptionError):  # it was looked at before
            self._recording.add(topic, message.content, time, message.published, message.number)
        self.content += len(message.content)
        self.ended = max(self.ended, message.at)

    @property
    def size(self) -> int:
        return self._file.tell()

    def sync(self) -> None:
        """Have the disk hold all that was added, readable without the end of the file."""
        self._recording.flush()
        os.fdatasync(self._file.fileno())

    def finish(self) -> Segment:
        """Write the end of the file."""
        self._recording.finish()
        self._file.flush()
        os.fdatasync(self._file.fileno())
        size = self.size
        self._file.close()
        return Segment(self.path, self.number, self.began, self.ended, size)

    def abandon(self) -> None:
        """Close the file as it is."""
        with contextlib.suppress(OSError):
            self._file.close()


def is_whole(path: Path) -> bool:
    """Whether a segment has its end."""
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) < 2 * len(MCAP_MAGIC):
            return False
        file.seek(-len(MCAP_MAGIC), os.SEEK_END)
        return file.read() == MCAP_MAGIC


class Completed(NamedTuple):
    """What is left of a segment that was cut.

    Attributes:
        messages: number of those in whole chunks.
        lost: bytes behind these chunks.
    """

    messages: int
    lost: int


def complete(path: Path) -> Completed:
    """Give a segment that was cut its end, behind its last whole chunk; remove it if it has none.

    Raises:
        McapError: MCAP's library is not installed.
        OSError: it cannot be written. The file is as it was.
    """
    status, target = path.stat(), path.with_suffix(".whole")
    remove_file(target)
    remove_file(target.with_name(f".{target.name}.part"))
    with path.open("rb") as file, whole_file(target) as copy:
        messages, end = _copy(file, copy)
    if messages:
        os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))  # by which its messages get too old
        target.replace(path)
    else:
        remove_file(target)
        remove_file(path)
    sync_folder(path.parent)
    return Completed(messages, max(0, status.st_size - end))


def _copy(file: IO[bytes], copy: IO[bytes]) -> tuple[int, int]:
    """Copy the whole chunks of a file; return the number of messages, and where the last one of these chunks ends."""
    recording, end = McapFile(copy), 0
    for chunk_end, messages in _whole_chunks(file):
        for each in messages:
            recording.copy(each)
        end = chunk_end
    recording.finish()
    return recording.messages, _behind_indices(file, end)


def _whole_chunks(file: IO[bytes]) -> Iterator[tuple[int, list[StoredMessage]]]:
    """Yield where each chunk ends that is whole by its checksum (bytes), from the first on, and its messages."""
    table = ChannelTable()
    # Behind a cut, a disk has nothing, zeros, or another file's bytes, on which a library raises whatever it does.
    with contextlib.suppress(Exception):
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return
        for kind, at, content in records(file):
            if kind == NEXT_FILE:
                return
            if kind == CHUNK:
                chunk = parsed_chunk(content)
                yield at + len(content), [*table.messages(unpacked(chunk), len(chunk.data))]


def _behind_indices(file: IO[bytes], end: int) -> int:
    """Return where the whole indices of messages end that follow a chunk."""
    size = file.seek(0, os.SEEK_END)
    while True:
        file.seek(end)
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            return end
        kind, length = HEAD.unpack(head)
        if kind != _MESSAGE_INDEX or length > size - file.tell():
            return end
        end = file.tell() + length
