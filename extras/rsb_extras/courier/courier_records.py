"""Recordings, and places in them, as the two sides of a link and consoles name them; their types have bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Protocol, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import Count, Name, Reason
from rsb_bridge.wire.records import Nanoseconds

if TYPE_CHECKING:
    from collections.abc import Iterable

MOST_TOPICS = 256
"""Of a recording that is listed or got at once. A round figure: a large robot has some 200."""
MOST_SPANS = 4096
"""Of an order. A round figure: 32 kB of control messages, each as long as the head of a message that it asks for."""
MOST_RECORDINGS = 512
"""Of a side; the newest ones. A round figure."""
PAGE = 16
"""The most recordings of an answer."""
LATEST = (1 << 63) - 1
MARGIN = 120 * 1_000_000_000
"""ns before and after a recording in which those of this side complete it, too: a message may be late, and clocks
differ. A round figure."""
_LAST_DATE = 4_000_000_000_000_000_000
"""ns since the epoch, 2096: what comes later has no date on every machine."""

RecordingId: TypeAlias = Annotated[str, Meta(max_length=16, pattern=r"\A[0-9a-f]{16}\Z")]
"""Made by the side that has the recording, of its folder and its name: what a peer names never becomes a path."""
TopicNames: TypeAlias = Annotated[tuple[Name, ...], Meta(max_length=MOST_TOPICS)]


class ListedTopic(msgspec.Struct, frozen=True, omit_defaults=True, array_like=True):
    name: Name
    type_name: Name = ""
    messages: Count = 0


class ListedRecording(msgspec.Struct, frozen=True, omit_defaults=True):
    """A recording of one side.

    Attributes:
        name: of the file or the folder.
        stamp: of its files' sizes, times and beginnings: another one is another recording.
        size: bytes of its files.
        begin: when its first message was recorded (ns since the epoch on the clock of that side), or 0 if unknown.
        topics: those that the asker may read; without their number of messages where that is unknown.
        more_topics: how many more there are.
        cause: why it was kept, or empty.
        note: of an operator, or of what kept it.
        problem: why not all of this is known, or empty.
    """

    id: RecordingId
    name: Name
    stamp: RecordingId
    size: Count = 0
    begin: Nanoseconds = 0
    end: Nanoseconds = 0
    messages: Count = 0
    topics: Annotated[tuple[ListedTopic, ...], Meta(max_length=MOST_TOPICS)] = ()
    more_topics: Count = 0
    cause: Name = ""
    note: Name = ""
    problem: Reason = ""


class Cursor(msgspec.Struct, frozen=True, array_like=True, order=True):
    """A place in the messages of a recording that are asked for, in their order.

    Attributes:
        time: of the message (ns since the epoch).
        had: messages of that time before it.
        offset: bytes of it that come before the place (`rsb_extras.courier.pieces`).
    """

    time: Nanoseconds = 0
    had: Count = 0
    offset: Count = 0


class WantedSpan(msgspec.Struct, frozen=True, array_like=True):
    """Messages of one topic that follow each other.

    Attributes:
        topic: its place in `Wanted.topics`.
        after: ns from the begin of the span before, or of all that is wanted.
        length: ns from the first message to the last.
    """

    topic: Annotated[int, Meta(ge=0, lt=MOST_TOPICS)]
    after: Nanoseconds
    length: Nanoseconds = 0


class Wanted(msgspec.Struct, frozen=True, omit_defaults=True):
    """Some messages of a recording.

    Attributes:
        topics: their names, in any order.
        begin: ns since the epoch, the first time that counts, and `end` the last one.
        heads: whether a `rsb_extras.courier.picking.head_of` stands in place of each content.
        spans: the only ones that count, by their begins, or none if all do.
    """

    recording: RecordingId
    stamp: RecordingId
    topics: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=MOST_TOPICS)]
    begin: Nanoseconds = 0
    end: Nanoseconds = LATEST
    heads: bool = False
    spans: Annotated[tuple[WantedSpan, ...], Meta(max_length=MOST_SPANS)] = ()


def has_date(time: int) -> bool:
    """Whether a time (ns since the epoch) may be shown as a date: 0 is an unknown one."""
    return 0 < time < _LAST_DATE


class _Named(Protocol):
    @property
    def id(self) -> str: ...

    @property
    def name(self) -> str: ...


NamedT = TypeVar("NamedT", bound=_Named)


def called(name: str, recordings: Iterable[NamedT]) -> list[NamedT]:
    """Return those that an operator may mean: of this id, else of this name, else whose names begin with it."""
    known = [*recordings]
    return (
        [each for each in known if each.id == name]
        or [each for each in known if each.name == name]
        or [each for each in known if name and each.name.startswith(name)]
    )
