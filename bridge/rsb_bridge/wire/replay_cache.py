"""Which first messages of the handshake came before: who sends one again has only recorded it (PROTOCOL.md, 1.2)."""

from __future__ import annotations

from collections import deque

_MOST = 512
_EPHEMERAL_LENGTH = 32
"""Bytes at a first message's beginning that its sender chooses anew each time (X25519)."""


class ReplayCache:
    """A client's newest first messages that opened under its key."""

    def __init__(self) -> None:
        self._seen: deque[bytes] = deque(maxlen=_MOST)

    def is_new(self, message: bytes) -> bool:
        """Remember a first message; returns False where it came before."""
        ephemeral = message[:_EPHEMERAL_LENGTH]
        if ephemeral in self._seen:
            return False
        self._seen.append(ephemeral)
        return True
