"""Sealing: authenticated encryption by sequence number, key epochs, the replay window (PROTOCOL.md, 1.3 and 1.4)."""

from __future__ import annotations

import hmac
import struct
import zlib
from enum import IntEnum
from typing import TYPE_CHECKING, Literal, TypeAlias

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM, ChaCha20Poly1305
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.protocol_error import Misuse

if TYPE_CHECKING:
    from collections.abc import Iterable

Buffer: TypeAlias = bytes | bytearray | memoryview
Role = Literal["client", "server"]

KEY_LENGTH = 32
EPOCH_BITS = 20  # an epoch is 2**20 sequence numbers, far inside what one AES-GCM key may seal (NIST SP 800-38D, 8.3)
EPOCHS_AHEAD = 256
"""Epochs by which a datagram may be ahead of the newest authentic one: limits how many keys a forged one costs."""

PROBE_ROUTE = 0  # the route of the probes of a UDP path, which nobody proposes

_REKEY_SEQUENCE = 2**64 - 1  # Noise's nonce for REKEY (4.2), which no content has
_DIRECTIONS: dict[Role, int] = {"client": 0, "server": 1}


class CipherSuite(IntEnum):
    PLAIN = 0
    AESGCM = 1
    CHACHAPOLY = 2

    @property
    def tag_length(self) -> int:
        return 4 if self is CipherSuite.PLAIN else 16


class InvalidSeal(Wording):
    """The reasons why a seal does not open."""

    FORGED = "sequence {sequence} was not sealed with this key: damaged or forged"
    REPLAYED = "sequence {sequence} is replayed"
    TOO_LATE = "sequence {sequence} is {late} datagrams late: replayed, or delayed too long"
    EPOCH_TOO_FAR_AHEAD = "key epoch {epoch} is too far ahead"


class SealError(Exception):
    """A seal is invalid: forged, damaged, out of order or replayed; the message names the reason if it can."""


class _Checksum:
    """Takes the AEAD's place on a link without encryption: CRC-32 detects damage, but no attack."""

    def encrypt(self, nonce: bytes, data: Buffer, associated_data: Buffer) -> bytes:
        return b"".join((data, self._tag(nonce, data, associated_data)))  # `+` takes no views

    def decrypt(self, nonce: bytes, data: Buffer, associated_data: Buffer) -> bytes:
        content, tag = data[:-4], data[-4:]
        if tag != self._tag(nonce, content, associated_data):
            raise InvalidTag
        return bytes(content)

    def encrypt_into(self, nonce: bytes, data: Buffer, associated_data: Buffer, buf: memoryview) -> int:
        buf[:-4] = data
        buf[-4:] = self._tag(nonce, data, associated_data)
        return len(buf)

    def decrypt_into(self, nonce: bytes, data: Buffer, associated_data: Buffer, buf: memoryview) -> int:
        content, tag = data[:-4], data[-4:]
        if tag != self._tag(nonce, content, associated_data):
            raise InvalidTag
        buf[:] = content
        return len(buf)

    @staticmethod
    def _tag(nonce: bytes, data: Buffer, associated_data: Buffer) -> bytes:
        return zlib.crc32(data, zlib.crc32(associated_data, zlib.crc32(nonce))).to_bytes(4, "big")


_Cipher: TypeAlias = AESGCM | ChaCha20Poly1305 | _Checksum

_NONCES = {
    CipherSuite.PLAIN: struct.Struct(">Q").pack,
    CipherSuite.AESGCM: struct.Struct(">4xQ").pack,
    CipherSuite.CHACHAPOLY: struct.Struct("<4xQ").pack,
}


def _cipher(suite: CipherSuite, key: bytes | None) -> _Cipher:
    if suite is CipherSuite.PLAIN:
        return _Checksum()
    if key is None or len(key) != KEY_LENGTH:
        raise ValueError(Misuse.KEY_LENGTH(suite=suite.name, expected=KEY_LENGTH))
    return AESGCM(key) if suite is CipherSuite.AESGCM else ChaCha20Poly1305(key)


class _Epochs:
    """The ciphers of one key, one for each epoch; the next epoch's key is REKEY of this one's (Noise, 4.2)."""

    def __init__(self, suite: CipherSuite, key: bytes | None) -> None:
        self._suite = suite
        self._first = 0
        self._ciphers = [_cipher(suite, key)]

    def cipher(self, epoch: int) -> _Cipher:
        """Return the cipher of an epoch.

        Raises:
            SealError: the epoch is more than `EPOCHS_AHEAD` ahead of the oldest one kept.
        """
        ciphers = self._ciphers
        index = epoch - self._first
        if index > EPOCHS_AHEAD:
            raise SealError(InvalidSeal.EPOCH_TOO_FAR_AHEAD(epoch=epoch))
        while index >= len(ciphers):
            ciphers.append(self._rekeyed(ciphers[-1]))
        return ciphers[index]

    def forget_before(self, epoch: int) -> None:
        """Forget the keys of earlier epochs, so that nobody who takes over this process can open what they sealed."""
        del self._ciphers[: epoch - self._first]
        self._first = epoch

    def _rekeyed(self, cipher: _Cipher) -> _Cipher:
        nonce = _NONCES[self._suite](_REKEY_SEQUENCE)
        return _cipher(self._suite, cipher.encrypt(nonce, bytes(KEY_LENGTH), b"")[:KEY_LENGTH])


class _StreamState:
    """The common part of sealing and opening in order: the implied sequence number and its epoch's cipher."""

    def __init__(self, suite: CipherSuite, key: bytes | None) -> None:
        self.suite = suite
        self.sequence = 0
        self._nonce = _NONCES[suite]
        self._epochs = _Epochs(suite, key)
        self._epoch = 0
        self._current = self._epochs.cipher(0)

    def _enter_epoch(self, epoch: int) -> None:
        self._current = self._epochs.cipher(epoch)
        self._epochs.forget_before(epoch)
        self._epoch = epoch


class Sealer(_StreamState):
    """Seals in one direction under one key.

    Attributes:
        sequence: the next sequence number.
    """

    def seal(self, content: Buffer, associated: Buffer) -> bytes:
        """Seal under the next sequence number.

        Args:
            content: is encrypted and authenticated.
            associated: is authenticated only, and sent in the clear.

        Returns:
            The sealed content, `CipherSuite.tag_length` bytes longer.
        """
        sequence = self.sequence
        self.sequence = sequence + 1  # used up, also if sealing fails
        if sequence >> EPOCH_BITS != self._epoch:
            self._enter_epoch(sequence >> EPOCH_BITS)
        return self._current.encrypt(self._nonce(sequence), content, associated)

    def seal_into(self, content: Buffer, associated: Buffer, sealed: memoryview) -> None:
        """Seal as `seal`, into memory of exactly the sealed content's length."""
        # Written out, as in the opener: a function for the common part would run for each message.
        sequence = self.sequence
        self.sequence = sequence + 1
        if sequence >> EPOCH_BITS != self._epoch:
            self._enter_epoch(sequence >> EPOCH_BITS)
        self._current.encrypt_into(self._nonce(sequence), content, associated, sealed)


class StreamOpener(_StreamState):
    """Opens what a `Sealer` sealed, in order and, except after `skip_to`, without gaps.

    Attributes:
        sequence: the next sequence number.
    """

    def open(self, sealed: Buffer, associated: Buffer) -> bytes:
        """Open the next content.

        Raises:
            SealError: the peer did not seal this next; the stream can't be used any more.
        """
        sequence = self.sequence
        if sequence >> EPOCH_BITS != self._epoch:
            self._enter_epoch(sequence >> EPOCH_BITS)
        try:
            content = self._current.decrypt(self._nonce(sequence), sealed, associated)
        except InvalidTag:
            raise self._forged() from None
        self.sequence = sequence + 1
        return content

    def open_into(self, sealed: Buffer, associated: Buffer, content: memoryview) -> None:
        """Open as `open`, into memory of exactly the content's length, which holds garbage after an error."""
        sequence = self.sequence
        if sequence >> EPOCH_BITS != self._epoch:
            self._enter_epoch(sequence >> EPOCH_BITS)
        try:
            self._current.decrypt_into(self._nonce(sequence), sealed, associated, content)
        except InvalidTag:
            raise self._forged() from None
        self.sequence = sequence + 1

    def skip_to(self, sequence: int) -> None:
        """Go on with a later content: those before it are lost.

        Raises:
            SealError: it is not later, or more than an epoch ahead, which costs time and is never lost in one stream.
        """
        if sequence < self.sequence:
            raise SealError(InvalidSeal.REPLAYED(sequence=sequence))
        if (sequence >> EPOCH_BITS) - self._epoch > 1:
            raise SealError(InvalidSeal.EPOCH_TOO_FAR_AHEAD(epoch=sequence >> EPOCH_BITS))
        self.sequence = sequence

    def _forged(self) -> SealError:
        return SealError(InvalidSeal.FORGED(sequence=self.sequence))


class DatagramOpener:
    """Opens what a `Sealer` sealed, in any order, each number once.

    Only authentic datagrams move the replay window (RFC 4303, 3.4.3) and the epoch.

    Attributes:
        newest: the highest sequence number opened, or -1 if none was.
    """

    def __init__(self, suite: CipherSuite, key: bytes | None, window: int = 1024) -> None:
        self._nonce = _NONCES[suite]
        self._epochs = _Epochs(suite, key)
        self._current = self._epochs.cipher(0)
        self._window = window
        self._mask = (1 << window) - 1
        self._epoch = 0
        self.newest = -1
        self._seen = 0  # bit n: the n-th before the newest was received

    @property
    def missing(self) -> int:
        """The numbers of the window that are not opened: bit n is set for the n-th before the newest."""
        return ~self._seen & self._mask & ((1 << (self.newest + 1)) - 1 if self.newest < self._window else self._mask)

    def open(self, sequence: int, sealed: Buffer, associated: Buffer) -> bytes:
        """Open one datagram's content.

        Args:
            sequence: from the datagram; authenticated with it.
            associated: the data authenticated with the content.

        Raises:
            SealError: forged, damaged, replayed, or older than the window.
        """
        ahead = sequence - self.newest
        if ahead <= 0:
            if ahead <= -self._window:
                raise SealError(InvalidSeal.TOO_LATE(sequence=sequence, late=-ahead))
            if self._seen >> -ahead & 1:
                raise SealError(InvalidSeal.REPLAYED(sequence=sequence))
        epoch = sequence >> EPOCH_BITS
        cipher = self._current if epoch == self._epoch else self._epochs.cipher(epoch)
        try:
            content = cipher.decrypt(self._nonce(sequence), sealed, associated)
        except InvalidTag:
            raise SealError(InvalidSeal.FORGED(sequence=sequence)) from None
        if ahead <= 0:
            self._seen |= 1 << -ahead
            return content
        # Not shifted by more than the window: that would make an integer as long as the leap.
        self._seen = ((self._seen << ahead) & self._mask) | 1 if ahead < self._window else 1
        if epoch != self._epoch:
            self._epochs.forget_before(epoch - 1)  # datagrams of the last epoch may still come
            self._epoch, self._current = epoch, cipher
        self.newest = sequence
        return content


class ConnectionKeys:
    """The data keys of a link, one for each route and direction, derived from its handshake (PROTOCOL.md, 1.3).

    Each side's proposals advance a chain, one way. A key is handed out once and kept nowhere else. So nobody who takes
    over this process can derive the keys of earlier routes, or the earlier keys of a route that is open.

    Attributes:
        link_id: 8 bytes; names the link in preambles and datagrams.
        sample_secret: the secret of sample tags (`SampleTags`), or None without encryption.
    """

    def __init__(self, suite: CipherSuite, export: bytes | None, link_id: bytes) -> None:
        self.suite = suite
        self.link_id = link_id
        self.sample_secret = None if export is None else derive_sample_secret(export)
        self._chains: dict[Role, bytes | None] = {
            role: _expand(export, b"rsb chain", bytes((direction,))) for role, direction in _DIRECTIONS.items()
        }
        self._data: dict[tuple[int, Role], bytes | None] = {}
        self._attach = _expand(export, b"rsb attach")
        self._of_resumed = _expand(export, b"rsb resumed")
        self._derive(PROBE_ROUTE, export)

    def resumed(self, routes: Iterable[int]) -> None:
        """Derive the keys of the routes that resume on this connection of their association. Call it once."""
        for route in routes:
            self._derive(route, self._of_resumed)
        del self._of_resumed  # so that an attacker in this process cannot derive these keys again

    def proposed(self, route: int, proposer: Role) -> None:
        """Derive the keys of a route when its proposal is sent or received, in the order of the control stream."""
        chain = self._chains[proposer]
        self._derive(route, chain)
        self._chains[proposer] = _expand(chain, b"rsb next")

    def closed(self, route: int) -> None:
        """Forget the keys of a route that nobody has taken."""
        for role in _DIRECTIONS:  # a topic sends one way, so that nobody takes the other way's key
            self._data.pop((route, role), None)

    def route_sealer(self, route: int, sending_role: Role) -> Sealer:
        """Seals a route's data in one direction. There is only one, because a second would repeat nonces.

        Raises:
            ValueError: it was requested before, or the route was not proposed.
        """
        return Sealer(self.suite, self._take(route, sending_role))

    def stream_opener(self, route: int, sending_role: Role) -> StreamOpener:
        """Opens a route's data on a stream; `sending_role` is the peer's. Raises as `route_sealer`."""
        return StreamOpener(self.suite, self._take(route, sending_role))

    def datagram_opener(self, route: int, sending_role: Role) -> DatagramOpener:
        """Opens a route's datagrams; `sending_role` is the peer's. Raises as `route_sealer`."""
        return DatagramOpener(self.suite, self._take(route, sending_role))

    def attach_proof(self, header: bytes, stream: int) -> bytes:
        """Return a client's proof that a data stream is its own, over the preamble frame up to the proof."""
        return Sealer(self.suite, self._attach_key(stream)).seal(b"", header)

    def check_attach_proof(self, header: bytes, stream: int, proof: bytes) -> None:
        """Check a client's `attach_proof`.

        Raises:
            SealError: the proof is not this client's.
        """
        StreamOpener(self.suite, self._attach_key(stream)).open(proof, header)

    def _derive(self, route: int, secret: bytes | None) -> None:
        for role, direction in _DIRECTIONS.items():
            self._data[route, role] = _expand(secret, b"rsb data", struct.pack(">IB", route, direction))

    def _attach_key(self, stream: int) -> bytes | None:
        return _expand(self._attach, b"rsb stream", struct.pack(">I", stream))

    def _take(self, route: int, sending_role: Role) -> bytes | None:
        try:
            return self._data.pop((route, sending_role))
        except KeyError:
            raise ValueError(Misuse.NO_KEY_LEFT(route=route)) from None


def _expand(secret: bytes | None, label: bytes, info: bytes = b"") -> bytes | None:
    """Return HKDF-Expand of a secret, or None without encryption."""
    return None if secret is None else HKDFExpand(SHA256(), KEY_LENGTH, label + info).derive(secret)


TAG_LENGTH = 16
_NONCE = struct.Struct(">BxxxQ")


def derive_sample_secret(export: bytes) -> bytes:
    """Derive the secret of all tags of a link, or of an operator's connection, from its handshake."""
    return HKDFExpand(SHA256(), KEY_LENGTH, b"rsb samples").derive(export)


class SampleTags:
    """Both directions' tags of one stream.

    A nonce is the kind and the number of a sample. Two samples of one kind and number have the same content: data is
    numbered, a window's content is its number, and a stream ends once.

    Args:
        secret: of the link (`derive_sample_secret`).
        opener: this side opened the stream.
    """

    def __init__(self, secret: bytes, stream: str, *, opener: bool) -> None:
        opening, answering = (self._cipher(secret, stream, direction) for direction in (0, 1))
        self._sending, self._receiving = (opening, answering) if opener else (answering, opening)

    def tag(self, kind: int, number: int, payload: Buffer) -> bytes:
        """Return the tag of a sample that this side sends."""
        return self._sending.encrypt(_NONCE.pack(kind, number), b"", payload)

    def proves(self, kind: int, number: int, payload: Buffer, tag: bytes) -> bool:
        """Whether the peer sent the sample."""
        # Without a tag, a sample proves nothing: strangers' samples cost no cipher.
        expected = self._receiving.encrypt(_NONCE.pack(kind, number), b"", payload) if tag else b"-"
        return hmac.compare_digest(expected, tag)

    @staticmethod
    def _cipher(secret: bytes, stream: str, direction: int) -> ChaCha20Poly1305:
        info = b"rsb sample tags" + stream.encode() + bytes((direction,))
        return ChaCha20Poly1305(HKDFExpand(SHA256(), KEY_LENGTH, info).derive(secret))
