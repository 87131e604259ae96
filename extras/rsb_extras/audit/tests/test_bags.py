"""Recordings as rosbag2 and its users leave them: sqlite3, compressed message by message, one file behind another."""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from tests.support.wording import says

from rsb_extras.audit.audit_table import AuditText
from rsb_extras.audit.recorded import offers_of
from rsb_extras.audit.tests.audit_places import TOPICS
from rsb_extras.audit.tests.conftest import Audited, Sides
from rsb_extras.audit.tests.written import START, Written, text
from rsb_extras.recording.reading.stored_message import LONGEST, Damage, UnreadableRecording

Run = Callable[..., Audited]
NONE = QosTime(0, 0)
POLICIES = (QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, NONE, NONE)
QOS = [Qos(*POLICIES, QosLiveliness.AUTOMATIC, NONE, False)]
PROFILE = "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n"


def string(number: int) -> bytes:
    content = f"message {number}".encode()
    return b"\0\1\0\0" + struct.pack("<I", len(content) + 1) + content + b"\0"


def write_bag(
    path: Path, plugin: StoragePlugin, mode: CompressionMode, *, age: float = 0.0, lost: int | None = None
) -> None:
    """Write a bag as rosbags does, which knows rosbag2's own files."""
    bag = Writer(path, version=9, storage_plugin=plugin)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    types = get_typestore(Stores.ROS2_JAZZY)
    with bag:
        topic = bag.add_connection("/scan", "std_msgs/msg/String", typestore=types, offered_qos_profiles=QOS)
        for number in range(100):
            if number != lost:
                bag.write(topic, round((START + 2 + age + number * 0.1) * 1e9), string(number))


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_bags_of_each_kind(plugin: StoragePlugin, mode: CompressionMode, tmp_path: Path, ran: Any) -> None:
    """A folder against a plain file of MCAP, and one of its files alone."""
    write_bag(tmp_path / "near", StoragePlugin.MCAP, CompressionMode.NONE)
    write_bag(tmp_path / "far", plugin, mode, age=0.02, lost=50)
    (file,) = (each for each in (tmp_path / "far").iterdir() if each.suffix != ".yaml")
    for far in (tmp_path / "far", file):
        before = file.read_bytes()
        found = json.loads(ran("audit", str(tmp_path / "near"), str(far), "--json").out)
        (scan,) = found["topics"]
        assert (scan["matched"], scan["lost"], scan["reliable"], scan["described"]) == (99, 1, True, True)
        assert found["far"]["cut"] == ""
        assert (file.read_bytes(), len([*(tmp_path / "far").iterdir()])) == (before, 2), "nothing is written beside it"


def old_bag(path: Path, *, columns: str = "", values: str = "", log: bool = False) -> sqlite3.Connection:
    """Return a sqlite3 bag as rosbag2 wrote it until Iron: without definitions, at first without QoS."""
    bag = sqlite3.connect(path)
    if log:
        bag.execute("PRAGMA journal_mode = WAL")
    bag.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        f" serialization_format TEXT NOT NULL{columns});"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        f"INSERT INTO topics VALUES (1, '/scan', 'std_msgs/msg/String', 'cdr'{values});"
    )
    return bag


def add(bag: sqlite3.Connection, number: int, content: bytes, age: float = 0.02) -> None:
    time = round((START + 2 + age + number * 0.1) * 1e9)
    bag.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", (time, content))


@pytest.mark.parametrize(
    ("columns", "values", "reliable"), [("", "", None), (", offered_qos_profiles TEXT", f", '{PROFILE}'", True)]
)
def test_bag_of_an_older_rosbag2(
    columns: str, values: str, reliable: bool | None, sides: Sides, tmp_path: Path, audited: Run
) -> None:
    bag = old_bag(tmp_path / "old_0.db3", columns=columns, values=values)
    sides.near.topic("/scan")
    for number in range(100):
        sides.near.add("/scan", 2 + number * 0.1, string(number))
        add(bag, number, string(number))
    bag.commit()
    bag.close()
    sides.near.spans(12)
    sides.near.done()
    found = audited("--back", "/scan", near=sides.near.path, far=tmp_path / "old_0.db3")["/scan"]
    assert (found["matched"], found["reliable"]) == (100, reliable)


def test_messages_in_the_log_of_a_killed_recorder_are_read(sides: Sides, tmp_path: Path, audited: Run) -> None:
    """A recorder that writes ahead leaves the newest messages in a file beside."""
    bag = old_bag(tmp_path / "live.db3", log=True)
    topic = sides.near.topic("/scan")
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.1, string(number))
        add(bag, number, string(number))
    bag.commit()
    (tmp_path / "bag").mkdir()
    for name in ("live.db3", "live.db3-wal"):
        shutil.copy(tmp_path / name, tmp_path / "bag" / name)
    bag.close()
    sides.near.done()
    assert audited(near=sides.near.path, far=tmp_path / "bag")["/scan"]["matched"] == 100


def test_damaged_bag_is_read_as_far_as_it_goes(sides: Sides, tmp_path: Path, audited: Run, ran: Any) -> None:
    """SQLite refuses one that is cut off."""
    path = tmp_path / "cut_0.db3"
    bag = old_bag(path)
    topic = sides.near.topic("/scan")
    for number in range(1000):
        sides.near.add(topic, 2 + number * 0.1, text(number, 200))
        add(bag, number, text(number, 200))
    bag.commit()
    bag.close()
    sides.near.done()
    data = bytearray(path.read_bytes())
    half = data.index(text(500, 200)) // 4096 * 4096
    data[half : half + 4096] = bytes(4096)
    path.write_bytes(data)
    found = audited("--overlap", near=sides.near.path, far=path)
    assert found.json["far"]["cut"]
    assert 400 < found["/scan"]["matched"] <= 500
    path.write_bytes(data[:half])
    assert says(ran("audit", str(sides.near.path), str(path)).err, Damage.BROKEN_BAG)


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
HOSTILE = {
    "view": "DROP TABLE messages;"
    f"CREATE VIEW messages AS {ENDLESS} SELECT 1 AS topic_id, i AS timestamp, x'00010000' AS data FROM n",
    "computed": "DROP TABLE messages;"
    "CREATE TABLE messages(topic_id, timestamp, data AS (zeroblob(60000000)));"
    "INSERT INTO messages VALUES (1, 1)",
    "text": "INSERT INTO messages VALUES (1, 1, 'now', x'00010000')",
    "topic": "INSERT INTO messages VALUES (1, 7, 1, x'00010000')",
    "no content": "DROP TABLE messages; CREATE TABLE messages(topic_id, timestamp)",
    "no topics": "DROP TABLE topics",
}


def audit_far(sides: Sides, far: Path, ran: Any) -> tuple[Any, int]:
    """Audit a file as the far side; return how it ran, and the bytes of memory that it took at most."""
    sides.spans(15)
    sides.near.done()
    tracemalloc.start()
    done = ran("audit", str(sides.near.path), str(far))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return done, most


@pytest.mark.parametrize("name", HOSTILE)
def test_database_that_is_no_bag_is_refused(name: str, sides: Sides, tmp_path: Path, ran: Any) -> None:
    """A view that never ends is not asked, and nothing that is computed is."""
    path = tmp_path / "odd.db3"
    bag = old_bag(path)
    bag.executescript(HOSTILE[name])
    bag.commit()
    bag.close()
    done, most = audit_far(sides, path, ran)
    assert (done.code, says(done.err, UnreadableRecording.EMPTY, path=path)) == (2, True)
    assert most < 40_000_000


def test_pages_that_are_named_many_times_end_a_bag(sides: Sides, tmp_path: Path, ran: Any) -> None:
    """A page of messages is made the child of its parent a hundred times."""
    path = tmp_path / "odd.db3"
    bag = old_bag(path)
    bag.execute("DROP INDEX timestamp_idx")
    for number in range(4000):
        add(bag, number, text(number, 60))
    bag.commit()
    (root,) = bag.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    (size,) = bag.execute("PRAGMA page_size").fetchone()
    bag.close()
    data = bytearray(path.read_bytes())
    page = (root - 1) * size
    assert data[page] == 5, "a page of pages"
    (cells,) = struct.unpack_from(">H", data, page + 3)
    (first,) = struct.unpack_from(">H", data, page + 12)
    for cell in range(cells):
        (at,) = struct.unpack_from(">H", data, page + 12 + 2 * cell)
        data[page + at : page + at + 4] = data[page + first : page + first + 4]
    path.write_bytes(data)
    sides.spans(15)
    sides.near.done()
    done = json.loads(ran("audit", str(sides.near.path), str(path), "--json").out)
    assert done["far"]["messages"] * 60 <= path.stat().st_size


# --- files of MCAP


def test_files_behind_each_other_are_read(sides: Sides, tmp_path: Path, audited: Run, ran: Any) -> None:
    """`cat one two`: each has its own numbers of channels; the first one may have been cut off behind a chunk."""
    parts = [Written(tmp_path / f"{number}.mcap") for number in range(2)]
    parts[1].add(parts[1].topic("/other"), 15, 1)
    topic = sides.near.topic("/scan")
    for part in parts:
        part.topic(topic)
    for number in range(100):
        sides.near.add(topic, 2 + number * 0.1, number)
        parts[number >= 50].add(topic, 2.02 + number * 0.1, number)
    for part in parts:
        part.done()
    sides.near.done()
    both = tmp_path / "both.mcap"
    both.write_bytes(parts[0].path.read_bytes() + parts[1].path.read_bytes())
    found = audited(near=sides.near.path, far=both)
    assert (found["/scan"]["matched"], found["/scan"]["lost"], found.json["far"]["joined"]) == (100, 0, 1)
    assert (found.json["far"]["cut"], found.json["only_far"]) == ("", ["/other"])
    assert says(ran("audit", str(sides.near.path), str(both)).out, AuditText.JOINED, side="FAR", count=2)
    both.write_bytes(parts[0].path.read_bytes() + b"something else")
    assert audited(near=sides.near.path, far=both).json["far"]["cut"] == Damage.FOLLOWS()


def chunk_of(content: bytes) -> bytes:
    """Return a file of one chunk, packed."""
    builder: Any = RecordBuilder()
    Chunk("zstd", zstandard.compress(content), 0, 0, 0, len(content)).write(builder)
    packed: bytes = builder.end()
    return b"\x89MCAP0\r\n" + packed


def read_far(sides: Sides, path: Path, ran: Any) -> str:
    done, most = audit_far(sides, path, ran)
    assert done.code == 2
    assert most < 20_000_000
    return str(done.err)


def test_chunk_that_unpacks_to_more_is_not_unpacked(sides: Sides, tmp_path: Path, ran: Any) -> None:
    path = tmp_path / "large.mcap"
    path.write_bytes(chunk_of(bytes(LONGEST + 1)))
    assert path.stat().st_size < 33_000
    assert Damage.TOO_LONG(limit=64) in read_far(sides, path, ran)


def test_chunk_of_empty_records_is_not_gone_through(sides: Sides, tmp_path: Path, ran: Any) -> None:
    path = tmp_path / "many.mcap"
    path.write_bytes(chunk_of((b"\x80" + bytes(8)) * 1_000_000))
    assert Damage.TOO_MANY() in read_far(sides, path, ran)


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_message_that_unpacks_to_more_ends_a_recording(plugin: StoragePlugin, tmp_path: Path, ran: Any) -> None:
    write_bag(tmp_path / "near", StoragePlugin.MCAP, CompressionMode.NONE)
    with Writer(tmp_path / "far", version=9, storage_plugin=plugin) as bag:
        types = get_typestore(Stores.ROS2_JAZZY)
        topic = bag.add_connection("/scan", "std_msgs/msg/String", typestore=types, offered_qos_profiles=QOS)
        bag.write(topic, round((START + 2.02) * 1e9), string(0))
        bag.write(topic, round((START + 3.02) * 1e9), zstandard.compress(bytes(LONGEST + 1)))
    found = json.loads(ran("audit", str(tmp_path / "near"), str(tmp_path / "far"), "--json").out)
    assert Damage.TOO_LONG(limit=64) in found["far"]["cut"]
    assert found["far"]["messages"] == 1


def test_number_of_topics_is_bounded(
    monkeypatch: pytest.MonkeyPatch, sides: Sides, tmp_path: Path, audited: Run
) -> None:
    TOPICS.set(monkeypatch, 20)
    sides.stream(sides.topic("/scan"))
    for number in range(30):
        sides.far.add(sides.far.topic(f"/topic{number}"), 13.0, 1)
    found = audited()
    assert found.json["far"]["cut"] == Damage.TOPICS(limit=20)
    assert found["/scan"]["matched"] == 100


def test_length_of_profiles_is_bounded() -> None:
    profile = "- reliability: reliable\n  durability: volatile\n"
    assert len(offers_of(profile * 1000)) == 1000
    assert offers_of(profile * 2000) == []


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_profiles_of_all_channels_are_bounded(compression: CompressionType, tmp_path: Path, ran: Any) -> None:
    """Each is short enough; together, they would take long to parse."""
    sides = Sides(*(Written(tmp_path / f"{name}.mcap", compression=compression) for name in ("near", "far")))
    for number in range(40):
        topic = f"/topic{number}"
        for side in sides:
            side.topic(topic, publishers=500)
            for at in range(3):
                side.add(topic, float(at), number * 10 + at)
    for side in sides:
        side.done()
    found = json.loads(ran("audit", str(sides.near.path), str(sides.far.path), "--json").out)
    known = [each["reliable"] for each in found["topics"]]
    assert (True in known, None in known) == (True, True)
