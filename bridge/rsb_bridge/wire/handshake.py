"""The handshake: Noise_NNpsk0_25519 over the session key (Noise specification, revision 34; PROTOCOL.md, 1.2)."""

from __future__ import annotations

import hashlib
import hmac
from collections import deque
from typing import NamedTuple, TypeAlias

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from rsb_bridge.wire.protocol_error import Broken, Misuse, ProtocolError
from rsb_bridge.wire.sealing import KEY_LENGTH, CipherSuite, Sealer, StreamOpener

_NAMES = {
    CipherSuite.AESGCM: b"Noise_NNpsk0_25519_AESGCM_SHA256",
    CipherSuite.CHACHAPOLY: b"Noise_NNpsk0_25519_ChaChaPoly_SHA256",
}
_DH_LENGTH = 32
_HASH_LENGTH = 32


class HandshakeKeys(NamedTuple):
    """The keys that a handshake gives; all None without encryption.

    Attributes:
        client: 32 bytes; seals the control frames from client to server.
        server: 32 bytes; seals those from server to client.
        export: 32 bytes; data keys are derived from it.
    """

    client: bytes | None
    server: bytes | None
    export: bytes | None


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
        name = _NAMES[suite]
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


def _hkdf(chaining_key: bytes, material: bytes) -> tuple[bytes, bytes, bytes]:
    """HKDF of section 4.3 with three outputs, of which the first two equal HKDF with two."""
    temporary = hmac.digest(chaining_key, material, "sha256")
    first = hmac.digest(temporary, b"\x01", "sha256")
    second = hmac.digest(temporary, first + b"\x02", "sha256")
    return first, second, hmac.digest(temporary, second + b"\x03", "sha256")


_MOST = 512
"""A round figure: an older message is answered again, but a replay cannot confirm."""


class ReplayCache:
    """A client's newest first messages that opened under its key."""

    def __init__(self) -> None:
        self._seen: deque[bytes] = deque(maxlen=_MOST)

    def is_new(self, message: bytes) -> bool:
        """Remember a first message; returns False where it came before."""
        ephemeral = message[:_DH_LENGTH]  # random bytes: the sender's ephemeral key
        if ephemeral in self._seen:
            return False
        self._seen.append(ephemeral)
        return True
