"""Recordings as they lie on disk: a file, or the files of a folder of rosbag2, each of which is read once."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rsb_extras.recording.reading.mcap_records import (
    CHUNK,
    IS_MESSAGE,
    MCAP_MAGIC,
    NEXT_FILE,
    ChannelTable,
    parsed_chunk,
    records,
    unpacked,
)
from rsb_extras.recording.reading.sqlite_bag import SQLITE_MAGIC, opened_bag
from rsb_extras.recording.reading.stored_message import (
    ZSTD,
    Damage,
    DamageError,
    RecordingError,
    UnreadableRecording,
    reading,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import IO

    from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

SUFFIXES = ".mcap", ".db3"
"""Of the files of recordings."""
_NUMBER = re.compile(r"(.+)_\d+(\.mcap|\.db3)")  # of the files of a split bag


def files_of(path: Path) -> list[Path]:
    """Return the files of a recording, in their order.

    Raises:
        RecordingError: it is a folder without a recording, or with several.
    """
    try:
        if not path.is_dir():
            return [path]
        names = [each.name for each in path.iterdir()]
    except OSError as error:
        raise RecordingError(UnreadableRecording.NOT_THERE(path=path, reason=error.strerror)) from None
    if any(name.endswith((".mcap.zstd", ".db3.zstd")) for name in names):
        raise RecordingError(UnreadableRecording.COMPRESSED(path=path))
    found = [name for name in names if name.endswith(SUFFIXES)]
    if not found:
        raise RecordingError(UnreadableRecording.NONE_WITHIN(path=path))
    numbered = {name: _NUMBER.fullmatch(name) for name in found}
    if len({match.groups() if match else name for name, match in numbered.items()}) > 1:
        raise RecordingError(UnreadableRecording.SEVERAL(path=path))
    return [path / name for name in sorted(found, key=lambda name: (len(name), name))]  # _10 behind _9


def is_sqlite(opened: IO[bytes], path: Path) -> bool:
    """Read the magic of a file, and return whether it is of sqlite3, or else of MCAP.

    Raises:
        RecordingError: it is neither, or cut off.
    """
    magic = opened.read(len(MCAP_MAGIC))
    found = bool(magic) and SQLITE_MAGIC.startswith(magic)
    if magic.startswith(ZSTD):
        raise RecordingError(UnreadableRecording.COMPRESSED(path=path))
    if not found and not MCAP_MAGIC.startswith(magic):
        raise RecordingError(UnreadableRecording.NO_RECORDING(path=path))
    if len(magic) < len(MCAP_MAGIC):
        raise DamageError(Damage.BROKEN(kind=EOFError.__name__))
    return found


class StoredMessages:
    """Yields the messages of one file in its order, also of a pipe. For the order of their times, see `OpenRecording`.

    Attributes:
        read: bytes of the file that have messages, so far.
        joined: number of recordings that stand behind another one in the same file.
        cut: why the rest was not read, or empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.read = 0
        self.joined = 0
        self.cut = ""
        self._channels: list[Mapping[int, StoredChannel]] = []

    @property
    def channels(self) -> Iterator[StoredChannel]:
        """The channels found so far, also those without a message. Those of messages are the same objects."""
        return (channel for channels in self._channels for channel in channels.values())

    def __iter__(self) -> Iterator[StoredMessage]:
        """Yield the messages, until the end or a damage.

        Raises:
            RecordingError: it is no recording, or cannot be read.
        """
        try:
            with reading(self.path), self.path.open("rb") as opened:
                if is_sqlite(opened, self.path):
                    yield from self._of_sqlite()
                else:
                    yield from self._of_mcap(opened)
        except DamageError as error:
            self.cut = str(error)

    def _of_sqlite(self) -> Iterator[StoredMessage]:
        with opened_bag(self.path) as bag:
            self._channels.append(bag.channels)
            for message in bag.messages():
                self.read = bag.read
                yield message

    def _of_mcap(self, opened: IO[bytes]) -> Iterator[StoredMessage]:
        import mcap.records  # noqa: F401, PLC0415 -- a file without a record needs it, too

        table = self._new_table()
        for kind, _, content in records(opened):
            self.read += len(content)
            if kind == NEXT_FILE:
                self.joined += 1
                table = self._new_table()
            elif kind == IS_MESSAGE:
                yield table.message(content)
            elif kind == CHUNK:
                chunk = parsed_chunk(content)
                yield from table.messages(unpacked(chunk), len(chunk.data))
            else:
                table.add(kind, content)

    def _new_table(self) -> ChannelTable:
        table = ChannelTable()
        self._channels.append(table.channels)
        return table
