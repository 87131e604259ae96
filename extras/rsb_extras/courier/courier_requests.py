"""What a console asks an engine about recordings: lists, to get one, how that goes, and to give it up."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import TEXT_LENGTH, Command, Count, Effect, Name, Reason, Right, Seconds, sanitize_text
from rsb_bridge.wire.records import Nanoseconds, Share
from rsb_extras.courier.completed_recording import CompletedRecording
from rsb_extras.courier.courier_records import LATEST, MOST_RECORDINGS, ListedRecording, TopicNames

LISTED_WITHIN = 60.0
"""s in which the other side's recordings are listed: some pages over a thin link."""
_PATH = 4096
"""Characters of a path: Linux's PATH_MAX."""


class RecordingGroup(msgspec.Struct, frozen=True, omit_defaults=True):
    """The recordings of one side.

    Attributes:
        link: the link to it, or empty for this side.
        problem: why nothing is known of them, or empty.
        age: s since that side has listed them, or None if it has not.
    """

    link: Name = ""
    recordings: Annotated[tuple[ListedRecording, ...], Meta(max_length=MOST_RECORDINGS)] = ()
    problem: Reason = ""
    age: Seconds | None = 0.0


class FetchState(StrEnum):
    WAITING, FETCHING, WRITING, DONE, FAILED = "waiting", "fetching", "writing", "done", "failed"


class FetchReport(msgspec.Struct, frozen=True, omit_defaults=True):
    """How a fetch goes.

    Attributes:
        name: of the fetch, and of its file.
        link: from whose other side.
        share: how much of the span has come.
        taken: bytes that have come, as they crossed.
        rate: bytes/s lately.
        rest: s that it still takes at this rate, or None if nobody knows.
        path: of the file, once it is written.
        reason: why it waits or has failed, or empty.
        completes: whether it completes what came live.
        completed: what is in the file, of one that completes what came live and is done.
    """

    name: Name
    link: Name
    recording: Name
    state: FetchState
    share: Share = 0.0
    taken: Count = 0
    rate: Annotated[float, Meta(ge=0)] = 0.0
    rest: Seconds | None = None
    messages: Count = 0
    path: Annotated[str, Meta(max_length=_PATH)] = ""
    reason: Reason = ""
    completed: CompletedRecording | None = None
    completes: bool = False

    @property
    def is_over(self) -> bool:
        return self.state in (FetchState.DONE, FetchState.FAILED)


class ListRecordings(Command[tuple[RecordingGroup, ...]], frozen=True, tag="list_recordings"):
    """List the recordings of this side and of all links, without empty sides, or of one side."""

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    cancellable = True
    link: str = ""
    here: bool = False  # this side alone: no link is asked
    there: bool = False  # the other sides alone: no folder is looked through


class NewestRecordings(Command[tuple[RecordingGroup, ...]], frozen=True, tag="newest_recordings"):
    """Return the newest recordings of this side, and those with a cause of the other sides, the newest first.

    Nothing is asked of the other sides: it is what they have listed last. Topics are left out.

    Attributes:
        most: of each side.
    """

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    link: str = ""
    most: Annotated[int, Meta(ge=1, le=MOST_RECORDINGS)] = 16


class FetchRecording(Command[str], frozen=True, tag="fetch_recording"):
    """Get a recording of the other side of a link, or a part of it. The result is the name of the fetch.

    Attributes:
        recording: its id or its name.
        topics: those to get, or none for all.
        begin: ns since the epoch on the other side's clock, and `end` the last one that counts.
        completes: whether it completes what came live; topics then have their names of either side.
        live: the recording of this side that is completed, by its id or name, or empty for all that this bridge has.
    """

    always = Effect.HARMLESS  # a new file beside others
    is_of_links = True
    refreshes = False
    link: str
    recording: str
    topics: TopicNames = ()
    begin: Nanoseconds = 0
    end: Nanoseconds = LATEST
    completes: bool = False
    live: str = ""

    def checked(self, result: str) -> str:
        return sanitize_text(result, TEXT_LENGTH)


class ListFetches(Command[tuple[FetchReport, ...]], frozen=True, tag="list_fetches"):
    """Return how fetches go: those under way, and the last ones that have ended."""

    right = Right.LOOK
    is_of_links = True
    refreshes = False
    link: str = ""

    def checked(self, result: tuple[FetchReport, ...]) -> tuple[FetchReport, ...]:
        return tuple(msgspec.structs.replace(each, path=sanitize_text(each.path, _PATH)) for each in result)


class ReadCompleted(Command[CompletedRecording], frozen=True, tag="read_completed"):
    """Return what a recording of this side says that it completes, and what is missing.

    Attributes:
        recording: its id, its name, or the begin of its name.
    """

    right = Right.LOOK
    refreshes = False
    recording: str


class CancelFetch(Command[None], frozen=True, tag="cancel_fetch"):
    """Give up a fetch, and remove what has come."""

    always = Effect.LOSES
    is_of_links = True
    refreshes = False
    name: str
    link: str = ""
