"""The kinds of field that control messages have, each with its bounds (PROTOCOL.md, 3).

Text ends up in terminals and logs, so it is short, and prints as it reads.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from rsb_bridge.model.limits import PORT, RATE, REASON_LENGTH, STALE_AFTER, TEXT_LENGTH

# Control characters, and the marks that turn the direction of text.
_UNPRINTABLE = "\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069"
_PLAIN = rf"\A[^{_UNPRINTABLE}]*\Z"

Name: TypeAlias = Annotated[str, Meta(max_length=TEXT_LENGTH, pattern=_PLAIN)]
Words: TypeAlias = Annotated[str, Meta(max_length=REASON_LENGTH, pattern=_PLAIN)]

RouteId: TypeAlias = Annotated[int, Meta(ge=1, le=2**32 - 1)]
LinkId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Port: TypeAlias = Annotated[int, Meta(ge=0, le=int(PORT.high))]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
Hertz: TypeAlias = Annotated[float, Meta(ge=0, le=RATE.high)]
StaleAfter: TypeAlias = Annotated[float, Meta(ge=0, le=STALE_AFTER.high)]
Causes: TypeAlias = Annotated[dict[Name, int], Meta(max_length=32)]
Features: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=32)]

Transport = Literal["tcp", "udp", "bluetooth"]
Compression = Literal["none", "zstd"]
RefuseCode = Literal["no_such_type", "type_differs", "denied", "port_taken", "bad_request"]


def plain(text: str, limit: int = REASON_LENGTH) -> str:
    """A text made fit: what does not print becomes U+FFFD, what is too long is cut."""
    return re.sub(f"[{_UNPRINTABLE}]", "\N{REPLACEMENT CHARACTER}", text[:limit])
