"""Preamble frames: the first ones each way on every stream, in the clear (PROTOCOL.md, 1.1)."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from enum import Enum, IntEnum, auto
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.fingerprints import FINGERPRINT_LENGTH, fingerprint_of, format_fingerprint
from rsb_bridge.model.limits import NAME_BYTES
from rsb_bridge.model.text import is_clean, sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.events import Attach, Event, Failed, RefusalCode, StreamName, StreamRefused
from rsb_bridge.wire.framing import LENGTH, PREAMBLE_LIMIT, pack_frame
from rsb_bridge.wire.protocol_error import Broken, ForeignProtocolError, Misuse, ProtocolError
from rsb_bridge.wire.sealing import CipherSuite, SealError

if TYPE_CHECKING:
    from rsb_bridge.wire.sealing import Buffer

VERSION = 1  # of the wire format. A peer of another version is refused
MAGIC = b"rsb"
PREFIX_LENGTH = 5  # bytes of a preamble frame before its body
MESSAGE_LIMIT = 512  # bytes of a refusal's message
LINK_ID_LENGTH = 8
_DATA = struct.Struct(f">{LINK_ID_LENGTH}sIH?")
_CONTROL_VERSION = struct.Struct(">H")  # of the control protocol, in an OPERATOR frame


class PreambleKind(IntEnum):
    CONTROL = 1
    DATA = 2
    ACCEPT = 3
    REFUSE = 4
    RETRY = 5
    OPERATOR = 6


class RefusalText(Wording):
    """Sentences that a stream is refused with, each true on either side."""

    PEER_OLDER = (
        "this side speaks version {ours} of the wire format, the peer version {theirs}: "
        "update rsb-console on the peer, which is older"
    )
    THIS_SIDE_OLDER = (
        "this side speaks version {ours} of the wire format, the peer version {theirs}: "
        "update rsb-console on this side, which is older"
    )
    KEYS_DIFFER = "the keys of {name!r} differ: {theirs} on the {there}, {ours} on the {here}"
    KEY_NOT_NAMED = "the {there} does not name its key of {name!r}; the {here} has {ours}"
    FIRST_MESSAGE_FORGED = (
        "the first message of {name!r} is damaged or forged: the fingerprints of both sides' keys are equal"
    )
    ANSWER_SEALED_WITH_ANOTHER_KEY = "this side's key does not open the server's answer"
    ENGINE_SEALED_WITH_ANOTHER_KEY = (
        "the answer is not sealed with this console's key, {fingerprint}: the engine has another one, or somebody on "
        "the way answers in its place"
    )
    ENCRYPTION_NOT_POSSIBLE = "the client encrypts, but the server has no key for {name!r}"
    ENCRYPTION_REQUIRED = "the server requires encryption for {name!r}, but the client does not encrypt"


class Refusal(Exception):  # noqa: N818 - an answer, not an error of this side's
    """This side refuses a stream.

    Attributes:
        message: the reason in a sentence that is true on either side.
        link: the name of the client that asks, if it has proven its key; else an empty string.
    """

    def __init__(self, code: RefusalCode, message: str, link: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.link = link


def key_of(keys: tuple[bytes, ...], offered: bytes, name: str, there: str, here: str) -> bytes:
    """Return the key that a peer claims to have, so that several valid keys do not make its first message costlier.

    The claim is part of the handshake's prologue: with another key, the message does not open.

    Args:
        offered: the fingerprint of the peer's key.
        there: the peer's role, for the message.
        here: this side's role, for the message.

    Raises:
        Refusal: the peer names no key or none of the valid ones.
    """
    by_fingerprint = {fingerprint_of(key): key for key in keys}
    if offered not in by_fingerprint:
        ours = " or ".join(map(format_fingerprint, by_fingerprint))
        if theirs := format_fingerprint(offered):
            message = RefusalText.KEYS_DIFFER(name=name, theirs=theirs, there=there, ours=ours, here=here)
        else:
            message = RefusalText.KEY_NOT_NAMED(name=name, there=there, ours=ours, here=here)
        raise Refusal(RefusalCode.WRONG_KEY, message)
    return by_fingerprint[offered]


class ControlPreamble(NamedTuple):
    """A client's request for a control connection."""

    suite: CipherSuite
    name: str
    fingerprint: bytes  # of its key, unproven: 8 bytes, or zeros for no key
    header: bytes  # the frame up to the handshake message: the handshake's prologue
    message: bytes  # the first handshake message


class OperatorPreamble(NamedTuple):
    """A console's request for a connection."""

    version: int  # of the control protocol that the console speaks
    operator: str
    engine: str  # the engine that is meant
    fingerprint: bytes  # of the operator's key, as the console says: 8 bytes
    header: bytes  # the frame up to the handshake message: the handshake's prologue
    message: bytes  # the first handshake message


def take_frame(stream: bytearray) -> bytes | None:
    """Remove one frame of the handshake from the front of a stream's buffer.

    Returns:
        The frame without its length, or None while it is incomplete.

    Raises:
        ForeignProtocolError: the frame is too long for the handshake.
    """
    if len(stream) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack_from(stream)
    if length > PREAMBLE_LIMIT:
        raise ForeignProtocolError(recognise(stream))
    if len(stream) < LENGTH.size + length:
        return None
    frame = bytes(stream[LENGTH.size : LENGTH.size + length])
    del stream[: LENGTH.size + length]
    return frame


# --- writing frames. A name that is too long is a ValueError


def preamble_frame(kind: PreambleKind, body: bytes = b"") -> bytes:
    """Return a preamble frame, without its length."""
    return MAGIC + bytes((VERSION, kind)) + body


def control_header(suite: CipherSuite, name: str, fingerprint: bytes = bytes(FINGERPRINT_LENGTH)) -> bytes:
    """Return the part of a CONTROL frame before its handshake message; `fingerprint` is of the key, zeros for none."""
    return preamble_frame(PreambleKind.CONTROL, bytes((suite,)) + _packed_name(name) + fingerprint)


def operator_header(version: int, operator: str, engine: str, fingerprint: bytes) -> bytes:
    """Return the part of an OPERATOR frame before its handshake message."""
    body = _CONTROL_VERSION.pack(version) + _packed_name(operator) + _packed_name(engine)
    return preamble_frame(PreambleKind.OPERATOR, body + fingerprint)


def _packed_name(name: str) -> bytes:
    encoded = name.encode()
    if len(encoded) > NAME_BYTES:
        raise ValueError(Misuse.NAME_TOO_LONG(length=len(encoded), limit=NAME_BYTES))
    return bytes((len(encoded),)) + encoded


def data_header(link_id: bytes, name: StreamName) -> bytes:
    """Return the part of a DATA frame before its proof."""
    return preamble_frame(PreambleKind.DATA, _DATA.pack(link_id, *name))


def refuse_frame(code: RefusalCode, message: str) -> bytes:
    """Return a REFUSE frame; a message that is too long is cut."""
    return preamble_frame(PreambleKind.REFUSE, bytes((code,)) + message.encode(errors="replace")[:MESSAGE_LIMIT])


# --- reading frames. An invalid one is a ProtocolError


def parse_preamble(frame: bytes) -> tuple[PreambleKind, bytes]:
    """Return the kind of a preamble frame and its body, which are the same in every version.

    Raises:
        ForeignProtocolError: this is no preamble frame.
        Refusal: the peer speaks another version.
    """
    if len(frame) < PREFIX_LENGTH or not frame.startswith(MAGIC):
        raise ForeignProtocolError
    version, kind = frame[3], frame[4]
    # Before the kind, which another version may have alone: its peer has to hear which side to update.
    if version != VERSION:
        text = RefusalText.THIS_SIDE_OLDER if version > VERSION else RefusalText.PEER_OLDER
        raise Refusal(RefusalCode.WRONG_VERSION, text(ours=VERSION, theirs=version))
    try:
        return PreambleKind(kind), frame[PREFIX_LENGTH:]
    except ValueError:
        raise ProtocolError(Broken.UNKNOWN_PREAMBLE(kind=kind)) from None


def parse_control(frame: bytes) -> ControlPreamble:
    body = frame[PREFIX_LENGTH:]
    if len(body) < 2 or len(body) < 2 + body[1] + FINGERPRINT_LENGTH:
        raise ProtocolError(Broken.CONTROL_TOO_SHORT())
    name_end = 2 + body[1]
    end = name_end + FINGERPRINT_LENGTH
    name = _read_name(body[2:name_end], "CONTROL")
    return ControlPreamble(parse_suite(body), name, body[name_end:end], frame[: PREFIX_LENGTH + end], body[end:])


def parse_operator(frame: bytes) -> OperatorPreamble:
    names_at = PREFIX_LENGTH + _CONTROL_VERSION.size
    if len(frame) < names_at:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="version"))
    operator, engine_at = _name_at(frame, names_at)
    engine, at = _name_at(frame, engine_at)
    end = at + FINGERPRINT_LENGTH
    if len(frame) < end:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="fingerprint"))
    (version,) = _CONTROL_VERSION.unpack_from(frame, PREFIX_LENGTH)
    return OperatorPreamble(version, operator, engine, frame[at:end], frame[:end], frame[end:])


def _name_at(frame: bytes, at: int) -> tuple[str, int]:
    """Return a name behind its length, and where it ends."""
    begin = at + 1
    end = begin + frame[at] if at < len(frame) else begin
    if len(frame) < end:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="names"))
    return _read_name(frame[begin:end], "OPERATOR"), end


def _read_name(encoded: bytes, frame: str) -> str:
    try:
        name = encoded.decode()
    except UnicodeDecodeError:
        raise ProtocolError(Broken.NAME_NOT_UTF8(frame=frame)) from None
    if not is_clean(name):
        raise ProtocolError(Broken.NAME_UNPRINTABLE(frame=frame))
    return name


def parse_data(frame: bytes) -> Attach:
    end = PREFIX_LENGTH + _DATA.size
    if len(frame) < end:
        raise ProtocolError(Broken.DATA_TOO_SHORT())
    link_id, *name = _DATA.unpack_from(frame, PREFIX_LENGTH)
    return Attach(link_id, StreamName(*name), frame[end:], frame[:end])


def parse_suite(body: bytes) -> CipherSuite:
    """Read the cipher suite at the beginning of a CONTROL or RETRY frame's body."""
    try:
        return CipherSuite(body[0])
    except (IndexError, ValueError):
        raise ProtocolError(Broken.UNKNOWN_SUITE()) from None


def parse_refuse(body: bytes) -> tuple[RefusalCode, str]:
    """Read a REFUSE frame's body."""
    try:
        code = RefusalCode(body[0])
    except (IndexError, ValueError):
        raise ProtocolError(Broken.UNKNOWN_REFUSAL()) from None
    # It is not authenticated, and the message goes to a terminal.
    return code, sanitize_text(body[1 : 1 + MESSAGE_LIMIT].decode(errors="replace"))


# --- other programs' streams

_HTTP = (b"HTTP", b"GET ", b"HEAD ", b"POST ", b"PUT ", b"DELETE ", b"OPTIONS ", b"CONNECT ", b"PATCH ", b"TRACE ")
_BEGINNINGS: tuple[tuple[str, tuple[bytes, ...]], ...] = (
    ("HTTP", (*_HTTP, b"PRI * HTTP", b"<!DO", b"<!do", b"<htm", b"<HTM", b"<?xm")),  # HTTP/0.9 answers without a header
    ("SSH", (b"SSH-",)),
    ("TLS", tuple(bytes((kind, 3, minor)) for kind in (0x15, 0x16) for minor in range(5))),
    ("RTPS", (b"RTPS", b"RTCP")),
    ("Redis", (b"-ERR", b"+PONG", b"*1\r\n")),
    ("FTP or SMTP", (b"220 ", b"220-", b"EHLO", b"HELO")),
    ("VNC", (b"RFB ",)),
)
_ZENOH_CLOSE = bytes.fromhex("020003")
"""Two bytes of length, and the message by which a router refuses a program that does not speak Zenoh."""
_ZENOH_INIT = 0x01
_ZENOH_VERSIONS = (0x08, 0x09)


def recognise(data: Buffer) -> str:
    """Return the name of the protocol that a stream begins with, or an empty string if it is not a known one.

    Args:
        data: the first bytes, at least four.
    """
    start = bytes(data[:16])
    for name, beginnings in _BEGINNINGS:
        # A stream may have brought less than a beginning is long.
        if any(start.startswith(each) or each.startswith(start) for each in beginnings):
            return name
    # A Zenoh client begins with two bytes of length, INIT and the version.
    is_init = len(start) >= 4 and start[2] & 0x1F == _ZENOH_INIT and start[3] in _ZENOH_VERSIONS
    return "Zenoh" if is_init or start.startswith(_ZENOH_CLOSE) else ""


# --- streams


class PreamblePhase(Enum):
    """The expected part of a stream."""

    PREAMBLE = auto()  # preamble frames, one by one
    SEALED = auto()  # sealed frames
    HANDED_OVER = auto()  # a data stream, whose bytes go to the caller
    OVER = auto()


class PreambleStream(ABC):
    """The common part of all ends of a stream: the preamble, and failures."""

    _is_server = False

    def __init__(self) -> None:
        self._phase = PreamblePhase.PREAMBLE
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._events: list[Event] = []

    def receive_data(self, data: Buffer) -> list[Event]:
        """Take the next bytes of the stream; `data` must not be changed afterwards."""
        self._events = []
        try:
            self._take_in(data)
        except Refusal as refusal:
            self._refuse(refusal.code, refusal.message)
            self._end(StreamRefused(refusal.code, refusal.message))
        except (ProtocolError, SealError) as error:
            if self._phase is PreamblePhase.PREAMBLE:  # later, the peer expects sealed frames only
                self._refuse(RefusalCode.BAD_FORMAT, str(error))
            foreign = error.protocol if isinstance(error, ForeignProtocolError) else None
            self._end(Failed(str(error), foreign))
        return self._events

    def data_to_send(self) -> bytes:
        """Return the bytes to write now; returned once."""
        data, self._outbox = bytes(self._outbox), bytearray()
        return data

    def leftover(self) -> bytes:
        """Return the bytes after an accepted data stream's preamble, once."""
        data, self._inbox = bytes(self._inbox), bytearray()
        return data

    def _take_in(self, data: Buffer) -> None:
        if self._phase is PreamblePhase.OVER:
            return
        self._inbox += data
        while self._phase is PreamblePhase.PREAMBLE and (frame := take_frame(self._inbox)) is not None:
            self._on_preamble(*parse_preamble(frame), frame)

    @abstractmethod
    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        """Act on one preamble frame; `frame` is the whole of it."""

    def _refuse(self, code: RefusalCode, message: str) -> None:
        if self._is_server:  # a client has no frame for it
            self._outbox += pack_frame(refuse_frame(code, message))

    def _refused_by_peer(self, body: bytes) -> None:
        code, message = parse_refuse(body)
        self._end(StreamRefused(code, message))

    def _end(self, event: Event) -> None:
        self._phase = PreamblePhase.OVER
        self._events.append(event)
