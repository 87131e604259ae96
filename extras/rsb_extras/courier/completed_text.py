"""What a completed recording has and misses, in words."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_console.notation.formats import byte_count
from rsb_extras.courier.completed_recording import ClockSource, MissingReason
from rsb_extras.courier.courier_records import has_date

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_extras.courier.completed_recording import CompletedClock, CompletedRecording, CompletedTopic, MissingSpan


class CompletedText(Wording):
    BYTES = "{fetched} of {whole} of messages over there were missing here, and are fetched"
    CLOCK = "times are of this side's clock: those of the other side {sign}{seconds:.6f} s, by {source}"
    BY_MESSAGES = "{count:,} messages (within {spread:.6f} s)"
    BY_LINK = "the link's measurement, as no message came live"
    BY_NOTHING = "nothing: no message came live, and the link has not measured it"
    NAMES = "{here} ({there} over there)"
    TOPIC = "{name}: {live:,} live, {fetched:,} fetched, {missing:,} in neither recording"
    GAP = "  {begin} to {end}: {messages}{reason}"
    COUNT = "{count:,} messages, "
    MORE = "  {count:,} more, shorter ones"


_REASONS = {
    MissingReason.BEGINS_LATER: "the other side's recording begins later",
    MissingReason.ENDS_EARLIER: "the other side's recording ends earlier",
    MissingReason.NOT_RECORDED: "the other side's recording has no such topic",
    MissingReason.DENIED: "the other side's session does not let this side read it",
    MissingReason.LOST: "the other side's recording has lost them",
    MissingReason.DAMAGED: "the other side's recording is damaged there",
    MissingReason.NOT_GIVEN: "the other side did not send them",
}


def completed_lines(completed: CompletedRecording) -> Iterator[str]:
    """Yield the lines that tell what is in the file, and what is missing and why."""
    yield from summary_texts(completed)
    for topic in completed.topics:
        figures = {"live": topic.live, "fetched": topic.fetched, "missing": topic.missing}
        yield CompletedText.TOPIC(name=topic_name(topic), **figures)
        yield from gap_texts(topic)


def summary_texts(completed: CompletedRecording) -> Iterator[str]:
    """Yield how much was fetched, and how times became times of this side."""
    fetched, whole = byte_count(completed.fetched), byte_count(completed.whole)
    yield CompletedText.BYTES(fetched=fetched, whole=whole)
    yield _clock(completed.clock)


def topic_name(topic: CompletedTopic) -> str:
    return topic.name if topic.name == topic.there else CompletedText.NAMES(here=topic.name, there=topic.there)


def gap_texts(topic: CompletedTopic) -> Iterator[str]:
    """Yield when messages of a topic are missing, and why."""
    for gap in topic.gaps:
        yield _of_gap(gap)
    if topic.more_gaps:
        yield CompletedText.MORE(count=topic.more_gaps)


def _clock(clock: CompletedClock) -> str:
    if clock.source is ClockSource.MESSAGES:
        source = CompletedText.BY_MESSAGES(count=clock.matched, spread=clock.spread / 1e9)
    else:
        source = CompletedText.BY_LINK() if clock.source is ClockSource.LINK else CompletedText.BY_NOTHING()
    return CompletedText.CLOCK(sign="-" if clock.offset < 0 else "+", seconds=abs(clock.offset) / 1e9, source=source)


def _of_gap(gap: MissingSpan) -> str:
    messages = "" if gap.messages is None else CompletedText.COUNT(count=gap.messages)
    begin, end = _date(gap.begin), _date(gap.end)
    return CompletedText.GAP(begin=begin, end=end, messages=messages, reason=_REASONS[gap.reason])


def _date(time: int) -> str:
    moment = datetime.fromtimestamp(time / 1e9) if has_date(time) else None
    return "any time" if moment is None else moment.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]
