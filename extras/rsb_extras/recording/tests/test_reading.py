"""Recordings are read in the order of their times, by their index if it is whole, with bounded memory."""

from __future__ import annotations

import os
import sqlite3
import struct
import tracemalloc
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from tests.support.wording import says

from rsb_extras.audit.tests.bags import add, old_bag, string, write_bag
from rsb_extras.recording.reading.mcap_records import MCAP_MAGIC, records
from rsb_extras.recording.reading.open_recording import OpenRecording, messages_of, summary_of
from rsb_extras.recording.reading.recording_files import StoredMessages
from rsb_extras.recording.reading.stored_message import Damage, DamageError, RecordingError, UnreadableRecording
from rsb_extras.recording.tests.reading_places import HELD, TOGETHER

STEP = 1_000_000


def content(number: int, size: int = 40) -> bytes:
    return b"\0\1\0\0" + struct.pack("<Q", number).ljust(size, b".")


def number_of(message: Any) -> int:
    (number,) = struct.unpack_from("<Q", message.content, 4)
    return int(number)


def write(path: Path, times: list[int], topics: int = 2, **options: Any) -> Path:
    """Write a message each `times`, to one topic after the other."""
    with path.open("wb") as file:
        writer: Any = Writer(file, **{"chunk_size": 400, **options})
        writer.start(profile="ros2", library="a test")
        schema = writer.register_schema("std_msgs/msg/UInt64", "ros2msg", b"uint64 data")
        channels = [writer.register_channel(f"/topic{each}", "cdr", schema, {}) for each in range(topics)]
        for number, time in enumerate(times):
            writer.add_message(channels[number % topics], time, content(number), time - 1, number)
        writer.finish()
    return path


FORMS: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "no chunks": {"use_chunking": False},
    "no summary": {"use_statistics": False},
    "no channels in the summary": {"repeat_channels": False},
    "no index of messages": {"index_types": IndexType.CHUNK},
    "no index of chunks": {"index_types": IndexType.NONE},
}


@pytest.mark.parametrize("form", FORMS)
def test_messages_come_in_the_order_of_their_times(form: str, tmp_path: Path) -> None:
    """Messages of one time in the order of the file, also if they lie in several chunks."""
    times = [(1 + number // 3) * STEP for number in range(200)]
    times[50:90] = reversed(times[50:90])
    path = write(tmp_path / "file.mcap", times, **FORMS[form])
    found = list(messages_of(path))
    expected = sorted(range(200), key=lambda number: times[number])
    assert [number_of(message) for message in found] == expected
    assert [message.time for message in found] == sorted(times)
    assert {(message.published - message.time, message.channel.type_name) for message in found} == {
        (-1, "std_msgs/msg/UInt64")
    }
    assert [message.number for message in found] == expected
    part = list(messages_of(path, topics={"/topic1"}, begin=20 * STEP, end=30 * STEP))
    assert [number_of(message) for message in part] == [
        number for number in expected if number % 2 and 20 * STEP <= times[number] < 30 * STEP
    ]
    summary = summary_of(path)
    assert summary[:3] == (STEP, 67 * STEP, 200)
    assert summary.topics == {f"/topic{each}": ("std_msgs/msg/UInt64", 100) for each in range(2)}
    assert (summary.size, summary.cut) == (path.stat().st_size, "")


def test_topic_without_messages_is_in_the_summary(tmp_path: Path) -> None:
    path = write(tmp_path / "file.mcap", [5], topics=3)
    assert summary_of(path).topics["/topic2"] == ("std_msgs/msg/UInt64", 0)


@pytest.mark.parametrize("together", [1 << 20, 100])
def test_file_that_is_cut_off_is_read_to_there(together: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    TOGETHER.set(monkeypatch, together)
    for form in ("zstd", "no chunks"):
        path = write(tmp_path / "file.mcap", [(1 + number) * STEP for number in range(200)], **FORMS[form])
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])
        found = list(messages_of(path))
        summary = summary_of(path)
        assert 50 < len(found) == summary.messages < 150
        assert [number_of(message) for message in found] == list(range(len(found)))
        assert [number_of(each) for each in messages_of(path, begin=21 * STEP, end=23 * STEP)] == [20, 21]
        assert (summary.end, bool(summary.cut)) == (found[-1].time, True)


class _Counted(BytesIO):
    """A file that counts how often it is read."""

    reads = 0

    def read(self, size: int | None = -1) -> bytes:
        self.reads += 1
        return super().read(size)


def test_zeros_behind_a_power_cut_take_no_time(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.mcap", [STEP * number for number in range(1, 100)]).read_bytes()
    cut = _Counted(whole[: len(whole) // 2] + bytes(1 << 20))
    cut.seek(len(MCAP_MAGIC))
    with pytest.raises(EOFError):
        for _ in records(cut):
            pass
    assert cut.reads < 1000


def test_channel_that_a_writer_has_begun_twice_has_all_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/UInt64", "ros2msg", b"uint64 data")
        for number in range(2):
            channel = writer.register_channel("/topic", "cdr", schema, {})
            writer.add_message(channel, STEP * number, content(number), 0)
        writer.finish()
    assert summary_of(path).messages == 2


def test_damaged_chunk_ends_a_recording_there(tmp_path: Path) -> None:
    """Its index is whole, so that a reader knows of the damage only when it comes there."""
    times = [(1 + number) * STEP for number in range(200)]
    path = write(tmp_path / "file.mcap", times, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[data.index(content(100))] ^= 0xFF
    path.write_bytes(data)
    found: list[int] = []
    with pytest.raises(DamageError):
        found.extend(map(number_of, messages_of(path)))
    assert 80 < len(found) <= 100
    assert found == list(range(len(found)))


def test_files_of_a_folder_are_one_recording(tmp_path: Path) -> None:
    """Split files may overlap, and one of another format may lie between them."""
    folder = tmp_path / "bag"
    folder.mkdir()
    write(folder / "bag_0.mcap", [STEP, 2 * STEP, 9 * STEP])
    write(folder / "bag_1.mcap", [STEP, 9 * STEP])
    found = [(message.time // STEP, number_of(message)) for message in messages_of(folder)]
    assert found == [(1, 0), (1, 0), (2, 1), (9, 2), (9, 1)]
    assert summary_of(folder).messages == 5


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_bag_of_another_writer(plugin: StoragePlugin, mode: CompressionMode, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", plugin, mode)
    recording = OpenRecording(tmp_path / "bag")
    assert [bytes(message.content) for message in recording.messages()] == [string(number) for number in range(100)]
    assert recording.summary.topics == {"/scan": ("std_msgs/msg/String", 100)}
    (channel,) = recording.channels
    assert "reliab" in channel.profiles
    assert channel.definition[0] == "ros2msg"


@pytest.mark.parametrize("change", ["", "DROP INDEX timestamp_idx", "DROP INDEX timestamp_idx; CREATE INDEX"])
def test_order_of_a_database(change: str, tmp_path: Path) -> None:
    """With the index that rosbag2 makes, without one, and with one that computes."""
    path = tmp_path / "bag_0.db3"
    bag = old_bag(path)
    for number in (3, 1, 2, 2, 0):
        add(bag, number, string(number))
    if change.endswith("CREATE INDEX"):
        change += " timestamp_idx ON messages (abs(timestamp))"
    bag.executescript(change)
    bag.commit()
    bag.close()
    recording = OpenRecording(path)
    assert [bytes(each.content) for each in recording.messages()] == [string(each) for each in (0, 1, 2, 2, 3)]
    second = recording.summary.begin + 100_000_000
    assert [bytes(each.content) for each in recording.messages(begin=second, end=second + 1)] == [string(1)]
    assert recording.summary.messages == 5


def test_damaged_database_is_read_to_there(tmp_path: Path) -> None:
    path = tmp_path / "bag_0.db3"
    bag = old_bag(path)
    for number in range(1000):
        add(bag, number, content(number, 200))
    bag.commit()
    bag.close()
    data = bytearray(path.read_bytes())
    half = data.index(content(500, 200)) // 4096 * 4096
    data[half : half + 4096] = bytes(4096)
    path.write_bytes(data)
    summary = summary_of(path)
    assert 400 < summary.messages <= 500
    assert says(summary.cut, Damage.BROKEN_BAG)


# --- files that are made to do harm


def test_index_with_other_times_is_damage(tmp_path: Path) -> None:
    path = write(tmp_path / "file.mcap", [(1 + number) * STEP for number in range(100)], enable_crcs=False)
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    second = summary.chunk_indexes[1]
    place = data.rindex(struct.pack("<QQ", second.message_start_time, second.message_end_time))
    data[place : place + 16] = struct.pack("<QQ", 90 * STEP, 99 * STEP)
    path.write_bytes(data)
    with pytest.raises(DamageError) as raised:
        list(messages_of(path))
    assert str(raised.value) == Damage.DISORDERED()


def test_chunks_that_all_overlap_are_not_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    HELD.set(monkeypatch, 20_000)
    path = write(tmp_path / "file.mcap", [(1 + number % 7) * STEP for number in range(1000)])
    with pytest.raises(DamageError) as raised:
        list(messages_of(path))
    assert says(str(raised.value), Damage.OVERLAPPING)


def test_memory_does_not_grow_with_a_recording(tmp_path: Path) -> None:
    path = write(tmp_path / "file.mcap", [(1 + number) * STEP for number in range(50_000)], chunk_size=100_000)
    tracemalloc.start()
    count = sum(1 for _ in messages_of(path))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 50_000
    assert most < 3_000_000


@pytest.mark.parametrize("exists", [True, False])
def test_what_is_no_file_is_not_waited_for(exists: bool, tmp_path: Path) -> None:
    if exists:
        os.mkfifo(tmp_path / "file.mcap")
    with pytest.raises(RecordingError):
        summary_of(tmp_path / "file.mcap")


def test_both_orders_have_the_same_messages(tmp_path: Path) -> None:
    path = write(tmp_path / "file.mcap", [(1 + number * 37 % 50) * STEP for number in range(300)])
    stored = list(StoredMessages(path))
    assert sorted(stored, key=lambda each: each.time) == list(messages_of(path))


def test_other_content_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    path.write_bytes(b"text" * 20)
    with pytest.raises(RecordingError) as raised:
        summary_of(path)
    assert says(str(raised.value), UnreadableRecording.NO_RECORDING)


def test_view_in_a_database_is_not_asked(tmp_path: Path) -> None:
    path = tmp_path / "odd.db3"
    bag: sqlite3.Connection = old_bag(path)
    bag.executescript(
        "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        " SELECT 1 AS topic_id, i AS timestamp, x'00010000' AS data FROM n"
    )
    bag.commit()
    bag.close()
    assert (summary_of(path).messages, summary_of(path).cut) == (0, Damage.NO_BAG())
