"""The types of control messages' fields, each with its bounds (PROTOCOL.md, 3).

Text goes to terminals and logs, so it is short and has printable characters only.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT
from rsb_bridge.model.limits import PORT, RATE, REASON_LENGTH, STALE_AFTER, TEXT_LENGTH
from rsb_bridge.model.sources import HOP_LENGTH, MOST_BRIDGES, MOST_HOPS
from rsb_bridge.model.text import UNPRINTABLE

_PRINTABLE = rf"\A[^{UNPRINTABLE}]*\Z"

Name: TypeAlias = Annotated[str, Meta(max_length=TEXT_LENGTH, pattern=_PRINTABLE)]
Reason: TypeAlias = Annotated[str, Meta(max_length=REASON_LENGTH, pattern=_PRINTABLE)]

RouteId: TypeAlias = Annotated[int, Meta(ge=1, le=2**32 - 1)]
DescriptionText: TypeAlias = Annotated[bytes, Meta(max_length=DESCRIPTION_LIMIT)]
PublisherId: TypeAlias = Annotated[bytes, Meta(min_length=16, max_length=16)]
MessageNumber: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
LinkId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Port: TypeAlias = Annotated[int, Meta(ge=0, le=int(PORT.high))]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
Hertz: TypeAlias = Annotated[float, Meta(ge=0, le=RATE.high)]
StaleAfter: TypeAlias = Annotated[float, Meta(ge=0, le=STALE_AFTER.high)]
Causes: TypeAlias = Annotated[dict[Name, int], Meta(max_length=32)]
Hop: TypeAlias = Annotated[str, Meta(min_length=1, max_length=HOP_LENGTH, pattern=_PRINTABLE)]
Hops: TypeAlias = Annotated[tuple[Hop, ...], Meta(min_length=1, max_length=MOST_HOPS)]
Bridges: TypeAlias = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=MOST_BRIDGES)]
NodeNames: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=16)]
Features: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=32)]

MOST_PUBLISHERS = 4096
"""Of one latched topic, in one message."""
PublisherIds: TypeAlias = Annotated[tuple[PublisherId, ...], Meta(max_length=MOST_PUBLISHERS)]
NewestNumbers: TypeAlias = Annotated[dict[PublisherId, MessageNumber], Meta(max_length=MOST_PUBLISHERS)]

Transport = Literal["tcp", "udp", "bluetooth"]
Compression = Literal["none", "zstd"]
RefuseCode = Literal["type_differs", "denied", "port_taken"]
