"""Tags that prove that a sample of a Zenoh stream comes from the peer (PROTOCOL.md, 12).

Anybody in a Zenoh network may publish under any key. What a stream carries is sealed, but the kind and the number of a
sample are not: a stranger could end a stream by one forged sample. A tag authenticates the sample as a whole.
"""

from __future__ import annotations

import hmac
import struct
from typing import TYPE_CHECKING

from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

if TYPE_CHECKING:
    from rsb_bridge.wire.sealing import Buffer

FEATURE = "sample_tags"
"""The feature by which a side of a link tags its samples."""
TAG_LENGTH = 16
_KEY_LENGTH = 32
_NONCE = struct.Struct(">BxxxQ")


def derive_sample_secret(export: bytes) -> bytes:
    """Derive the secret of all tags of a link, or of an operator's connection, from its handshake."""
    return HKDFExpand(SHA256(), _KEY_LENGTH, b"rsb samples").derive(export)


class SampleTags:
    """Both directions' tags of one stream.

    A nonce is the kind and the number of a sample. Two samples of one kind and number have the same content: data is
    numbered, a window's content is its number, and a stream ends once.

    Args:
        secret: of the link (`derive_sample_secret`).
        stream: names the stream.
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
        expected = self._receiving.encrypt(_NONCE.pack(kind, number), b"", payload) if tag else b"-"
        return hmac.compare_digest(expected, tag)

    @staticmethod
    def _cipher(secret: bytes, stream: str, direction: int) -> ChaCha20Poly1305:
        info = b"rsb sample tags" + stream.encode() + bytes((direction,))
        return ChaCha20Poly1305(HKDFExpand(SHA256(), _KEY_LENGTH, info).derive(secret))
