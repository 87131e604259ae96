"""The ring on disk: bounds, what each segment begins with, and what survives."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

import pytest

from rsb_extras.disk_ring.ring_codes import RingCode
from rsb_extras.disk_ring.tests.ring_bed import FRAMES, LATCHED, RingBed, message, spec, texts
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.latched_messages import LatchedMessages
from rsb_extras.recording.tests.recordings import read, read_strictly

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LARGE = "x" * 100_000


@pytest.fixture
def bed(tmp_path: Path) -> Iterator[RingBed]:
    found = RingBed(tmp_path)
    yield found
    found.close()


def test_segments_follow_each_other_without_a_gap(bed: RingBed) -> None:
    bed.pass_time(100)
    bed.end()
    assert len(bed.segments) == 4, "30 s each"
    assert [each for path in bed.segments for each in texts(path)] == [f"at {1000 + n}" for n in range(1, 101)]


def test_each_segment_begins_complete(bed: RingBed) -> None:
    bed.write("left", topic=FRAMES, publisher=b"left")
    bed.write("right", topic=FRAMES, publisher=b"right")
    bed.pass_time(100)
    bed.end()
    for path in bed.segments:
        assert read(path)[0].topic == "/tf_static"
        assert texts(path, "/tf_static") == ["left", "right"]
        (schema, channel, message), *_ = read_strictly(path)
        assert (schema.data, channel.metadata["topic_type_hash"]) == (b"string data\n", FRAMES.type_hash)
        assert "transient_local" in channel.metadata["offered_qos_profiles"]
        assert message.publish_time < int(1_700_001_001e9), "its own time of publication"


def test_nothing_pushes_out_a_static_transform(bed: RingBed) -> None:
    bed.write("stays", topic=FRAMES, publisher=b"once")
    for number in range(300):
        bed.write(f"again {number} {LARGE}", topic=FRAMES, publisher=b"often")
    bed.pass_time(700)
    bed.end()
    assert texts(bed.segments[-1], "/tf_static")[0] == "stays"
    assert len(texts(bed.segments[-1], "/tf_static")) == 2


@pytest.mark.parametrize("publisher", [b"", b"one"])
def test_latched_messages_at_a_rate_cost_little(publisher: bytes) -> None:
    latched = LatchedMessages()
    began = time.process_time()
    for number in range(6000):
        latched.add(message(float(number), f"at {number}", FRAMES, publisher))
    assert time.process_time() - began < 2.0, "0.1 s; 10 s where each message looks at all before"
    kept = [*latched]
    assert sum(each.cost for each in kept) == latched.size <= (64 << 10) * (1 if publisher else 16) + kept[-1].cost
    assert [each.at for each in kept] == [float(number) for number in range(6000 - len(kept), 6000)]


def test_bytes_are_bounded(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=0.01, free=0.0))
    for _ in range(400):
        bed.now += 0.01
        bed.write(os.urandom(40_000).hex())
        assert sum(each.stat().st_size for each in bed.segments) <= 10_000_000
    bed.end()
    assert sum(each.stat().st_size for each in bed.segments) > 7_000_000


def test_seconds_are_bounded(tmp_path: Path) -> None:
    bed = RingBed(tmp_path, RecordLimits(disk=1.0, disk_seconds=80.0, free=0.0))
    bed.pass_time(300)
    bed.end()
    kept = [each for path in bed.segments for each in texts(path)]
    assert kept[-1] == "at 1300"
    assert 80 <= len(kept) <= 92


def test_ring_gives_way_to_free_space(bed: RingBed, monkeypatch: pytest.MonkeyPatch) -> None:
    bed.pass_time(100)
    free = iter([False, False, True, True, False, False])
    monkeypatch.setattr(bed.files, "_lacks_space", lambda: next(free))
    bed.files.trim()
    assert len(bed.segments) == 4, "there is room"
    bed.files.trim()
    assert len(bed.segments) == 2, "the oldest two are gone"
    monkeypatch.setattr(bed.files, "_lacks_space", lambda: True)
    with pytest.raises(OSError, match=r"lower record\.free"):
        bed.files.trim()


def test_next_process_goes_on(tmp_path: Path) -> None:
    first = RingBed(tmp_path)
    first.pass_time(100)
    first.end()
    before = first.segments
    second = RingBed(tmp_path, now=1200.0)
    second.pass_time(10)
    second.end()
    assert second.segments[:-1] == before
    assert texts(second.segments[-1])[0] == "at 1201"


def test_two_bridges_of_one_name_have_a_ring_each(tmp_path: Path) -> None:
    first, second = RingBed(tmp_path), RingBed(tmp_path)
    assert first.files.folder != second.files.folder
    for each in (first, second):
        each.end()


def test_killed_bridge_loses_what_was_not_written(tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    bed.pass_time(5)
    bed.write("not on disk yet")
    bed.close()
    after = RingBed(tmp_path, now=1010.0)
    assert texts(after.segments[0])[:5] == [f"at {1000 + n}" for n in range(1, 6)]
    assert RingCode.RECOVERED in after.codes()
    after.end()


def test_compression_ends_where_it_would_cost_a_core(bed: RingBed) -> None:
    for _ in range(1000):
        bed.now += 0.001
        bed.write(LARGE)
    bed.files.finish_segment()
    quiet = bed.segments[0].stat().st_size
    for _ in range(1000):
        bed.now += 0.001
        bed.write(LARGE)
    bed.end()
    assert quiet < 10_000_000, "100 MB of one letter"
    assert bed.segments[1].stat().st_size > 30_000_000


def test_larger_head_makes_longer_segments(bed: RingBed) -> None:
    bed.write(LARGE * 10, topic=spec("/map", LATCHED))
    bed.pass_time(300)
    bed.end()
    assert len(bed.segments) == 2, "a map again each 30 s would be most of the ring"


def test_others_files_are_left_alone(tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    strange = [bed.files.folder / name for name in ("notes.txt", "mine.mcap")]
    for path in strange:
        path.write_text("mine")
    bed.close()
    RingBed(tmp_path).end()
    assert all(path.exists() for path in strange)
