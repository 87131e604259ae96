"""Pieces of recordings: messages as one row of bytes, cut, packed, and joined again.

A message is 32 bytes of `HEAD` and its content. The same recording gives the same row of bytes each time, so that a
piece may begin anywhere in it, also within a long message.
"""

from __future__ import annotations

import hashlib
import struct
from typing import TYPE_CHECKING, Annotated, TypeAlias

import msgspec
import zstandard
from msgspec import Meta

from rsb_bridge.feature_api import TEXT_LENGTH, Count, Name, Reason, Wording, sanitize_text
from rsb_extras.courier.courier_records import Cursor, TopicNames
from rsb_extras.recording.reading.stored_message import LONGEST, DamageError, StoredChannel, StoredMessage

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

PIECE = 256 << 10
"""Bytes of messages of a piece. A round figure: what crosses again at most after a loss, with 2 s at 1 Mbit/s."""
MOST_CHANNELS = 1024
"""Of a fetch: topics, each of some publishers."""
_DEFINITION = 256 << 10
"""Bytes of a definition that crosses; a longer one is left out, so that most programs cannot read the topic."""
_UNPACKED = 2 * PIECE + 2 * _DEFINITION
"""Bytes of an unpacked piece at most: the definitions of one piece have as many as its messages, or one is longer."""
LIMIT = _UNPACKED + (64 << 10)
"""Bytes of a piece as it crosses."""
HEAD = struct.Struct("<QQII8s")
"""Of a message: log time, publish time (ns since the epoch), number, bytes of its content, channel."""
_LEVEL = 3
"""Of zstd: its default."""
_DIGEST = hashlib.sha256().digest_size
_PROFILES = 64 << 10  # characters; a publisher has 400

ChannelId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]


class PieceProblem(Wording):
    """The reason why a piece, or what all of them give, is not what was asked for."""

    INVALID = "a piece is damaged"
    WRONG_PLACE = "a piece begins elsewhere than the last one ended"
    NO_PROGRESS = "a piece has nothing"
    UNKNOWN_CHANNEL = "a message has no channel"
    NOT_ASKED = "a message of {topic} was not asked for"
    OUT_OF_ORDER = "messages are not in order"
    TOO_LONG = "a message has more than {limit} MiB"
    TOO_MANY_CHANNELS = "more than {most} channels"
    TOO_MANY = "more pieces than were asked for"
    CUT = "the last message is cut off"


class PieceError(ValueError):
    """A piece is not what was asked for; the text says why."""


class PieceChannel(msgspec.Struct, frozen=True, array_like=True):
    """A `StoredChannel`, as it crosses."""

    topic: Name
    type_name: Name
    encoding: Name
    profiles: Annotated[str, Meta(max_length=_PROFILES)]
    definition_encoding: Name
    definition: Annotated[bytes, Meta(max_length=_DEFINITION)]
    type_hash: Name
    publisher: Name

    def channel(self) -> StoredChannel:
        return StoredChannel(
            self.topic, self.type_name, self.encoding, self.profiles, (self.definition_encoding, self.definition),
            self.type_hash, self.publisher,
        )  # fmt: skip


Channels: TypeAlias = dict[ChannelId, PieceChannel]


class PieceContent(msgspec.Struct, frozen=True, array_like=True):
    """What a piece has packed.

    Attributes:
        channels: those that begin in it.
        messages: a part of the row of bytes.
    """

    channels: Annotated[Channels, Meta(max_length=MOST_CHANNELS)]
    messages: Annotated[bytes, Meta(max_length=PIECE)]


class Piece(msgspec.Struct, frozen=True, array_like=True):
    """A piece of a recording.

    Attributes:
        run: of the `BeginPieces`.
        number: in this run, from 1.
        begin: where it begins in the messages that are asked for, and `end` where the next one does.
        is_last: whether none follows.
        packed: its `PieceContent`, by zstd.
        damage: of the last piece: why the rest of the recording is not read, or empty.
        denied: of the last piece of heads: wanted topics that the asker may not read.
    """

    run: Count
    number: Count
    begin: Cursor
    end: Cursor
    is_last: bool
    packed: Annotated[bytes, Meta(max_length=LIMIT)]
    damage: Reason = ""
    denied: TopicNames = ()

    def content(self) -> PieceContent:
        """Return what is packed; raises `PieceError`."""
        try:
            reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(self.packed)
            unpacked = reader.read(_UNPACKED + 1)
            if len(unpacked) > _UNPACKED:
                raise PieceError(PieceProblem.INVALID())
            return msgspec.msgpack.decode(unpacked, type=PieceContent)
        except (zstandard.ZstdError, msgspec.DecodeError, UnicodeDecodeError):
            raise PieceError(PieceProblem.INVALID()) from None


def encode_piece(piece: Piece) -> bytes:
    """Return a piece with its hash before it."""
    encoded = msgspec.msgpack.encode(piece)
    return hashlib.sha256(encoded).digest() + encoded


def decode_piece(data: bytes) -> Piece:
    """Return a piece whose hash is right; raises `PieceError`."""
    digest, encoded = data[:_DIGEST], data[_DIGEST:]
    if len(data) > LIMIT + _DIGEST + 128 or hashlib.sha256(encoded).digest() != digest:
        raise PieceError(PieceProblem.INVALID())
    try:
        return msgspec.msgpack.decode(encoded, type=Piece)
    except (msgspec.DecodeError, UnicodeDecodeError):
        raise PieceError(PieceProblem.INVALID()) from None


def check_follows(piece: Piece, at: Cursor) -> None:
    """Raise `PieceError` if a piece does not go on at a place."""
    if piece.begin != at:
        raise PieceError(PieceProblem.WRONG_PLACE())
    if piece.end < at or (piece.end == at and not piece.is_last):
        raise PieceError(PieceProblem.NO_PROGRESS())


class Cutter:
    """Cuts the messages of a recording into pieces.

    Args:
        messages: those that are asked for, from the time of `at` on.
        at: where the first piece begins.
        known: channels that need not cross.
        denied: wanted topics that the asker may not read.
    """

    def __init__(
        self,
        run: int,
        messages: Iterator[StoredMessage],
        at: Cursor,
        known: Collection[bytes],
        denied: tuple[str, ...] = (),
    ) -> None:
        self._denied = denied
        self._run, self._number = run, 0
        self._messages = messages
        self._at = at
        self._known = set(known)
        self._ids: dict[StoredChannel, tuple[bytes, PieceChannel]] = {}
        self._time, self._had = at.time, -1  # of the message that was read last
        self._rest: StoredMessage | None = None
        self._damage = ""
        self._offset = 0  # bytes of it that have been cut off
        self._advance()
        while self._rest is not None and self._place() < Cursor(at.time, at.had):
            self._advance()
        if self._place() == Cursor(at.time, at.had):
            self._offset = at.offset

    def _place(self) -> Cursor:
        return Cursor(self._time, self._had, self._offset)

    def _advance(self) -> None:
        self._offset = 0
        try:
            self._rest = next(self._messages, None)
        except DamageError as error:
            self._rest, self._damage = None, sanitize_text(str(error))
        if self._rest is None or self._rest.time == self._time:
            self._had += 1
        else:
            self._time, self._had = self._rest.time, 0

    def next(self) -> Piece:
        """Return the next piece, on any thread; the last one says so."""
        parts: list[bytes | memoryview] = []
        channels: Channels = {}
        room, definitions = PIECE, PIECE
        while self._rest is not None and room:
            key, channel = self._id(self._rest.channel)
            if key not in self._known:
                definitions -= len(channel.definition)
                if definitions < 0 and channels:
                    break
                channels[key] = channel
                self._known.add(key)
            part = self._part(key, self._rest, room)
            parts += part
            cut = sum(map(len, part))
            room -= cut
            self._offset += cut
            if self._offset == HEAD.size + len(self._rest.content):
                self._advance()
        begin, self._at = self._at, self._place()
        self._number += 1
        packed = msgspec.msgpack.encode(PieceContent(channels, b"".join(parts)))
        packed = zstandard.ZstdCompressor(level=_LEVEL).compress(packed)
        is_last = self._rest is None
        return Piece(self._run, self._number, begin, self._at, is_last, packed, self._damage, self._denied)

    def _part(self, key: bytes, message: StoredMessage, room: int) -> list[bytes | memoryview]:
        """Return so many bytes of a message from `_offset` on."""
        content, offset = message.content, self._offset
        if offset >= HEAD.size:
            return [content[offset - HEAD.size : offset - HEAD.size + room]]
        head = HEAD.pack(message.time, message.published, message.number, len(content), key)
        found: list[bytes | memoryview] = [head[offset : offset + room]]
        if room > HEAD.size - offset:
            found.append(content[: room - (HEAD.size - offset)])
        return found

    def _id(self, channel: StoredChannel) -> tuple[bytes, PieceChannel]:
        found = self._ids.get(channel)
        if found is None:
            found = self._ids[channel] = channel_id(channel)
        return found


def channel_id(channel: StoredChannel) -> tuple[bytes, PieceChannel]:
    """Return a channel as it crosses, and its id, which follows from it."""
    encoding, definition = channel.definition
    if len(definition) > _DEFINITION:
        encoding, definition = "", b""
    profiles = channel.profiles if len(channel.profiles) <= _PROFILES else ""
    texts = (channel.topic, channel.type_name, channel.encoding, encoding, channel.type_hash, channel.publisher)
    topic, type_name, message_encoding, encoding, type_hash, publisher = (
        sanitize_text(each, TEXT_LENGTH) for each in texts
    )
    record = PieceChannel(topic, type_name, message_encoding, profiles, encoding, definition, type_hash, publisher)
    return hashlib.sha256(msgspec.msgpack.encode(record)).digest()[:8], record


class Joiner:
    """Makes messages of the pieces of a recording, in their order.

    Args:
        topics: those that were asked for, and `begin` and `end` their span.
        channels: those that are known.
    """

    def __init__(self, topics: Collection[str], begin: int, end: int, channels: Channels | None = None) -> None:
        self._topics, self._begin, self._end = topics, begin, end
        self._channels = {key: each.channel() for key, each in (channels or {}).items()}
        self._row = bytearray()
        self._last = 0

    def add(self, content: PieceContent) -> Iterator[StoredMessage]:
        """Yield the messages that are whole with a further piece; raises `PieceError`."""
        for key, each in content.channels.items():
            self._channels[key] = each.channel()
        if len(self._channels) > MOST_CHANNELS:
            raise PieceError(PieceProblem.TOO_MANY_CHANNELS(most=MOST_CHANNELS))
        self._row += content.messages
        at = 0
        with memoryview(self._row) as row:
            while len(row) - at >= HEAD.size:
                time, published, number, size, key = HEAD.unpack_from(row, at)
                self._check(time, size, key)
                end = at + HEAD.size + size
                if end > len(row):
                    break
                self._last = time
                yield StoredMessage(
                    self._channels[key], time, published, number, memoryview(bytes(row[at + HEAD.size : end]))
                )
                at = end
        del self._row[:at]

    def finish(self) -> None:
        """Raise `PieceError` if a message is cut off."""
        if self._row:
            raise PieceError(PieceProblem.CUT())

    def _check(self, time: int, size: int, key: bytes) -> None:
        channel = self._channels.get(key)
        if channel is None:
            raise PieceError(PieceProblem.UNKNOWN_CHANNEL())
        if channel.topic not in self._topics:
            raise PieceError(PieceProblem.NOT_ASKED(topic=channel.topic))
        if time < self._last or not self._begin <= time <= self._end:
            raise PieceError(PieceProblem.OUT_OF_ORDER())
        if size > LONGEST:
            raise PieceError(PieceProblem.TOO_LONG(limit=LONGEST >> 20))
