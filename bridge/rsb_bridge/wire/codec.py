"""Control messages as bytes: msgpack, checked against their types (PROTOCOL.md, 3)."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeVar, Union, get_args

import msgspec
import zstandard
from msgspec import Meta, Raw

from rsb_bridge.installed_features import added
from rsb_bridge.model.limits import ROUTES_PER_LINK
from rsb_bridge.wire.framing import CONTROL_LIMIT
from rsb_bridge.wire.messages import (
    ConnectionMessage,
    ControlMessage,
    ControlMessageBase,
    Hello,
    Report,
    UrgentMessage,
    Welcome,
)
from rsb_bridge.wire.protocol_error import Broken, ProtocolError
from rsb_bridge.wire.records import (
    PRINTABLE,
    CallsReport,
    FullRecord,
    PathRecord,
    ReceivedCounts,
    ReceivedReport,
    SentCounts,
    SentReport,
    TopicEntry,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_E = TypeVar("_E")
_T = TypeVar("_T")
ReportEntry: TypeAlias = SentReport | ReceivedReport | CallsReport | SentCounts | ReceivedCounts
_Entries: TypeAlias = Annotated[tuple[Raw, ...], Meta(max_length=ROUTES_PER_LINK)]

WHOLE = 8 << 10  # bytes of any message that is decoded at once, in at most 4 ms
MOST_TOPICS = 4000
"""Entries of a list of topics. Its 1 MiB unpacked holds about 5,000 with usual names, or 1,400 with the longest."""
_NOT_PRINTABLE = f"matching regex {PRINTABLE!r}"


class ReportParts(ConnectionMessage, frozen=True, tag="report"):
    """A `rsb_bridge.wire.messages.Report` whose entries are not decoded."""

    sent: _Entries = ()
    received: _Entries = ()
    calls: _Entries = ()
    sent_counts: _Entries = ()
    received_counts: _Entries = ()
    full: FullRecord | None = None
    path: PathRecord | None = None
    looked_at: bool | None = None


_encoder = msgspec.msgpack.Encoder()
_urgent: msgspec.msgpack.Decoder[UrgentMessage] = msgspec.msgpack.Decoder(UrgentMessage)
_hello = msgspec.msgpack.Decoder(Hello)
_welcome = msgspec.msgpack.Decoder(Welcome)
_sent = msgspec.msgpack.Decoder(SentReport)
_received = msgspec.msgpack.Decoder(ReceivedReport)
_sent_counts = msgspec.msgpack.Decoder(SentCounts)
_received_counts = msgspec.msgpack.Decoder(ReceivedCounts)
_calls = msgspec.msgpack.Decoder(CallsReport)
_topic = msgspec.msgpack.Decoder(TopicEntry)
_topics: msgspec.msgpack.Decoder[tuple[Raw, ...]] = msgspec.msgpack.Decoder(
    Annotated[tuple[Raw, ...], Meta(max_length=MOST_TOPICS)]
)


def report_entries(report: Report | ReportParts) -> Iterator[tuple[ReportEntry, int]]:
    """Yield the entries of a report, each decoded when it is asked for, with its bytes, or 0 if it was decoded before.

    Raises:
        msgspec.DecodeError: the next one is invalid.
    """
    yield from _decoded(report.sent, _sent)
    yield from _decoded(report.received, _received)
    yield from _decoded(report.calls, _calls)
    yield from _decoded(report.sent_counts, _sent_counts)
    yield from _decoded(report.received_counts, _received_counts)


def pack_topics(entries: Sequence[TopicEntry]) -> bytes:
    """Return the entries of a `rsb_bridge.wire.messages.TopicList`."""
    return zstandard.compress(_encoder.encode(entries))


def topic_entries(packed: bytes) -> Iterator[tuple[TopicEntry, int]]:
    """Yield the entries of a list of topics, as `report_entries` does.

    Raises:
        ProtocolError: they can't be unpacked.
        msgspec.DecodeError: the next one is invalid, or there are too many.
    """
    yield from _decoded(_topics.decode(unpack(packed, CONTROL_LIMIT)), _topic)


def unpack(packed: bytes, limit: int) -> bytes:
    """Return the content of a zstd frame.

    Raises:
        ProtocolError: it is invalid, or its content is longer than the limit.
    """
    try:
        # Before anything is unpacked: a few bytes can become gigabytes.
        if 0 <= (size := zstandard.frame_content_size(packed)) <= limit:
            return zstandard.ZstdDecompressor().decompress(packed)
    except zstandard.ZstdError as error:
        raise invalid(error) from None
    raise invalid(ValueError(f"a zstd frame claims {size:,} bytes"))


def _decoded(
    entries: tuple[_E, ...] | tuple[Raw, ...], decoder: msgspec.msgpack.Decoder[_E]
) -> Iterator[tuple[_E, int]]:
    for entry in entries:
        if isinstance(entry, Raw):
            content = memoryview(entry)
            yield decoder.decode(content), len(content)
        else:
            yield entry, 0


@cache
def control_messages() -> tuple[type[ControlMessageBase], ...]:
    """Return all types of control messages, features' last. Called late: a feature's may need this module."""

    def tag(message: type[ControlMessageBase]) -> str:
        return str(message.__struct_config__.tag)

    of_core = get_args(ControlMessage)
    return (*of_core, *added("messages", name_of=tag, taken=map(tag, of_core)))


@cache
def decoders() -> tuple[msgspec.msgpack.Decoder[ControlMessageBase], msgspec.msgpack.Decoder[ControlMessageBase]]:
    """Return the decoders of short and of long control messages. Two threads must not make them at the same time.

    Each fills in what msgspec keeps of the messages' types, and msgspec 0.22 has no lock for that.
    """
    # A long one without `Report`, whose tag the form in parts has: msgspec takes no tag twice.
    long = [each for each in control_messages() if each is not Report]
    return msgspec.msgpack.Decoder(Union[*control_messages()]), msgspec.msgpack.Decoder(Union[*long, ReportParts])


def encode(message: ControlMessageBase) -> bytes:
    """Return a message as msgpack."""
    return _encoder.encode(message)


def decode(data: bytes) -> ControlMessageBase:
    """Return a control message from msgpack. Entries of a long report are decoded later.

    Raises:
        ProtocolError: the message is invalid, or a field is out of its range.
    """
    short, long = decoders()
    if len(data) <= WHOLE:
        return _decode(short, data)
    return _decode(long, data)


def decode_urgent(data: bytes) -> UrgentMessage:
    """Return a control message that came as a datagram; errors as `decode`, and for a message of another type."""
    return _decode(_urgent, data)


def invalid(error: Exception) -> ProtocolError:
    """Say in words why a message, or a part of one, cannot be decoded."""
    message = str(error).replace(_NOT_PRINTABLE, "without unprintable characters")
    return ProtocolError(Broken.INVALID_CONTROL_MESSAGE(problem=message))


def decode_hello(data: bytes) -> Hello:
    """Return a `Hello` from msgpack; errors as `decode`."""
    return _decode(_hello, data)


def decode_welcome(data: bytes) -> Welcome:
    """Return a `Welcome` from msgpack; errors as `decode`."""
    return _decode(_welcome, data)


def _decode(decoder: msgspec.msgpack.Decoder[_T], data: bytes) -> _T:
    try:
        return decoder.decode(data)
    # The last two are no errors of msgspec's: a peer causes them by text that is not UTF-8, and by maps in maps.
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise invalid(error) from None
