"""Long control messages as they come: a list of entries, each of which is decoded by itself, later.

A `Report` or `TopicList` of 1 MiB has 131,000 entries or 200,000 short texts, and takes the thread of all links up to
half a second to decode. All other messages have limits that keep them below a few milliseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeVar

import msgspec
from msgspec import Meta, Raw

from rsb_bridge.model.limits import ROUTES_PER_LINK

# msgspec resolves the annotations at run time
from rsb_bridge.wire.fields import Count
from rsb_bridge.wire.records import CallsReport, FullRecord, ReceivedReport, SentReport, TopicEntry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.wire.messages import Report
    from rsb_bridge.wire.questions import TopicList

_E = TypeVar("_E")

_Entries: TypeAlias = Annotated[tuple[Raw, ...], Meta(max_length=ROUTES_PER_LINK)]


class ReportParts(msgspec.Struct, frozen=True, tag_field="message", tag="report"):
    """A `rsb_bridge.wire.messages.Report` whose entries are not decoded."""

    sent: _Entries
    received: _Entries
    calls: _Entries = ()
    full: FullRecord | None = None


class TopicListParts(msgspec.Struct, frozen=True, tag_field="message", tag="topiclist"):
    """A `rsb_bridge.wire.questions.TopicList` whose entries are not decoded."""

    request: Count
    topics: tuple[Raw, ...]


_sent = msgspec.msgpack.Decoder(SentReport)
_received = msgspec.msgpack.Decoder(ReceivedReport)
_calls = msgspec.msgpack.Decoder(CallsReport)
_topic = msgspec.msgpack.Decoder(TopicEntry)


def report_entries(report: Report | ReportParts) -> Iterator[tuple[SentReport | ReceivedReport | CallsReport, int]]:
    """Yield the entries of a report, each decoded when it is asked for, with its bytes, or 0 if it was decoded before.

    Raises:
        msgspec.DecodeError: the next one is invalid.
    """
    yield from _decoded(report.sent, _sent)
    yield from _decoded(report.received, _received)
    yield from _decoded(report.calls, _calls)


def topic_entries(topics: TopicList | TopicListParts) -> Iterator[tuple[TopicEntry, int]]:
    """Yield the entries of a list of topics, as `report_entries` does."""
    yield from _decoded(topics.topics, _topic)


def _decoded(
    entries: tuple[_E, ...] | tuple[Raw, ...], decoder: msgspec.msgpack.Decoder[_E]
) -> Iterator[tuple[_E, int]]:
    for entry in entries:
        if isinstance(entry, Raw):
            content = memoryview(entry)
            yield decoder.decode(content), len(content)
        else:
            yield entry, 0
