"""The kinds of field that control messages have, each with its bounds (PROTOCOL.md, 3).

Text ends up in terminals and logs, so it is short, and prints as it reads.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

NAME_LIMIT = 255
WORDS_LIMIT = 500

# Control characters, and the marks that turn the direction of text.
_UNPRINTABLE = "\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069"
_PLAIN = rf"\A[^{_UNPRINTABLE}]*\Z"

Name: TypeAlias = Annotated[str, Meta(max_length=NAME_LIMIT, pattern=_PLAIN)]
Words: TypeAlias = Annotated[str, Meta(max_length=WORDS_LIMIT, pattern=_PLAIN)]

RouteId: TypeAlias = Annotated[int, Meta(ge=1, le=2**32 - 1)]
LinkId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Port: TypeAlias = Annotated[int, Meta(ge=0, le=65535)]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
LOWEST_RATE, HIGHEST_RATE = 0.001, 1e6  # Hz
Hertz: TypeAlias = Annotated[float, Meta(ge=0, le=HIGHEST_RATE)]
Causes: TypeAlias = Annotated[dict[Name, int], Meta(max_length=32)]
Features: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=32)]

DEEPEST = 100_000
"""Messages; what a receiver keeps for late joiners is bounded further (`rsb_bridge.route.incoming`)."""

Transport = Literal["tcp", "udp", "bluetooth"]
Compression = Literal["none", "zstd"]
RefuseCode = Literal["no_such_type", "type_differs", "denied", "port_taken", "bad_request"]


def plain(text: str, limit: int = WORDS_LIMIT) -> str:
    """A text made fit: what does not print becomes U+FFFD, what is too long is cut."""
    return re.sub(f"[{_UNPRINTABLE}]", "\N{REPLACEMENT CHARACTER}", text[:limit])
