"""A fetch that completes what came live: first the heads of all messages, then those that are missing here.

It puts each message of the other side's recording into the file once, with its time, and what only came live beside it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import sqlite3
from io import BytesIO
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.files import UNFINISHED
from rsb_bridge.feature_api import Wording
from rsb_extras.courier.completed_recording import (
    MOST_GAPS,
    CompletedRecording,
    CompletedTopic,
    MissingReason,
    MissingSpan,
)
from rsb_extras.courier.fetch_spool import PieceRow, Spool, check_room, until
from rsb_extras.courier.live_parts import LIVE, keep_parts
from rsb_extras.courier.message_index import MOST_MESSAGES, MessageIndex, TooManyMessagesError
from rsb_extras.courier.pieces import PieceError, PieceProblem
from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import DamageError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from rsb_extras.courier.fetch_spool import AskedFetch
    from rsb_extras.courier.live_parts import LivePart
    from rsb_extras.courier.message_index import Placed, TopicFigures
    from rsb_extras.courier.pieces import Channels
    from rsb_extras.recording.mcap_file import McapFile
    from rsb_extras.recording.reading.stored_message import StoredChannel, StoredMessage

METADATA = "rsb_completed"
"""The name of the metadata record of the file, whose `json` is a `CompletedRecording`, before the messages."""
METADATA_WITHIN = 4 << 20
"""Bytes of a file that have it. A round figure: a `CompletedRecording` of 256 topics with long names has 0.5 MB."""
_HEADS, _INDEX, _UNSORTED = "heads", "messages.db", "unsorted.mcap"
_HEADS_SHARE = 0.1
"""Of what a fetch shows of its progress, for the heads. A round figure."""


class CompletionProblem(Wording):
    """The reason why there is no file."""

    TOO_MANY = "more than {most:,} messages: give --from and --to, or topics"
    NO_ROOM = "{folder} takes no index of the messages: {error}"
    LATE = "messages came in another order than they can be sorted in: {error}"


class CompletionSpool(Spool):
    """The folder of a fetch with its rows of pieces, and the files that came live.

    Args:
        parts: the files that came live; they are in the folder once it is made.
    """

    def __init__(self, folder: Path, asked: AskedFetch, parts: Sequence[LivePart] = ()) -> None:
        assert asked.completes is not None
        super().__init__(folder, asked)
        self._completes = asked.completes
        self._here = {each.there: each.here for each in asked.completes.topics}
        self._parts = parts
        self._rows = [PieceRow(folder / _HEADS, asked.wanted, asked.listed.size, self._working)]
        self._orders = 0
        self._channels: Channels | None = None
        self._index: MessageIndex | None = None

    def _prepare(self) -> None:
        self._rows[0].folder.mkdir(0o700)
        unfinished = self.folder / f"{LIVE}{UNFINISHED}"
        keep_parts(self._parts, unfinished)
        unfinished.rename(self.folder / LIVE)

    @property
    def is_made(self) -> bool:
        return (self.folder / LIVE).is_dir()

    @property
    def rows(self) -> Sequence[PieceRow]:
        return self._rows

    @property
    def share(self) -> float:
        if len(self._rows) == 1:
            return _HEADS_SHARE * self._rows[0].share(self.asked.listed)
        done = len(self._rows) - 2 + self._rows[-1].share(self.asked.listed)
        return _HEADS_SHARE + (1 - _HEADS_SHARE) * done / self._orders

    def next_row(self, stop: Callable[[], bool]) -> PieceRow | None:
        with self._working, self._indexing():
            while self._rows[-1].is_whole:
                index = self._index or self._compared(stop)
                if len(self._rows) > self._orders:
                    return None
                self._rows.append(self._row(index, len(self._rows), stop))
            return self._rows[-1]

    def _row(self, index: MessageIndex, number: int, stop: Callable[[], bool]) -> PieceRow:
        """Return the pieces of one order of missing messages, with those that have come."""
        wanted = index.order(number - 1, self.asked.wanted)
        # A bridge of another version may find other ones missing: pieces of another order are none of this one.
        digest = hashlib.sha256(msgspec.msgpack.encode(wanted)).hexdigest()[:16]
        folder = self.folder / f"{number:04}-{digest}"
        folder.mkdir(0o700, exist_ok=True)
        if self._channels is None:
            self._channels = self._rows[0].channels()
        row = PieceRow(folder, wanted, self.asked.listed.size, self._working, self._channels)
        row.load(stop)
        return row

    def _compared(self, stop: Callable[[], bool]) -> MessageIndex:
        path = self.folder / _INDEX
        path.unlink(missing_ok=True)  # of a bridge before: the same comes of the same files
        self._index = index = MessageIndex(path, self._completes.topics, lambda: check_room(self.folder))
        try:
            self._fill(index, stop)
        except BaseException:
            self._drop_index()
            raise
        self._orders = index.orders
        return index

    def _drop_index(self) -> None:
        index, self._index = self._index, None
        if index is not None:
            index.close()

    @contextlib.contextmanager
    def _indexing(self) -> Iterator[None]:
        """Raise OSError if the index fails, which is made anew then: what was not written whole may say anything."""
        try:
            yield
        except sqlite3.Error as error:
            self._drop_index()
            raise OSError(errno.ENOSPC, CompletionProblem.NO_ROOM(folder=self.folder, error=error)) from None

    def _fill(self, index: MessageIndex, stop: Callable[[], bool]) -> None:
        try:
            index.add_there(until(self._rows[0].messages(), stop))
            numbered = enumerate(until(self._live(), stop), 1)
            for _, part in itertools.groupby(numbered, key=lambda each: each[1][0]):
                index.add_live((at, message) for at, (_, message) in part)
            index.compare(self._completes.ahead)
        except TooManyMessagesError:
            raise PieceError(CompletionProblem.TOO_MANY(most=MOST_MESSAGES)) from None

    def _live(self) -> Iterator[tuple[Path, StoredMessage]]:
        """Yield the messages that came live, file by file; what is damaged ends a file."""
        names = {each.here for each in self._completes.topics}
        for path in sorted((self.folder / LIVE).iterdir()):
            with contextlib.suppress(RecordingError):
                for message in OpenRecording(path).messages(topics=names):
                    yield path, message

    # --- the file

    def _write(self, stop: Callable[[], bool]) -> int:
        with self._indexing():
            return self._write_file(stop)

    def _write_file(self, stop: Callable[[], bool]) -> int:
        if self.next_row(stop) is not None or self._index is None:
            raise PieceError(PieceProblem.CUT())
        unsorted = self.folder / _UNSORTED
        for each in (unsorted, unsorted.with_name(f".{unsorted.name}{UNFINISHED}")):
            each.unlink(missing_ok=True)
        check_room(self.folder, self.taken)
        with new_recording(unsorted) as recording:
            self._write_all(self._index, recording, stop)
        check_room(self.folder, unsorted.stat().st_size)
        self.completed = self._figures(self._index)
        try:
            with new_recording(self.path, metadata={METADATA: {"json": _text(self.completed)}}) as recording:
                for message in until(OpenRecording(unsorted).messages(), stop):
                    recording.copy(message)
        except DamageError as error:
            raise PieceError(CompletionProblem.LATE(error=error)) from None
        return recording.messages

    def _write_all(self, index: MessageIndex, recording: McapFile, stop: Callable[[], bool]) -> None:
        """Write all messages with their places, those that came live first."""
        channels = [each._replace(topic=self._here[each.topic]) for each in index.channels]
        alike: dict[StoredChannel, StoredChannel] = {}
        places = index.live_places(*self._span(index))
        at, place = next(places, (0, None))
        for number, (_, message) in enumerate(until(self._live(), stop), 1):
            if number != at or place is None:
                continue
            check_room(self.folder)
            if place.id:
                channel = channels[place.channel]
            else:
                channel = alike.get(message.channel) or alike.setdefault(
                    message.channel, _alike(message.channel, channels)
                )
                place = place._replace(published=message.published, number=message.number)
            recording.copy(_placed(message, channel, place))
            at, place = next(places, (0, None))
        index.begin_fetched()
        for row in self._rows[1:]:
            for message in until(row.messages(), stop):
                if (place := index.fetched_place(message)) is not None:
                    recording.copy(_placed(message, channels[place.channel], place))

    def close(self) -> None:
        if (index := self._index) is not None:
            index.interrupt()
        with self._working:
            self._drop_index()

    def remove(self) -> None:
        self.close()
        super().remove()

    def _span(self, index: MessageIndex) -> tuple[int, int]:
        """Return the asked span on this side's clock (ns since the epoch)."""
        begin, end = index.here(self._completes.begin), index.here(self._completes.end)
        if self._completes.is_open:
            first, last = index.live_span()
            return min(begin, first or begin), max(end, last)
        return begin, end

    def _figures(self, index: MessageIndex) -> CompletedRecording:
        figures = [*index.figures(*self._span(index))]
        topics = [self._topic(index, number, each) for number, each in enumerate(figures)]
        fetched, whole = sum(each.size for each in figures), sum(each.whole for each in figures)
        return CompletedRecording(index.clock, tuple(topics), fetched, whole)

    def _topic(self, index: MessageIndex, number: int, figures: TopicFigures) -> CompletedTopic:
        name = self._completes.topics[number]
        lost, gaps = index.lost(number)
        missing = [
            MissingSpan(MissingReason.LOST, index.here(each.begin), index.here(each.end), each.messages)
            for each in gaps
        ]
        if (absent := figures.absent) is not None:
            lost += absent.messages
            span = index.here(absent.begin), index.here(absent.end)
            missing.append(MissingSpan(MissingReason.NOT_GIVEN, *span, absent.messages))
        missing += self._unknown(index, name.there)
        largest = sorted(missing, key=lambda gap: (gap.messages is not None, -(gap.messages or 0)))
        shown = sorted(largest[:MOST_GAPS], key=lambda gap: gap.begin)
        return CompletedTopic(
            name.here, name.there, figures.live, figures.only_live, figures.fetched, max(0, lost), tuple(shown),
            max(0, len(missing) - MOST_GAPS),
        )  # fmt: skip

    def _unknown(self, index: MessageIndex, topic: str) -> Iterator[MissingSpan]:
        """Yield the times of which the other side's recording has nothing to tell."""
        begin, end = self._span(index)
        listed, heads = self.asked.listed, self._rows[0]
        if topic in heads.denied:
            yield MissingSpan(MissingReason.DENIED, begin, end)
        elif not heads.damage and topic not in {
            *(each.name for each in listed.topics),
            *(each.topic for each in index.channels),
        }:
            yield MissingSpan(MissingReason.NOT_RECORDED, begin, end)
        else:
            first, last = index.here(listed.begin), index.here(heads.at.time if heads.damage else listed.end)
            if begin < first and listed.end:
                yield MissingSpan(MissingReason.BEGINS_LATER, begin, first)
            if end > last and listed.end:
                yield MissingSpan(MissingReason.DAMAGED if heads.damage else MissingReason.ENDS_EARLIER, last, end)


def _placed(message: StoredMessage, channel: StoredChannel, place: Placed) -> StoredMessage:
    return message._replace(
        channel=channel, time=place.time, published=min(place.published, place.time), number=place.number
    )


def _alike(channel: StoredChannel, known: Sequence[StoredChannel]) -> StoredChannel:
    """Return the other side's channel of a topic for what only came live, if it has one of the same type."""
    same = (each for each in known if each[:3] == channel[:3])  # topic, type and encoding
    return next(same, channel)


def _text(completed: CompletedRecording) -> str:
    return msgspec.json.encode(completed).decode()


def completed_in(head: bytes) -> CompletedRecording | None:
    """Return what a file says that it completes, or None if it says nothing, or what nobody can read.

    Args:
        head: the first `METADATA_WITHIN` bytes of the file, which may be anybody's.
    """
    from mcap.records import Header, Metadata  # noqa: PLC0415 -- bridges that record nothing do without
    from mcap.stream_reader import StreamReader  # noqa: PLC0415

    with contextlib.suppress(Exception):
        for record in StreamReader(BytesIO(head), emit_chunks=True).records:
            if isinstance(record, Metadata) and record.name == METADATA:
                return msgspec.json.decode(record.metadata["json"], type=CompletedRecording)
            if not isinstance(record, Header | Metadata):
                break
    return None
