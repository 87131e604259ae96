"""PROTOCOL.md's tables against the code: the document is what is implemented."""

import math
import re
import typing
from pathlib import Path

import msgspec
import pytest
from tests.wire.document_helpers import documented_fields

import rsb_bridge
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.calls import LANES, MOST_LANES, Refused
from rsb_bridge.model.keep import Keep
from rsb_bridge.model.limits import DEPTH, QOS_TIME, RATE, REASON_LENGTH, TEXT_LENGTH
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import Kind
from rsb_bridge.model.topic_keys import STALE_AFTER
from rsb_bridge.wire import events, headers, messages, preamble, records
from rsb_bridge.wire.records import RefuseCode

DOCUMENT = (Path(rsb_bridge.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")
STRUCTS = {
    "Hello": messages.Hello,
    "Welcome": messages.Welcome,
    "Source": records.Source,
    "SentReport": records.SentReport,
    "SentCounts": records.SentCounts,
    "ReceivedCounts": records.ReceivedCounts,
    "ReceivedReport": records.ReceivedReport,
    "Verdict": records.VerdictRecord,
    "Deaf": records.DeafRecord,
    "Driver": records.DriverRecord,
    "Full": records.FullRecord,
    "Path": records.PathRecord,
    "LaneEntry": records.LaneEntry,
    "CallsReport": records.CallsReport,
    "TopicEntry": records.TopicEntry,
    "NamePattern": messages.NamePattern,
    "FoundName": messages.FoundName,
    "VelocityLimits": VelocityLimits,
    "Keep": Keep,
    "qos": Qos,
} | {message.__name__: message for message in typing.get_args(messages.ControlMessage)}


def _section(number: int) -> str:
    return DOCUMENT.split(f"\n## {number}. ")[1].split("\n## ")[0]


def test_every_message_is_documented_and_no_other() -> None:
    assert documented_fields(_section(3)).keys() == STRUCTS.keys()


@pytest.mark.parametrize("name", STRUCTS)
def test_every_field_is_documented_and_no_other(name: str) -> None:
    assert documented_fields(_section(3))[name] == {field.name for field in msgspec.structs.fields(STRUCTS[name])}


def test_messages_that_do_not_count_are_documented() -> None:
    (listed,) = re.findall(r"handled to their end, except (.*?), which belong to a connection", DOCUMENT, re.DOTALL)
    types = typing.get_args(messages.ControlMessage)
    of_connection = {each.__name__ for each in types if issubclass(each, messages.ConnectionMessage)}
    assert set(re.split(r",\s+|\s+and\s+", listed)) == of_connection


@pytest.mark.parametrize("kind", list(preamble.PreambleKind))
def test_every_preamble_frame_is_documented(kind: preamble.PreambleKind) -> None:
    assert re.search(rf"^\| {kind.value} {kind.name} \| (client|server) \|", DOCUMENT, re.MULTILINE)


@pytest.mark.parametrize("code", list(events.RefusalCode))
def test_every_refusal_code_is_documented(code: events.RefusalCode) -> None:
    assert f"| {code.value} | {code.name.replace('_', ' ').lower()} |" in DOCUMENT


def test_exactly_the_existing_codes_are_documented() -> None:
    rows = re.findall(r"^\| \| code \| (.*?) \|", DOCUMENT, re.MULTILINE)
    refused, closed = (set(re.findall(r'"(\w+)"', row)) for row in rows)
    assert (refused, closed) == (set(typing.get_args(RefuseCode)), set(EndCode))


def test_the_limits_are_documented() -> None:
    figures = (
        f"at most {TEXT_LENGTH} characters, reasons and verdicts' texts {REASON_LENGTH}; "
        f"a rate is 0 or {RATE.low:g} to 10^{math.log10(RATE.high):.0f} Hz, "
        f"a depth {DEPTH.low} to {DEPTH.high:,}, "
        f"a deadline, lifespan or lease 0 or {QOS_TIME.low:g} to 10^{math.log10(QOS_TIME.high):.0f} s"
    )
    assert figures in " ".join(DOCUMENT.split())
    assert f"0: never warns; else {STALE_AFTER.low:g} to 10^{math.log10(STALE_AFTER.high):.0f} s" in DOCUMENT


def test_the_frames_of_calls_are_documented() -> None:
    text = _section(8)
    assert f"a header of {headers.CALL_HEADER_LENGTH} bytes" in " ".join(text.split())
    for what in headers.What:
        assert f"{what.value} {what.name.lower()}" in text


def test_why_calls_are_refused_is_documented() -> None:
    rows = "".join(re.findall(r'^\| (".*?) \|', _section(8), re.MULTILINE))
    assert set(re.findall(r'"(.*?)"', rows)) == {*Refused} - {Refused.OTHER}


@pytest.mark.parametrize("kind", LANES)
def test_the_lanes_of_every_kind_are_documented(kind: Kind) -> None:
    text = _section(8)
    for lane in LANES[kind]:
        for part in filter(None, (lane.suffix, lane.absolute, lane.type_suffix)):
            assert f"`{part}`" in text
        assert lane.type_name.startswith("rcl_interfaces/srv/") or lane.type_name in text
    assert len(LANES[kind]) <= MOST_LANES
