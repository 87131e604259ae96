"""What is read of recordings, how their names are brought together, calls and goals, and what is refused."""

from __future__ import annotations

import json
import sqlite3
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from mcap.records import Chunk
from mcap.writer import CompressionType
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from tests.support.wording import says

from rsb_extras.audit.audit_table import AuditText
from rsb_extras.audit.recorded import insert, new_database, offers_of
from rsb_extras.audit.tests.audit_places import CALLS_REMEMBERED, INSERTS, MATCHES_HELD, NEW_DATABASE, PIECE, ROWS_HELD
from rsb_extras.audit.tests.conftest import Audited, Sides
from rsb_extras.audit.tests.written import START, Written, text
from rsb_extras.audit.topic_pairs import PairText
from rsb_extras.recording.reading.mcap_records import unpacked
from rsb_extras.recording.reading.stored_message import DamageError, UnreadableRecording

Run = Callable[..., Audited]


# --- names


def test_prefix_pairs_topics(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    for name in ("/scan", "/camera/image"):
        sides.near.topic(name)
        sides.far.topic(f"/robot1{name}")
        sides.stream(name, f"/robot1{name}", lost={50})
    sides.far.topic("/robot0/scan")
    found = audited()
    pairs = {(each["topic"], each["far_topic"], each["paired_by"]) for each in found.json["topics"]}
    assert pairs == {
        ("/scan", "/robot1/scan", "prefix"), ("/camera/image", "/robot1/camera/image", "prefix")
    }  # fmt: skip
    assert found.breaches == {("lost", "/scan", 1), ("lost", "/camera/image", 1)}
    assert (found.json["only_near"], found.json["only_far"]) == (["/only/near"], ["/only/far", "/robot0/scan"])


def test_equal_prefixes_pair_nothing(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.near.topic("/scan")
    for name in ("/robot1/scan", "/robot2/scan"):
        sides.far.topic(name)
    sides.stream("/scan", "/robot2/scan")
    assert audited().json["topics"] == []
    found = audited("--pair", "/scan=/robot2/scan", near=sides.near.path, far=sides.far.path)
    assert [(each["far_topic"], each["matched"], each["paired_by"]) for each in found.json["topics"]] == [
        ("/robot2/scan", 100, "option")
    ]


def test_types_that_differ_are_no_pair(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.near.topic("/scan", type_name="std_msgs/msg/String")
    sides.far.topic("/scan", type_name="std_msgs/msg/Int8")
    sides.stream("/scan")
    assert "/scan" in audited().json["only_near"]


def test_named_topics_have_to_cross(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    sides.near.topic("/odom")
    for number in range(5):
        sides.near.add("/odom", 3 + number, number)
        for side, other in zip(sides, (0, 100), strict=True):
            if not number:
                side.topic("/tf")
            side.add("/tf", 3 + number, number + other)
    assert audited().breaches == {("not_judged", "/tf", 5)}
    assert audited("--topic", "/scan", near=sides.near.path, far=sides.far.path).code == 0
    named = ("--topic", "/scan", "--topic", "/odom", "--topic", "/t*")
    found = audited(*named, near=sides.near.path, far=sides.far.path)
    assert (found.code, found.breaches) == (1, {("not_crossed", "/odom", 5), ("not_crossed", "/tf", 5)})
    assert {each["topic"] for each in found.json["topics"]} == {"/scan", "/tf"}
    assert (found.json["only_near"], found.json["only_far"]) == (["/odom"], [])


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--pair", "/none=/scan"), PairText.NOT_IN_NEAR),
        (("--pair", "/scan=/none"), PairText.NOT_IN_FAR),
        (("--pair", "/scan=/only/far"), PairText.TYPES),
        (("--topic", "/none"), PairText.NO_TOPIC),
    ],
)
def test_names_that_are_not_there(options: tuple[str, ...], problem: PairText, sides: Sides, ran: Any) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    for side in sides:
        side.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path), *options)
    assert (done.code, says(done.err, problem)) == (2, True)


@pytest.mark.parametrize(
    "options",
    [
        ("--pair", "/scan"),
        ("--pair", "scan=/x"),
        ("--back", "x y"),
        ("--offset", "nan"),
        ("--offset", "1e99"),
        ("--gap", "0"),
    ],
)
def test_wrong_usage(options: tuple[str, ...], ran: Any) -> None:
    with pytest.raises(SystemExit) as ended:
        ran("audit", "near.mcap", "far.mcap", *options)
    assert ended.value.code == 2


def test_nothing_in_common_fails(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.near.topic("/scan")
    sides.near.add("/scan", 3, 1)
    found = audited()
    assert (found.code, found.breaches) == (1, {("nothing_compared", "", 0)})


# --- files


@pytest.mark.parametrize("compression", list(CompressionType))
def test_compressed_chunks(compression: CompressionType, tmp_path: Path, ran: Any) -> None:
    sides = Sides(*(Written(tmp_path / f"{name}.mcap", compression=compression) for name in ("near", "far")))
    sides.stream(sides.topic("/scan"))
    for side in sides:
        side.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path), "--json")
    assert [each["matched"] for each in json.loads(done.out)["topics"]] == [100]


def test_cut_off_file_is_read_as_far_as_it_goes(sides: Sides, audited: Run) -> None:
    """A recorder that was killed leaves no end, and perhaps half a chunk."""
    sides.stream(sides.topic("/scan", reliability="best_effort"))
    big = sides.far.topic("/big", type_name="std_msgs/msg/Big")
    for number in range(40):
        sides.far.add(big, 13 + number * 0.1, number.to_bytes(4) * 2000)
    whole = audited()
    assert whole.json["far"]["cut"] == ""
    data = sides.far.path.read_bytes()
    sides.far.path.write_bytes(data[: len(data) // 2])
    found = audited(near=sides.near.path, far=sides.far.path)
    assert found.json["far"]["cut"]
    assert (found["/scan"]["matched"], found.code) == (100, 0)
    assert 100 < found.json["far"]["messages"] < 140


def test_damaged_chunk_ends_a_recording(tmp_path: Path, ran: Any) -> None:
    """What comes after it may belong to other topics than it seems."""
    sides = Sides(*(Written(tmp_path / f"{n}.mcap", compression=CompressionType.NONE) for n in ("near", "far")))
    topic = sides.topic("/scan")
    for number in range(1000):
        for side in sides:
            side.add(topic, number * 0.01, number)
    for side in sides:
        side.done()
    data = bytearray(sides.far.path.read_bytes())
    data[data.index(text(700))] ^= 0xFF
    sides.far.path.write_bytes(data)
    done = json.loads(ran("audit", str(sides.near.path), str(sides.far.path), "--json").out)
    assert (bool(done["far"]["cut"]), done["ok"]) == (True, True)
    assert 0 < done["far"]["messages"] < 700


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunk_gets_no_more_memory_than_it_says(compression: str) -> None:
    pack = zstandard.compress if compression == "zstd" else lz4.frame.compress
    content = pack(bytes(50_000_000))
    tracemalloc.start()
    with pytest.raises(ValueError):
        unpacked(Chunk(compression, content, 0, 0, 1, 1000))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10_000_000
    with pytest.raises(DamageError):
        unpacked(Chunk(compression, content, 0, 0, 0, 1 << 40))
    with pytest.raises(ValueError):
        unpacked(Chunk(compression, pack(bytes(10)), 0, 0, 0, 1000))


def test_folder_of_rosbag2(sides: Sides, tmp_path: Path, audited: Run) -> None:
    """Split into several files, each with its own numbers of channels."""
    folder = tmp_path / "far_bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    sides.near.spans(15)
    topic = sides.near.topic("/scan")
    parts = [Written(folder / f"far_{number}.mcap") for number in (2, 10)]
    parts[1].add(parts[1].topic("/other"), 15, 1)  # has the number of /scan in the other file
    for part in parts:
        part.topic(topic)
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.1, number)
        if number != 70:
            parts[number >= 50].add(topic, 2.02 + number * 0.1, number)
    for part in parts:
        part.done()
    found = audited(far=folder)
    assert (found["/scan"]["far"], found["/scan"]["matched"], found["/scan"]["disordered"]) == (99, 99, 0)
    assert found.json["only_far"] == ["/other"]
    assert found.breaches == {("lost", "/scan", 1)}
    again = audited("--back", "/scan", near=sides.near.path, far=folder)
    assert (again["/scan"]["matched"], again["/scan"]["disordered"]) == (99, 0)


def test_times_that_no_clock_has(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    odd = sides.far.topic("/odd")
    for number in range(20):
        sides.far.add(odd, 1.6e10 * (number % 2), number)  # 2^64 ns are 1.8e10 s
    assert audited("--overlap")["/scan"]["matched"] == 100


def test_recording_of_another_writer(sides: Sides, tmp_path: Path, ran: Any) -> None:
    """A folder as rosbags writes it, which knows rosbag2's own files, against a file of ours."""
    none = QosTime(0, 0)
    policies = (QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, none, none)
    qos = [Qos(*policies, QosLiveliness.AUTOMATIC, none, False)]
    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/robot1/scan", "std_msgs/msg/String", typestore=types, offered_qos_profiles=qos)
        for number in range(100):
            bag.write(topic, round((START + 2.02 + number * 0.1) * 1e9), text(number))
    sides.near.spans(15)
    sides.near.topic("/scan")
    for number in range(101):
        sides.near.add("/scan", 2 + number * 0.1, number)
    sides.near.done()
    near, bag_path = str(sides.near.path), str(tmp_path / "bag")
    (scan,) = json.loads(ran("audit", near, bag_path, "--json").out)["topics"]
    assert (scan["far_topic"], scan["matched"], scan["lost"]) == ("/robot1/scan", 100, 0)
    (back,) = json.loads(ran("audit", bag_path, near, "--json").out)["topics"]
    assert (back["reliable"], back["latched"], back["matched"]) == (True, False, 100)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", UnreadableRecording.EMPTY),
        (b"SQLite format 3\0" * 8, UnreadableRecording.EMPTY),
        (b"text" * 8, UnreadableRecording.NO_RECORDING),
        (b"\x28\xb5\x2f\xfd" * 8, UnreadableRecording.COMPRESSED),
        (b"\x89MCAP0\r\n", UnreadableRecording.EMPTY),
        (b"\x89MCAP0\r\n\xff" + (1 << 62).to_bytes(8, "little"), UnreadableRecording.EMPTY),
        (None, UnreadableRecording.NOT_THERE),
    ],
)
def test_what_is_no_recording(content: bytes | None, problem: Any, sides: Sides, tmp_path: Path, ran: Any) -> None:
    sides.spans(15)
    sides.near.done()
    path = tmp_path / "odd"
    if content is not None:
        path.write_bytes(content)
    done = ran("audit", str(sides.near.path), str(path))
    assert (done.code, says(done.err, problem, path=path)) == (2, True)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("bag.txt", UnreadableRecording.NONE_WITHIN),
        ("bag.mcap.zstd", UnreadableRecording.COMPRESSED),
        ("bag.db3.zstd", UnreadableRecording.COMPRESSED),
    ],
)
def test_folder_without_recording(name: str, problem: Any, sides: Sides, tmp_path: Path, ran: Any) -> None:
    sides.spans(15)
    sides.near.done()
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / name).write_bytes(b"x")
    done = ran("audit", str(tmp_path / "bag"), str(sides.near.path))
    assert (done.code, says(done.err, problem)) == (2, True)


def test_recording_without_messages(sides: Sides, ran: Any) -> None:
    sides.spans(15)
    for side in sides:
        side.done()
    empty = Written(sides.near.path.with_name("empty.mcap"))
    empty.done()
    done = ran("audit", str(sides.near.path), str(empty.path))
    assert (done.code, says(done.err, UnreadableRecording.EMPTY, path=empty.path)) == (2, True)


def test_missing_library_is_named(sides: Sides, monkeypatch: pytest.MonkeyPatch, ran: Any) -> None:
    sides.spans(15)
    sides.near.done()
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    done = ran("audit", str(sides.near.path), str(sides.near.path))
    assert (done.code, says(done.err, UnreadableRecording.NOT_INSTALLED)) == (2, True)


# --- memory


def test_rows_are_not_held_in_memory(sides: Sides, monkeypatch: pytest.MonkeyPatch, audited: Run) -> None:
    """No list of rows grows beyond its limit, equal messages included."""
    ROWS_HELD.set(monkeypatch, 50)
    MATCHES_HELD.set(monkeypatch, 50)
    PIECE.set(monkeypatch, 40)
    longest = 0

    def watched(database: Any, table: str, rows: list[Any]) -> None:
        nonlocal longest
        longest = max(longest, len(rows))
        insert(database, table, rows)

    for place in INSERTS:
        place.set(monkeypatch, watched)
    sides.spans(15)
    topic, other, gone = sides.topic("/alive"), sides.topic("/scan"), sides.topic("/gone")
    sides.far.add(gone, 2, 7)
    for number in range(1000):
        at = 2 + number * 0.01
        sides.near.add(gone, at, 7)
        sides.near.add(topic, at, 7)
        sides.near.add(other, at, number)
        if number != 400:
            sides.far.add(topic, at + 0.002, 7)
            sides.far.add(other, at + 0.002, number)
    found = audited("--offset", "0")
    assert [(found[name]["matched"], found[name]["lost"]) for name in (topic, other)] == [(999, 1), (999, 1)]
    assert (found[gone]["matched"], found[gone]["lost"]) == (1, 999)
    assert longest <= 100


def test_full_disk_is_named(sides: Sides, monkeypatch: pytest.MonkeyPatch, ran: Any) -> None:
    def small() -> sqlite3.Connection:
        database = new_database()
        database.execute("PRAGMA max_page_count = 20")
        return database

    NEW_DATABASE.set(monkeypatch, small)
    topic = sides.topic("/scan")
    for number in range(10_000):
        for side in sides:
            side.add(topic, number * 0.001, number)
    for side in sides:
        side.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path))
    assert (done.code, says(done.err, AuditText.NO_ROOM)) == (2, True)


# --- calls and goals


def event(kind: int, number: int) -> bytes:
    """Return an event of service introspection, without a request and a response."""
    caller = bytes(range(16))
    return b"\0\1\0\0" + struct.pack("<B3xiI16s4xq2I", kind, 5, 6, caller, number, 0, 0)


def test_calls_without_an_answer(sides: Sides, audited: Run) -> None:
    sides.spans(60)
    sides.stream(sides.topic("/scan"))
    events = sides.topic("/add/_service_event", type_name="example_interfaces/srv/AddTwoInts_Event")
    for number in range(20):
        at = 5.0 + number * 2.5  # the last ones 10 s before the end
        sides.near.add(events, at, event(0, number))
        if number != 7:
            sides.far.add(events, at + 0.1, event(1, number))
            sides.far.add(events, at + 0.2, event(2, number))
        if number not in (3, 7, 19):
            sides.near.add(events, at + 0.3, event(3, number))
    found = audited()
    calls = {(each["side"], each["seen_by"], each["asked"], each["unanswered"]) for each in found.json["calls"]}
    assert calls == {("near", "caller", 20, 2), ("far", "provider", 19, 0)}
    assert (found.code, found.breaches) == (1, {("call", "/add", 2)})
    assert all(each["topic"] != events for each in found.json["topics"])


def test_calls_of_others_do_not_count(sides: Sides, audited: Run) -> None:
    sides.spans(60)
    sides.stream(sides.topic("/scan"))
    sides.near.add(sides.topic("/add/_service_event"), 5.0, event(0, 1))
    found = audited("--topic", "/scan")
    assert (found.json["calls"], found.code) == ([], 0)


def test_calls_that_are_forgotten_are_unanswered(monkeypatch: pytest.MonkeyPatch, sides: Sides, audited: Run) -> None:
    CALLS_REMEMBERED.set(monkeypatch, 5)
    sides.spans(60)
    events = sides.topic("/add/_service_event")
    for number in range(20):
        sides.near.add(events, 5.0 + number, event(0, number))
    (calls,) = audited().json["calls"]
    assert (calls["asked"], calls["unanswered"]) == (20, 20)


def status(*goals: tuple[int, int]) -> bytes:
    """Return a GoalStatusArray of goals, each as its number and status."""
    content = struct.pack("<I", len(goals))
    for number, state in goals:
        content += number.to_bytes(16)
        content += bytes(-len(content) % 4) + struct.pack("<iIb", 5, 6, state)
    return b"\0\1\0\0" + content


def test_goals_without_a_result(sides: Sides, audited: Run) -> None:
    sides.spans(60)
    topic = sides.topic("/go/_action/status", type_name="action_msgs/msg/GoalStatusArray")
    for at, goals in ((5.0, ((1, 2),)), (8.0, ((1, 4), (2, 2), (3, 2))), (11.0, ((1, 4), (2, 6), (3, 2)))):
        sides.far.add(topic, at, status(*goals))
        if at < 11:
            sides.near.add(topic, at + 0.1, status(*goals))
    found = audited("--back", "/go/**")
    assert [(each["goals"], each["unanswered"], each["unfinished"]) for each in found.json["goals"]] == [(3, 1, 1)]
    assert ("goal", "/go", 1) in found.breaches


def test_lines_for_people(sides: Sides, ran: Any) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"), lost={50})
    for side in sides:
        side.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path))
    assert done.code == 1
    assert says(done.out, AuditText.FAILED, name="/scan")


def test_lines_tell_the_bridge_from_the_sender(sides: Sides, ran: Any) -> None:
    """Both were silent from 5 s to 8 s, the bridge alone from 12 s to 14 s."""
    sides.spans(29.5)
    topic = sides.topic("/scan")
    for number in range(280):
        at = 1 + number * 0.1
        if not 5 < at < 8:
            sides.near.add(topic, at, number)
            if not 12 < at < 14:
                sides.far.add(topic, at + 0.01, number)
    for side in sides:
        side.done()
    lines = ran("audit", str(sides.near.path), str(sides.far.path)).out.splitlines()
    assert [says(line, AuditText.SILENCE, other=19, side="FAR") for line in lines].count(True) == 1
    assert [says(line, AuditText.SILENCE) for line in lines].count(True) == 1
    assert [says(line, AuditText.SENDER, count=1, side="NEAR") for line in lines].count(True) == 1


def test_goal_that_ends_after_one_recording_is_no_breach(sides: Sides, audited: Run) -> None:
    topic = sides.topic("/go/_action/status", type_name="action_msgs/msg/GoalStatusArray")
    sides.near.spans(60)
    sides.far.spans(80)
    sides.far.add(topic, 5.0, status((1, 2)))
    sides.near.add(topic, 5.1, status((1, 2)))
    sides.far.add(topic, 65.0, status((1, 4)))
    found = audited("--back", "/go/**", "--overlap")
    assert [(each["goals"], each["unanswered"]) for each in found.json["goals"]] == [(1, 0)]
    assert found.code == 0


def test_topic_that_is_not_judged_needs_no_long_recording(sides: Sides, audited: Run) -> None:
    sides.near.spans(60)
    sides.far.spans(45)
    sides.stream(sides.topic("/cmd_vel"), back=True)
    topic = sides.topic("/rosout")
    sides.near.add(topic, 5.0, 1)
    sides.far.add(topic, 5.0, 2)
    found = audited("--back", "/cmd_vel")
    assert (found["/rosout"]["nothing_common"], found.code) == (True, 0)


def test_lines_say_what_was_not_judged(sides: Sides, ran: Any) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    for name in ("/image", "/rosout"):
        topic = sides.topic(name)
        for number, side in enumerate(sides):
            side.add(topic, 5.0, number)
    for side in sides:
        side.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path))
    assert (done.code, says(done.out, AuditText.PASSED)) == (1, False)
    found = [line for line in done.out.splitlines() if says(line, AuditText.FAILED)]
    assert [says(line, AuditText.FAILED, name="/image") for line in found] == [True]


def test_name_with_two_types_is_two_topics(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    sides.near.add(sides.near.topic("/scan", "std_msgs/msg/Int32", publisher="other"), 5.0, 1, "other")
    found = audited()
    assert (found["/scan"]["matched"], "/scan" in found.json["only_near"]) == (100, True)


def test_anchors_of_a_profile_are_not_followed() -> None:
    assert offers_of("- &one {reliability: reliable}\n- *one\n") == []


def test_files_of_a_split_bag_are_read_by_their_numbers(tmp_path: Path, sides: Sides, ran: Any) -> None:
    (tmp_path / "bag").mkdir()
    for number in range(11):
        part = Written(tmp_path / f"bag/bag_{number}.mcap")
        part.add(part.topic("/scan"), float(number), number)
        if number >= 9:
            part.add(part.topic("/add/_service_event"), number + 0.5, event(0 if number == 9 else 3, 1))
        part.done()
    sides.far.spans(12)
    sides.far.done()
    found = json.loads(ran("audit", str(tmp_path / "bag"), str(sides.far.path), "--overlap", "--json").out)
    assert [(each["asked"], each["unanswered"]) for each in found["calls"]] == [(1, 0)]


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (("bag_0.mcap.zstd", "bag_1.mcap"), UnreadableRecording.COMPRESSED),
        (("near.mcap", "far.mcap"), UnreadableRecording.SEVERAL),
    ],
)
def test_folder_that_is_no_whole_bag_is_refused(
    names: tuple[str, ...], problem: Any, tmp_path: Path, ran: Any, sides: Sides
) -> None:
    sides.spans(15)
    sides.near.done()
    (tmp_path / "bag").mkdir()
    for name in names:
        (tmp_path / "bag" / name).write_bytes(sides.near.path.read_bytes())
    done = ran("audit", str(tmp_path / "bag"), str(sides.near.path))
    assert (done.code, says(done.err, problem)) == (2, True)


@pytest.mark.parametrize("option", ["--back", "--forth"])
def test_way_of_a_topic_that_is_not_there_is_refused(option: str, sides: Sides, ran: Any) -> None:
    sides.spans(15)
    sides.near.done()
    sides.far.done()
    done = ran("audit", str(sides.near.path), str(sides.far.path), option, "/scam")
    assert (done.code, says(done.err, PairText.NO_TOPIC, option=option, pattern="/scam")) == (2, True)


def test_any_length_of_a_silence_is_taken(sides: Sides, audited: Run) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    assert audited("--gap", "1e300").code == 0


def test_recordings_may_come_by_a_pipe(sides: Sides, ran: Any) -> None:
    sides.spans(15)
    sides.stream(sides.topic("/scan"))
    sides.near.done()
    sides.far.done()
    with subprocess.Popen(["cat", sides.near.path], stdout=subprocess.PIPE) as piped:
        assert piped.stdout is not None
        done = ran("audit", f"/dev/fd/{piped.stdout.fileno()}", str(sides.far.path), "--json")
    assert (done.code, json.loads(done.out)["topics"][0]["matched"]) == (0, 100)
