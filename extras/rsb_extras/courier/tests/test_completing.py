"""What came live on one side of two real bridges is completed by a recording of the other side."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

import msgspec
import pytest
from mcap.reader import make_reader
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_extras.courier import RecordingFolders
from rsb_extras.courier.completed_recording import (
    ClockSource,
    CompletedClock,
    CompletedRecording,
    CompletedTopic,
    MissingReason,
)
from rsb_extras.courier.completion_spool import METADATA, completed_in
from rsb_extras.courier.courier_records import LATEST
from rsb_extras.courier.courier_requests import CancelFetch, FetchRecording, FetchState, ReadCompleted
from rsb_extras.courier.tests.bags import BEGAN, SECOND, channel, in_bag, write_bag
from rsb_extras.courier.tests.courier_bed import done, fetches, report, slow_link, two_sides
from rsb_extras.recording.mcap_file import new_recording
from rsb_extras.recording.reading.stored_message import StoredMessage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine
    from rsb_extras.courier.courier_requests import FetchReport

BEHIND = 3 * SECOND + 123
"""ns by which the clock of the robot is behind, and the time on the way."""
LATCHED = channel("/tf_static")._replace(profiles="- durability: transient_local\n  depth: 1\n")


def on_robot(seconds: int, topics: Iterable[str] = ("/scan", "/tf"), *, rate: int = 20) -> list[StoredMessage]:
    """Messages that the robot recorded; every fifth of a topic is the same as others."""
    random = Random(7)
    found = []
    for at in range(rate * seconds):
        for place, topic in enumerate(topics):
            time = BEGAN + at * SECOND // rate + place
            content = b"\0\1\0\0" + (b"same" if at % 5 == 0 else random.randbytes(1000))
            found.append(StoredMessage(channel(topic), time, time - 1, at + 1, memoryview(content)))
    return found


def came(message: StoredMessage, late: int = 0) -> StoredMessage:
    """Return a message as it came live."""
    return message._replace(time=message.time + BEHIND + late, published=message.published + BEHIND, number=0)


def expected(message: StoredMessage) -> StoredMessage:
    return message._replace(time=message.time + BEHIND, published=message.published + BEHIND)


def live(bags: Path, content: Iterable[StoredMessage], name: str = "robot1-20260730-101500.mcap") -> None:
    """Write what a bridge of this side has recorded."""
    folder = bags.parent / "state" / "rsb-console" / "recordings"
    folder.mkdir(parents=True, exist_ok=True)
    write_bag(folder / name, sorted(content, key=lambda each: each.time))


def mostly_missing(bags: Path) -> list[StoredMessage]:
    """Return 100 s of messages that the robot has recorded, of which this side has each seventh."""
    written = write_bag(bags / "drive.mcap", on_robot(100))
    live(bags, (came(each) for each in written if each.number % 7 == 0))
    return written


def complete(engine: Engine, *topics: str, begin: int = 0, end: int = LATEST, live: str = "") -> str:
    return engine.do(FetchRecording("robot1", "drive.mcap", topics, begin, end, completes=True, live=live)).result(60)


def completed(engine: Engine, *topics: str, **asked: str | int) -> tuple[FetchReport, CompletedRecording]:
    found = done(engine, complete(engine, *topics, **asked))  # type: ignore[arg-type]
    assert found.completed is not None
    return found, found.completed


def test_each_message_is_there_once_on_one_clock(bridge: Bridge, bags: Path) -> None:
    """Of what was lost here and there, in an outage, late behind it, and equal to others."""
    written = write_bag(bags / "drive.mcap", on_robot(20))
    random = Random(1)
    outage = range(BEGAN + 5 * SECOND, BEGAN + 12 * SECOND)
    late = outage.stop - SECOND
    live(
        bags,
        [
            came(each, max(0, outage.stop - each.time) if each.time in outage else random.randrange(2_000_000))
            for each in written
            if (each.time not in outage or each.time > late) and random.random() > 0.1
        ],
    )
    pc, _ = two_sides(bridge, bags)
    found, result = completed(pc)
    made = in_bag(bags.parent / found.path)
    assert result.clock.source is ClockSource.MESSAGES
    off = result.clock.offset - BEHIND
    assert 0 <= off < 2_000_000
    assert [each._replace(time=each.time - off, published=each.published - off) for each in made] == [
        expected(each) for each in written
    ]
    assert [(each.name, each.live + each.fetched, each.missing, each.only_live) for each in result.topics] == [
        ("/scan", 400, 0, 0), ("/tf", 400, 0, 0),
    ]  # fmt: skip
    assert result.fetched < 0.5 * result.whole
    assert found.taken < 0.6 * (bags / "drive.mcap").stat().st_size
    with Path(found.path).open("rb") as file:
        (record,) = make_reader(file).iter_metadata()
    assert record.name == "rsb_completed"
    assert msgspec.json.decode(record.metadata["json"], type=CompletedRecording) == result


def test_the_file_tells_what_is_missing_after_a_restart(bridge: Bridge, bags: Path) -> None:
    mostly_missing(bags)
    pc, _ = two_sides(bridge, bags)
    found, result = completed(pc)
    pc.stop()
    pc = bridge.server()
    assert pc.do(ReadCompleted(Path(found.path).name)).result(60) == result
    for name, reason in (("robot1-2", "completes no recording"), ("nothing", "has no recording nothing")):
        with pytest.raises(EngineError, match=reason):
            pc.do(ReadCompleted(name)).result(60)


@pytest.mark.parametrize("change", [lambda head: head[:60], lambda head: head])
def test_a_file_that_says_anything_completes_nothing(change: Callable[[bytes], bytes], tmp_path: Path) -> None:
    path = tmp_path / "any.mcap"
    text = msgspec.json.encode(CompletedRecording(CompletedClock(ClockSource.NONE), (CompletedTopic("/a", "/b", 300),)))
    with new_recording(path, metadata={METADATA: {"json": text.decode()}}):
        pass
    assert completed_in(path.read_bytes()) is not None
    assert completed_in(change(path.read_bytes().replace(b'"live":300', b'"live":"3"'))) is None


def test_nothing_is_fetched_that_came(bridge: Bridge, bags: Path) -> None:
    written = write_bag(bags / "drive.mcap", on_robot(20))
    live(bags, map(came, written))
    pc, _ = two_sides(bridge, bags)
    found, result = completed(pc)
    assert (found.messages, result.fetched) == (len(written), 0)
    assert found.taken < 0.1 * (bags / "drive.mcap").stat().st_size


def test_without_anything_live_the_remedy_is_told(bridge: Bridge, bags: Path) -> None:
    write_bag(bags / "drive.mcap", on_robot(1))
    pc, _ = two_sides(bridge, bags)
    with pytest.raises(EngineError, match=r"no recording of /scan, /tf from then: .* record: \{disk: 2\}"):
        complete(pc)
    assert not fetches(pc)


def test_latched_messages_come_again_and_count_once(bridge: Bridge, bags: Path) -> None:
    """Each segment begins with them, and each new subscription gets them again."""
    frames = StoredMessage(LATCHED, BEGAN, BEGAN - 9, 1, memoryview(b"\0\1\0\0frames"))
    again = frames._replace(time=BEGAN + SECOND)
    other = StoredMessage(LATCHED, BEGAN + 2 * SECOND, BEGAN + 2 * SECOND, 2, memoryview(b"\0\1\0\0others"))
    scans = on_robot(3, ["/scan"])
    write_bag(bags / "drive.mcap", sorted([frames, again, other, *scans], key=lambda each: each.time))
    live(bags, [came(frames, 60), came(frames, SECOND)._replace(published=BEGAN + BEHIND + SECOND), *map(came, scans)])
    pc, _ = two_sides(bridge, bags)
    found, _ = completed(pc)
    made = [each for each in in_bag(bags.parent / found.path) if each.channel.topic == "/tf_static"]
    assert [(bytes(each.content), each.time) for each in made] == [
        (b"\0\1\0\0frames", BEGAN + BEHIND), (b"\0\1\0\0others", other.time + BEHIND),
    ]  # fmt: skip


def test_what_neither_side_has_is_told_with_the_reason(bridge: Bridge, bags: Path) -> None:
    whole = on_robot(20, ["/scan"])
    kept = [each for each in whole if each.time >= BEGAN + 5 * SECOND and not 200 < each.number <= 230]
    write_bag(bags / "drive.mcap", kept)
    live(bags, [came(each) for each in whole if each.number % 2 and each.number <= 210])
    pc, _ = two_sides(bridge, bags, deny=("/secret",))
    end = BEGAN + 30 * SECOND
    _, result = completed(pc, "/scan", "/secret", "/nowhere", begin=BEGAN, end=end)
    scan, secret, nowhere = result.topics
    assert [(each.reason, each.messages) for each in scan.gaps] == [
        (MissingReason.BEGINS_LATER, None), (MissingReason.LOST, 25), (MissingReason.ENDS_EARLIER, None),
    ]  # fmt: skip
    assert (scan.live, scan.only_live, scan.fetched, scan.missing) == (105, 55, 220, 25)
    assert [each.reason for each in secret.gaps] == [MissingReason.DENIED]
    assert [each.reason for each in nowhere.gaps] == [MissingReason.NOT_RECORDED]
    assert (scan.gaps[0].begin, scan.gaps[-1].end) == (BEGAN + BEHIND, end + BEHIND)


def test_a_recording_that_is_named_is_completed_whole(bridge: Bridge, bags: Path) -> None:
    whole = on_robot(20, ["/scan"])
    write_bag(bags / "drive.mcap", whole[100:300])
    here = bags.parent / "here"
    here.mkdir()
    write_bag(here / "mine.mcap", [came(each) for each in whole if each.number % 2])
    pc, _ = two_sides(bridge, bags, own=RecordingFolders((str(here),)))
    found, result = completed(pc, live="mine")
    assert found.messages == 300
    assert [(each.live, each.only_live, each.fetched) for each in result.topics] == [(200, 100, 100)]
    with pytest.raises(EngineError, match="no recording yours"):
        complete(pc, live="yours")


def test_it_goes_on_over_cuts_and_restarts(bridge: Bridge, bags: Path) -> None:
    """What came live stays for it, whatever becomes of the ring meanwhile."""
    written = mostly_missing(bags)
    with slow_link(bridge, 300_000) as relay:
        pc, robot = two_sides(bridge, bags)
        name = complete(pc)
        (bags.parent / "state" / "rsb-console" / "recordings" / "robot1-20260730-101500.mcap").unlink()
        for cut in range(6):
            _goes_on(pc, name)
            relay.cut()
            if cut % 2:
                pc.stop()
                pc = bridge.server()
                eventually(partial(fetches, pc), what="it is taken up")
        assert report(pc, name).state is not FetchState.DONE, "all of them came in between"
        relay.rate = None
        found = done(pc, name)
        robot.stop()
    assert found.messages == len(written)
    assert [each.time for each in in_bag(bags.parent / found.path)] == [each.time + BEHIND for each in written]


def _goes_on(engine: Engine, name: str) -> None:
    had = report(engine, name).taken
    eventually(lambda: report(engine, name).taken > had, what="it goes on")


def test_nothing_stays_of_one_that_is_given_up(bridge: Bridge, bags: Path, fetched: Path) -> None:
    mostly_missing(bags)
    with slow_link(bridge, 300_000):
        pc, _ = two_sides(bridge, bags)
        name = complete(pc)
        eventually(lambda: report(pc, name).share > 0.2, what="messages come")
        pc.do(CancelFetch(name)).result(60)
        assert not [*fetched.iterdir()]


def test_without_a_common_message_the_link_tells_the_time(bridge: Bridge, bags: Path) -> None:
    written = write_bag(bags / "drive.mcap", on_robot(2, ["/scan"]))
    live(bags, [each._replace(content=memoryview(b"\0\1\0\0other")) for each in written[:1]])
    pc, _ = two_sides(bridge, bags)
    eventually(lambda: pc.snapshot().links[0].clock_offset is not None, what="a measurement")
    _, result = completed(pc)
    assert result.clock.source is ClockSource.LINK
    assert abs(result.clock.offset) < SECOND, "both have one clock"


def test_one_that_was_not_made_whole_goes_with_what_it_has(bridge: Bridge, bags: Path, fetched: Path) -> None:
    """A bridge was killed while it kept what came live, another one while it removed a fetch."""
    mostly_missing(bags)
    with slow_link(bridge, 300_000):
        pc, _ = two_sides(bridge, bags)
        name = complete(pc)
        pc.stop()
        (fetched / f".{name}.fetch" / "live").rename(fetched / f".{name}.fetch" / "live.part")
        (fetched / ".other.gone").mkdir()
        pc = bridge.server()
        eventually(lambda: not [*fetched.iterdir()], what="nothing is left")
        assert not fetches(pc)


def test_the_same_is_not_fetched_twice(bridge: Bridge, bags: Path) -> None:
    """Though the link has measured the clocks anew; another recording of this side is another one."""
    written = mostly_missing(bags)
    here = bags.parent / "here"
    here.mkdir()
    for name in ("mine.mcap", "yours.mcap"):
        write_bag(here / name, map(came, written[:10]))
    with slow_link(bridge, 300_000):
        pc, _ = two_sides(bridge, bags, own=RecordingFolders((str(here),)))
        first = complete(pc)
        eventually(lambda: pc.snapshot().links[0].clock_offset is not None, what="a measurement")
        assert complete(pc) == first
        assert len({first, complete(pc, live="mine"), complete(pc, live="yours")}) == 3


def test_a_topic_without_a_message_in_the_span_is_recorded(bridge: Bridge, bags: Path) -> None:
    scans = on_robot(10, ["/scan"])
    once = on_robot(1, ["/once"], rate=1)
    write_bag(bags / "drive.mcap", sorted([*scans, *once], key=lambda each: each.time))
    live(bags, map(came, scans[::2]))
    pc, _ = two_sides(bridge, bags)
    _, result = completed(pc, begin=BEGAN + 5 * SECOND)
    assert [each.gaps for each in result.topics if each.name == "/once"] == [()]
