"""Whatever a robot says of its messages, each of them is in the file once, in bounds, or the fetch ends with words."""

from __future__ import annotations

import os
import sqlite3
from collections import Counter
from contextlib import closing
from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.support.wording import pattern

from rsb_extras.courier.completed_recording import AskedCompletion, CompletedName
from rsb_extras.courier.completion_spool import CompletionProblem, CompletionSpool
from rsb_extras.courier.courier_records import LATEST, ListedRecording, Wanted
from rsb_extras.courier.fetch_spool import AskedFetch
from rsb_extras.courier.live_parts import LivePart, keep_parts
from rsb_extras.courier.message_index import MessageIndex
from rsb_extras.courier.picking import picked
from rsb_extras.courier.pieces import Cutter, PieceError, encode_piece
from rsb_extras.courier.tests.bags import BEGAN, channel, in_bag, write_bag
from rsb_extras.courier.tests.courier_places import MOST_COMPARED
from rsb_extras.recording.reading.open_recording import OpenRecording
from rsb_extras.recording.reading.stored_message import StoredMessage

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

KEY = "0123456789abcdef"
TOPICS = ("/scan", "/tf", "/tf_static")
LATCHED = channel("/tf_static")._replace(profiles="- durability: transient_local\n")
TIMES = (0, 1, BEGAN, BEGAN + 1, BEGAN + 10**9, LATEST - 1, LATEST)
NUMBERS = (0, 1, 2, 3, 1000, 2**31, 2**32 - 1)
CONTENTS = (b"", b"\0", b"\0\1\0\0", b"\0\1\0\0same", b"\0\1\0\0other", bytes(5000))


def hostile(random: Random, count: int, topics: Iterable[str] = TOPICS) -> list[StoredMessage]:
    channels = [channel(each, f"/node{at}") if each != "/tf_static" else LATCHED for at, each in enumerate(topics)]
    found = [
        StoredMessage(
            random.choice(channels),
            random.choice((*TIMES, random.randrange(BEGAN, BEGAN + 10**10))),
            random.choice((0, BEGAN, 2**63, 2**64 - 1)),
            random.choice(NUMBERS),
            memoryview(random.choice((*CONTENTS, random.randbytes(9)))),
        )
        for _ in range(count)
    ]
    return sorted(found, key=lambda each: each.time)


def spool(folder: Path, live: list[StoredMessage], ahead: float | None) -> CompletionSpool:
    write_bag(folder / "live.mcap", live)
    names = tuple(CompletedName(each, each, comes=each != "/tf") for each in TOPICS)
    wanted = Wanted(KEY, KEY, TOPICS, heads=True)
    asked = AskedFetch(
        "made", "", "", ListedRecording(KEY, "drive", KEY), wanted, "", AskedCompletion(names, ahead=ahead)
    )
    return CompletionSpool(folder / ".made.fetch", asked, [LivePart(folder / "live.mcap", 0, 0)]).make()


def get_all(made: CompletionSpool, robot: OpenRecording) -> None:
    """Get what is asked for, as over a link."""
    run = 0
    while (row := made.next_row(lambda: False)) is not None:
        run += 1
        cutter = Cutter(run, picked(robot, row.wanted, row.wanted.topics, row.at.time), row.at, row.known)
        while not row.is_whole:
            piece = cutter.next()
            row.add(piece, encode_piece(piece))


@pytest.mark.parametrize("seed", range(30))
def test_each_message_is_there_once_whatever_it_says(seed: int, tmp_path: Path) -> None:
    random = Random(seed)
    there = write_bag(tmp_path / "robot.mcap", hostile(random, 300))
    chosen = [each for each in there if random.random() < 0.5]
    live = sorted([*chosen, *hostile(random, 20)], key=lambda each: each.time)
    made = spool(tmp_path, live, random.choice((None, 0.0, -1e9, 1e300)))
    get_all(made, OpenRecording(tmp_path / "robot.mcap"))
    made.write(lambda: False)
    assert made.completed is not None
    written = in_bag(made.path)
    assert [each.time for each in written] == sorted(each.time for each in written)
    assert all(0 <= each.published <= each.time <= LATEST for each in written)
    counts = Counter((each.channel.topic, bytes(each.content)) for each in written)
    expected = Counter((each.channel.topic, bytes(each.content)) for each in there if each.channel is not LATCHED)
    assert not expected - counts, "all of the robot's are there"
    assert (counts - expected).total() <= len(live) + sum(each.channel == LATCHED for each in there)
    assert sum(each.fetched + each.live for each in made.completed.topics) == len(written)


def test_more_messages_than_can_be_compared_end_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    MOST_COMPARED.set(monkeypatch, 100)
    there = write_bag(tmp_path / "robot.mcap", hostile(Random(1), 300))
    made = spool(tmp_path, there[:3], 0.0)
    with pytest.raises(PieceError, match=pattern(CompletionProblem.TOO_MANY)):
        get_all(made, OpenRecording(tmp_path / "robot.mcap"))
    made.remove()
    assert not made.folder.exists()


def test_contents_that_are_not_those_of_the_heads_are_left_out(tmp_path: Path) -> None:
    """They are told as not given."""
    there = hostile(Random(1), 100, ["/scan"])
    write_bag(tmp_path / "robot.mcap", there)
    write_bag(tmp_path / "other.mcap", [each._replace(content=memoryview(b"a lie")) for each in there])
    made = spool(tmp_path, there[:50], 0.0)
    while not made.rows[0].is_whole:
        row = made.rows[0]
        piece = Cutter(
            1, picked(OpenRecording(tmp_path / "robot.mcap"), row.wanted, TOPICS, 0), row.at, row.known
        ).next()
        row.add(piece, encode_piece(piece))
    get_all(made, OpenRecording(tmp_path / "other.mcap"))
    made.write(lambda: False)
    assert made.completed is not None
    scan = made.completed.topics[0]
    assert scan.fetched == 0
    assert scan.missing >= len(there) - 50 - scan.only_live
    assert not any(bytes(each.content) == b"a lie" for each in in_bag(made.path))


def test_an_index_that_fails_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = write_bag(tmp_path / "robot.mcap", hostile(Random(1), 100, ["/scan"]))
    made = spool(tmp_path, there[:50], 0.0)
    get_all(made, OpenRecording(tmp_path / "robot.mcap"))

    def fails(_: MessageIndex) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    with monkeypatch.context() as patched:
        patched.setattr(MessageIndex, "begin_fetched", fails)
        with pytest.raises(OSError, match="disk I/O error"):
            made.write(lambda: False)
    assert made.write(lambda: False) >= len(there)


def test_pieces_of_another_order_are_none_of_this_one(tmp_path: Path) -> None:
    """A bridge of another version may find other messages missing."""
    scan = channel("/scan")
    there = [StoredMessage(scan, BEGAN + n, BEGAN + n, n + 1, memoryview(b"\0\1\0\0%d" % n)) for n in range(200)]
    write_bag(tmp_path / "robot.mcap", there)
    robot = OpenRecording(tmp_path / "robot.mcap")
    before = spool(tmp_path, there[1::2], 0.0)
    get_all(before, robot)
    before.close()
    (part,) = (before.folder / "live").iterdir()
    part.unlink()
    write_bag(part, there[3::4])
    after = CompletionSpool(before.folder, before.asked)
    after.rows[0].load(lambda: False)
    get_all(after, robot)
    assert after.write(lambda: False) == len(there)


def test_what_the_ring_let_go_meanwhile_is_fetched(tmp_path: Path) -> None:
    there = write_bag(tmp_path / "robot.mcap", hostile(Random(1), 100, ["/scan"]))
    made = spool(tmp_path, [], None)
    made.remove()
    parts = [LivePart(tmp_path / "gone.mcap", 0, 0), LivePart(tmp_path / "live.mcap", 0, 0)]
    made = CompletionSpool(made.folder, made.asked, parts).make()
    get_all(made, OpenRecording(tmp_path / "robot.mcap"))
    assert made.write(lambda: False) == len(there)


@pytest.mark.parametrize("is_old", [False, True])
def test_a_database_that_may_be_written_is_copied(tmp_path: Path, *, is_old: bool) -> None:
    bag = tmp_path / "drive.db3"
    bag.write_bytes(b"any")
    if is_old:
        os.utime(bag, (0, 0))
    keep_parts([LivePart(bag, 0, 0)], tmp_path / "live")
    assert bag.stat().st_nlink == 1 + is_old
    assert (tmp_path / "live" / "0001.db3").read_bytes() == b"any"


def test_a_file_of_that_name_stays(tmp_path: Path) -> None:
    """An operator has put one there while it was fetched."""
    there = write_bag(tmp_path / "robot.mcap", hostile(Random(1), 50))
    made = spool(tmp_path, there[:10], 0.0)
    own = tmp_path / "made.mcap"
    own.write_bytes(b"mine")
    get_all(made, OpenRecording(tmp_path / "robot.mcap"))
    count = made.write(lambda: False)
    assert own.read_bytes() == b"mine"
    assert made.path == tmp_path / "made-2.mcap"
    assert len(in_bag(made.path)) == count
    assert not made.folder.exists()


def test_an_index_stays_interrupted(tmp_path: Path) -> None:
    """Between two statements, too: the next one may take minutes."""
    names = [CompletedName("/scan", "/scan")]
    index = MessageIndex(tmp_path / "messages.db", names, lambda: None)
    index.add_live(enumerate([each._replace(channel=channel("/scan")) for each in hostile(Random(1), 5000)], 1))
    index.interrupt()
    with pytest.raises(sqlite3.OperationalError, match="interrupted"):
        index.compare(None)
    index.close()


def test_what_a_database_holds_in_its_log_is_kept(tmp_path: Path) -> None:
    """While something writes to it, or if that was killed."""
    bag = tmp_path / "run_0.db3"
    with closing(sqlite3.connect(bag, isolation_level=None)) as writer:
        writer.execute("PRAGMA journal_mode = WAL")
        writer.execute("PRAGMA wal_autocheckpoint = 0")
        writer.executescript(
            "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB);"
            "INSERT INTO topics VALUES (1, '/scan', 'std_msgs/msg/String', 'cdr');"
        )
        writer.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", [(at, at, b"\0\1\0\0") for at in range(1, 9)])
        os.utime(bag, (0, 0))
        keep_parts([LivePart(bag, 1, 8)], tmp_path / "live")
        (kept,) = (tmp_path / "live").iterdir()
        assert [each.time for each in OpenRecording(kept).messages()] == [*range(1, 9)]
