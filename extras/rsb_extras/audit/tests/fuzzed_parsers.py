"""A recording to audit: from anywhere, cut off, damaged, or made to do harm."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from io import BytesIO
from typing import Any

import msgspec
from mcap.writer import CompressionType, Writer
from tests.fuzz.parser import Parser
from tests.fuzz.scratch import scratch_folder

from rsb_extras.audit.audit_table import lines_of
from rsb_extras.audit.comparing import AuditOptions, AuditReport, compare
from rsb_extras.audit.defined_types import DefinitionError, defined_type
from rsb_extras.audit.padding import Padding, PaddingError
from rsb_extras.audit.recorded import offers_of
from rsb_extras.audit.tests.written import write_sides
from rsb_extras.audit.unanswered import SeenCalls, SeenGoals
from rsb_extras.recording.reading.stored_message import RecordingError


def _read_recording(data: bytes) -> None:
    """Compare it with a sound recording, in both roles."""
    folder = scratch_folder()
    path, near, far = folder / "fuzzed.mcap", folder / "near.mcap", folder / "far.mcap"
    if not near.exists():
        write_sides(str(near), str(far), ("/scan", "/odom"))
    path.write_bytes(data)
    for pair in ((near, path), (path, far)):
        try:
            report = compare(*pair, AuditOptions())
        except RecordingError:
            continue
        assert list(lines_of(report))
        encoded = msgspec.json.encode(report)
        assert len(encoded) <= 1 << 20
        assert msgspec.json.decode(encoded, type=AuditReport) == report  # JSON turns infinity and NaN into null


def _read_definition(data: bytes) -> None:
    """A type that a recording defines, and a message of it."""
    definition, _, message = data.partition(b"\0")
    try:
        padding = Padding(defined_type("pkg/msg/Name", definition.decode(errors="replace")))
        cleared, parts = padding.cleared(b"\0\1\0\0" + message, 10_000)
    except (DefinitionError, PaddingError):
        return
    assert parts <= 10_000
    assert cleared is None or len(cleared) <= 4 + len(message)


def _read_profiles(data: bytes) -> None:
    assert len(offers_of(data.decode(errors="replace"))) <= len(data)


def _read_events(data: bytes) -> None:
    calls, goals = SeenCalls(), SeenGoals()
    for seen in (calls, goals):
        seen.add(memoryview(data), 1)
    assert sum(calls.unanswered(2).values()) == len(calls.open) <= 1
    assert len(goals.goals) <= len(data) / 25 + 1


def small_mcap(compression: CompressionType, in_chunks: bool) -> bytes:
    file = BytesIO()
    writer: Any = Writer(file, compression=compression, use_chunking=in_chunks, enable_crcs=False, chunk_size=300)
    writer.start(profile="ros2", library="x")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    for topic in ("/scan", "/go/_action/status", "/add/_service_event"):
        qos = {"offered_qos_profiles": "- reliability: reliable\n  durability: transient_local\n"}
        channel = writer.register_channel(topic, "cdr", schema, qos)
        for number in range(4):
            writer.add_message(channel, 10**18 + number, b"\0\1\0\0" + bytes(range(number, number + 48)), 0)
    writer.finish()
    return file.getvalue()


def small_bag() -> bytes:
    with closing(sqlite3.connect(":memory:")) as bag:
        bag.executescript(
            "PRAGMA page_size = 512;"
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
            "INSERT INTO topics VALUES (1, '/scan', 'std_msgs/msg/String', 'cdr', '')"
        )
        rows = [(1, 10**18 + number, b"\0\1\0\0" + bytes(range(number, number + 48))) for number in range(20)]
        bag.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        bag.commit()
        return bag.serialize()


_SEEDS = (
    small_bag(),
    small_mcap(CompressionType.NONE, True),
    small_mcap(CompressionType.NONE, False),
    small_mcap(CompressionType.LZ4, True),
)
_EVENT = b"\0\1\0\0" + bytes(44)
_STATUS = b"\0\1\0\0\2\0\0\0" + bytes(24) + b"\4" + bytes(16) + b"\0\0\0" + bytes(8) + b"\2"
_DEFINITIONS = (
    b"uint8 one\nfloat64[3] two\nstring<=9[] three\nC c\n"
    + b"=" * 80
    + b"\nMSG: pkg/C\nint16 x\nC2[2] y\0"
    + bytes(40),
    b"uint32[] x\nint64 LIMIT=3\n\0\2\0\0\0" + bytes(8),
)
_PROFILES = b"- history: 3\n  reliability: 1\n  durability: 2\n- reliability: best_effort\n"
PARSERS = (
    Parser("audited_recording", _read_recording, _SEEDS),
    Parser("defined_type_and_message", _read_definition, _DEFINITIONS),
    Parser("offered_profiles", _read_profiles, (_PROFILES, b"- &a [*a]\n", b"2001-99-99")),
    Parser("call_and_goal_events", _read_events, (_EVENT, _STATUS)),
)
