"""The messages of a recording that a peer asks for: all of some topics, spans of them, or their heads."""

from __future__ import annotations

import heapq
import struct
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from rsb_extras.courier.pieces import HEAD
from rsb_extras.recording.reading.stored_message import StoredMessage, content_key

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from rsb_extras.courier.courier_records import Wanted
    from rsb_extras.recording.reading.open_recording import OpenRecording

_HEAD = struct.Struct("<qI")
HEADED = HEAD.size + _HEAD.size
"""Bytes of a message with its head in place of its content, before a piece is packed."""
_ISLANDS = 64
"""Parts of a recording that are looked for by their times for one order. A round figure: to look for one goes through
its index, so a peer must not ask for thousands."""
_WATER = 5_000_000_000  # ns without a wanted message that are skipped, not read. A round figure: some chunks


class HeadError(ValueError):
    """It is no head of a message."""


class MessageHead(NamedTuple):
    """What stands in place of a message's content.

    Attributes:
        key: its `content_key`.
        size: bytes of the content.
    """

    key: int
    size: int


def head_of(message: StoredMessage) -> StoredMessage:
    """Return a message with its head in place of its content."""
    key = content_key(message.content, is_cdr=message.channel.encoding == "cdr")
    return message._replace(content=memoryview(_HEAD.pack(key, len(message.content))))


def read_head(message: StoredMessage) -> MessageHead:
    """Read what `head_of` wrote; raises `HeadError`."""
    if len(message.content) != _HEAD.size:
        raise HeadError
    return MessageHead(*_HEAD.unpack(message.content))


def picked(recording: OpenRecording, wanted: Wanted, topics: Collection[str], at: int) -> Iterator[StoredMessage]:
    """Yield the wanted messages in their order, of these topics and from a time on (ns since the epoch).

    Raises:
        RecordingError: as `OpenRecording.messages`.
    """
    if wanted.spans:
        found = _of_spans(recording, wanted, topics, at)
    else:
        found = recording.messages(topics=frozenset(topics), begin=max(wanted.begin, at), end=wanted.end + 1)
    return map(head_of, found) if wanted.heads else found


def _of_spans(recording: OpenRecording, wanted: Wanted, topics: Collection[str], at: int) -> Iterator[StoredMessage]:
    spans: dict[str, list[tuple[int, int]]] = {}
    whole: list[tuple[int, int]] = []
    begin = wanted.begin
    for span in wanted.spans:
        begin += span.after
        end = begin + span.length
        if end < at or span.topic >= len(wanted.topics) or wanted.topics[span.topic] not in topics:
            continue
        spans.setdefault(wanted.topics[span.topic], []).append((begin, end))
        whole.append((begin, end))
    left = {topic: iter(each) for topic, each in spans.items()}
    open_spans = {topic: next(each) for topic, each in left.items()}
    for first, last in _islands(whole):
        for message in recording.messages(topics=spans.keys(), begin=max(first, at), end=min(last, wanted.end) + 1):
            topic = message.channel.topic
            current = open_spans[topic]
            while current[1] < message.time and (following := next(left[topic], None)) is not None:
                current = open_spans[topic] = following
            if current[0] <= message.time <= current[1]:
                yield message


def _islands(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the parts of time that have spans, which are in the order of their begins."""
    joined: list[list[int]] = []
    for begin, end in spans:
        if joined and begin <= joined[-1][1] + _WATER:
            joined[-1][1] = max(joined[-1][1], end)
        else:
            joined.append([begin, end])
    gaps = [(after[0] - before[1], at) for at, (before, after) in enumerate(pairwise(joined), 1)]
    cuts = sorted(at for _, at in heapq.nlargest(_ISLANDS - 1, gaps))
    bounds = [0, *cuts, len(joined)]
    return [(joined[a][0], max(each[1] for each in joined[a:b])) for a, b in pairwise(bounds) if a < b]
