"""The messages of MCAP files, as rows."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import IO, TYPE_CHECKING, Any

import zstandard

from rsb_extras.audit.recorded import LONGEST, Damage, DamageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.audit.recorded import RecordedChannel, RecordingRows

MAGIC = b"\x89MCAP0\r\n"
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_FOOTER, _SCHEMA, _CHANNEL, _IS_MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15  # opcodes of records
_NEXT_FILE = -1
_SKIPPED = 1 << 20  # bytes that are read at once of what does not count
_RECORDS_AT_FIRST = 1000  # of a chunk, beside one for each byte: to go through records takes longer than to read them


def read_mcap(opened: IO[bytes], rows: RecordingRows) -> None:
    """Read a file behind its magic, and those that stand behind it in the same file.

    Raises:
        Exception: of any class; it is cut off or damaged, and was read up to there.
    """
    records = _McapRecords(rows)
    for kind, record in _records(opened):
        if kind == _NEXT_FILE:
            rows.recording.joined += 1
            records = _McapRecords(rows)
        else:
            rows.pass_bytes(len(record))
            records.add(kind, record)


def _records(opened: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield the records that count, up to the end of the data. The library's reader spends a fifth more on indices.

    Raises:
        DamageError: a record is too long, or what stands behind the end is no recording.
        EOFError: the file ends earlier.
    """
    has_data, is_whole = True, False
    while head := opened.read(len(MAGIC)):
        if head == MAGIC:  # also behind one that was cut off where a record ends
            yield _NEXT_FILE, b""
            has_data, is_whole = True, False
            continue
        if is_whole:
            raise DamageError(Damage.FOLLOWS())
        head += opened.read(_HEAD.size - len(head))
        if len(head) < _HEAD.size:
            break
        kind, length = _HEAD.unpack(head)
        if has_data and kind in (_SCHEMA, _CHANNEL, _IS_MESSAGE, _CHUNK):
            if length > LONGEST:
                raise DamageError(Damage.TOO_LONG(limit=LONGEST >> 20))
            record = opened.read(length)
            if len(record) < length:
                break
            yield kind, record
            continue
        while length and (skipped := opened.read(min(length, _SKIPPED))):  # a pipe cannot seek
            length -= len(skipped)
        has_data = has_data and kind != _DATA_END
        if kind == _FOOTER:
            is_whole = opened.read(len(MAGIC)) == MAGIC
    if has_data:
        raise EOFError


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


class _McapRecords:
    """Makes rows of the records of one file, which has its own ids of schemas and channels."""

    def __init__(self, rows: RecordingRows) -> None:
        self._rows = rows
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, RecordedChannel] = {}

    def add(self, kind: int, record: bytes | memoryview) -> None:
        from mcap.data_stream import ReadDataStream  # noqa: PLC0415
        from mcap.records import Channel, Chunk, Schema  # noqa: PLC0415

        if kind == _IS_MESSAGE:
            channel, _, time, _ = _MESSAGE.unpack_from(record)
            self._rows.add(self._channels[channel], time, memoryview(record)[_MESSAGE.size :])
        elif kind == _CHANNEL:
            self._add_channel(Channel.read(ReadDataStream(BytesIO(record))))
        elif kind == _SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            self._schemas[schema.id] = schema
        else:
            self._add_chunk(Chunk.read(ReadDataStream(BytesIO(record))))

    def _add_chunk(self, chunk: Any) -> None:
        # The library's own loop takes three times as long, as it makes an object of each message.
        data, left = unpacked(chunk), len(chunk.data) + _RECORDS_AT_FIRST
        view, at, end, add = memoryview(data), 0, len(data), self._rows.add
        while at < end:
            kind, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            left -= 1
            if at + length > end:
                raise EOFError
            if left < 0:
                raise DamageError(Damage.TOO_MANY())
            if kind == _IS_MESSAGE:
                channel, _, time, _ = _MESSAGE.unpack_from(data, at)
                add(self._channels[channel], time, view[at + _MESSAGE.size : at + length])
            elif kind in (_CHANNEL, _SCHEMA):
                self.add(kind, view[at : at + length])
            at += length

    def _add_channel(self, record: Any) -> None:
        if record.id in self._channels:  # some writers repeat it in each chunk
            return
        schema, metadata = self._schemas.get(record.schema_id), record.metadata
        self._channels[record.id] = self._rows.channel(
            record.topic,
            schema.name if schema else "",
            record.message_encoding,
            metadata.get("offered_qos_profiles", ""),
            (schema.encoding, schema.data) if schema else ("", b""),
            type_hash=metadata.get("topic_type_hash", ""),
            publisher=metadata.get("publisher", ""),
        )
