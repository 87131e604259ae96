"""Recordings as rows: each file is read once, and each message becomes a row of a database on disk.

A row has the key of the message's content, its time and its sender. No content is kept, so memory does not grow with a
recording; the disk holds about 60 bytes a message.
"""

from __future__ import annotations

import hashlib
import re
import sqlite3
import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import yaml
import zstandard

from rsb_bridge.model.wording import Wording
from rsb_extras.audit.unanswered import GOAL_STATUS, SERVICE_EVENTS, SeenCalls, SeenGoals

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _IS_MESSAGE, _CHUNK, _DATA_END = 3, 4, 5, 6, 15  # opcodes of records
_SET_BACK = 500_000_000  # ns, above what writers may mix up. A round figure
_MOST_SHIFT = 1 << 60  # ns, which the database still adds to any time
_LATEST = (1 << 62) - 1  # ns; later times of a damaged file would not fit into the database when compared
_LONGEST = 1 << 30
"""Bytes of one record, chunks included. A round figure: rosbag2 writes chunks of less than 1 MB, and a message is at
most as long as memory allows."""
_SKIPPED = 1 << 20  # bytes that are read at once of what does not count
_NUMBER = re.compile(r"(.+)_\d+\.mcap")  # of the files of a split bag
_CACHE = 16 << 10
"""KiB that the database keeps in memory, and that each of up to four sorts takes. 64 MiB were no faster for 10 million
messages."""
ROWS_HELD = 20_000  # rows before they are written: some 4 MB
_RELIABLE: dict[object, bool] = {"reliable": True, 1: True, "best_effort": False, 2: False}
_LATCHED: dict[object, bool] = {"transient_local": True, 1: True, "volatile": False, 2: False}
"""Policies by their names (rosbag2 since Jazzy) and numbers (before)."""


class UnreadableRecording(Wording):
    """Reasons why a recording cannot be read."""

    NOT_INSTALLED = "mcap is not installed: pip install 'rsb-console[record]'"
    NOT_THERE = "{path} cannot be read: {reason}"
    NO_MCAP = "{path} is no MCAP file: record with `ros2 bag record --storage mcap`, or convert it"
    NO_MCAP_WITHIN = "{path} has no file *.mcap: record with `ros2 bag record --storage mcap`, or convert it"
    SEVERAL = "{path} has recordings of several names: give one of its files"
    COMPRESSED = "{path} is compressed as a whole: unpack it with `zstd -d`"
    EMPTY = "{path} has no message{cut}"
    NO_ROOM = "the folder for temporary files cannot hold the audit ({reason}): set TMPDIR to one with more room"


class RecordingError(Exception):
    """A recording cannot be read; the message says why, and what to do."""


class Offer(NamedTuple):
    """The QoS that a publisher offers; a field is None if it is unknown."""

    reliable: bool | None
    latched: bool | None


@dataclass
class TopicRows:
    """The messages of a topic in one recording.

    Attributes:
        table: of the database, with `key`, `time` (ns) and `sender` of each message, and `shift`: ns by which the clock
            was set back before it, as far as the topic's own messages show it.
        messages: number of them.
        latest, shift: of its last message.
        senders: numbers of the publishers, by what the recording calls them; rosbag2 tells none apart.
        offers: QoS of the publishers of each sender.
    """

    name: str
    type_name: str
    table: str
    messages: int = 0
    latest: int = 0
    shift: int = 0
    senders: dict[str, int] = field(default_factory=dict)
    offers: dict[str, list[Offer]] = field(default_factory=dict)

    @property
    def offer(self) -> Offer:
        """The QoS that all publishers share; a field is None if they differ or it is unknown."""
        known = [offer for offers in self.offers.values() for offer in offers]
        reliable, latched = ({offer[at] for offer in known} for at in (0, 1))
        return Offer(*(next(iter(each)) if len(each) == 1 else None for each in (reliable, latched)))

    @property
    def one_publisher_each(self) -> bool:
        """Whether all messages of a sender come from one publisher, as far as the recording says."""
        return all(len(offers) <= 1 for offers in self.offers.values())


@dataclass
class ReadRecording:
    """A recording that was read.

    Attributes:
        files: those of a folder.
        topics: by name and type.
        first, last: ns, log times of messages, or 0 if there is none.
        cut: why the rest was not read, or empty.
        calls: by service.
        goals: by action.
    """

    path: Path
    files: list[Path]
    topics: dict[tuple[str, str], TopicRows] = field(default_factory=dict)
    messages: int = 0
    first: int = 0
    last: int = 0
    cut: str = ""
    calls: dict[str, SeenCalls] = field(default_factory=dict)
    goals: dict[str, SeenGoals] = field(default_factory=dict)


def new_database() -> sqlite3.Connection:
    """Return an empty database in a file that SQLite deletes, in the folder for temporary files."""
    database = sqlite3.connect("", isolation_level=None)
    # Without a journal, as nobody needs the rows after a failure.
    for pragma in ("journal_mode = OFF", "synchronous = OFF", "temp_store = FILE", f"cache_size = -{_CACHE}"):
        database.execute(f"PRAGMA {pragma}")
    database.execute("BEGIN")
    return database


def read_recording(path: Path, side: str, database: sqlite3.Connection) -> ReadRecording:
    """Read a file, or the files of a rosbag2 folder, into tables whose names begin with `side`.

    Raises:
        RecordingError: it is no recording, or has no message.
    """
    recording = ReadRecording(path, _files_of(path))
    rows = _Rows(recording, side, database)
    for file in recording.files:
        try:
            with file.open("rb") as opened:
                cut = _read(opened, file, rows)
        except OSError as error:
            raise RecordingError(UnreadableRecording.NOT_THERE(path=file, reason=error.strerror or error)) from None
        if cut:
            recording.cut = cut if file == path else f"{file.name}: {cut}"
    rows.write()
    for topic in recording.topics.values():  # sorted once, for all that is asked of it
        database.execute(f"CREATE INDEX {topic.table}_keys ON {topic.table} (key, time, sender)")
    if not recording.messages:
        raise RecordingError(UnreadableRecording.EMPTY(path=path, cut=recording.cut and f": {recording.cut}"))
    return recording


def content_key(content: memoryview, *, is_cdr: bool) -> int:
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


def offers_of(profiles: str) -> list[Offer]:
    """Parse ``offered_qos_profiles`` of a channel, as rosbag2 writes it; what is not understood is unknown."""
    if "&" in profiles:  # no profile has anchors, a few lines of which may fill the memory
        return []
    try:
        parsed = yaml.safe_load(profiles)
    except (yaml.YAMLError, ValueError, RecursionError):  # ValueError: a date that is none
        return []
    if not isinstance(parsed, list):
        return []
    return [
        Offer(_policy(_RELIABLE, each.get("reliability")), _policy(_LATCHED, each.get("durability")))
        for each in parsed
        if isinstance(each, dict)
    ]


def _policy(known: dict[object, bool], value: object) -> bool | None:
    return known.get(value) if isinstance(value, str | int) else None


def _files_of(path: Path) -> list[Path]:
    try:
        if not path.is_dir():
            return [path]
        names = [each.name for each in path.iterdir()]
    except OSError as error:
        raise RecordingError(UnreadableRecording.NOT_THERE(path=path, reason=error.strerror)) from None
    if any(name.endswith(".mcap.zstd") for name in names):
        raise RecordingError(UnreadableRecording.COMPRESSED(path=path))
    found = [name for name in names if name.endswith(".mcap")]
    if not found:
        raise RecordingError(UnreadableRecording.NO_MCAP_WITHIN(path=path))
    numbered = {name: _NUMBER.fullmatch(name) for name in found}
    if len({match[1] if match else name for name, match in numbered.items()}) > 1:
        raise RecordingError(UnreadableRecording.SEVERAL(path=path))
    return [path / name for name in sorted(found, key=lambda name: (len(name), name))]  # _10 behind _9


def _read(opened: IO[bytes], path: Path, rows: _Rows) -> str:
    """Read a file, and return why its end was not read, or an empty text."""
    try:
        import mcap.records  # noqa: F401, PLC0415 -- everything else does without
    except ImportError:
        raise RecordingError(UnreadableRecording.NOT_INSTALLED()) from None
    magic = opened.read(len(_MAGIC))
    if not _MAGIC.startswith(magic):
        raise RecordingError(UnreadableRecording.NO_MCAP(path=path))
    if len(magic) < len(_MAGIC):
        return "it is cut off or damaged (EOFError)"
    rows.begin_file()
    try:
        for kind, record in _records(opened):
            rows.add_record(kind, record)
    except (sqlite3.Error, OSError):
        raise
    # What the libraries of MCAP, zstd and lz4 raise has no common class.
    except Exception as error:  # noqa: BLE001
        return f"it is cut off or damaged ({type(error).__name__})"
    return ""


def _records(opened: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield the records that count, up to the end of the data. The library's reader spends a fifth more on indices.

    Raises:
        EOFError: the file ends earlier.
    """
    while len(head := opened.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        if kind == _DATA_END:
            return
        if length > _LONGEST:
            raise OverflowError
        if kind not in (_SCHEMA, _CHANNEL, _IS_MESSAGE, _CHUNK):
            while length and (skipped := opened.read(min(length, _SKIPPED))):  # a pipe cannot seek
                length -= len(skipped)
            continue
        record = opened.read(length)
        if len(record) < length:
            break
        yield kind, record
    raise EOFError


def unpacked(chunk: Any) -> bytes:
    """Return the content of a chunk. The library's own function takes as much memory as a file asks for."""
    size = chunk.uncompressed_size
    if size > _LONGEST:
        raise OverflowError
    data: bytes = chunk.data
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(data).read(size)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 -- comes with mcap

        data = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif chunk.compression:
        raise NotImplementedError(chunk.compression)
    # A damaged chunk would look like losses.
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError
    return data


class _Channel(NamedTuple):
    topic: TopicRows
    sender: int
    is_cdr: bool
    watch: Callable[[memoryview, int], None] | None


class _Rows:
    """Makes rows of the records of MCAP files."""

    def __init__(self, recording: ReadRecording, side: str, database: sqlite3.Connection) -> None:
        self._recording = recording
        self._side = side
        self._database = database
        self._held: dict[str, list[tuple[int, int, int, int]]] = {}
        self._count = 0
        self.begin_file()

    def begin_file(self) -> None:
        """Forget the ids of schemas and channels, which each file has its own of."""
        self._types: dict[int, str] = {}
        self._channels: dict[int, _Channel] = {}

    def add_record(self, kind: int, record: bytes | memoryview) -> None:
        from mcap.data_stream import ReadDataStream  # noqa: PLC0415
        from mcap.records import Channel, Chunk, Schema  # noqa: PLC0415

        if kind == _IS_MESSAGE:
            channel, _, time, _ = _MESSAGE.unpack_from(record)
            self._add_message(channel, time, memoryview(record)[_MESSAGE.size :])
        elif kind == _CHANNEL:
            self._add_channel(Channel.read(ReadDataStream(BytesIO(record))))
        elif kind == _SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            self._types[schema.id] = schema.name
        else:
            self._add_chunk(unpacked(Chunk.read(ReadDataStream(BytesIO(record)))))

    def _add_chunk(self, data: bytes) -> None:
        # The library's own loop takes three times as long, as it makes an object of each message.
        view, at, end = memoryview(data), 0, len(data)
        while at < end:
            kind, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if at + length > end:
                raise EOFError
            if kind == _IS_MESSAGE:
                channel, _, time, _ = _MESSAGE.unpack_from(data, at)
                self._add_message(channel, time, view[at + _MESSAGE.size : at + length])
            elif kind in (_CHANNEL, _SCHEMA):
                self.add_record(kind, view[at : at + length])
            at += length

    def _add_channel(self, record: Any) -> None:
        if record.id in self._channels:  # some writers repeat it in each chunk
            return
        recording, name = self._recording, record.topic
        type_name = self._types.get(record.schema_id, "").replace("/msg/", "/")
        topic = recording.topics.get((name, type_name))
        if topic is None:
            table = f"{self._side}_{len(recording.topics)}"
            self._database.execute(f"CREATE TABLE {table} (key INTEGER, time INTEGER, sender INTEGER, shift INTEGER)")
            topic = recording.topics[name, type_name] = TopicRows(name, type_name, table)
            self._held[table] = []
        publisher = record.metadata.get("publisher", "")
        sender = topic.senders.setdefault(publisher, len(topic.senders))
        offers = offers_of(record.metadata.get("offered_qos_profiles", ""))
        # The next file of a split recording has the channel again.
        topic.offers[publisher] = max(offers, topic.offers.get(publisher, []), key=len)
        watch = None
        if name.endswith(SERVICE_EVENTS):
            watch = recording.calls.setdefault(name.removesuffix(SERVICE_EVENTS), SeenCalls()).add
        elif name.endswith(GOAL_STATUS):
            watch = recording.goals.setdefault(name.removesuffix(GOAL_STATUS), SeenGoals()).add
        self._channels[record.id] = _Channel(topic, sender, record.message_encoding == "cdr", watch)

    def _add_message(self, channel_id: int, time: int, content: memoryview) -> None:
        topic, sender, is_cdr, watch = self._channels[channel_id]
        time = min(time, _LATEST)
        # A recorder writes a topic's messages as they come, so that an earlier time means that its clock was set.
        if time < topic.latest - _SET_BACK:
            topic.shift = min(topic.shift + topic.latest - time, _MOST_SHIFT)
        topic.latest = time
        self._held[topic.table].append((content_key(content, is_cdr=is_cdr), time, sender, topic.shift))
        topic.messages += 1
        recording = self._recording
        recording.first = min(recording.first, time) if recording.messages else time
        recording.last = max(recording.last, time)
        recording.messages += 1
        if watch is not None:
            watch(content, time)
        self._count += 1
        if self._count >= ROWS_HELD:
            self.write()

    def write(self) -> None:
        """Write the held rows to the database."""
        for table, rows in self._held.items():
            insert(self._database, table, rows)
        self._count = 0


def view(database: sqlite3.Connection, **views: tuple[TopicRows, int]) -> None:
    """Give tables of topics, with an offset of their times, the names that queries have."""
    for name, (topic, offset) in views.items():
        database.execute(f"DROP VIEW IF EXISTS {name}")
        # `turn` has the order in which they were recorded, also where the clock was set back.
        columns = f"key, time - {offset} AS time, sender, time - {offset} + shift AS turn"
        rows = f"SELECT {columns} FROM {topic.table}"  # noqa: S608 -- names of our own
        database.execute(f"CREATE TEMP VIEW {name} AS {rows}")


def insert(database: sqlite3.Connection, table: str, rows: list[Any]) -> None:
    """Write rows to a table, and empty their list."""
    if rows:
        database.executemany(f"INSERT INTO {table} VALUES ({','.join('?' * len(rows[0]))})", rows)  # noqa: S608
        rows.clear()
