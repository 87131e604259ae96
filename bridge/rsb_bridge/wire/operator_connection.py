"""A console's connection with an engine over a network: a handshake, then the console's bytes in sealed records.

Sans-IO, as `rsb_bridge.wire.connection` (PROTOCOL.md, 10). An operator's connection is always encrypted, with the
same cipher suite for all: a console transfers little.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.fingerprints import FINGERPRINT_LENGTH, fingerprint_of, format_fingerprint
from rsb_bridge.model.limits import NAME_BYTES
from rsb_bridge.model.text import is_clean, sanitize_text
from rsb_bridge.wire.events import Admitted, OperatorOpened, RefusalCode
from rsb_bridge.wire.preamble import PREFIX_LENGTH, PreambleKind, Refusal, RefusalText, key_of, preamble_frame
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealed_stream import AcceptingStream, ConnectingStream, SealedStream, handshake_of
from rsb_bridge.wire.sealing import CipherSuite

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.sealed_stream import Credential

SUITE = CipherSuite.CHACHAPOLY
RECORD_CONTENT = 16 << 10
"""Bytes of a record's content at most. A round figure: nothing was measured."""
_RECORD_HEADER = b""
RECORD_LIMIT = RECORD_CONTENT + SUITE.tag_length
HOST_BYTES = 64
"""Bytes of the console's host name in UTF-8."""
_AT_BYTES = 64
_VERSION = struct.Struct(">H")


class OperatorPreamble(NamedTuple):
    """A console's request for a connection.

    Attributes:
        version: of the control protocol that the console speaks.
        engine: the engine that is meant.
        fingerprint: of the operator's key, as the console says: 8 bytes.
        header: the frame up to the handshake message: the handshake's prologue.
        message: the first handshake message.
    """

    version: int
    operator: str
    engine: str
    fingerprint: bytes
    header: bytes
    message: bytes


def operator_header(version: int, operator: str, engine: str, fingerprint: bytes) -> bytes:
    """Return the part of an OPERATOR frame before its handshake message.

    Raises:
        ValueError: a name is too long.
    """
    body = _VERSION.pack(version)
    for name in (operator, engine):
        encoded = name.encode()
        if len(encoded) > NAME_BYTES:
            raise ValueError(Misuse.NAME_TOO_LONG(length=len(encoded), limit=NAME_BYTES))
        body += bytes((len(encoded),)) + encoded
    return preamble_frame(PreambleKind.OPERATOR, body + fingerprint)


def parse_operator(frame: bytes) -> OperatorPreamble:
    """Read an OPERATOR frame.

    Raises:
        ProtocolError: the frame is invalid.
    """
    names_at = PREFIX_LENGTH + _VERSION.size
    if len(frame) < names_at:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="version"))
    operator, engine_at = _name(frame, names_at)
    engine, at = _name(frame, engine_at)
    end = at + FINGERPRINT_LENGTH
    if len(frame) < end:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="fingerprint"))
    (version,) = _VERSION.unpack_from(frame, PREFIX_LENGTH)
    return OperatorPreamble(version, operator, engine, frame[at:end], frame[:end], frame[end:])


def _name(frame: bytes, at: int) -> tuple[str, int]:
    """Return a name behind its length, and where it ends."""
    begin = at + 1
    end = begin + frame[at] if at < len(frame) else begin
    if len(frame) < end:
        raise ProtocolError(Broken.OPERATOR_TOO_SHORT(field="names"))
    try:
        name = frame[begin:end].decode()
    except UnicodeDecodeError:
        raise ProtocolError(Broken.NAME_NOT_UTF8(frame="OPERATOR")) from None
    if not is_clean(name):
        raise ProtocolError(Broken.NAME_UNPRINTABLE(frame="OPERATOR"))
    return name, end


class _Records(SealedStream):
    """Either end, in addition to its handshake."""

    def send(self, content: bytes) -> bytes:
        """Seal the next bytes for the other end, in as many records as they take.

        Returns:
            The bytes to write.

        Raises:
            RuntimeError: the connection was never `Admitted`.
        """
        view = memoryview(content)
        return b"".join(self._seal(view[at : at + RECORD_CONTENT]) for at in range(0, len(content), RECORD_CONTENT))

    def _on_content(self, content: bytes) -> None:
        if not content:
            raise ProtocolError(Broken.EMPTY_RECORD())
        self._events.append(OperatorOpened(content))


class OperatorConsole(_Records, ConnectingStream):
    """The console's end."""

    def __init__(self, operator: str, key: bytes, engine: str, *, version: int, host: str = "") -> None:
        """Prepare to attach.

        Args:
            operator: as the engine's session names them.
            key: 32 bytes, the operator's.
            engine: the name of the session that is meant.
            version: of the control protocol.
            host: this machine's name, for the engine's events.

        Raises:
            ValueError: a name is too long.
        """
        super().__init__(_RECORD_HEADER, RECORD_LIMIT)
        self._key = key
        self._mark = fingerprint_of(key)
        self._preamble = operator_header(version, operator, engine, self._mark)
        self._host = host.encode(errors="replace")[:HOST_BYTES]

    def start(self) -> bytes:
        """Return the bytes to write first."""
        return self._first_message(SUITE, self._key, self._preamble, self._host)

    def _on_accept(self, message: bytes) -> None:
        wrong_key = RefusalText.ENGINE_SEALED_WITH_ANOTHER_KEY(fingerprint=format_fingerprint(self._mark))
        self.at = self._read_answer(message, wrong_key)[:_AT_BYTES].decode(errors="replace")
        self.proven = True
        self._start_sealing(SUITE, self._handshake.split())
        self._confirm()
        self._events.append(Admitted())


class OperatorEngine(AcceptingStream, _Records):
    """The engine's end.

    It tells strangers as much as a link does: that an operator is unknown, or that keys differ. Neither opens anything.
    """

    def __init__(self, engine: str, identity: Callable[[str], Credential], at: str = "") -> None:
        """Wait for a console.

        Args:
            identity: the credential of an operator by their name, which is not authenticated yet; may raise `Refusal`.
            at: this engine's address in a Zenoh network, or empty elsewhere.
        """
        super().__init__(_RECORD_HEADER, RECORD_LIMIT, "console", identity)
        self._at = at
        self._engine = engine

    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        if kind is not PreambleKind.OPERATOR:
            raise ProtocolError(Broken.UNEXPECTED_FROM_OPERATOR(kind=kind.name))
        offer = parse_operator(frame)
        # Before the operator's name, so that it is asked about only where this engine is meant.
        if offer.engine != self._engine:
            raise Refusal(RefusalCode.UNKNOWN_NAME, RefusalText.ANOTHER_ENGINE(name=offer.engine))
        self.name = offer.operator
        keys, replays = self._identity(offer.operator)
        key = key_of(keys, offer.fingerprint, offer.operator, "console", "engine")
        handshake = handshake_of(SUITE, key, offer.header)
        host = self._read_first(handshake, offer.message)
        if len(host) > HOST_BYTES:
            raise ProtocolError(Broken.HOST_NAME_TOO_LONG())
        # After it has opened, or strangers could push all of the operator's messages out of the memory.
        self._check_new(replays, offer.message)
        answer = handshake.write(self._at.encode())
        admitted = Admitted(sanitize_text(host.decode(errors="replace")), key)
        self._accept(SUITE, handshake.split(), answer, admitted)
