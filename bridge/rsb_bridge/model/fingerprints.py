"""A key's fingerprint: what operators compare, and both sides may tell anybody."""

from __future__ import annotations

import hashlib

FINGERPRINT_LENGTH = 8
"""Bytes."""


def fingerprint_of(secret: bytes) -> bytes:
    """The beginning of a key's SHA-256."""
    return hashlib.sha256(secret).digest()[:FINGERPRINT_LENGTH]


def format_fingerprint(fingerprint: bytes) -> str:
    """16 hexadecimal digits, in fours; empty for one of zeros, which stands for no key."""
    digits = fingerprint.hex()
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4)) if any(fingerprint) else ""
