"""Recordings whose messages are read in the order of their times, from any time on.

Of MCAP, the index at the end of a file is used; a file without one, of a recorder that was killed, is read once to make
it. Files are not trusted: memory stays bounded whatever they say.
"""

from __future__ import annotations

import heapq
import zlib
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, NamedTuple, Protocol

from rsb_extras.recording.reading.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEAD,
    IS_MESSAGE,
    MCAP_MAGIC,
    NEXT_FILE,
    SCHEMA,
    ChannelTable,
    parsed_chunk,
    records,
    unpacked,
)
from rsb_extras.recording.reading.recording_files import files_of, is_sqlite
from rsb_extras.recording.reading.sqlite_bag import opened_bag
from rsb_extras.recording.reading.stored_message import (
    LONGEST,
    Damage,
    DamageError,
    RecordingError,
    StoredChannel,
    StoredMessage,
    UnreadableRecording,
    reading,
)

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator
    from pathlib import Path

_CHUNK_INDEX, _STATISTICS = 8, 11  # opcodes of records of the summary
_HELD = 256 << 20
"""Bytes of chunks with the same times that are held together. A round figure: chunks of rosbag2 rarely overlap."""
_MESSAGE_COST = 400  # bytes of a message's objects, beside its content: 370 by `sys.getsizeof`
_MOST_MESSAGES = 200_000  # of a chunk. A round figure: chunks of 4 MiB hold 80,000 messages without content
_MOST_BLOCKS = 1_000_000  # of a file. A round figure: 1 TB in chunks of 1 MB
_TOGETHER = 1 << 20  # bytes of messages outside of chunks that are read at once


class RecordingSummary(NamedTuple):
    """A recording in short.

    Attributes:
        begin, end: ns since the epoch, times of the first and the last message, or 0 if there is none.
        size: bytes of its files.
        topics: by name: type and number of messages.
        cut: why the rest was not read, or empty.
    """

    begin: int
    end: int
    messages: int
    size: int
    topics: dict[str, tuple[str, int]]
    cut: str


class _Block(Protocol):
    """Messages that lie together in a file."""

    @property
    def begin(self) -> int: ...
    @property
    def end(self) -> int: ...
    def load(
        self, topics: Container[str] | None, begin: int | None, end: int | None
    ) -> tuple[int, Iterator[StoredMessage]]:
        """Return the bytes that are held, and the messages in the order of their times, ties in that of the file."""


@dataclass
class _Index:
    """Where the messages of a file are, how many each channel has, and why the rest was not read."""

    blocks: list[_Block] = field(default_factory=list)
    counts: Counter[StoredChannel] = field(default_factory=Counter)
    cut: str = ""


class _McapBlock(NamedTuple):
    """A chunk, or messages outside of chunks.

    Attributes:
        at, length: bytes of the file: the chunk's record without its head, or whole records of messages.
        ids: of the channels with messages, or None if unknown.
    """

    begin: int
    end: int
    path: Path
    at: int
    length: int
    is_chunk: bool
    table: ChannelTable
    ids: frozenset[int] | None

    def load(
        self, topics: Container[str] | None, begin: int | None, end: int | None
    ) -> tuple[int, Iterator[StoredMessage]]:
        only = self.table.ids_of(topics)
        if only is not None and self.ids is not None and only.isdisjoint(self.ids):
            return 0, iter(())
        with reading(self.path):
            with self.path.open("rb") as opened:
                opened.seek(self.at)
                data = opened.read(self.length)
            if len(data) < self.length:
                raise EOFError
            size = len(data)
            if self.is_chunk:
                chunk = parsed_chunk(data)
                data, size = unpacked(chunk), len(chunk.data)
            found: list[StoredMessage] = []
            for message in self.table.messages(data, size, only):
                if (begin is None or message.time >= begin) and (end is None or message.time < end):
                    found.append(message)
                    if len(found) > _MOST_MESSAGES:
                        raise DamageError(Damage.TOO_MANY())
        found.sort(key=lambda each: each.time)
        return (len(data) + _MESSAGE_COST * len(found) if found else 0), iter(found)


class _SqliteBlock(NamedTuple):
    """A whole file, which SQLite brings into order."""

    begin: int
    end: int
    path: Path

    def load(
        self, topics: Container[str] | None, begin: int | None, end: int | None
    ) -> tuple[int, Iterator[StoredMessage]]:
        return 0, self._messages(topics, begin, end)

    def _messages(self, topics: Container[str] | None, begin: int | None, end: int | None) -> Iterator[StoredMessage]:
        with reading(self.path), opened_bag(self.path) as bag:
            yield from bag.messages_by_time(topics, begin, end)


class OpenRecording:
    """A recording, of which only the index is in memory; no file stays open.

    Attributes:
        counts: number of messages of each channel of all files.
        summary: RecordingSummary.

    Raises:
        RecordingError: it is no recording, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files = files_of(path)
        indices = [_index_of(file) for file in self.files]
        blocks = [block for each in indices for block in each.blocks]
        # With their places in the files, by which messages of one time are ordered.
        self._blocks = sorted(enumerate(blocks), key=lambda placed: placed[1].begin)
        counts: Counter[StoredChannel] = Counter()
        topics: dict[str, tuple[str, int]] = {}
        for index in indices:
            counts.update(index.counts)
        for channel, count in counts.items():
            topics[channel.topic] = channel.type_name, topics.get(channel.topic, ("", 0))[1] + count
        self.counts = counts
        self.summary = RecordingSummary(
            begin=self._blocks[0][1].begin if self._blocks else 0,
            end=max((block.end for block in blocks), default=0),
            messages=sum(counts.values()),
            size=sum(file.stat().st_size for file in self.files),
            topics=topics,
            cut="; ".join(
                index.cut if file == path else f"{file.name}: {index.cut}"
                for file, index in zip(self.files, indices, strict=True)
                if index.cut
            ),
        )

    @property
    def channels(self) -> list[StoredChannel]:
        """Those of all files, each once."""
        return [*self.counts]

    def messages(
        self, *, topics: Container[str] | None = None, begin: int | None = None, end: int | None = None
    ) -> Iterator[StoredMessage]:
        """Yield messages in the order of their times, those of one time in the order of the files.

        Args:
            topics: their names, or None for all.
            begin: ns since the epoch of the first one.
            end: ns since the epoch before which the last one is.

        Raises:
            RecordingError: a file cannot be read, or is damaged there: all messages before were yielded.
        """
        waiting = deque(
            (place, block)
            for place, block in self._blocks
            if (begin is None or block.end >= begin) and (end is None or block.begin < end)
        )
        # Each as its next message's time, its place, its bytes, that message, and those behind it.
        loaded: list[tuple[int, int, int, StoredMessage, Iterator[StoredMessage]]] = []
        held, last = 0, None
        while waiting or loaded:
            while waiting and (not loaded or waiting[0][1].begin <= loaded[0][0]):
                place, block = waiting.popleft()
                cost, rest = block.load(topics, begin, end)
                if (first := next(rest, None)) is not None:
                    held += cost
                    heapq.heappush(loaded, (first.time, place, cost, first, rest))
                if held > _HELD and len(loaded) > 1:
                    raise DamageError(Damage.OVERLAPPING(limit=_HELD >> 20))
            if not loaded:
                continue
            time, place, cost, message, rest = loaded[0]
            if last is not None and time < last:
                raise DamageError(Damage.DISORDERED())
            last = time
            yield message
            if (following := next(rest, None)) is None:
                heapq.heappop(loaded)
                held -= cost
            else:
                heapq.heapreplace(loaded, (following.time, place, cost, following, rest))


def summary_of(path: Path) -> RecordingSummary:
    """Return a recording in short: from the summaries of its files if they are whole, else by reading them.

    Raises:
        RecordingError: it is no recording, or cannot be read.
    """
    return OpenRecording(path).summary


def messages_of(
    path: Path, *, topics: Container[str] | None = None, begin: int | None = None, end: int | None = None
) -> Iterator[StoredMessage]:
    """Yield messages as `OpenRecording.messages`."""
    return OpenRecording(path).messages(topics=topics, begin=begin, end=end)


def _index_of(path: Path) -> _Index:
    if not path.is_file():
        raise RecordingError(
            UnreadableRecording.NO_FILE(path=path)
            if path.exists()
            else UnreadableRecording.NOT_THERE(path=path, reason="there is no such file")
        )
    index = _Index()
    try:
        with reading(path), path.open("rb") as opened:
            if is_sqlite(opened, path):
                _read_sqlite(path, index)
            elif (found := _summarized(opened, path)) is not None:
                index = found
            else:
                opened.seek(len(MCAP_MAGIC))
                _read_mcap(opened, path, index)
    except DamageError as error:
        index.cut = str(error)
    return index


def _read_sqlite(path: Path, index: _Index) -> None:
    with opened_bag(path) as bag:
        try:
            counts, begin, end = bag.counts()
        except DamageError:
            # What lies before the damage, message by message.
            span = _Span()
            try:
                for message in bag.messages():
                    index.counts[message.channel] += 1
                    span.add(message.time)
            finally:
                index.blocks += (_SqliteBlock(*times, path) for times in span)
            raise
        for number, channel in bag.channels.items():
            index.counts[channel] += counts.get(number, 0)
        if counts:
            index.blocks.append(_SqliteBlock(begin, end, path))


class _Span(list[tuple[int, int]]):
    """The times of the first and the last message, or nothing if there is none."""

    def add(self, time: int) -> None:
        begin, end = self[0] if self else (time, time)
        self[:] = [(min(begin, time), max(end, time))]


def _summarized(opened: IO[bytes], path: Path) -> _Index | None:
    """Return the index that the file's own summary gives, or None if there is no whole one."""
    with suppress(Exception):  # a summary that cannot be read in any way is none
        return _from_summary(opened, path)
    return None


def _from_summary(opened: IO[bytes], path: Path) -> _Index | None:
    from mcap.records import ChunkIndex, Footer, Statistics  # noqa: PLC0415 -- bridges that record nothing do without

    length = 20
    footer_at = opened.seek(0, 2) - len(MCAP_MAGIC) - length - HEAD.size
    opened.seek(footer_at)
    tail = opened.read()
    footer: Footer = _parsed(Footer, tail[HEAD.size : HEAD.size + length])
    start = footer.summary_start
    is_footer = HEAD.unpack_from(tail) == (FOOTER, length) and tail.endswith(MCAP_MAGIC)
    if not is_footer or not 0 < start < footer_at or footer_at - start > LONGEST:
        return None
    # Behind another file, the place is not that of the summary.
    opened.seek(start - 4 - HEAD.size)
    is_behind_data = HEAD.unpack(opened.read(HEAD.size)) == (DATA_END, 4)
    opened.seek(start)
    data = opened.read(footer_at - start)
    if not is_behind_data or footer.summary_crc not in (0, zlib.crc32(data + tail[: HEAD.size + length - 4])):
        return None
    table, chunks, statistics, at = ChannelTable(), [], None, 0
    while at < len(data):
        kind, size = HEAD.unpack_from(data, at)
        at += HEAD.size
        record = data[at : at + size]
        at += size
        if kind in (SCHEMA, CHANNEL):
            table.add(kind, record)
        elif kind == _CHUNK_INDEX:
            chunks.append(_parsed(ChunkIndex, record))
        elif kind == _STATISTICS:
            statistics = _parsed(Statistics, record)
    if statistics is None or statistics.chunk_count != len(chunks) or not _is_whole(statistics, chunks, table):
        return None
    blocks: list[_Block] = [
        _McapBlock(
            each.message_start_time,
            each.message_end_time,
            path,
            each.chunk_start_offset + HEAD.size,
            each.chunk_length - HEAD.size,
            True,
            table,
            frozenset(each.message_index_offsets) or None,
        )
        for each in sorted(chunks, key=lambda each: each.chunk_start_offset)
        if HEAD.size < each.chunk_length <= LONGEST and each.chunk_start_offset + each.chunk_length <= start
    ]
    if len(blocks) < len(chunks):
        return None
    if statistics.message_start_time:  # a chunk without messages has no times
        blocks = [block for block in blocks if block.begin or block.end]
    counts: Counter[StoredChannel] = Counter()
    for number, channel in table.channels.items():  # some writers begin the same channel again
        counts[channel] += statistics.channel_message_counts.get(number, 0)
    return _Index(blocks, counts)


def _parsed(record: Any, content: bytes) -> Any:
    from mcap.data_stream import ReadDataStream  # noqa: PLC0415

    return record.read(ReadDataStream(BytesIO(content)))


def _is_whole(statistics: Any, chunks: Iterable[Any], table: ChannelTable) -> bool:
    """Whether a summary names the channels of all messages, and chunks if there are any."""
    counts = statistics.channel_message_counts
    has_chunks = any(True for _ in chunks)
    return (
        counts.keys() <= table.channels.keys()
        and sum(counts.values()) == statistics.message_count
        and (has_chunks or not statistics.message_count)
    )


def _read_mcap(opened: IO[bytes], path: Path, index: _Index) -> None:
    """Read a file behind its magic, and note where its messages are."""
    import mcap.records  # noqa: F401, PLC0415 -- a file without a record needs it, too

    table = ChannelTable()
    run = _Run(path, table)
    try:
        for kind, at, content in records(opened):
            if kind == IS_MESSAGE:
                message = table.message(content)
                index.counts[message.channel] += 1
                if not run.takes(at, len(content)):
                    index.blocks += run.blocks()
                    run = _Run(path, table)
                run.add(at, len(content), message.time)
                continue
            index.blocks += run.blocks()
            if kind == NEXT_FILE:
                table = ChannelTable()
            elif kind == CHUNK:
                index.blocks += _chunk_block(path, at, content, table, index.counts)
            else:
                table.add(kind, content)
            run = _Run(path, table)
            if len(index.blocks) > _MOST_BLOCKS:
                raise DamageError(Damage.TOO_MANY())
    finally:
        index.blocks += run.blocks()


def _chunk_block(
    path: Path, at: int, content: bytes, table: ChannelTable, counts: Counter[StoredChannel]
) -> Iterator[_Block]:
    chunk = parsed_chunk(content)
    found: Counter[StoredChannel] = Counter()
    span = _Span()
    for message in table.messages(unpacked(chunk), len(chunk.data)):
        found[message.channel] += 1
        span.add(message.time)
    counts.update(found)
    for begin, end in span:
        yield _McapBlock(begin, end, path, at, len(content), True, table, None)


class _Run:
    """Messages outside of chunks that follow each other."""

    def __init__(self, path: Path, table: ChannelTable) -> None:
        self._path = path
        self._table = table
        self._at = self._end_at = 0
        self._span = _Span()

    def takes(self, at: int, length: int) -> bool:
        """Whether a record's content follows at once, and both together are not too long."""
        follows = self._end_at == at - HEAD.size
        return not self._span or (follows and at + length - self._at <= _TOGETHER)

    def add(self, at: int, length: int, time: int) -> None:
        if not self._span:
            self._at = at - HEAD.size
        self._span.add(time)
        self._end_at = at + length

    def blocks(self) -> Iterator[_Block]:
        for begin, end in self._span:
            length = self._end_at - self._at
            yield _McapBlock(begin, end, self._path, self._at, length, False, self._table, None)
