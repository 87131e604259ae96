"""The messages of sqlite3 files, which rosbag2 wrote by default until Iron.

The file is not written, and nothing that it may hold runs: neither a trigger nor a view, and no virtual table.
"""

from __future__ import annotations

import errno
import sqlite3
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from rsb_extras.recording.reading.stored_message import (
    LONGEST,
    ZSTD,
    Damage,
    DamageError,
    StoredChannel,
    StoredMessage,
    unpacked_message,
)

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path

SQLITE_MAGIC = b"SQLite format 3\0"
_LEAST_ROW = 8  # bytes that the file has for each message at least: pages that are named twice would go on without end
_TABLES = {"topics", "messages"}
_DEFINITIONS = "message_definitions"  # since Iron
_BY_TIME = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"
"""The index that rosbag2 makes; another one is not used, as it may compute what it holds."""
_EARLIEST, _LATEST = -(1 << 63), (1 << 63) - 1  # ns; the times of a database


class SqliteBag:
    """A file that is open.

    Attributes:
        channels: by the numbers of their topics.
        read: bytes of messages, so far.
    """

    def __init__(self, bag: sqlite3.Connection, size: int) -> None:
        self._bag = bag
        self._size = size
        self.read = 0
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0"
        tables = {name for (name,) in _found(bag, query)}
        if not tables >= _TABLES:
            raise DamageError(Damage.NO_BAG())
        definitions: dict[str, tuple[str, bytes]] = {}
        if _DEFINITIONS in tables:
            columns = _columns(bag, _DEFINITIONS, ("topic_type", "encoding", "encoded_message_definition"))
            rows = _texts(bag, columns, _DEFINITIONS)
            definitions = {name: (encoding, text.encode()) for name, encoding, text in rows}
        columns = _columns(
            bag, "topics", ("name", "type", "serialization_format"), ("offered_qos_profiles", "type_description_hash")
        )
        self.channels: dict[int, StoredChannel] = {}
        for number, name, type_name, encoding, profiles, type_hash in _texts(bag, f"id, {columns}", "topics"):
            definition = definitions.get(type_name, ("", b""))
            self.channels[int(number)] = StoredChannel(name, type_name, encoding, profiles, definition, type_hash, "")
        _columns(bag, "messages", ("topic_id", "timestamp", "data"))

    def messages(self) -> Iterator[StoredMessage]:
        """Yield all messages in the order of the file.

        Raises:
            DamageError: it is damaged.
        """
        return self._messages("NOT INDEXED", None)

    def messages_by_time(
        self, topics: Container[str] | None, begin: int | None, end: int | None
    ) -> Iterator[StoredMessage]:
        """Yield messages of some topics, in the order of their times, from `begin` on and before `end` (ns).

        Raises:
            DamageError: it is damaged.
        """
        query = "SELECT sql FROM sqlite_master WHERE type = 'index' AND name = 'timestamp_idx' AND rootpage > 0"
        index = "INDEXED BY timestamp_idx" if (_BY_TIME,) in _found(self._bag, query) else "NOT INDEXED"
        first, last = (_EARLIEST if begin is None else begin), (_LATEST if end is None else end - 1)
        rows = f"{index} WHERE timestamp BETWEEN ? AND ? ORDER BY timestamp, rowid"
        within = (min(max(first, _EARLIEST), _LATEST), min(max(last, _EARLIEST), _LATEST))
        return self._messages(rows, topics, *within)

    def counts(self) -> tuple[dict[int, int], int, int]:
        """Return how many messages each topic has, by its number, and the times (ns) of the first and last message.

        Raises:
            DamageError: it is damaged.
        """
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages NOT INDEXED GROUP BY topic_id"
        found = [row for row in _found(self._bag, query) if row[0] in self.channels]
        if not all(isinstance(each, int) for row in found for each in row):
            raise DamageError(Damage.BROKEN_BAG(reason="a row of messages"))
        begin, end = min((row[2] for row in found), default=0), max((row[3] for row in found), default=0)
        return {row[0]: row[1] for row in found}, begin, end

    def _messages(self, rows: str, topics: Container[str] | None, *values: int) -> Iterator[StoredMessage]:
        left = bytes_left = self._size
        query = f"SELECT topic_id, timestamp, data FROM messages {rows}"  # noqa: S608 -- texts of our own
        for number, time, content in _found(self._bag, query, *values):
            channel = self.channels.get(number)
            if channel is None or not isinstance(time, int) or not isinstance(content, bytes):
                raise DamageError(Damage.BROKEN_BAG(reason="a row of messages"))
            left -= _LEAST_ROW
            bytes_left -= len(content)
            self.read += len(content)
            if left < 0 or bytes_left < 0:
                raise DamageError(Damage.TOO_MANY())
            if topics is None or channel.topic in topics:
                is_packed = content[:4] == ZSTD and channel.encoding == "cdr"
                plain = unpacked_message(content) if is_packed else memoryview(content)
                yield StoredMessage(channel, time, time, 0, plain)


def log_of(path: Path) -> Path:
    """Return where SQLite keeps what was written last, while something writes or if that was killed."""
    return path.with_name(f"{path.name}-wal")


def copy_bag(path: Path, target: Path) -> None:
    """Copy a file with what its log holds, also while something writes to it; raises OSError if it cannot be copied."""
    try:
        with closing(_opened(path, has_log=True)) as bag, closing(sqlite3.connect(target)) as copy:
            bag.backup(copy)
    except sqlite3.Error as error:
        target.unlink(missing_ok=True)
        raise OSError(errno.EIO, f"SQLite says: {error}", str(path)) from None


@contextmanager
def opened_bag(path: Path) -> Iterator[SqliteBag]:
    """A file, open.

    Raises:
        DamageError: it is no bag, or damaged.
        OSError: it cannot be read.
    """
    log = log_of(path)
    has_log = log.exists() and log.stat().st_size > 0
    size = path.stat().st_size + (log.stat().st_size if has_log else 0)
    try:
        bag = _opened(path, has_log=has_log)
    except sqlite3.Error as error:
        raise DamageError(Damage.BROKEN_BAG(reason=error)) from None
    with closing(bag):
        bag.text_factory = lambda text: text.decode(errors="replace")
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        for pragma in ("trusted_schema = OFF", "query_only = ON", "mmap_size = 0", "cell_size_check = ON"):
            bag.execute(f"PRAGMA {pragma}")
        yield SqliteBag(bag, size)


def _opened(path: Path, *, has_log: bool) -> sqlite3.Connection:
    # Without a log of what was written last, the file is read as it is: no other file is made or locked beside it.
    uri = f"file:{quote(str(path.absolute()))}?mode=ro{'' if has_log else '&immutable=1'}"
    return sqlite3.connect(uri, uri=True, isolation_level=None)


def _columns(bag: sqlite3.Connection, table: str, needed: tuple[str, ...], known: tuple[str, ...] = ()) -> str:
    """Return the columns to select, those of `known` that the table lacks as empty texts.

    Raises:
        DamageError: it lacks one that is needed, or computes one.
    """
    found = {name: hidden for _, name, *_, hidden in _found(bag, f"PRAGMA table_xinfo({table})")}
    if any(found.get(name) != 0 for name in needed) or any(found.values()):
        raise DamageError(Damage.NO_BAG())
    return ", ".join((*needed, *(name if name in found else "''" for name in known)))


def _texts(bag: sqlite3.Connection, columns: str, table: str) -> Iterator[tuple[str, ...]]:
    for row in _found(bag, f"SELECT {columns} FROM {table}"):  # noqa: S608 -- names of our own
        yield tuple("" if each is None else str(each) for each in row)


def _found(bag: sqlite3.Connection, query: str, *values: int) -> Iterator[tuple[Any, ...]]:
    """Yield what a query finds in the bag.

    Raises:
        DamageError: it is damaged.
    """
    try:
        yield from bag.execute(query, values)
    except (sqlite3.Error, OverflowError, MemoryError) as error:
        raise DamageError(Damage.BROKEN_BAG(reason=error)) from None
