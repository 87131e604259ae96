"""A ring whose power is cut at any byte: what is lost, and who reads the rest."""

from __future__ import annotations

import os
import shutil
from random import Random
from typing import TYPE_CHECKING

import pytest
from rosbags.highlevel import AnyReader

from rsb_extras.disk_ring.ring_codes import RingCode
from rsb_extras.disk_ring.tests.power_cut_cost import RANDOM_TAILS, cut, written
from rsb_extras.disk_ring.tests.ring_bed import RingBed, texts
from rsb_extras.recording import RecordLimits

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("tail", RANDOM_TAILS)
@pytest.mark.parametrize("seed", range(5))
def test_whole_chunks_survive_a_power_cut(tail: str, seed: int, tmp_path: Path) -> None:
    before = written(tmp_path / "before", Random(seed))
    cut(before, tail, Random(seed))
    after = RingBed(before.state, now=before.now + 100.0)
    found = [each for path in after.segments for each in texts(path)]
    assert found == before.all[: len(found)], "in order, and nothing between is missing"
    assert len(found) >= before.synced, "what the disk had is there"
    for path in after.segments:
        with AnyReader([path]) as reader:
            assert [*reader.messages()]
    after.write("goes on")
    after.end()
    assert texts(after.segments[-1]) == ["goes on"]


@pytest.mark.parametrize("size", [0, 1, 8, 30])
def test_file_without_a_chunk_goes(size: int, tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    bed.pass_time(40)
    bed.close()
    os.truncate(bed.segments[-1], size)
    after = RingBed(tmp_path, now=1100.0)
    assert len(after.segments) == 1
    assert RingCode.RECOVERED in after.codes()
    after.end()


def test_cut_file_is_as_old_as_it_was(tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    bed.pass_time(5)
    bed.close()
    wall = bed.wall - 1000.0
    os.utime(bed.segments[0], (wall, wall))
    after = RingBed(tmp_path, RecordLimits(disk=1.0, disk_seconds=100.0, free=0.0), now=bed.now)
    assert RingCode.RECOVERED in after.codes()
    after.files.look_after(0)
    assert not after.segments
    after.end()


def test_power_cut_while_completing(tmp_path: Path) -> None:
    bed = RingBed(tmp_path)
    bed.pass_time(5)
    bed.close()
    (segment,) = bed.segments
    shutil.copy(segment, segment.with_suffix(".whole"))
    shutil.copy(segment, segment.with_name(f".{segment.stem}.whole.part"))
    after = RingBed(tmp_path, now=1100.0)
    assert [each.name for each in after.files.folder.iterdir()] == [segment.name]
    assert len(texts(segment)) == 5
    after.end()
