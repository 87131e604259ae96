"""The types of control messages' fields, each with its bounds (PROTOCOL.md, 3).

Text goes to terminals and logs, so it is short and has printable characters only.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta, Struct

from rsb_bridge.cdr.description import DESCRIPTION_LIMIT
from rsb_bridge.model.limits import LATCHED_DEPTH, PORT, RATE, REASON_LENGTH, TEXT_LENGTH
from rsb_bridge.model.names import HOP_LENGTH, MOST_BRIDGES, MOST_HOPS
from rsb_bridge.model.pictures import TOPICS_AT_ONCE
from rsb_bridge.model.session import HIGHEST, LOWEST
from rsb_bridge.model.text import UNPRINTABLE
from rsb_bridge.model.topic_keys import TOPIC_KEYS
from rsb_bridge.model.wording import Wording

PRINTABLE = rf"\A[^{UNPRINTABLE}]*\Z"  # not `$`, which also matches before an end of line

Name: TypeAlias = Annotated[str, Meta(max_length=TEXT_LENGTH, pattern=PRINTABLE)]
Reason: TypeAlias = Annotated[str, Meta(max_length=REASON_LENGTH, pattern=PRINTABLE)]

RouteId: TypeAlias = Annotated[int, Meta(ge=1, le=2**32 - 1)]
DescriptionText: TypeAlias = Annotated[bytes, Meta(max_length=DESCRIPTION_LIMIT)]
PublisherId: TypeAlias = Annotated[bytes, Meta(min_length=16, max_length=16)]
MessageNumber: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
HistoryDepth: TypeAlias = Annotated[int, Meta(ge=0, le=LATCHED_DEPTH)]
LinkId: TypeAlias = Annotated[bytes, Meta(min_length=8, max_length=8)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53)]
Nanoseconds: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Shift: TypeAlias = Annotated[int, Meta(ge=-(2**62), le=2**62)]
Port: TypeAlias = Annotated[int, Meta(ge=0, le=int(PORT.high))]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e9)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
Hertz: TypeAlias = Annotated[float, Meta(ge=0, le=RATE.high)]
Causes: TypeAlias = Annotated[dict[Name, int], Meta(max_length=32)]
Rank: TypeAlias = Annotated[int, Meta(ge=LOWEST, le=HIGHEST)]
Hop: TypeAlias = Annotated[str, Meta(min_length=1, max_length=HOP_LENGTH, pattern=PRINTABLE)]
Hops: TypeAlias = Annotated[tuple[Hop, ...], Meta(min_length=1, max_length=MOST_HOPS)]
MaybeHops: TypeAlias = Annotated[tuple[Hop, ...], Meta(max_length=MOST_HOPS)]
Bridges: TypeAlias = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=MOST_BRIDGES)]
NodeNames: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=16)]
ViewedTopics: TypeAlias = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=TOPICS_AT_ONCE)]

MOST_PUBLISHERS = 4096
"""Of one latched topic, in one message."""
HistoryDepths: TypeAlias = Annotated[dict[PublisherId, HistoryDepth], Meta(max_length=MOST_PUBLISHERS)]
NewestNumbers: TypeAlias = Annotated[dict[PublisherId, MessageNumber], Meta(max_length=MOST_PUBLISHERS)]

RefuseCode = Literal["type_differs", "denied", "port_taken"]


class OutOfRange(Wording):
    """Limits of a route that are neither 0 nor in their range."""

    RATE = "a rate is 0 or {range} Hz"
    SPEED = "a {name} limit is {range} {unit}"
    SECONDS = "{name} is 0 or {range} s"


_CHECKED = tuple(
    (key.name, key.limits, OutOfRange.RATE if key.unit == "Hz" else OutOfRange.SECONDS)
    for key in TOPIC_KEYS.values()
    if key.limits and key.name != "timeout"
)
"""A timeout out of range is refused with the topic, and the link stays."""


def check_limits(message: Struct) -> None:
    """Check the limits of a route in a message, which are 0 or in a range, and those on velocities.

    Raises:
        ValueError: one is out of its range.
    """
    for name, limits, mistake in _CHECKED:
        value = getattr(message, name, None)
        if value and value not in limits:
            raise ValueError(mistake(name=name, range=limits))
    speeds = getattr(message, "limits", None)
    for name, _, allowed, unit in () if speeds is None else speeds.out_of_range:
        raise ValueError(OutOfRange.SPEED(name=name, range=allowed, unit=unit))
