"""Opening frames: the first each way on every stream, in the clear (PROTOCOL.md, 1.1)."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from rsb_bridge.model.limits import NAME_BYTES
from rsb_bridge.wire.framing import LENGTH, OPENING_LIMIT, ProtocolError
from rsb_bridge.wire.sealing import Suite

VERSION = 1
"""Of the wire format; peers of another are refused."""
WORDS_LIMIT = 512
LINK_ID_LENGTH = 8

MAGIC = b"rsb"
_PREFIX_LENGTH = 5
_DATA = struct.Struct(f">{LINK_ID_LENGTH}sI")


class Kind(IntEnum):
    """What an opening frame is."""

    CONTROL = 1
    DATA = 2
    ACCEPT = 3
    REFUSE = 4
    RETRY = 5


class RefusalCode(IntEnum):
    """Why a stream is not let in."""

    WRONG_VERSION = 1
    WRONG_KEY = 2
    UNKNOWN_NAME = 3
    ENCRYPTION_REQUIRED = 4
    ENCRYPTION_NOT_POSSIBLE = 5
    BAD_FORMAT = 6
    NO_SUCH_ROUTE = 7
    BUSY = 8
    SHUTTING_DOWN = 9


class Refusal(Exception):  # noqa: N818 - an answer, not an error of this side's
    """A stream is not let in.

    Attributes:
        code: why.
        words: why, in words that read the same on either side.
    """

    def __init__(self, code: RefusalCode, words: str) -> None:
        super().__init__(words)
        self.code = code
        self.words = words


class ControlOpening(NamedTuple):
    """A client's wish for a control connection.

    Attributes:
        suite: what it would seal with.
        name: the session it belongs to.
        header: the frame up to the handshake message: the handshake's prologue.
        message: the first handshake message.
    """

    suite: Suite
    name: str
    header: bytes
    message: bytes


class DataOpening(NamedTuple):
    """A client's wish for a data stream.

    Attributes:
        link_id: 8 bytes.
        route: its id.
        header: the frame up to the proof, which authenticates it.
        proof: `rsb_bridge.wire.sealing.SessionKeys.attach_proof`.
    """

    link_id: bytes
    route: int
    header: bytes
    proof: bytes


def take_frame(stream: bytearray) -> bytes | None:
    """Take one opening frame off the front of what a stream has brought, leaving the rest.

    Returns:
        The frame without its length; None while it is not whole.

    Raises:
        ProtocolError: what comes cannot be an opening frame.
    """
    if len(stream) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack_from(stream)
    if length > OPENING_LIMIT:
        raise ProtocolError("what came first is no opening frame: the other side is not an rsb-console")
    if len(stream) < LENGTH.size + length:
        return None
    frame = bytes(stream[LENGTH.size : LENGTH.size + length])
    del stream[: LENGTH.size + length]
    return frame


def opening(kind: Kind, body: bytes = b"") -> bytes:
    """An opening frame, without its length."""
    return MAGIC + bytes((VERSION, kind)) + body


def control_header(suite: Suite, name: str) -> bytes:
    """A CONTROL frame up to its handshake message.

    Raises:
        ValueError: the name is too long.
    """
    encoded = name.encode()
    if len(encoded) > NAME_BYTES:
        raise ValueError(
            f"the name has {len(encoded)} bytes in UTF-8, and at most {NAME_BYTES} are allowed: choose a shorter one"
        )
    return opening(Kind.CONTROL, bytes((suite, len(encoded))) + encoded)


def data_header(link_id: bytes, route: int) -> bytes:
    """A DATA frame up to its proof."""
    return opening(Kind.DATA, _DATA.pack(link_id, route))


def refuse_frame(code: RefusalCode, words: str) -> bytes:
    """A REFUSE frame; words that are too long are cut."""
    return opening(Kind.REFUSE, bytes((code,)) + words.encode(errors="replace")[:WORDS_LIMIT])


def parse_opening(frame: bytes) -> tuple[Kind, bytes]:
    """Read what is the same in every version.

    Returns:
        The kind and its body.

    Raises:
        ProtocolError: it is no opening frame.
        Refusal: it is one of another version.
    """
    if len(frame) < _PREFIX_LENGTH or not frame.startswith(MAGIC):
        raise ProtocolError("what came first is no opening frame: the other side is not an rsb-console")
    version, kind = frame[3], frame[4]
    if version != VERSION:
        raise Refusal(RefusalCode.WRONG_VERSION, f"this side speaks version {VERSION}, the peer version {version}")
    try:
        return Kind(kind), frame[_PREFIX_LENGTH:]
    except ValueError:
        raise ProtocolError(f"there is no opening frame of kind {kind}") from None


def parse_control(frame: bytes) -> ControlOpening:
    """Read a CONTROL frame.

    Raises:
        ProtocolError: it is not one.
    """
    body = frame[_PREFIX_LENGTH:]
    if len(body) < 2 or len(body) < 2 + body[1]:
        raise ProtocolError("a CONTROL frame ends before its name does")
    end = 2 + body[1]
    try:
        name = body[2:end].decode()
    except UnicodeDecodeError:
        raise ProtocolError("the name in a CONTROL frame is not UTF-8") from None
    return ControlOpening(parse_suite(body), name, frame[: _PREFIX_LENGTH + end], body[end:])


def parse_data(frame: bytes) -> DataOpening:
    """Read a DATA frame.

    Raises:
        ProtocolError: it is not one.
    """
    end = _PREFIX_LENGTH + _DATA.size
    if len(frame) < end:
        raise ProtocolError("a DATA frame ends before its route does")
    link_id, route = _DATA.unpack_from(frame, _PREFIX_LENGTH)
    return DataOpening(link_id, route, frame[:end], frame[end:])


def parse_further(frame: bytes) -> DataOpening:
    """Read a DATA frame that came behind the opening of a stream.

    Raises:
        ProtocolError: it is not one.
        Refusal: it is an opening frame of another version.
    """
    kind, _ = parse_opening(frame)
    if kind is not Kind.DATA:
        raise ProtocolError(f"an opening frame of kind {kind.name} has no place on an open stream")
    return parse_data(frame)


def parse_suite(body: bytes) -> Suite:
    """Read the suite that a CONTROL or RETRY frame's body begins with.

    Raises:
        ProtocolError: there is none.
    """
    try:
        return Suite(body[0])
    except (IndexError, ValueError):
        raise ProtocolError("an opening frame names a cipher suite that does not exist") from None


def parse_refuse(body: bytes) -> tuple[RefusalCode, str]:
    """Read a REFUSE frame's body.

    Nothing authenticates it, and it goes to a terminal: what is not printable is replaced.

    Raises:
        ProtocolError: it is not one.
    """
    try:
        code = RefusalCode(body[0])
    except (IndexError, ValueError):
        raise ProtocolError("the peer refuses for a reason that does not exist") from None
    words = body[1 : 1 + WORDS_LIMIT].decode(errors="replace")
    return code, "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in words)
