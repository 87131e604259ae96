"""The state machines of a stream: bytes in, events out (PROTOCOL.md, 1).

The caller reads a socket, passes the bytes to `receive_data`, acts on the events, and writes what `data_to_send` and
`send` return, in the order of the calls. After `Refused` or `Failed` a connection ignores further bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.fingerprints import FINGERPRINT_LENGTH, fingerprint_of
from rsb_bridge.wire import sealing
from rsb_bridge.wire.codec import decode, decode_hello, decode_welcome, encode
from rsb_bridge.wire.events import (
    Accepted,
    Attach,
    DataFrame,
    Established,
    Received,
    RefusalCode,
    Refused,
    Undecoded,
)
from rsb_bridge.wire.framing import CONTROL, CONTROL_LIMIT, DATA, HEADER, FrameReader, pack_frame
from rsb_bridge.wire.handshake import Handshake, NoiseHandshake, PlainHandshake
from rsb_bridge.wire.preamble import (
    MAGIC,
    ControlPreamble,
    Kind,
    Phase,
    PreambleStream,
    Refusal,
    RefusalText,
    control_header,
    data_header,
    key_of,
    parse_control,
    parse_data,
    parse_preamble,
    parse_refuse,
    parse_suite,
    preamble_frame,
    take_frame,
)
from rsb_bridge.wire.protocol_error import Broken, ForeignProtocolError, Misuse, ProtocolError
from rsb_bridge.wire.sealing import Buffer, Sealer, SealError, SessionKeys, StreamOpener, Suite

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.wire.handshake import ReplayCache
    from rsb_bridge.wire.messages import ControlMessage, Hello, Welcome

_CONTROL_HEADER = HEADER.pack(CONTROL, 0, 0, 0)


class Credential(NamedTuple):
    """The proof that a client of a certain name owes.

    Attributes:
        keys: 32 bytes each, of which it must have one, or empty without encryption.
        replays: remembers its first messages under all keys.
    """

    keys: tuple[bytes, ...]
    replays: ReplayCache


class _Control(PreambleStream):
    """Either end of a control connection: sealed control frames after the handshake.

    Attributes:
        decodes: whether control messages are decoded as they come. If not, each is an `Undecoded` event, so that its
            receiver can spread the work: a message of 1 MiB may take half a second.
    """

    def __init__(self, *, multiplexed: bool) -> None:
        super().__init__()
        self.decodes = True
        self._multiplexed = multiplexed
        self._frames = FrameReader(CONTROL_LIMIT)
        self._sealer: Sealer | None = None
        self._opener: StreamOpener | None = None

    def send(self, message: ControlMessage) -> bytes:
        """Seal a control message.

        Returns:
            The bytes to write; what `data_to_send` still held comes first.

        Raises:
            ValueError: the message is longer than a control frame may be.
            RuntimeError: the connection was never `Established`.
        """
        content = encode(message)
        if HEADER.size + len(content) + Suite.AESGCM.tag_length > CONTROL_LIMIT:
            raise ValueError(
                Misuse.CONTROL_MESSAGE_TOO_LONG(
                    message=type(message).__name__, length=len(content), limit=CONTROL_LIMIT
                )
            )
        self._write(content)
        return self.data_to_send()

    def _start_sealing(self, suite: Suite, sending: bytes | None, receiving: bytes | None) -> None:
        self._sealer = Sealer(suite, sending)
        self._opener = StreamOpener(suite, receiving)
        self._phase = Phase.SEALED

    def _write(self, content: bytes) -> None:
        if self._sealer is None:
            raise RuntimeError(Misuse.NOT_ESTABLISHED())
        self._outbox += pack_frame(_CONTROL_HEADER, self._sealer.seal(content, _CONTROL_HEADER))

    def _take_in(self, data: Buffer) -> None:
        super()._take_in(data)
        if self._is(Phase.SEALED):
            self._open_frames()

    def _open_frames(self) -> None:
        assert self._opener is not None
        for frame in self._frames.feed(self.leftover()):
            header = frame[: HEADER.size]
            if header == _CONTROL_HEADER:
                self._on_control(self._opener.open(frame[HEADER.size :], header))
            elif self._multiplexed and len(header) == HEADER.size and header[0] == DATA:
                self._events.append(DataFrame(HEADER.unpack(header)[2], frame))
            else:
                self._on_other_frame(frame)
                return

    def _on_other_frame(self, frame: memoryview) -> None:
        raise ProtocolError(Broken.UNEXPECTED_ON_CONTROL(header=bytes(frame[: HEADER.size]).hex(" ")))

    def _on_control(self, content: bytes) -> None:
        self._events.append(Received(decode(content)) if self.decodes else Undecoded(content))


class ClientConnection(_Control):
    """The client's end of a control connection."""

    def __init__(self, hello: Hello, key: bytes | None, suite: Suite, *, multiplexed: bool = False) -> None:
        """Prepare to connect.

        Args:
            hello: this side.
            key: 32 bytes, or None for no encryption with any suite.
            suite: AESGCM or CHACHAPOLY, the faster one on this machine. The server may ask for CHACHAPOLY.
            multiplexed: data frames share the stream (Bluetooth).
        """
        super().__init__(multiplexed=multiplexed)
        self._hello = hello
        self._key = key
        self._suite = Suite.PLAIN if key is None else suite
        self._handshake: Handshake = PlainHandshake()
        self._heard = False  # a sealed frame: so the server has this side's confirmation
        self._proven = False
        self._at = ""
        self._sample_secret: bytes | None = None

    @property
    def proven(self) -> bool:
        """Whether the server has proven that it has the key; one without encryption proves nothing."""
        return self._proven

    @property
    def at(self) -> str:
        """The server's address in a Zenoh network, as it says, or an empty string."""
        return self._at

    @property
    def sample_secret(self) -> bytes | None:
        """The secret of the stream's sample tags, or None before the handshake, or if the server sends none."""
        return self._sample_secret

    @property
    def suite(self) -> Suite:
        """The cipher suite that was offered last; the server may have asked for another than at first."""
        return self._suite

    def fork(self) -> ClientConnection:
        """Return a copy to take one of several answers to the first message, which strangers may answer, too."""
        other, handshake = self._fork(self._handshake)
        other._handshake = handshake
        return other

    def start(self) -> bytes:
        """The bytes to write first.

        Raises:
            ValueError: the name is too long.
        """
        mark = bytes(FINGERPRINT_LENGTH) if self._key is None else fingerprint_of(self._key)
        header = control_header(self._suite, self._hello.name, mark)
        self._handshake = _handshake(self._suite, self._key, header)
        return pack_frame(header, self._handshake.write(encode(self._hello)))

    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        match kind:
            case Kind.ACCEPT:
                self._on_accept(body)
            case Kind.REFUSE:
                self._refused_by_peer(body)
            case Kind.RETRY if self._suite is Suite.AESGCM and parse_suite(body) is Suite.CHACHAPOLY:
                self._suite = Suite.CHACHAPOLY
                self._outbox += self.start()
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))

    def _on_control(self, content: bytes) -> None:
        self._heard = True
        super()._on_control(content)

    def _on_other_frame(self, frame: memoryview) -> None:
        """Take a REFUSE of a server that has accepted and then missed this side's confirmation."""
        if self._heard or frame[: len(MAGIC)] != MAGIC:
            super()._on_other_frame(frame)
        kind, body = parse_preamble(bytes(frame))
        if kind is not Kind.REFUSE:
            super()._on_other_frame(frame)
        self._refused_by_peer(body)

    def _refused_by_peer(self, body: bytes) -> None:
        if parse_refuse(body)[0] is RefusalCode.SHUT_DOWN:  # anybody could have the client wait so
            raise ProtocolError(Broken.SHUT_DOWN_IN_REFUSE())
        super()._refused_by_peer(body)

    def _on_accept(self, message: bytes) -> None:
        try:
            welcome = decode_welcome(self._handshake.read(message))
        except SealError:
            raise Refusal(RefusalCode.WRONG_KEY, RefusalText.ANSWER_SEALED_WITH_ANOTHER_KEY()) from None
        keys = self._handshake.split()
        self._proven, self._at = self._key is not None, welcome.at
        if keys.export is not None and all(
            sealing.FEATURE in each for each in (self._hello.features, welcome.features)
        ):
            self._sample_secret = sealing.derive_sample_secret(keys.export)
        self._start_sealing(self._suite, keys.client, keys.server)
        self._write(b"")  # the confirmation, which a replay of a recorded first message can't give
        if welcome.taken:
            raise Refusal(RefusalCode.NAME_TAKEN, welcome.taken)
        if welcome.shut_down:
            raise Refusal(RefusalCode.SHUT_DOWN, welcome.shut_down)
        self._events.append(Established(welcome, SessionKeys(self._suite, keys.export, welcome.link_id)))


class ServerConnection(_Control):
    """The server's end of an inbound stream: a control connection, or a data stream to be attached."""

    _is_server = True

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
        super().__init__(multiplexed=multiplexed)
        self.name = ""
        """The name that the client says, which is not authenticated before `Established`."""
        self._identity = identity
        self._make_welcome = make_welcome
        self._aes = aes
        self._retried = False
        self._fingerprint = b""
        self._unconfirmed: Established | Refused | None = None  # what is so once the client has confirmed
        self._sample_secret: bytes | None = None

    @property
    def accepted(self) -> bool:
        """Whether the client's first message opens under its key. Somebody may have recorded and sent it again."""
        return self._is(Phase.SEALED)

    @property
    def sample_secret(self) -> bytes | None:
        """The secret of the stream's sample tags, or None if the client is not accepted, or sends none."""
        return self._sample_secret

    @property
    def fingerprint(self) -> bytes:
        """The fingerprint of an accepted client's key, or empty without encryption."""
        return self._fingerprint

    def accept_attach(self) -> bytes:
        """Accept the data stream; return the bytes to write. `leftover` has the bytes after the preamble."""
        self._outbox += pack_frame(preamble_frame(Kind.ACCEPT))
        return self.data_to_send()

    def refuse(self, code: RefusalCode, message: str) -> bytes:
        """Refuse the stream: the bytes to write before closing it."""
        self._phase = Phase.OVER
        self._refuse(code, message)
        return self.data_to_send()

    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        match kind:
            case Kind.CONTROL:
                self._on_offer(parse_control(frame))
            case Kind.DATA:
                link_id, route, header, proof = parse_data(frame)
                self._phase = Phase.HANDED_OVER
                self._events.append(Attach(link_id, route, proof, header))
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))

    def _on_offer(self, offer: ControlPreamble) -> None:
        self.name = offer.name
        keys, replays = self._identity(offer.name)
        if not keys and offer.suite is not Suite.PLAIN:
            raise Refusal(
                RefusalCode.ENCRYPTION_NOT_POSSIBLE,
                RefusalText.ENCRYPTION_NOT_POSSIBLE(name=offer.name),
            )
        if keys and offer.suite is Suite.PLAIN:
            raise Refusal(
                RefusalCode.ENCRYPTION_REQUIRED,
                RefusalText.ENCRYPTION_REQUIRED(name=offer.name),
            )
        if offer.suite is Suite.AESGCM and not self._aes:
            self._retry()
        else:
            key = key_of(keys, offer.fingerprint, offer.name, "client", "server") if keys else None
            self._welcome(offer, key, replays)

    def _retry(self) -> None:
        if self._retried:
            raise ProtocolError(Broken.RETRY_IGNORED())
        self._retried = True
        self._outbox += pack_frame(preamble_frame(Kind.RETRY, bytes((Suite.CHACHAPOLY,))))

    def _welcome(self, offer: ControlPreamble, key: bytes | None, replays: ReplayCache) -> None:
        handshake = _handshake(offer.suite, key, offer.header)
        try:
            hello = decode_hello(handshake.read(offer.message))
        except SealError:
            raise Refusal(
                RefusalCode.WRONG_KEY,
                RefusalText.FIRST_MESSAGE_FORGED(name=offer.name),
            ) from None
        if key is not None and not replays.is_new(offer.message):
            raise ProtocolError(Broken.HANDSHAKE_REPLAYED(name=offer.name))
        if hello.name != offer.name:
            raise ProtocolError(Broken.NAMES_DIFFER(preamble=offer.name, hello=hello.name))
        welcome = self._make_welcome(hello)
        self._outbox += pack_frame(preamble_frame(Kind.ACCEPT, handshake.write(encode(welcome))))
        keys = handshake.split()
        self._start_sealing(offer.suite, keys.server, keys.client)
        self._fingerprint = b"" if key is None else offer.fingerprint
        if keys.export is not None and sealing.FEATURE in hello.features:
            self._sample_secret = sealing.derive_sample_secret(keys.export)
        if welcome.taken:
            self._unconfirmed = Refused(RefusalCode.NAME_TAKEN, welcome.taken, hello)
        elif welcome.shut_down:
            self._unconfirmed = Refused(RefusalCode.SHUT_DOWN, welcome.shut_down, hello)
        else:
            self._unconfirmed = Established(hello, SessionKeys(offer.suite, keys.export, welcome.link_id))

    def _open_frames(self) -> None:
        if self._unconfirmed is not None:
            # Until here the peer may be anybody, so it gets no more room than a preamble frame has.
            try:
                frame = take_frame(self._inbox)
            except ForeignProtocolError:
                raise ProtocolError(Broken.NOT_CONFIRMED(peer="client")) from None
            if frame is None:
                return
            self._confirm(frame, self._unconfirmed)
        if self._is(Phase.SEALED):
            super()._open_frames()

    def _confirm(self, frame: bytes, outcome: Established | Refused) -> None:
        assert self._opener is not None
        header, sealed = frame[: HEADER.size], frame[HEADER.size :]
        if header != _CONTROL_HEADER or self._opener.open(sealed, header):
            raise ProtocolError(Broken.NOT_CONFIRMED(peer="client"))
        self._unconfirmed = None
        if isinstance(outcome, Refused):
            self._end(outcome)
        else:
            self._events.append(outcome)


class DataConnection(PreambleStream):
    """The client's end of a data stream, until the server accepts it and a route's channel takes over."""

    def __init__(self, keys: SessionKeys, route: int) -> None:
        super().__init__()
        self._keys = keys
        self._route = route

    def start(self) -> bytes:
        """The bytes to write first."""
        header = data_header(self._keys.link_id, self._route)
        return pack_frame(header, self._keys.attach_proof(header, self._route))

    def _on_preamble(self, kind: Kind, body: bytes, frame: bytes) -> None:
        match kind:
            case Kind.ACCEPT:
                self._phase = Phase.HANDED_OVER
                self._events.append(Accepted())
            case Kind.REFUSE:
                self._refused_by_peer(body)
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))


def _handshake(suite: Suite, key: bytes | None, prologue: bytes) -> Handshake:
    return PlainHandshake() if key is None else NoiseHandshake(suite, key, prologue)
