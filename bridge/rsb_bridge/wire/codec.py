"""Control messages as bytes: msgpack, checked against their types (PROTOCOL.md, 3)."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from rsb_bridge.wire.fields import PRINTABLE
from rsb_bridge.wire.framing import ProtocolError
from rsb_bridge.wire.messages import ControlMessage, Hello, Welcome

_T = TypeVar("_T")

_NOT_PRINTABLE = f"matching regex {PRINTABLE!r}"

_encoder = msgspec.msgpack.Encoder()
_control: msgspec.msgpack.Decoder[ControlMessage] = msgspec.msgpack.Decoder(ControlMessage)
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
        message = str(error).replace(_NOT_PRINTABLE, "without unprintable characters")
        raise ProtocolError(f"invalid control message: {message}") from None
