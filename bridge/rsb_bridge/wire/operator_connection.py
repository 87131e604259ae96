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
from rsb_bridge.wire.events import Admitted, Opened, RefusalCode
from rsb_bridge.wire.framing import FrameReader, pack_frame
from rsb_bridge.wire.handshake import NoiseHandshake
from rsb_bridge.wire.preamble import (
    PREFIX_LENGTH,
    Kind,
    Phase,
    PreambleStream,
    Refusal,
    RefusalText,
    key_of,
    preamble_frame,
    take_frame,
)
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealing import Sealer, SealError, StreamOpener, Suite, derive_sample_secret

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.connection import Credential
    from rsb_bridge.wire.handshake import Handshake
    from rsb_bridge.wire.sealing import Buffer

SUITE = Suite.CHACHAPOLY
RECORD_CONTENT = 16 << 10
"""Bytes of a record's content at most."""
RECORD_LIMIT = RECORD_CONTENT + SUITE.tag_length
HOST_BYTES = 64
"""Bytes of the console's host name in UTF-8."""
_AT_BYTES = 64
_VERSION = struct.Struct(">H")
_TAGS = 0x8000
"""The bit of a console's version that announces sample tags (`rsb_bridge.wire.sealing`)."""


class OperatorPreamble(NamedTuple):
    """A console's request for a connection.

    Attributes:
        version: of the control protocol that the console speaks.
        operator: who wants to attach.
        engine: the engine that is meant.
        fingerprint: of the operator's key, as the console says: 8 bytes.
        header: the frame up to the handshake message: the handshake's prologue.
        message: the first handshake message.
        tags: the console takes sample tags.
    """

    version: int
    operator: str
    engine: str
    fingerprint: bytes
    header: bytes
    message: bytes
    tags: bool = False


def operator_header(version: int, operator: str, engine: str, fingerprint: bytes) -> bytes:
    """The part of an OPERATOR frame before its handshake message.

    Raises:
        ValueError: a name is too long.
    """
    body = _VERSION.pack(version | _TAGS)
    for name in (operator, engine):
        encoded = name.encode()
        if len(encoded) > NAME_BYTES:
            raise ValueError(Misuse.NAME_TOO_LONG(length=len(encoded), limit=NAME_BYTES))
        body += bytes((len(encoded),)) + encoded
    return preamble_frame(Kind.OPERATOR, body + fingerprint)


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
    tags = bool(version & _TAGS)
    return OperatorPreamble(version & ~_TAGS, operator, engine, frame[at:end], frame[:end], frame[end:], tags)


def _name(frame: bytes, at: int) -> tuple[str, int]:
    """A name behind its length, and where it ends."""
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


class _Sealed(PreambleStream):
    """Either end: sealed records after the handshake."""

    def __init__(self) -> None:
        super().__init__()
        self._records = FrameReader(RECORD_LIMIT)
        self._sealer: Sealer | None = None
        self._opener: StreamOpener | None = None
        self._sample_secret: bytes | None = None

    @property
    def sample_secret(self) -> bytes | None:
        """The secret of the stream's sample tags, or None before the handshake, or if the other end sends none."""
        return self._sample_secret

    def send(self, content: bytes) -> bytes:
        """Seal the next bytes for the other end, in as many records as they take.

        Returns:
            The bytes to write.

        Raises:
            RuntimeError: the connection was never `Admitted`.
        """
        if self._sealer is None:
            raise RuntimeError(Misuse.NOT_ADMITTED())
        view, seal = memoryview(content), self._sealer.seal
        return b"".join(
            pack_frame(seal(view[at : at + RECORD_CONTENT], b"")) for at in range(0, len(content), RECORD_CONTENT)
        )

    def _start_sealing(self, sending: bytes | None, receiving: bytes | None) -> None:
        self._sealer = Sealer(SUITE, sending)
        self._opener = StreamOpener(SUITE, receiving)
        self._phase = Phase.SEALED

    def _take_in(self, data: Buffer) -> None:
        super()._take_in(data)
        if self._is(Phase.SEALED):
            self._open_records()

    def _open_records(self) -> None:
        assert self._opener is not None
        for record in self._records.feed(self.leftover()):
            content = self._opener.open(record, b"")
            if not content:
                raise ProtocolError(Broken.EMPTY_RECORD())
            self._events.append(Opened(content))


class OperatorConsole(_Sealed):
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
        super().__init__()
        mark = fingerprint_of(key)
        self._mark = format_fingerprint(mark)
        self._header = operator_header(version, operator, engine, mark)
        self._handshake: Handshake = NoiseHandshake(SUITE, key, self._header)
        self._at = ""
        self._host = host.encode(errors="replace")[:HOST_BYTES]

    @property
    def at(self) -> str:
        """The engine's address in a Zenoh network, as it says, or an empty string."""
        return self._at

    @property
    def proven(self) -> bool:
        """Whether the engine has proven that it has the key."""
        return self._is(Phase.SEALED)

    def fork(self) -> OperatorConsole:
        """Return a copy to take one of several answers to the first message, which strangers may answer, too."""
        other, handshake = self._fork(self._handshake)
        other._handshake = handshake
        return other

    def start(self) -> bytes:
        """The bytes to write first."""
        return pack_frame(self._header, self._handshake.write(self._host))

    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        match kind:
            case Kind.ACCEPT:
                self._on_accept(body)
            case Kind.REFUSE:
                self._refused_by_peer(body)
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))

    def _on_accept(self, message: bytes) -> None:
        try:
            self._at = self._handshake.read(message)[:_AT_BYTES].decode(errors="replace")
        except SealError:
            raise Refusal(
                RefusalCode.WRONG_KEY,
                RefusalText.ENGINE_SEALED_WITH_ANOTHER_KEY(fingerprint=self._mark),
            ) from None
        keys = self._handshake.split()
        self._start_sealing(keys.client, keys.server)
        if self._at and keys.export is not None:
            self._sample_secret = derive_sample_secret(keys.export)
        assert self._sealer is not None
        self._outbox += pack_frame(self._sealer.seal(b"", b""))  # the confirmation, which no replay can give
        self._events.append(Admitted())


class OperatorEngine(_Sealed):
    """The engine's end.

    It tells strangers as much as a link does: that an operator is unknown, or that keys differ. Neither opens anything.
    """

    _is_server = True

    def __init__(self, engine: str, identity: Callable[[str], Credential], at: str = "") -> None:
        """Wait for a console.

        Args:
            engine: this engine's name.
            identity: the credential of an operator by their name, which is not authenticated yet; may raise `Refusal`.
            at: this engine's address in a Zenoh network, or empty on a stream that takes no sample tags.
        """
        super().__init__()
        self.operator = ""
        """The name that the console gives, which is not authenticated before `Admitted`."""
        self._at = at
        self._engine = engine
        self._identity = identity
        self._admitted: Admitted | None = None  # what is so once the console has confirmed

    @property
    def accepted(self) -> bool:
        """Whether the first message opens under the operator's key. Somebody may have recorded and sent it again."""
        return self._is(Phase.SEALED)

    def refuse(self, code: RefusalCode, message: str) -> bytes:
        """Refuse the connection, before it is admitted: the bytes to write before closing it."""
        self._phase = Phase.OVER
        self._refuse(code, message)
        return self.data_to_send()

    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        if kind is not Kind.OPERATOR:
            raise ProtocolError(Broken.UNEXPECTED_FROM_OPERATOR(kind=kind.name))
        offer = parse_operator(frame)
        if offer.engine != self._engine:
            raise Refusal(RefusalCode.UNKNOWN_NAME, RefusalText.ANOTHER_ENGINE(name=offer.engine))
        keys, replays = self._identity(offer.operator)
        self.operator = offer.operator
        key = key_of(keys, offer.fingerprint, offer.operator, "console", "engine")
        handshake = NoiseHandshake(SUITE, key, offer.header)
        try:
            host = handshake.read(offer.message)
        except SealError:
            raise Refusal(
                RefusalCode.WRONG_KEY,
                RefusalText.FIRST_MESSAGE_FORGED(name=offer.operator),
            ) from None
        if len(host) > HOST_BYTES:
            raise ProtocolError(Broken.HOST_NAME_TOO_LONG())
        if not replays.is_new(offer.message):
            raise ProtocolError(Broken.HANDSHAKE_REPLAYED(name=offer.operator))
        self._outbox += pack_frame(preamble_frame(Kind.ACCEPT, handshake.write(self._at.encode())))
        split = handshake.split()
        self._start_sealing(split.server, split.client)
        if self._at and offer.tags and split.export is not None:
            self._sample_secret = derive_sample_secret(split.export)
        self._admitted = Admitted(offer.operator, sanitize_text(host.decode(errors="replace")), key)

    def _open_records(self) -> None:
        if self._admitted is not None:
            # Until here the peer may be anybody, so it gets no more room than a preamble frame has.
            record = take_frame(self._inbox)
            if record is None:
                return
            assert self._opener is not None
            if self._opener.open(record, b""):
                raise ProtocolError(Broken.NOT_CONFIRMED(peer="console"))
            self._events.append(self._admitted)
            self._admitted = None
        super()._open_records()
