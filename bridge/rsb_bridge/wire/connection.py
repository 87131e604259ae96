"""The state machines of a link's streams, and of an operator's: bytes in, events out (PROTOCOL.md, 1 and 10).

The caller reads a socket, passes the bytes to `receive_data`, acts on the events, and writes what `data_to_send` and
`send` return, in the order of the calls. After `StreamRefused` or `Failed` a connection ignores further bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.fingerprints import FINGERPRINT_LENGTH, fingerprint_of, format_fingerprint
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.wire.codec import decode_hello, decode_welcome, encode
from rsb_bridge.wire.events import (
    Accepted,
    Admitted,
    DataFrame,
    Established,
    MessageReceived,
    OperatorOpened,
    RefusalCode,
    StreamRefused,
)
from rsb_bridge.wire.framing import CONTROL, CONTROL_LIMIT, DATA, HEADER, pack_frame
from rsb_bridge.wire.preamble import (
    MAGIC,
    ControlPreamble,
    PreambleKind,
    PreamblePhase,
    PreambleStream,
    Refusal,
    RefusalText,
    control_header,
    data_header,
    key_of,
    operator_header,
    parse_control,
    parse_data,
    parse_operator,
    parse_preamble,
    parse_refuse,
    parse_suite,
    preamble_frame,
)
from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealed_stream import AcceptingStream, ConnectingStream, Credential, SealedStream, handshake_of
from rsb_bridge.wire.sealing import CipherSuite, ConnectionKeys

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.events import StreamName
    from rsb_bridge.wire.messages import ControlMessageBase, Hello, Welcome
    from rsb_bridge.wire.sealed_stream import ReplayCache

_CONTROL_HEADER = HEADER.pack(CONTROL, 0, 0, 0)
# With the longer tag, so that a message that one link takes is not too long for another one.
_LONGEST_CONTENT = CONTROL_LIMIT - HEADER.size - CipherSuite.AESGCM.tag_length
# Of operators' connections, which are always encrypted, with one suite: a console transfers little
OPERATOR_SUITE = CipherSuite.CHACHAPOLY
RECORD_CONTENT = 16 << 10  # bytes of a record's content at most. A round figure: nothing was measured
RECORD_LIMIT = RECORD_CONTENT + OPERATOR_SUITE.tag_length
_RECORD_HEADER = b""
HOST_BYTES = 64  # of the console's host name in UTF-8
_AT_BYTES = 64


class _Control(SealedStream):
    """Either end of a control connection, in addition to its handshake."""

    _multiplexed: bool

    def send(self, message: ControlMessageBase) -> bytes:
        """Seal a control message; see `send_encoded`."""
        return self.send_encoded(encode(message))

    def send_encoded(self, content: bytes) -> bytes:
        """Seal a control message as it was encoded.

        Returns:
            The bytes to write; what `data_to_send` still held comes first.

        Raises:
            ValueError: the message is longer than a control frame may be.
            RuntimeError: the connection was never `Established`.
        """
        if len(content) > _LONGEST_CONTENT:
            raise ValueError(Misuse.CONTROL_MESSAGE_TOO_LONG(length=len(content), limit=CONTROL_LIMIT))
        self._outbox += self._seal(content)
        return self.data_to_send()

    def _on_content(self, content: bytes) -> None:
        self._events.append(MessageReceived(content))

    def _on_other_frame(self, frame: memoryview) -> None:
        header = frame[: HEADER.size]
        if not self._multiplexed or len(header) < HEADER.size or header[0] != DATA:
            super()._on_other_frame(frame)  # raises
        self._events.append(DataFrame(frame))


class ClientConnection(_Control, ConnectingStream):
    """The client's end of a control connection.

    Attributes:
        suite: the cipher suite that was offered last; the server may have asked for another than at first.
    """

    def __init__(self, hello: Hello, key: bytes | None, suite: CipherSuite, *, multiplexed: bool = False) -> None:
        """Prepare to connect.

        Args:
            key: 32 bytes, or None for no encryption with any suite.
            suite: AESGCM or CHACHAPOLY, the faster one on this machine. The server may ask for CHACHAPOLY.
            multiplexed: data frames share the stream (Bluetooth).
        """
        super().__init__(_CONTROL_HEADER, CONTROL_LIMIT)
        self._multiplexed = multiplexed
        self._hello = hello
        self._key = key
        self.suite = CipherSuite.PLAIN if key is None else suite
        self._heard = False  # a sealed frame: so the server has this side's confirmation

    def start(self) -> bytes:
        """Return the bytes to write first.

        Raises:
            ValueError: the name is too long.
        """
        mark = bytes(FINGERPRINT_LENGTH) if self._key is None else fingerprint_of(self._key)
        header = control_header(self.suite, self._hello.name, mark)
        return self._first_message(self.suite, self._key, header, encode(self._hello))

    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        # Only from AES-GCM, and only to ChaCha20: a forged one can neither loop nor take the encryption away.
        may_retry = kind is PreambleKind.RETRY and self.suite is CipherSuite.AESGCM
        if may_retry and parse_suite(body) is CipherSuite.CHACHAPOLY:
            self.suite = CipherSuite.CHACHAPOLY
            self._outbox += self.start()
        else:
            super()._on_preamble(kind, body, frame)

    def _on_content(self, content: bytes) -> None:
        self._heard = True
        super()._on_content(content)

    def _on_other_frame(self, frame: memoryview) -> None:
        """Take a REFUSE of a server that has accepted and then missed this side's confirmation."""
        if not self._heard and frame[: len(MAGIC)] == MAGIC:
            kind, body = parse_preamble(bytes(frame))
            if kind is PreambleKind.REFUSE:
                self._refused_by_peer(body)
                return
        super()._on_other_frame(frame)

    def _refused_by_peer(self, body: bytes) -> None:
        if parse_refuse(body)[0] is RefusalCode.SHUT_DOWN:  # anybody could have the client wait so
            raise ProtocolError("a REFUSE with the code for a link that is shut down, which only a Welcome may say")
        super()._refused_by_peer(body)

    def _on_accept(self, message: bytes) -> None:
        welcome = decode_welcome(self._read_answer(message, RefusalText.ANSWER_SEALED_WITH_ANOTHER_KEY()))
        self.proven, self.at = self._key is not None, welcome.at
        keys = self._establish(
            self.suite
        )  # also where it is refused: only then does the server know that it has the key
        if welcome.taken:
            raise Refusal(RefusalCode.NAME_TAKEN, welcome.taken)
        if welcome.shut_down:
            raise Refusal(RefusalCode.SHUT_DOWN, welcome.shut_down)
        self._events.append(Established(welcome, ConnectionKeys(self.suite, keys.export, welcome.link_id)))


class ServerConnection(AcceptingStream, _Control):
    """The server's end of an inbound stream: a control connection, or a data stream to be attached.

    Attributes:
        fingerprint: of an accepted client's key, or empty without encryption.
    """

    def __init__(
        self,
        identity: Callable[[str], Credential],
        make_welcome: Callable[[Hello], Welcome],
        aes: bool,
        *,
        multiplexed: bool = False,
    ) -> None:
        """Wait for a client.

        Args:
            identity: the credential for a client's name, which is not authenticated yet; may raise `Refusal`.
            make_welcome: this side's answer to a client; may raise `Refusal`. It must not change anything: the client's
                message may be a replay, and the client is authenticated only with `Established`.
            aes: AES is fast on this machine; else a client that offers it is asked for ChaCha20-Poly1305.
            multiplexed: data frames share the stream (Bluetooth).
        """
        super().__init__(_CONTROL_HEADER, CONTROL_LIMIT, "client", identity)
        self._multiplexed = multiplexed
        self._make_welcome = make_welcome
        self._aes = aes
        self._retried = False
        self.fingerprint = b""

    def accept_attach(self) -> bytes:
        """Accept the data stream; return the bytes to write. `leftover` has the bytes after the preamble."""
        self._outbox += pack_frame(preamble_frame(PreambleKind.ACCEPT))
        return self.data_to_send()

    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        match kind:
            case PreambleKind.CONTROL:
                self._on_offer(parse_control(frame))
            case PreambleKind.DATA:
                self._events.append(parse_data(frame))
                self._phase = PreamblePhase.HANDED_OVER
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))

    def _on_offer(self, offer: ControlPreamble) -> None:
        self.name = offer.name
        keys, replays = self._identity(offer.name)
        if not keys and offer.suite is not CipherSuite.PLAIN:
            problem = RefusalText.ENCRYPTION_NOT_POSSIBLE(name=offer.name)
            raise Refusal(RefusalCode.ENCRYPTION_NOT_POSSIBLE, problem)
        if keys and offer.suite is CipherSuite.PLAIN:
            raise Refusal(RefusalCode.ENCRYPTION_REQUIRED, RefusalText.ENCRYPTION_REQUIRED(name=offer.name))
        if offer.suite is CipherSuite.AESGCM and not self._aes:
            if self._retried:
                raise ProtocolError(Broken.RETRY_IGNORED())
            self._retried = True
            self._outbox += pack_frame(preamble_frame(PreambleKind.RETRY, bytes((CipherSuite.CHACHAPOLY,))))
            return
        key = key_of(keys, offer.fingerprint, offer.name, "client", "server") if keys else None
        self._welcome(offer, key, replays)

    def _welcome(self, offer: ControlPreamble, key: bytes | None, replays: ReplayCache) -> None:
        handshake = handshake_of(offer.suite, key, offer.header)
        hello = decode_hello(self._read_first(handshake, offer.message))
        # After it has opened, or strangers could push all of the client's messages out of the memory. Without a key it
        # has no random part, and a client's second attempt would count as a replay.
        if key is not None:
            self._check_new(replays, offer.message)
        # The name in the preamble has chosen the key: else a client could be linked under another one's name.
        if hello.name != offer.name:
            raise ProtocolError(Broken.NAMES_DIFFER(preamble=offer.name, hello=hello.name))
        welcome = self._make_welcome(hello)
        answer, keys = handshake.write(encode(welcome)), handshake.split()
        outcome: Established | StreamRefused
        if welcome.taken:
            outcome = StreamRefused(RefusalCode.NAME_TAKEN, welcome.taken, hello)
        elif welcome.shut_down:
            outcome = StreamRefused(RefusalCode.SHUT_DOWN, welcome.shut_down, hello)
        else:
            outcome = Established(hello, ConnectionKeys(offer.suite, keys.export, welcome.link_id), welcome)
        self.fingerprint = b"" if key is None else offer.fingerprint
        self._accept(offer.suite, keys, answer, outcome)


class DataConnection(PreambleStream):
    """The client's end of a data stream, until the server accepts it and the link's routes take over."""

    def __init__(self, keys: ConnectionKeys, name: StreamName) -> None:
        super().__init__()
        header = data_header(keys.link_id, name)
        self._beginning = pack_frame(header, keys.attach_proof(header, name.number))

    def start(self) -> bytes:
        """Return the bytes to write first."""
        return self._beginning

    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        match kind:
            case PreambleKind.ACCEPT:
                self._phase = PreamblePhase.HANDED_OVER
                self._events.append(Accepted())
            case PreambleKind.REFUSE:
                self._refused_by_peer(body)
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))


class _Records(SealedStream):
    """Either end of an operator's connection, in addition to its handshake."""

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
            raise ProtocolError("an empty record")
        self._events.append(OperatorOpened(content))


class OperatorConsole(_Records, ConnectingStream):
    """The console's end of its connection with an engine over a network."""

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
        return self._first_message(OPERATOR_SUITE, self._key, self._preamble, self._host)

    def _on_accept(self, message: bytes) -> None:
        wrong_key = RefusalText.ENGINE_SEALED_WITH_ANOTHER_KEY(fingerprint=format_fingerprint(self._mark))
        self.at = self._read_answer(message, wrong_key)[:_AT_BYTES].decode(errors="replace")
        self.proven = True
        self._establish(OPERATOR_SUITE)
        self._events.append(Admitted())


class OperatorEngine(AcceptingStream, _Records):
    """The engine's end of a console's connection.

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
            raise ProtocolError(f"unexpected {kind.name} frame: operators attach here, not links")
        offer = parse_operator(frame)
        # Before the operator's name, so that it is asked about only where this engine is meant.
        if offer.engine != self._engine:
            raise Refusal(RefusalCode.UNKNOWN_NAME, f"this is not the engine {offer.engine!r}")
        self.name = offer.operator
        keys, replays = self._identity(offer.operator)
        key = key_of(keys, offer.fingerprint, offer.operator, "console", "engine")
        handshake = handshake_of(OPERATOR_SUITE, key, offer.header)
        host = self._read_first(handshake, offer.message)
        if len(host) > HOST_BYTES:
            raise ProtocolError("the console's host name is too long")
        # After it has opened, or strangers could push all of the operator's messages out of the memory.
        self._check_new(replays, offer.message)
        answer = handshake.write(self._at.encode())
        admitted = Admitted(sanitize_text(host.decode(errors="replace")), key)
        self._accept(OPERATOR_SUITE, handshake.split(), answer, admitted)
