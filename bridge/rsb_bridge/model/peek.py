"""A message that somebody looks at."""

from __future__ import annotations

from dataclasses import dataclass

PEEK_LIMIT = 1 << 20
"""Bytes of a message that are shown: a whole map, and the beginning of a large picture."""


@dataclass(frozen=True, slots=True)
class PeekedMessage:
    """A message of a route, as it passed this side.

    Attributes:
        payload: the serialized message with its encapsulation header; of a longer one, the first `PEEK_LIMIT` bytes.
        size: bytes of the whole message.
        type_name: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``, or empty.
        time: s since the epoch on this machine's clock, when DDS received it (sending side), or when it came over the
            link (receiving side).
        outgoing: this side sends it.
        is_kept: it is a latched topic's message of before, as a late joiner gets it; `time` is when it was asked for.
        latency: s that it took over the link, as the clock offset says; None: it is not known, or this side sends it.
        clock_offset: s, the peer's clock minus this machine's; None: it is not known.
        clock_uncertainty: s.
    """

    payload: bytes
    size: int
    type_name: str
    type_hash: str
    time: float
    outgoing: bool
    is_kept: bool = False
    latency: float | None = None
    clock_offset: float | None = None
    clock_uncertainty: float | None = None
