"""Fingerprints: the public names of keys, which operators compare on both sides."""

from __future__ import annotations

import hashlib

FINGERPRINT_LENGTH = 8  # bytes; of the protocol (PROTOCOL.md, 1.1). Two operators compare them by eye or by voice


def fingerprint_of(secret: bytes) -> bytes:
    """Return a key's public name, which operators compare on both sides: the beginning of its SHA-256."""
    return hashlib.sha256(secret).digest()[:FINGERPRINT_LENGTH]


def format_fingerprint(fingerprint: bytes) -> str:
    """Return 16 hexadecimal digits in groups of four, or an empty string for zeros, which mean no key."""
    digits = fingerprint.hex()
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4)) if any(fingerprint) else ""
