"""What it takes to complete what came live by a recording of the other side, and what comes of it."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import Count, Name
from rsb_bridge.wire.records import Nanoseconds
from rsb_extras.courier.courier_records import LATEST, MOST_TOPICS

MOST_GAPS = 8
"""Gaps of a topic that are listed. A round figure: the longest ones."""


class CompletedName(msgspec.Struct, frozen=True, array_like=True):
    """A topic by its names on both sides.

    Attributes:
        comes: whether its messages come from the other side, or go there.
    """

    there: Name
    here: Name
    comes: bool = True


class AskedCompletion(msgspec.Struct, frozen=True):
    """What is completed.

    Attributes:
        topics: in the order of `Wanted.topics`.
        begin: ns since the epoch on the other side's clock, the first time that counts, and `end` the last one.
        is_open: whether the span goes on as far as what came live.
        ahead: s by which the other side's clock is ahead, as the link has measured it, or None.
        live: the recording of this side, as an operator named it, or empty for all that this bridge has.
    """

    topics: tuple[CompletedName, ...]
    begin: Nanoseconds = 0
    end: Nanoseconds = LATEST
    is_open: bool = False
    ahead: float | None = None
    live: str = ""


class MissingReason(StrEnum):
    """Why messages are missing."""

    BEGINS_LATER, ENDS_EARLIER = "begins later", "ends earlier"
    NOT_RECORDED, DENIED = "not recorded", "denied"
    LOST, DAMAGED, NOT_GIVEN = "lost", "damaged", "not given"


class MissingSpan(msgspec.Struct, frozen=True):
    """A time in which messages are missing that neither side has.

    Attributes:
        begin, end: ns since the epoch.
        messages: how many, or None if nobody knows.
    """

    reason: MissingReason
    begin: Nanoseconds
    end: Nanoseconds
    messages: Count | None = None


class CompletedTopic(msgspec.Struct, frozen=True):
    """A topic of the file.

    Attributes:
        name: on this side.
        there: on the other side.
        live: messages that came live; of these, `only_live` are not in the other side's recording.
        missing: messages that neither side has, as far as numbers show it.
        gaps: the longest ones; `more_gaps` are not listed.
    """

    name: Name
    there: Name
    live: Count = 0
    only_live: Count = 0
    fetched: Count = 0
    missing: Count = 0
    gaps: Annotated[tuple[MissingSpan, ...], Meta(max_length=MOST_GAPS)] = ()
    more_gaps: Count = 0


class ClockSource(StrEnum):
    MESSAGES, LINK, NONE = "messages", "link", "none"


class CompletedClock(msgspec.Struct, frozen=True):
    """How times of the other side became times of this side.

    Attributes:
        offset: ns that were added to them: what its clock is behind, and the shortest time on the way.
        matched: messages that show it.
        spread: ns by which a quarter of these messages, the fastest ones, differ at most from the fastest tenth.
    """

    source: ClockSource
    offset: int = 0
    matched: Count = 0
    spread: Count = 0


class CompletedRecording(msgspec.Struct, frozen=True):
    """What is in the file, and what is missing. All times are of this side's clock.

    Attributes:
        fetched: bytes of the messages that were fetched.
        whole: bytes of all wanted messages of the other side's recording.
    """

    clock: CompletedClock
    topics: Annotated[tuple[CompletedTopic, ...], Meta(max_length=MOST_TOPICS)]
    fetched: Count = 0
    whole: Count = 0
