"""Power cuts of a ring on disk. As a program, it prints what a hundred of them lose."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from random import Random

from rsb_extras.disk_ring.tests.ring_bed import RingBed, texts

RANDOM_TAILS = ("lost", "cut", "zeros", "another's")
"""What a disk has of what it was not told to keep: nothing; a part; zeros; the bytes of another file."""


class WrittenBed(RingBed):
    """A ring that a bridge wrote until it was killed.

    Attributes:
        all: the messages, in order.
        synced: the number of those that the disk was told to keep.
        kept: bytes of its newest segment then.
    """

    all: list[str]
    synced: int
    kept: int


def written(state: Path, random: Random) -> WrittenBed:
    """Write some segments, and a part of one that the disk was not told to keep."""
    bed = WrittenBed(state)
    bed.all = []

    def write() -> None:
        bed.all.append(f"{len(bed.all)} {'x' * random.randrange(3_000)}")
        bed.write(bed.all[-1])

    for _ in range(random.randrange(20, 120)):
        bed.now += 1.0
        for _ in range(random.randrange(1, 8)):
            write()
        bed.files.look_after(0)
    write()
    bed.files.sync()
    bed.synced, bed.kept = len(bed.all), bed.segments[-1].stat().st_size
    for _ in range(random.randrange(40)):
        write()
    if random.randrange(2):  # the system has had it, and the disk not yet
        bed.files.sync()
    bed.close()
    return bed


def cut(bed: WrittenBed, tail: str, random: Random) -> None:
    """Have the disk lose what it was not told to keep of the newest segment."""
    path = bed.segments[-1]
    size = path.stat().st_size
    at = random.randrange(bed.kept, size + 1)
    os.truncate(path, bed.kept if tail == "lost" else at)
    if tail in ("zeros", "another's"):
        rest = size - at + random.randrange(10_000)
        with path.open("ab") as file:
            file.write(bytes(rest) if tail == "zeros" else random.randbytes(rest))


def main() -> None:
    cuts = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    segments = messages = lost = lost_segments = unsynced = disordered = 0
    for seed in range(cuts):
        random = Random(seed)
        with tempfile.TemporaryDirectory() as folder:
            bed = written(Path(folder), random)
            before = len(bed.segments)
            cut(bed, RANDOM_TAILS[seed % len(RANDOM_TAILS)], random)
            after = RingBed(bed.state, now=bed.now + 100.0)
            found = [each for path in after.segments for each in texts(path)]
            segments += before
            lost_segments += before - len(after.segments)
            messages += len(bed.all)
            lost += max(0, bed.synced - len(found))
            unsynced += len(bed.all) - max(bed.synced, len(found))
            disordered += found != bed.all[: len(found)]
            after.end()
    print(
        f"{cuts} cuts: {segments} segments, {lost_segments} lost; {messages} messages, {lost} lost that the disk had,"
    )
    print(f"{unsynced} lost of the last second; {disordered} rings with a gap or another order")


if __name__ == "__main__":
    main()
