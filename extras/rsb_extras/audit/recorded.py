"""Recordings as rows: each message becomes a row of a database on disk.

A row has the keys of the message's content, its time and its sender. No content is kept, so memory does not grow with a
recording; the disk holds about 70 bytes a message.
"""

from __future__ import annotations

import hashlib
import sqlite3
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.cdr.description import DescriptionError, TypeDescription, hash_of_text, read_description
from rsb_bridge.ros.native.rosidl_descriptions import installed_description
from rsb_extras.audit.padding import Padding, PaddingError
from rsb_extras.audit.unanswered import GOAL_STATUS, SERVICE_EVENTS, SeenCalls, SeenGoals
from rsb_extras.recording.reading.defined_types import DefinitionError, defined_type
from rsb_extras.recording.reading.recorded_qos import LATCHED, RELIABLE, parsed_profiles, policy
from rsb_extras.recording.reading.recording_files import StoredMessages, files_of
from rsb_extras.recording.reading.stored_message import (
    Damage,
    DamageError,
    RecordingError,
    UnreadableRecording,
    content_key,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from rsb_extras.recording.reading.stored_message import StoredChannel

_TOPICS = 10_000  # of a recording, with each publisher that it tells apart. A round figure
_ALL_PROFILES = 1 << 20  # characters of all channels' QoS: 3,000 publishers
_ALL_DEFINITIONS = 4 << 20  # bytes of all types' definitions: some 400 types
_PARTS_AT_FIRST = 1_000_000
"""Parts of messages that are looked at for padding, beside one for each byte of the file: some 0.5 s."""
_SET_BACK = 500_000_000  # ns, above what writers may mix up. A round figure
_MOST_SHIFT = 1 << 60  # ns, which the database still adds to any time
_LATEST = (1 << 62) - 1  # ns; later times of a damaged file would not fit into the database when compared
_CACHE = 16 << 10
"""KiB that the database keeps in memory, and that each of up to four sorts takes. 64 MiB were no faster for 10 million
messages."""
ROWS_HELD = 20_000  # rows before they are written: some 4 MB


class Offer(NamedTuple):
    """The QoS that a publisher offers; a field is None if it is unknown."""

    reliable: bool | None
    latched: bool | None


@dataclass
class TopicRows:
    """The messages of a topic in one recording.

    Attributes:
        table: of the database, with `key`, `plain`, `time` (ns) and `sender` of each message, and `shift`: ns by which
            the clock was set back before it, as far as the topic's own messages show it. `plain` is the key of its
            content without padding.
        described: whether the recording describes its type, so that `plain` is known.
        key: the column that is compared.
        messages: number of them.
        latest, shift: of its last message.
        senders: numbers of the publishers, by what the recording calls them; rosbag2 tells none apart.
        offers: QoS of the publishers of each sender.
    """

    name: str
    type_name: str
    table: str
    described: bool = True
    key: str = "key"
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
        joined: number of recordings that stand behind another one in the same file.
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
    joined: int = 0
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


def offers_of(profiles: str) -> list[Offer]:
    """Parse ``offered_qos_profiles`` of a channel, as rosbag2 writes it; what is not understood is unknown."""
    return [
        Offer(policy(RELIABLE, each.get("reliability")), policy(LATCHED, each.get("durability")))
        for each in parsed_profiles(profiles)
    ]


class RecordedChannel(NamedTuple):
    """A topic as one publisher has it, in one file."""

    topic: TopicRows
    sender: int
    is_cdr: bool
    padding: Padding | None
    watch: Callable[[memoryview, int], None] | None


def read_recording(path: Path, side: str, database: sqlite3.Connection) -> ReadRecording:
    """Read a file, or the files of a rosbag2 folder, into tables whose names begin with `side`.

    Raises:
        RecordingError: it is no recording, or has no message.
    """
    recording = ReadRecording(path, files_of(path))
    rows = _RecordingRows(recording, side, database)
    for file in recording.files:
        if cut := rows.read(StoredMessages(file)):
            recording.cut = cut if file == path else f"{file.name}: {cut}"
    rows.write()
    if not recording.messages:
        raise RecordingError(UnreadableRecording.EMPTY(path=path, cut=recording.cut and f": {recording.cut}"))
    return recording


class _RecordingRows:
    """Makes rows of the messages of one recording, which is filled."""

    def __init__(self, recording: ReadRecording, side: str, database: sqlite3.Connection) -> None:
        self._recording = recording
        self._side = side
        self._database = database
        self._held: dict[str, list[tuple[int, int, int, int, int]]] = {}
        self._count = self._senders = self._profiles = self._definitions = 0
        self._parts = _PARTS_AT_FIRST
        self._paddings: dict[tuple[str, str, bytes], Padding | None] = {}

    def read(self, stored: StoredMessages) -> str:
        """Read a file, and return why its end was not read, or an empty text.

        Raises:
            RecordingError: it is no recording, or cannot be read.
        """
        channels: dict[int, RecordedChannel] = {}  # by `id`, as their hashes take long
        read = 0
        try:
            for stored_channel, time, _, _, content in stored:
                if stored.read != read:
                    self._parts += stored.read - read
                    read = stored.read
                channel = channels.get(id(stored_channel))
                if channel is None:
                    channel = channels[id(stored_channel)] = self._channel(stored_channel)
                self._add(channel, time, content)
            for stored_channel in stored.channels:  # one without a message shows that its topic was there
                if id(stored_channel) not in channels:
                    self._channel(stored_channel)
        except DamageError as error:
            return str(error)
        finally:
            self._recording.joined += stored.joined
        return stored.cut

    def _channel(self, stored: StoredChannel) -> RecordedChannel:
        """Return a channel for messages of one topic and publisher.

        Raises:
            DamageError: the recording has too many topics.
        """
        recording, name, publisher = self._recording, stored.topic, stored.publisher
        short = stored.type_name.replace("/msg/", "/")
        topic = recording.topics.get((name, short))
        if topic is None:
            table = f"{self._side}_{len(recording.topics)}"
            columns = ", ".join(f"{each} INTEGER" for each in ("key", "plain", "time", "sender", "shift"))
            self._database.execute(f"CREATE TABLE {table} ({columns})")
            topic = recording.topics[name, short] = TopicRows(name, short, table)
            self._held[table] = []
        if publisher not in topic.senders:
            self._senders += 1
            if self._senders > _TOPICS:
                raise DamageError(Damage.TOPICS(limit=_TOPICS))
        sender = topic.senders.setdefault(publisher, len(topic.senders))
        self._profiles += len(stored.profiles)
        offers = offers_of(stored.profiles) if self._profiles <= _ALL_PROFILES else []
        # The next file of a split recording has the channel again.
        topic.offers[publisher] = max(offers, topic.offers.get(publisher, []), key=len)
        is_cdr = stored.encoding == "cdr"
        padding = self._padding(stored.type_name, stored.definition, stored.type_hash) if is_cdr else None
        if padding is None and is_cdr:
            topic.described = False
        watch = None
        if name.endswith(SERVICE_EVENTS):
            watch = recording.calls.setdefault(name.removesuffix(SERVICE_EVENTS), SeenCalls()).add
        elif name.endswith(GOAL_STATUS):
            watch = recording.goals.setdefault(name.removesuffix(GOAL_STATUS), SeenGoals()).add
        return RecordedChannel(topic, sender, is_cdr, padding, watch)

    def _padding(self, type_name: str, definition: tuple[str, bytes], type_hash: str) -> Padding | None:
        encoding, text = definition
        known = type_name, type_hash, hashlib.sha256(text).digest()
        if known not in self._paddings:
            self._definitions += len(text)
            described = None
            if encoding == "ros2msg" and self._definitions <= _ALL_DEFINITIONS:
                described = _defined(type_name, text)
            described = described or _installed(type_name, type_hash)
            try:
                self._paddings[known] = None if described is None else Padding(described)
            except PaddingError:
                self._paddings[known] = None
        return self._paddings[known]

    def _add(self, channel: RecordedChannel, time: int, content: memoryview) -> None:
        topic, sender, is_cdr, padding, watch = channel
        time = max(min(time, _LATEST), -_LATEST)
        # A recorder writes a topic's messages as they come, so that an earlier time means that its clock was set.
        if time < topic.latest - _SET_BACK:
            topic.shift = min(topic.shift + topic.latest - time, _MOST_SHIFT)
        topic.latest = time
        key = plain = content_key(content, is_cdr=is_cdr)
        if padding is not None and topic.described:
            try:
                cleared, parts = padding.cleared(content, self._parts)
            except PaddingError:
                topic.described = False
            else:
                self._parts -= parts
                if cleared is not None:
                    plain = content_key(cleared, is_cdr=True)
        self._held[topic.table].append((key, plain, time, sender, topic.shift))
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


def index_topics(database: sqlite3.Connection, pairs: Iterable[tuple[TopicRows, TopicRows]]) -> None:
    """Choose what is compared of pairs of topics, and sort it once, for all that is asked of it.

    Without padding if both recordings describe the type: one that is told by one of them only makes equal messages
    differ.
    """
    for pair in pairs:
        described = all(topic.described for topic in pair)
        for topic in pair:
            topic.key = "plain" if described else "key"
            database.execute(f"CREATE INDEX {topic.table}_keys ON {topic.table} ({topic.key}, time, sender)")


def view(database: sqlite3.Connection, **views: tuple[TopicRows, int]) -> None:
    """Give tables of topics, with an offset of their times, the names that queries have."""
    for name, (topic, offset) in views.items():
        database.execute(f"DROP VIEW IF EXISTS {name}")
        # `turn` has the order in which they were recorded, also where the clock was set back.
        columns = f"{topic.key} AS key, time - {offset} AS time, sender, time - {offset} + shift AS turn"
        rows = f"SELECT {columns} FROM {topic.table}"  # noqa: S608 -- names of our own
        database.execute(f"CREATE TEMP VIEW {name} AS {rows}")


def insert(database: sqlite3.Connection, table: str, rows: list[Any]) -> None:
    """Write rows to a table, and empty their list."""
    if rows:
        database.executemany(f"INSERT INTO {table} VALUES ({','.join('?' * len(rows[0]))})", rows)  # noqa: S608
        rows.clear()


def _defined(type_name: str, text: bytes) -> TypeDescription | None:
    try:
        return defined_type(type_name, text.decode())
    except (DefinitionError, UnicodeDecodeError):
        return None


def _installed(type_name: str, type_hash: str) -> TypeDescription | None:
    """Return the description of a type that is installed here, if it may be the recording's."""
    try:
        text = installed_description(type_name)
    except ValueError:
        return None
    if text is None or type_hash not in ("", hash_of_text(text)):
        return None
    try:
        return read_description(text, hash_of_text(text))
    except DescriptionError:
        return None
