"""Control messages as bytes: msgpack, checked against their types (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import TypeVar, Union, get_args

import msgspec

from rsb_bridge.wire.fields import PRINTABLE
from rsb_bridge.wire.framing import ProtocolError
from rsb_bridge.wire.messages import ControlMessage, Hello, Report, Welcome
from rsb_bridge.wire.parts import ReportParts, TopicListParts
from rsb_bridge.wire.questions import TopicList

_T = TypeVar("_T")

WHOLE = 8 << 10
"""Bytes of any message that is decoded at once, in at most 4 ms."""
_NOT_PRINTABLE = f"matching regex {PRINTABLE!r}"

_encoder = msgspec.msgpack.Encoder()
_control: msgspec.msgpack.Decoder[ControlMessage] = msgspec.msgpack.Decoder(ControlMessage)
_parts: msgspec.msgpack.Decoder[ControlMessage | ReportParts | TopicListParts] = msgspec.msgpack.Decoder(
    Union[*(each for each in get_args(ControlMessage) if each not in (Report, TopicList)), ReportParts, TopicListParts]
)
_hello = msgspec.msgpack.Decoder(Hello)
_welcome = msgspec.msgpack.Decoder(Welcome)


def encode(message: ControlMessage | Hello | Welcome) -> bytes:
    """A message as msgpack."""
    return _encoder.encode(message)


def decode(data: bytes) -> ControlMessage:
    """A control message from msgpack.

    Raises:
        ProtocolError: the message is invalid, or a field is out of its range.
    """
    return _decode(_control, data)


def decode_in_parts(data: bytes) -> ControlMessage | ReportParts | TopicListParts:
    """A control message from msgpack; of a long report or list, the entries are not decoded yet. Errors as `decode`."""
    if len(data) <= WHOLE:
        return _decode(_control, data)
    return _decode(_parts, data)


def invalid(error: Exception) -> ProtocolError:
    """Say in words why a message, or a part of one, cannot be decoded."""
    message = str(error).replace(_NOT_PRINTABLE, "without unprintable characters")
    return ProtocolError(f"invalid control message: {message}")


def decode_hello(data: bytes) -> Hello:
    """A `Hello` from msgpack; errors as `decode`."""
    return _decode(_hello, data)


def decode_welcome(data: bytes) -> Welcome:
    """A `Welcome` from msgpack; errors as `decode`."""
    return _decode(_welcome, data)


def _decode(decoder: msgspec.msgpack.Decoder[_T], data: bytes) -> _T:
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise invalid(error) from None
