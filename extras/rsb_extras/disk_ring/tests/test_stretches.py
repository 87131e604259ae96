"""Stretches that are kept: what is in them, what joins, what goes, and what survives a power cut."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rosbags.highlevel import AnyReader

from rsb_extras.disk_ring.ring_codes import RingCode
from rsb_extras.disk_ring.tests.ring_bed import FRAMES, RingBed, metadata, texts
from rsb_extras.recording import RecordLimits

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def bed(tmp_path: Path) -> Iterator[RingBed]:
    found = RingBed(tmp_path)
    yield found
    found.close()


def at(first: int, last: int) -> list[str]:
    return [f"at {number}" for number in range(first, last + 1)]


def test_before_and_after_are_kept_without_a_gap(bed: RingBed) -> None:
    bed.write("frame", topic=FRAMES)
    bed.pass_time(200)
    bed.keep()
    bed.pass_time(40)
    (stretch,) = bed.stretches
    assert re.fullmatch(r"robot1-202311\d\d-\d{6}-fault", stretch.name)
    found = texts(stretch)
    assert found[-1] == "at 1230"
    assert found == at(int(found[0].split()[1]), 1230)
    assert 60 <= 1200 - int(found[0].split()[1]) <= 91
    assert RingCode.KEPT in bed.codes()


def test_every_reader_takes_the_folder(bed: RingBed) -> None:
    bed.write("frame", topic=FRAMES)
    bed.pass_time(70)
    bed.keep()
    bed.pass_time(31)
    (stretch,) = bed.stretches
    found = metadata(stretch)
    assert found["version"] == 9
    assert found["relative_file_paths"] == [f"{stretch.name}_{number}.mcap" for number in range(len(found["files"]))]
    assert found["custom_data"]["cause"] == "fault"
    with AnyReader([stretch]) as reader:
        messages = list(reader.messages())
    assert len(messages) == found["message_count"]
    assert {connection.topic for connection, _, _ in messages} == {"/chat", "/tf_static"}


def test_second_fault_joins(bed: RingBed) -> None:
    bed.pass_time(100)
    bed.keep()
    bed.pass_time(20)
    bed.keep("link")
    bed.pass_time(40)
    (stretch,) = bed.stretches
    assert texts(stretch)[-1] == "at 1150"
    assert " link /chat" in metadata(stretch)["custom_data"]["also"]


def test_note_gives_it_its_name(bed: RingBed) -> None:
    bed.pass_time(100)
    bed.keep()
    bed.pass_time(20)
    where = bed.keep("note", "lens is dirty")
    bed.pass_time(40)
    (stretch,) = bed.stretches
    assert where == stretch
    assert stretch.name.endswith("-note")
    assert metadata(stretch)["custom_data"]["note"] == "lens is dirty"


def test_two_faults_apart_are_two(bed: RingBed) -> None:
    for _ in range(2):
        bed.pass_time(100)
        bed.keep()
    bed.pass_time(31)
    assert len(bed.stretches) == 2


def test_fault_that_comes_and_goes_ends(bed: RingBed) -> None:
    for _ in range(70):
        bed.keep()
        bed.pass_time(10)
    assert len(bed.stretches) == 1, "the next one has begun"
    assert texts(bed.stretches[0])[-1] == "at 1600"


def test_stretch_outlives_the_ring(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.01, free=0.0, before=10.0, after=5.0))
    bed.pass_time(20)
    bed.keep()
    for _ in range(300):
        bed.write(os.urandom(40_000).hex())
    bed.pass_time(6)
    (stretch,) = bed.stretches
    assert texts(stretch)[:15] == at(1001, 1015), "the ring has no room for them any more"
    bed.end()


def test_oldest_goes_and_an_operators_stays(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.1, free=0.0, before=0.0, after=1.0, kept=0.01))
    for reason in ("note", "fault", "link"):
        bed.keep(reason)
        for _ in range(100):
            bed.write(os.urandom(45_000).hex())
        bed.pass_time(2)
    names = [each.name.rpartition("-")[2] for each in bed.stretches]
    assert names == ["note", "link"]
    assert RingCode.REMOVED in bed.codes()
    bed.end()


def test_operators_stretches_fill_the_bound(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.1, free=0.0, before=0.0, after=1.0, kept=0.01))
    for _ in range(2):
        bed.keep("note")
        for _ in range(100):
            bed.write(os.urandom(45_000).hex())
        bed.pass_time(2)
    assert len(bed.stretches) == 2
    bed.pass_time(2)
    for _ in range(100):
        bed.write(os.urandom(45_000).hex())
    bed.keep("note")
    bed.pass_time(2)
    assert len(bed.stretches) == 2, "and none was removed"
    assert RingCode.NOT_KEPT in bed.codes()
    bed.end()


def test_folders_of_others_are_not_removed(tmp_path: Path) -> None:
    own = tmp_path / "recordings" / "drive-with-fault"
    own.mkdir(parents=True)
    for name in ("metadata.yaml", "drive_0.mcap"):
        (own / name).write_bytes(bytes(9_000_000))
    os.utime(own / "metadata.yaml", (0.0, 0.0))
    bed = RingBed(tmp_path, RecordLimits(disk=0.1, free=0.0, before=0.0, after=1.0, kept=0.02))
    for _ in range(3):
        bed.keep("fault")
        for _ in range(100):
            bed.write(os.urandom(45_000).hex())
        bed.pass_time(2)
    assert own.exists()
    bed.end()


def test_damaged_file_in_a_stretch_does_not_stop_the_ring(bed: RingBed) -> None:
    bed.pass_time(40)
    bed.keep()
    (part,) = (bed.state / "recordings").glob(".*")
    (first,) = part.glob("*.mcap")
    first.write_bytes(first.read_bytes()[:-40] + bytes(40))
    bed.pass_time(31)
    assert metadata(bed.stretches[0])["message_count"] == 70, "of the file without an index, too"


def test_cut_stretch_is_finished_by_the_next_process(tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    bed.pass_time(100)
    bed.keep("note", "it fell")
    bed.pass_time(10)
    bed.close()
    after = RingBed(tmp_path, now=1200.0)
    (stretch,) = after.stretches
    assert texts(stretch)[-1] == "at 1110"
    assert "cut" in metadata(stretch)["custom_data"]
    after.end()
    assert not [*(tmp_path / "recordings").glob(".*")]


def test_stretch_ends_with_the_bridge(bed: RingBed) -> None:
    bed.pass_time(10)
    bed.keep()
    bed.pass_time(5)
    bed.end()
    (stretch,) = bed.stretches
    assert texts(stretch) == at(1001, 1015)


def test_file_system_without_links_has_a_copy(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    bed.pass_time(70)
    bed.keep()
    bed.pass_time(31)
    assert texts(bed.stretches[0]) == at(1001, 1100)


def test_failure_within_a_stretch_leaves_no_gap(bed: RingBed) -> None:
    bed.pass_time(10)
    bed.keep()
    bed.pass_time(10)
    bed.files.abandon()
    bed.files.begin()
    bed.pass_time(21)
    (stretch,) = bed.stretches
    assert texts(stretch) == at(1001, 1040)


def test_stretch_that_got_full_has_no_gap(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.1, free=0.0, before=0.0, after=30.0, kept=0.01))
    bed.keep()
    for number in range(300):
        bed.write(f"{number} {os.urandom(45_000).hex()}")
        if RingCode.NOT_KEPT in bed.codes():
            break
    bed.write("small, so that it has room")
    assert isinstance(bed.keep("note"), str), "and a later cause does not go on with it"
    bed.pass_time(2)
    kept = [each.partition(" ")[0] for each in texts(bed.stretches[0])]
    assert kept == [f"{number}" for number in range(len(kept))]
    bed.end()


def test_stretch_that_cannot_begin_leaves_nothing(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    bed.pass_time(70)
    with monkeypatch.context() as patch:
        patch.setattr("rsb_extras.disk_ring.stretches.os.link", _fail)
        patch.setattr("rsb_extras.disk_ring.stretches.shutil.copyfile", _fail)
        bed.keep()
    assert RingCode.NOT_KEPT in bed.codes()
    assert not [*(bed.state / "recordings").iterdir()]


def test_stretch_without_room_removes_none(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.1, free=0.0, before=100.0, after=1.0, kept=0.01))
    bed.pass_time(5)
    bed.keep()
    bed.pass_time(2)
    for _ in range(300):
        bed.write(os.urandom(45_000).hex())
    assert "record.kept" in str(bed.keep("note"))
    assert len(bed.stretches) == 1
    bed.end()


def test_power_cut_while_a_stretch_gets_its_name(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    bed.pass_time(70)
    bed.keep()
    with monkeypatch.context() as patch:
        patch.setattr("rsb_extras.disk_ring.stretches.bag_metadata", _fail)
        bed.pass_time(31)
    bed.close()
    after = RingBed(bed.state, now=1200.0)
    assert texts(after.stretches[0]) == at(1001, 1100)
    after.end()


def keep_unreadable(bed: RingBed, monkeypatch: pytest.MonkeyPatch, error: OSError, ends: str) -> None:
    """Keep a stretch of which no file whose name ends so can be read."""
    bed.pass_time(70)
    bed.keep()
    opened = Path.open

    def open_path(path: Path, *arguments: Any, **options: Any) -> Any:
        if path.name.endswith(ends) and arguments == ("rb",):
            raise error
        return opened(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", open_path)
        bed.pass_time(31)


def test_a_passing_error_makes_no_empty_stretch(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its metadata would say 0 messages for ever: the next process finishes it."""
    keep_unreadable(bed, monkeypatch, OSError(errno.EMFILE, "too many open files"), ".mcap")
    assert RingCode.NOT_KEPT in bed.codes()
    bed.close()
    after = RingBed(bed.state, now=1200.0)
    assert texts(after.stretches[0]) == at(1001, 1100)
    after.end()


def test_file_that_may_not_be_read_is_told_once(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stretch is whole without it: it was left unfinished, and ended the ring at each start."""
    keep_unreadable(bed, monkeypatch, PermissionError(errno.EACCES, "Permission denied"), "_0.mcap")
    (stretch,) = bed.stretches
    found = metadata(stretch)
    assert found["files"][0]["message_count"] == 0
    assert found["message_count"] > 0, "of the others"
    assert bed.codes().count(RingCode.UNREAD) == 1
    assert RingCode.NOT_KEPT not in bed.codes()
    bed.end()


def test_file_that_is_gone_is_not_in_the_metadata(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_unreadable(bed, monkeypatch, FileNotFoundError(errno.ENOENT, "No such file or directory"), "_0.mcap")
    (stretch,) = bed.stretches
    found = metadata(stretch)
    assert f"{stretch.name}_0.mcap" not in found["relative_file_paths"]
    assert len(found["relative_file_paths"]) == len(found["files"]) > 0
    assert RingCode.NOT_KEPT not in bed.codes()
    bed.end()


def _fail(*_: object) -> None:
    raise OSError
