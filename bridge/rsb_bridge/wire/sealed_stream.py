"""Both ends of a stream that begins with a handshake, and goes on with sealed frames (PROTOCOL.md, 1.2 and 10).

The handshake is Noise_NNpsk0_25519 over the session key (Noise specification, revision 34). A link's control connection
and an operator's connection add their first messages, and the content of their frames.
"""

from __future__ import annotations

import copy
import hashlib
import hmac
from abc import abstractmethod
from collections import deque
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from rsb_bridge.wire.events import Failed, RefusalCode, StreamRefused
from rsb_bridge.wire.framing import FrameReader, pack_frame
from rsb_bridge.wire.preamble import (
    PreambleKind,
    PreamblePhase,
    PreambleStream,
    Refusal,
    RefusalText,
    preamble_frame,
    take_frame,
)
from rsb_bridge.wire.protocol_error import Broken, ForeignProtocolError, Misuse, ProtocolError
from rsb_bridge.wire.sealing import KEY_LENGTH, CipherSuite, Sealer, SealError, StreamOpener, derive_sample_secret

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Self

    from rsb_bridge.wire.events import Event
    from rsb_bridge.wire.sealing import Buffer

_NOISE_NAMES = {
    CipherSuite.AESGCM: b"Noise_NNpsk0_25519_AESGCM_SHA256",
    CipherSuite.CHACHAPOLY: b"Noise_NNpsk0_25519_ChaChaPoly_SHA256",
}
_DH_LENGTH = 32
_HASH_LENGTH = 32
_MOST_REPLAYS = 512
"""Remembered first messages of a client. A round figure: an older one is answered again, but cannot confirm."""


class HandshakeKeys(NamedTuple):
    """The keys that a handshake gives; all None without encryption."""

    client: bytes | None  # 32 bytes; seals the control frames from client to server
    server: bytes | None  # 32 bytes; seals those from server to client
    export: bytes | None  # 32 bytes; data keys are derived from it


class PlainHandshake:
    """The handshake of a link without encryption: its messages are the payloads."""

    def write(self, payload: bytes) -> bytes:
        return payload

    def read(self, message: bytes) -> bytes:
        return message

    def split(self) -> HandshakeKeys:
        return HandshakeKeys(None, None, None)


class NoiseHandshake:
    """One end of Noise NNpsk0: ``-> psk, e`` then ``<- e, ee``; names are the specification's (section 5).

    Every payload is sealed under a key of its own (psk handshakes mix a key at each ``e``, section 9.2), so the nonce
    is always 0: a fresh `Sealer`.
    """

    def __init__(
        self, suite: CipherSuite, psk: bytes, prologue: bytes, ephemeral: X25519PrivateKey | None = None
    ) -> None:
        """Start either end.

        Args:
            psk: 32 bytes, the session key.
            prologue: data that both ends must have in common.
            ephemeral: the key of a test vector, or None for a new key.

        Raises:
            ValueError: the psk is not 32 bytes long.
        """
        if len(psk) != KEY_LENGTH:
            raise ValueError(Misuse.SESSION_KEY_LENGTH(expected=KEY_LENGTH, length=len(psk)))
        self._suite = suite
        self._ephemeral = ephemeral or X25519PrivateKey.generate()
        self._written = False
        self._remote: bytes | None = None
        name = _NOISE_NAMES[suite]
        # Noise, 5.2. The one suite's name is exactly as long as a hash, and the other's is longer.
        self._h = name.ljust(_HASH_LENGTH, b"\0") if len(name) <= _HASH_LENGTH else hashlib.sha256(name).digest()
        self._ck = self._h
        self._k = b""
        self._mix_hash(prologue)
        self._mix_key_and_hash(psk)

    def write(self, payload: bytes) -> bytes:
        """Return this end's message: its ephemeral key, then the payload sealed."""
        public = self._ephemeral.public_key().public_bytes_raw()
        self._mix_hash(public)
        self._mix_key(public)
        if self._remote is not None:
            self._mix_key(self._dh(self._remote))
        self._written = True
        sealed = Sealer(self._suite, self._k).seal(payload, self._h)
        self._mix_hash(sealed)
        return public + sealed

    def read(self, message: bytes) -> bytes:
        """Return the payload of the other end's message.

        Raises:
            SealError: the other end has another key.
            ProtocolError: the message is invalid.
        """
        if len(message) < _DH_LENGTH + self._suite.tag_length:
            raise ProtocolError(Broken.HANDSHAKE_TOO_SHORT(length=len(message)))
        self._remote, sealed = message[:_DH_LENGTH], message[_DH_LENGTH:]
        self._mix_hash(self._remote)
        self._mix_key(self._remote)
        if self._written:
            self._mix_key(self._dh(self._remote))
        payload = StreamOpener(self._suite, self._k).open(sealed, self._h)
        self._mix_hash(sealed)
        return payload

    def split(self) -> HandshakeKeys:
        """Return the control keys, and a third output of the same HKDF, from which data keys are derived.

        The handshake forgets its secrets, because the connection keeps it.
        """
        keys = HandshakeKeys(*_hkdf(self._ck, b""))
        self._ck = self._k = b""
        del self._ephemeral
        return keys

    def _dh(self, remote: bytes) -> bytes:
        try:
            return self._ephemeral.exchange(X25519PublicKey.from_public_bytes(remote))
        except ValueError:  # a point of low order: the secret would be all zeros
            raise ProtocolError(Broken.EPHEMERAL_KEY_INVALID()) from None

    def _mix_hash(self, data: bytes) -> None:
        self._h = hashlib.sha256(self._h + data).digest()

    def _mix_key(self, material: bytes) -> None:
        self._ck, self._k, _ = _hkdf(self._ck, material)

    def _mix_key_and_hash(self, material: bytes) -> None:
        self._ck, mixed, self._k = _hkdf(self._ck, material)
        self._mix_hash(mixed)


Handshake: TypeAlias = PlainHandshake | NoiseHandshake
"""One end of a handshake of two messages: the client writes then reads, the server reads then writes."""


def handshake_of(suite: CipherSuite, key: bytes | None, prologue: bytes) -> Handshake:
    """Return one end of a handshake, which seals nothing without a key."""
    return PlainHandshake() if key is None else NoiseHandshake(suite, key, prologue)


def _hkdf(chaining_key: bytes, material: bytes) -> tuple[bytes, bytes, bytes]:
    """HKDF of section 4.3 with three outputs, of which the first two equal HKDF with two."""
    temporary = hmac.digest(chaining_key, material, "sha256")
    first = hmac.digest(temporary, b"\x01", "sha256")
    second = hmac.digest(temporary, first + b"\x02", "sha256")
    return first, second, hmac.digest(temporary, second + b"\x03", "sha256")


class ReplayCache:
    """A client's newest first messages that opened under its key."""

    def __init__(self) -> None:
        self._seen: deque[bytes] = deque(maxlen=_MOST_REPLAYS)

    def is_new(self, message: bytes) -> bool:
        """Remember a first message; returns False where it came before."""
        ephemeral = message[:_DH_LENGTH]  # random bytes: the sender's ephemeral key
        if ephemeral in self._seen:
            return False
        self._seen.append(ephemeral)
        return True


class Credential(NamedTuple):
    """The proof that a client or an operator of a certain name owes."""

    keys: tuple[bytes, ...]  # 32 bytes each, of which it must have one, or empty without encryption
    replays: ReplayCache  # remembers its first messages under all keys


class SealedStream(PreambleStream):
    """Either end: sealed frames after the handshake.

    Args:
        header: precedes the sealed content of each frame, and is authenticated with it.
        limit: bytes of a frame.

    Attributes:
        sample_secret: the secret of the stream's sample tags, or None before the handshake or without encryption.
    """

    def __init__(self, header: bytes, limit: int) -> None:
        super().__init__()
        self._header = header
        self._frames = FrameReader(limit)
        self._sealer: Sealer | None = None
        self._opener: StreamOpener | None = None
        self.sample_secret: bytes | None = None

    def _start_sealing(self, suite: CipherSuite, keys: HandshakeKeys) -> None:
        sending, receiving = (keys.server, keys.client) if self._is_server else (keys.client, keys.server)
        self._sealer, self._opener = Sealer(suite, sending), StreamOpener(suite, receiving)
        self._phase = PreamblePhase.SEALED
        if keys.export is not None:
            self.sample_secret = derive_sample_secret(keys.export)

    def _seal(self, content: Buffer) -> bytes:
        if self._sealer is None:
            raise RuntimeError(Misuse.NOT_ESTABLISHED())
        return pack_frame(self._header, self._sealer.seal(content, self._header))

    def _open(self, frame: Buffer) -> bytes:
        assert self._opener is not None
        return self._opener.open(frame[len(self._header) :], self._header)

    def _take_in(self, data: Buffer) -> None:
        super()._take_in(data)
        if self._phase is PreamblePhase.SEALED:
            self._open_frames()

    def _open_frames(self) -> None:
        for frame in self._frames.feed(self.leftover()):
            if frame[: len(self._header)] == self._header:
                self._on_content(self._open(frame))
            else:
                self._on_other_frame(frame)
                if self._phase is not PreamblePhase.SEALED:  # it was a REFUSE, which ends the stream
                    return

    @abstractmethod
    def _on_content(self, content: bytes) -> None:
        """Take the content of a sealed frame."""

    def _on_other_frame(self, frame: memoryview) -> None:
        """Take a frame with another header."""
        raise ProtocolError(Broken.UNEXPECTED_ON_CONTROL(header=bytes(frame[: len(self._header)]).hex(" ")))


class ConnectingStream(SealedStream):
    """The end that sends the first message.

    Attributes:
        proven: whether the server has proven that it has the key, and all that came is authentic.
        at: the server's address in a Zenoh network, as it says, or an empty string.
    """

    def __init__(self, header: bytes, limit: int) -> None:
        super().__init__(header, limit)
        self._handshake: Handshake  # from the first message on
        self.proven = False
        self.at = ""

    def fork(self) -> Self:
        """Return a copy to take one of several answers to the first message, which strangers may answer, too."""
        other = copy.copy(self)
        other._inbox, other._outbox, other._events = bytearray(), bytearray(), []
        other._handshake = copy.copy(self._handshake)
        return other

    def _first_message(self, suite: CipherSuite, key: bytes | None, header: bytes, payload: bytes) -> bytes:
        self._handshake = handshake_of(suite, key, header)
        return pack_frame(header, self._handshake.write(payload))

    def _on_preamble(self, kind: PreambleKind, body: bytes, frame: bytes) -> None:
        match kind:
            case PreambleKind.ACCEPT:
                self._on_accept(body)
            case PreambleKind.REFUSE:
                self._refused_by_peer(body)
            case _:
                raise ProtocolError(Broken.UNEXPECTED_IN_PREAMBLE(kind=kind.name))

    @abstractmethod
    def _on_accept(self, message: bytes) -> None:
        """Take the server's handshake message."""

    def _read_answer(self, message: bytes, wrong_key: str) -> bytes:
        try:
            return self._handshake.read(message)
        except SealError:
            raise Refusal(RefusalCode.WRONG_KEY, wrong_key) from None

    def _establish(self, suite: CipherSuite) -> HandshakeKeys:
        """Seal from now on, and confirm the handshake, which a replay of a recorded first message can't do."""
        keys = self._handshake.split()
        self._start_sealing(suite, keys)
        self._outbox += self._seal(b"")
        return keys

    def _end(self, event: Event) -> None:
        if isinstance(event, Failed):
            self.proven = False  # somebody may have added bytes to the answer of the server
        super()._end(event)


class AcceptingStream(SealedStream):
    """The end that receives the first message.

    Args:
        header: as in `SealedStream`.
        limit: as in `SealedStream`.
        peer: the other end's role.
        identity: the credential for a name, which is not authenticated yet; may raise `Refusal`.

    Attributes:
        name: given by the other end, and not authenticated before it has confirmed the handshake.
    """

    _is_server = True

    def __init__(self, header: bytes, limit: int, peer: str, identity: Callable[[str], Credential]) -> None:
        super().__init__(header, limit)
        self.name = ""
        self._peer = peer
        self._identity = identity
        self._unconfirmed: Event | None = None  # the outcome once the other end has confirmed

    @property
    def accepted(self) -> bool:
        """Whether the first message opens under the key. Somebody may have recorded and sent it again."""
        return self._phase is PreamblePhase.SEALED

    def refuse(self, code: RefusalCode, message: str) -> bytes:
        """Refuse the stream: the bytes to write before closing it."""
        self._phase = PreamblePhase.OVER
        self._refuse(code, message)
        return self.data_to_send()

    def _read_first(self, handshake: Handshake, message: bytes) -> bytes:
        try:
            return handshake.read(message)
        except SealError:
            raise Refusal(RefusalCode.WRONG_KEY, RefusalText.FIRST_MESSAGE_FORGED(name=self.name)) from None

    def _check_new(self, replays: ReplayCache, message: bytes) -> None:
        if not replays.is_new(message):
            raise ProtocolError(Broken.HANDSHAKE_REPLAYED(name=self.name))

    def _accept(self, suite: CipherSuite, keys: HandshakeKeys, answer: bytes, outcome: Event) -> None:
        """Answer a first message that opens. What it says counts once the other end has confirmed."""
        self._outbox += pack_frame(preamble_frame(PreambleKind.ACCEPT, answer))
        self._start_sealing(suite, keys)
        self._unconfirmed = outcome

    def _open_frames(self) -> None:
        if self._unconfirmed is not None and not self._take_confirmation(self._unconfirmed):
            return
        if self._phase is PreamblePhase.SEALED:
            super()._open_frames()

    def _take_confirmation(self, outcome: Event) -> bool:
        """Take the first sealed frame. Until then the peer may be anybody: it gets the room of a preamble frame."""
        try:
            frame = take_frame(self._inbox)
        except ForeignProtocolError:  # a long frame, and not of another program: this peer knows the preamble
            raise ProtocolError(Broken.NOT_CONFIRMED(peer=self._peer)) from None
        if frame is None:
            return False
        if not frame.startswith(self._header) or self._open(frame):  # or it has content
            raise ProtocolError(Broken.NOT_CONFIRMED(peer=self._peer))
        self._unconfirmed = None
        if isinstance(outcome, StreamRefused):
            self._end(outcome)
        else:
            self._events.append(outcome)
        return True
