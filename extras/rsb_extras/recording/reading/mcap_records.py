"""The messages of MCAP files, in the order of the file."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import zstandard

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

MCAP_MAGIC = b"\x89MCAP0\r\n"
HEAD, MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
FOOTER, SCHEMA, CHANNEL, IS_MESSAGE, CHUNK, DATA_END = 2, 3, 4, 5, 6, 15  # opcodes of records
NEXT_FILE = -1
_SKIPPED = 1 << 20  # bytes that are read at once of what does not count
_RECORDS_AT_FIRST = 1000  # of a chunk, beside one for each byte: to go through records takes longer than to read them
_HEADS = 64 << 20  # bytes of channels and definitions. A round figure: the audit of 3,000 topics needs 5 MB
_HEAD_COST = 1000  # bytes of a channel's objects. A round figure


class Record(NamedTuple):
    """A record that counts, or `NEXT_FILE`.

    Attributes:
        at: bytes of the file before its content.
    """

    kind: int
    at: int
    content: bytes


def records(opened: IO[bytes]) -> Iterator[Record]:
    """Yield the records up to the end of the data. The library's reader spends a fifth more on indices.

    Args:
        opened: behind its magic.

    Raises:
        DamageError: a record is too long, or what stands behind the end is no recording.
        EOFError: the file ends earlier.
    """
    has_data, is_whole, at = True, False, len(MCAP_MAGIC)
    while head := opened.read(len(MCAP_MAGIC)):
        if head == MCAP_MAGIC:  # also behind one that was cut off where a record ends
            at += len(head)
            yield Record(NEXT_FILE, at, b"")
            has_data, is_whole = True, False
            continue
        if is_whole:
            raise DamageError(Damage.FOLLOWS())
        head += opened.read(HEAD.size - len(head))
        if len(head) < HEAD.size:
            break
        kind, length = HEAD.unpack(head)
        if not kind:  # no record: a power cut has left zeros, of which each nine bytes would be one
            break
        at += HEAD.size
        if has_data and kind in (SCHEMA, CHANNEL, IS_MESSAGE, CHUNK):
            if length > LONGEST:
                raise DamageError(Damage.TOO_LONG(limit=LONGEST >> 20))
            record = opened.read(length)
            if len(record) < length:
                break
            yield Record(kind, at, record)
            at += length
            continue
        at += length
        while length and (skipped := opened.read(min(length, _SKIPPED))):  # a pipe cannot seek
            length -= len(skipped)
        has_data = has_data and kind != DATA_END
        if kind == FOOTER:
            is_whole = opened.read(len(MCAP_MAGIC)) == MCAP_MAGIC
            at += len(MCAP_MAGIC)
    if has_data:
        raise EOFError


def parsed_chunk(content: bytes) -> Any:
    from mcap.data_stream import ReadDataStream  # noqa: PLC0415 -- bridges that record nothing do without
    from mcap.records import Chunk  # noqa: PLC0415

    return Chunk.read(ReadDataStream(BytesIO(content)))


def unpacked(chunk: Any) -> bytes:
    """Return the content of a chunk. The library's own function takes as much memory as a file asks for."""
    size = chunk.uncompressed_size
    if size > LONGEST:
        raise DamageError(Damage.TOO_LONG(limit=LONGEST >> 20))
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


class ChannelTable:
    """The channels of one file, which has its own ids of schemas and channels.

    Attributes:
        channels: by their ids.
    """

    def __init__(self) -> None:
        self.channels: dict[int, StoredChannel] = {}
        self._schemas: dict[int, Any] = {}
        self._left = _HEADS

    def add(self, kind: int, record: bytes | memoryview) -> None:
        """Take in a channel or a schema.

        Raises:
            DamageError: they have too many bytes together.
        """
        from mcap.data_stream import ReadDataStream  # noqa: PLC0415
        from mcap.records import Channel, Schema  # noqa: PLC0415

        stream = ReadDataStream(BytesIO(record))
        read = Schema.read(stream) if kind == SCHEMA else Channel.read(stream)
        if read.id in (self._schemas if kind == SCHEMA else self.channels):  # some writers repeat it in each chunk
            return
        self._left -= len(record) + _HEAD_COST
        if self._left < 0:
            raise DamageError(Damage.HEADS(limit=_HEADS >> 20))
        if kind == SCHEMA:
            self._schemas[read.id] = read
            return
        schema, metadata = self._schemas.get(read.schema_id), read.metadata
        self.channels[read.id] = StoredChannel(
            read.topic,
            schema.name if schema else "",
            read.message_encoding,
            metadata.get("offered_qos_profiles", ""),
            (schema.encoding, schema.data) if schema else ("", b""),
            metadata.get("topic_type_hash", ""),
            metadata.get("publisher", ""),
        )

    def ids_of(self, topics: Container[str] | None) -> set[int] | None:
        """Return the ids of some topics' channels, or None for all."""
        return None if topics is None else {at for at, each in self.channels.items() if each.topic in topics}

    def message(self, record: bytes | memoryview) -> StoredMessage:
        channel, number, time, published = MESSAGE.unpack_from(record)
        found, content = self.channels[channel], memoryview(record)[MESSAGE.size :]
        if content[:4] == ZSTD and found.encoding == "cdr":
            content = unpacked_message(content)
        return StoredMessage(found, time, published, number, content)

    def messages(self, data: bytes, size: int, only: set[int] | None = None) -> Iterator[StoredMessage]:
        """Yield the messages of unpacked records, and take in their channels.

        Args:
            size: bytes that the file has for them.
            only: ids of channels, or None for all.

        Raises:
            Exception: of any class; they are damaged.
        """
        # The library's own loop takes three times as long, as it makes an object of each record.
        view, at, end, left, channels = memoryview(data), 0, len(data), size + _RECORDS_AT_FIRST, self.channels
        head, message, new = HEAD.unpack_from, MESSAGE.unpack_from, tuple.__new__
        while at < end:
            kind, length = head(data, at)
            at += HEAD.size
            left -= 1
            if at + length > end:
                raise EOFError
            if left < 0:
                raise DamageError(Damage.TOO_MANY())
            if kind == IS_MESSAGE:
                channel, number, time, published = message(data, at)
                if only is None or channel in only:
                    start, found = at + MESSAGE.size, channels[channel]
                    content = view[start : at + length]
                    if data[start : start + 4] == ZSTD and found.encoding == "cdr":
                        content = unpacked_message(content)
                    yield new(StoredMessage, (found, time, published, number, content))  # a third of its call's time
            elif kind in (CHANNEL, SCHEMA):
                self.add(kind, view[at : at + length])
            at += length
