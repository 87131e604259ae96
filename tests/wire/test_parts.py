"""Long control messages, whose entries are decoded one by one."""

from __future__ import annotations

import msgspec
import pytest

from rsb_bridge.model.qos import Qos
from rsb_bridge.wire.codec import (
    WHOLE,
    ReportParts,
    decode,
    encode,
    pack_topics,
    report_entries,
    topic_entries,
)
from rsb_bridge.wire.messages import Report
from rsb_bridge.wire.protocol_error import ProtocolError
from rsb_bridge.wire.records import CallsReport, ReceivedCounts, ReceivedReport, SentCounts, SentReport, TopicEntry

SENT, RECEIVED, CALLS = SentReport(route=1, publishers=5), ReceivedReport(route=2, subscribers=7), CallsReport(route=3)
COUNTS_SENT, COUNTS_RECEIVED = SentCounts(route=1, offered=5), ReceivedCounts(route=2, received=7)
TOPIC = TopicEntry("/a", "a/msg/B", "", Qos(depth=1), 1, 1)


@pytest.mark.parametrize("times", [1, 500])
def test_the_entries_are_those_of_the_whole(times: int) -> None:
    report = Report(
        (SENT,) * times, (RECEIVED,) * times, (CALLS,) * times, (COUNTS_SENT,) * times, (COUNTS_RECEIVED,) * times
    )
    data = encode(report)
    parts = decode(data)
    is_long = len(data) > WHOLE
    assert isinstance(parts, ReportParts if is_long else Report)
    found = list(report_entries(parts))
    words = [*report.sent, *report.received, *report.calls]
    assert [entry for entry, _ in found] == [*words, *report.sent_counts, *report.received_counts]
    assert all((size > 0) == is_long for _, size in found)
    assert sum(size for _, size in found) < len(data)


def test_so_are_those_of_a_list_of_topics() -> None:
    topics = [TOPIC] * 500
    assert [entry for entry, _ in topic_entries(pack_topics(topics))] == topics


@pytest.mark.parametrize(
    "packed",
    [
        b"",
        b"garbage",
        pack_topics([TOPIC] * 4001),
        pack_topics([TopicEntry("x" * 255, "y" * 255, "", None, 1, 1)] * 4000),
    ],
    ids=["empty", "garbage", "too many", "too long"],
)
def test_damaged_or_long_list_is_refused(packed: bytes) -> None:
    with pytest.raises((ProtocolError, msgspec.DecodeError)):
        next(topic_entries(packed))


def test_invalid_entry_is_found_when_reached() -> None:
    wrong = msgspec.to_builtins(Report(sent=(SENT,) * 500))
    wrong["sent"][-1]["route"] = 0
    parts = decode(msgspec.msgpack.encode({"message": "report", **wrong}))
    assert isinstance(parts, ReportParts)
    entries = report_entries(parts)
    for _ in range(499):
        next(entries)
    with pytest.raises(msgspec.DecodeError):
        next(entries)


def test_what_is_no_message_is_refused() -> None:
    with pytest.raises(ProtocolError):
        decode(b"\xc1")
