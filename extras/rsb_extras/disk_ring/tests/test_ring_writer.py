"""The thread that writes: what waits for it, what is lost, and what it does when a disk fails."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.feature_api import LinkError
from rsb_bridge.model.clock import Clock
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.disk_ring import ring_writer
from rsb_extras.disk_ring.ring_codes import RingCode, RingProblem, RingText
from rsb_extras.disk_ring.ring_files import RingClocks, RingPlace, undescribed
from rsb_extras.disk_ring.ring_writer import RingWriter
from rsb_extras.disk_ring.stretches import Occasion
from rsb_extras.disk_ring.tests.ring_bed import (
    CHAT,
    FRAMES,
    SMALL,
    message,
    metadata,
    recorded,
    spec,
    texts,
    written_so_far,
)
from rsb_extras.recording.message_ring import RingMessage
from rsb_extras.recording.tests.recordings import read_strictly

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.ros.ros_interface import TopicSpec


class WriterBed:
    """A ring on disk with its thread, before a test starts that.

    Attributes:
        asked: topics whose definitions it has asked for.
    """

    def __init__(self, state: Path, **changes: Any) -> None:
        self.state = state
        self.events = EventLog(Clock())
        self.asked: list[TopicSpec] = []
        clocks = RingClocks(time.monotonic, time.time)
        place = RingPlace(state, "robot1", "client")
        limits = type(SMALL)(**{"disk": 1.0, "free": 0.0, "after": 0.0, **changes})
        self.writer = RingWriter(place, limits, clocks, self.events, self.asked.append)

    @property
    def segments(self) -> list[Path]:
        return sorted((self.state / "ring" / "robot1").glob("*.mcap"))

    def put(self, content: str, topic: TopicSpec = CHAT) -> None:
        self.writer.put(message(time.monotonic(), content, topic))

    def has(self, code: RingCode) -> bool:
        return any(each.code == code for each in self.events.after(0))

    def end(self) -> None:
        self.writer.stop()
        self.writer.join()


@pytest.fixture
def bed(tmp_path: Path) -> Iterator[WriterBed]:
    found = WriterBed(tmp_path)
    found.writer.described(CHAT, recorded(CHAT))
    yield found
    found.writer.stop()
    if found.segments:
        found.writer.join()


def occasion() -> Occasion:
    return Occasion(time.monotonic(), time.time(), "note", "seen")


def test_all_is_written_in_order(bed: WriterBed) -> None:
    bed.writer.start()
    sent = [f"{number}" for number in range(2000)]
    for each in sent:
        bed.put(each)
    bed.end()
    assert [each for path in bed.segments for each in texts(path)] == sent


def test_message_is_on_disk_soon(bed: WriterBed) -> None:
    bed.writer.start()
    bed.put("soon")
    eventually(lambda: bed.segments and b"soon" in written_so_far(bed.segments[0]))
    bed.end()


def test_disk_that_stands_still_loses_messages_and_says_so(bed: WriterBed) -> None:
    large = RingMessage(0.0, CHAT, bytes(10_000_000), 0, 0, 0)
    for _ in range(20):
        bed.writer.put(large)
    assert bed.writer.lost == 13, "64 MiB wait"
    bed.writer.start()
    kept = bed.writer.keep(occasion())
    eventually(lambda: bed.has(RingCode.LOST))
    assert kept.result(60)
    bed.end()


def test_messages_wait_for_their_definition(bed: WriterBed) -> None:
    other = spec("/other")
    bed.writer.start()
    bed.put("first", other)
    eventually(lambda: bed.asked == [other])
    bed.writer.described(other, recorded(other))
    bed.end()
    ((schema, _, _),) = read_strictly(bed.segments[0])
    assert schema.data == b"string data\n"


def test_late_definition_begins_a_segment(bed: WriterBed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ring_writer, "_DEFINED_WITHIN", 0.0)
    other = spec("/other")
    bed.writer.start()
    bed.put("first", other)
    eventually(lambda: bed.segments and b"first" in written_so_far(bed.segments[0]))
    bed.writer.described(other, recorded(other))
    bed.put("second", other)
    bed.end()
    assert [texts(path, "/other") for path in bed.segments] == [["first"], ["second"]]
    assert [read_strictly(path)[0][0].data for path in bed.segments] == [b"", b"string data\n"]


def test_definition_that_nobody_had_is_asked_for_again(bed: WriterBed, monkeypatch: pytest.MonkeyPatch) -> None:
    other = spec("/other")
    bed.writer.described(other, undescribed(other))
    bed.writer.start()
    bed.put("first", other)
    eventually(lambda: bed.segments and b"first" in written_so_far(bed.segments[0]))
    assert not bed.asked
    monkeypatch.setattr(ring_writer, "_ASKED_EVERY", 0.0)
    eventually(lambda: bed.asked)
    bed.writer.described(other, recorded(other))
    bed.put("second", other)
    bed.end()
    assert [read_strictly(path)[0][0].data for path in bed.segments] == [b"", b"string data\n"]


def test_failing_disk_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ring_writer, "_RETRIES_EVERY", 0.0)
    (tmp_path / "ring").write_text("in the way")
    bed = WriterBed(tmp_path)
    bed.writer.described(CHAT, recorded(CHAT))
    bed.writer.start()
    eventually(lambda: bed.has(RingCode.STOPPED))
    with pytest.raises(LinkError) as raised:
        bed.writer.keep(occasion()).result(60)
    assert says(str(raised.value), RingProblem.NOT_WRITTEN)
    (tmp_path / "ring").unlink()
    eventually(lambda: bed.has(RingCode.GOES_ON))
    bed.put("again")
    bed.end()
    assert texts(bed.segments[-1]) == ["again"]
    assert sum(each.code == RingCode.STOPPED for each in bed.events.after(0)) == 1


def test_full_disk_is_named(tmp_path: Path) -> None:
    bed = WriterBed(tmp_path, free=1e6)
    bed.writer.start()
    eventually(lambda: bed.has(RingCode.STOPPED))
    bed.end()
    assert says(bed.events.after(0)[-1].text, RingText.STOPPED, error=RingText.NO_SPACE(free=1e6))


def test_stretch_is_answered_at_once(bed: WriterBed) -> None:
    bed.writer.start()
    bed.put("before")
    path = bed.writer.keep(occasion()).result(60)
    eventually(path.exists)
    assert metadata(path)["custom_data"]["note"] == "seen"
    bed.end()


def test_question_that_is_taken_back_does_not_stop_the_ring(bed: WriterBed) -> None:
    assert bed.writer.keep(occasion()).cancel()
    bed.writer.start()
    bed.put("after")
    bed.end()
    assert not bed.has(RingCode.STOPPED)
    assert texts(bed.segments[0]) == ["after"]


@pytest.mark.parametrize("has_next", [True, False])
def test_next_writer_knows_what_late_joiners_get(has_next: bool, bed: WriterBed, tmp_path: Path) -> None:
    """Unless messages passed between both, one of which may stand in its place."""
    bed.writer.described(FRAMES, recorded(FRAMES))
    bed.writer.start()
    bed.put("still", FRAMES)
    bed.writer.stop(has_next=has_next)
    after = WriterBed(tmp_path)
    after.writer.described(CHAT, recorded(CHAT))
    after.writer.start(bed.writer)
    after.put("two")
    after.end()
    assert texts(after.segments[-1], "/tf_static") == (["still"] if has_next else [])


def test_next_writer_waits_for_the_files(bed: WriterBed, tmp_path: Path) -> None:
    bed.writer.start()
    bed.put("one")
    bed.writer.stop()
    after = WriterBed(tmp_path)
    after.writer.described(CHAT, recorded(CHAT))
    after.writer.start(bed.writer)
    after.put("two")
    after.end()
    assert [each for path in after.segments for each in texts(path)] == ["one", "two"]
