"""The messages of sqlite3 files, which rosbag2 wrote by default until Iron, as rows.

The file is not written, and nothing that it may hold runs: neither a trigger nor a view, and no virtual table.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from rsb_extras.audit.recorded import LONGEST, Damage, DamageError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_extras.audit.recorded import RecordingRows

MAGIC = b"SQLite format 3\0"
_LEAST_ROW = 8  # bytes that the file has for each message at least: pages that are named twice would go on without end
_TABLES = {"topics", "messages"}
_DEFINITIONS = "message_definitions"  # since Iron


def read_sqlite(path: Path, rows: RecordingRows) -> None:
    """Read a file.

    Raises:
        DamageError: it is no bag, or damaged, and was read up to there.
        OSError: it cannot be read.
    """
    log = path.with_name(f"{path.name}-wal")
    has_log = log.exists() and log.stat().st_size > 0
    size = path.stat().st_size + (log.stat().st_size if has_log else 0)
    # Without a log of what was written last, the file is read as it is: no other file is made or locked beside it.
    uri = f"file:{quote(str(path.absolute()))}?mode=ro{'' if has_log else '&immutable=1'}"
    try:
        bag = sqlite3.connect(uri, uri=True, isolation_level=None)
    except sqlite3.Error as error:
        raise DamageError(Damage.BROKEN_BAG(reason=error)) from None
    with closing(bag):
        bag.text_factory = lambda text: text.decode(errors="replace")
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        for pragma in ("trusted_schema = OFF", "query_only = ON", "mmap_size = 0", "cell_size_check = ON"):
            bag.execute(f"PRAGMA {pragma}")
        _read_tables(bag, size, rows)


def _read_tables(bag: sqlite3.Connection, size: int, rows: RecordingRows) -> None:
    tables = {name for (name,) in _found(bag, "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0")}
    if not tables >= _TABLES:
        raise DamageError(Damage.NO_BAG())
    definitions: dict[str, tuple[str, bytes]] = {}
    if _DEFINITIONS in tables:
        columns = _columns(bag, _DEFINITIONS, ("topic_type", "encoding", "encoded_message_definition"))
        definitions = {name: (encoding, text.encode()) for name, encoding, text in _texts(bag, columns, _DEFINITIONS)}
    columns = _columns(
        bag, "topics", ("name", "type", "serialization_format"), ("offered_qos_profiles", "type_description_hash")
    )
    channels = {}
    for number, name, type_name, encoding, profiles, type_hash in _texts(bag, f"id, {columns}", "topics"):
        definition = definitions.get(type_name, ("", b""))
        channels[int(number)] = rows.channel(name, type_name, encoding, profiles, definition, type_hash=type_hash)
    _columns(bag, "messages", ("topic_id", "timestamp", "data"))
    left = bytes_left = size
    for number, time, content in _found(bag, "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"):
        if number not in channels or not isinstance(time, int) or not isinstance(content, bytes):
            raise DamageError(Damage.BROKEN_BAG(reason="a row of messages"))
        left -= _LEAST_ROW
        bytes_left -= len(content)
        if left < 0 or bytes_left < 0:
            raise DamageError(Damage.TOO_MANY())
        rows.pass_bytes(len(content))
        rows.add(channels[number], time, content)


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


def _found(bag: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    """Yield what a query finds in the bag.

    Raises:
        DamageError: it is damaged. Errors of the database of rows have another class.
    """
    try:
        yield from bag.execute(query)
    except (sqlite3.Error, OverflowError, MemoryError) as error:
        raise DamageError(Damage.BROKEN_BAG(reason=error)) from None
