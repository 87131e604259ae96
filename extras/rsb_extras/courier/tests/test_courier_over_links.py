"""Two bridges over a socket: a robot with recordings, and the other side that lists them and gets them."""

from __future__ import annotations

import os
import threading
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import happened, linked
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_extras.courier.courier_part import FetchProblem
from rsb_extras.courier.courier_requests import (
    CancelFetch,
    FetchState,
    ListRecordings,
    RecordingGroup,
)
from rsb_extras.courier.kept_recordings import FetchError, KeptProblem
from rsb_extras.courier.link_courier import CourierCode
from rsb_extras.courier.tests.bags import BEGAN, SECOND, in_bag, messages, write_bag
from rsb_extras.courier.tests.courier_bed import (
    done,
    fetch,
    fetches,
    listed,
    newest,
    report,
    robot_features,
    slow_link,
    two_sides,
)
from rsb_extras.courier.tests.courier_places import BEGINNING, CUTTER, LISTED_WITHIN, QUICK

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge


def test_recordings_are_listed_with_what_is_in_them(bridge: Bridge, bags: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(2))
    (bags / "notes.txt").write_text("no recording")
    (bags / "elsewhere.mcap").symlink_to("/etc/passwd")
    os.mkfifo(bags / "pipe.mcap")
    pc, _ = two_sides(bridge, bags)
    (drive,) = listed(pc).values()
    assert (drive.name, drive.size) == ("drive.mcap", (bags / "drive.mcap").stat().st_size)
    assert (drive.begin, drive.end, drive.messages) == (BEGAN, written[-1].time, len(written))
    assert [(each.name, each.type_name, each.messages) for each in drive.topics] == [
        ("/scan", "std_msgs/msg/String", 40),
        ("/tf", "std_msgs/msg/String", 40),
    ]


def test_what_was_kept_is_known_without_asking_again(bridge: Bridge, bags: Path) -> None:
    """So a tile costs a thin link nothing."""
    write_bag(bags / "drive.mcap", messages(1))
    (bags / "fault").mkdir()
    write_bag(bags / "fault" / "fault_0.mcap", messages(1))
    (bags / "fault" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  custom_data: {cause: fault}\n")
    pc, robot = two_sides(bridge, bags)
    here, there = newest(pc)
    assert (here, there) == (RecordingGroup(), RecordingGroup("robot1", age=None))
    listed(pc)
    robot.stop()
    eventually(lambda: not linked(pc), what="the link is down")
    (fault,) = newest(pc)[1].recordings
    assert (fault.name, fault.cause, fault.topics) == ("fault", "fault", ())


def test_newest_recordings_are_those_that_came_last(
    bridge: Bridge, bags: Path, fetched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No other file is looked into: a tile asks for them each ten seconds."""
    read: list[str] = []
    beginning: Callable[[str], bytes] = BEGINNING.value

    def noted(path: str) -> bytes:
        read.append(Path(path).name)
        return beginning(path)

    fetched.mkdir(parents=True)
    for at, name in enumerate(("b", "c", "a")):
        write_bag(fetched / f"{name}.mcap", messages(1))
        os.utime(fetched / f"{name}.mcap", (BEGAN / SECOND + at,) * 2)
    pc, _ = two_sides(bridge, bags)
    BEGINNING.set(monkeypatch, noted)
    assert [each.name for each in newest(pc, 2)[0].recordings] == ["a.mcap", "c.mcap"]
    assert sorted(read) == ["a.mcap", "c.mcap"]


def test_a_bag_that_is_being_written_came_last(bridge: Bridge, bags: Path) -> None:
    """Its folder has the time at which its file began."""
    write_bag(bags / "drive.mcap", messages(1))
    (bags / "growing").mkdir()
    write_bag(bags / "growing" / "growing_0.mcap", messages(1))
    for path, at in (("drive.mcap", 2), ("growing/growing_0.mcap", 3), ("growing", 1)):
        os.utime(bags / path, (BEGAN / SECOND + at,) * 2)
    _, robot = two_sides(bridge, bags)
    assert [each.name for each in newest(robot, 1)[0].recordings] == ["growing"]


def test_why_a_recording_was_kept_is_listed(bridge: Bridge, bags: Path) -> None:
    """As `rsb_extras.disk_ring` writes it; what else may stand there takes neither time nor memory."""
    deep = ["a0: &a0 [many]", *(f"a{at}: &a{at} [{', '.join([f'*a{at - 1}'] * 10)}]" for at in range(1, 12))]
    kept = {
        "fault": ["cause: fault", "text: no data for 3 s"],
        "note": ["cause: note", "text: before", "note: it fell; it fell again"],
        "odd": ["cause: *a11", "note: *a11"],
    }
    for name, lines in kept.items():
        (bags / name).mkdir()
        write_bag(bags / name / f"{name}_0.mcap", messages(1))
        head = [*deep, "rosbag2_bagfile_information:", "  custom_data:"]
        (bags / name / "metadata.yaml").write_text("\n".join((*head, *(f"    {each}" for each in lines))))
    pc, _ = two_sides(bridge, bags)
    found = {each.name: (each.cause, each.note) for each in listed(pc).values()}
    assert found == {
        "fault": ("fault", "no data for 3 s"),
        "note": ("note", "it fell; it fell again"),
        "odd": ("", ""),
    }


def test_a_file_that_takes_long_is_not_read_while_it_grows(
    bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    QUICK.set(monkeypatch, -1.0)
    path = bags / "drive.mcap"
    whole = write_bag(path, messages(10, 10_000))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    pc, _ = two_sides(bridge, bags)
    first = listed(pc)["drive.mcap"]
    assert 0 < first.messages < len(whole)
    path.write_bytes(data[: len(data) * 3 // 4])
    second = listed(pc)["drive.mcap"]
    assert (says(second.problem, KeptProblem.WRITTEN), second.messages) == (True, 0)
    os.utime(path, (1e9, 1e9))
    assert first.messages < listed(pc)["drive.mcap"].messages < len(whole)


def test_a_recording_comes_message_for_message(bridge: Bridge, bags: Path, fetched: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(3))
    pc, robot = two_sides(bridge, bags)
    found = done(pc, fetch(pc, "drive.mcap"))
    assert in_bag(fetched / "robot1-drive.mcap") == written
    assert found.path == str(fetched / "robot1-drive.mcap")
    assert found.messages == len(written)
    assert [each.name for each in fetched.iterdir()] == ["robot1-drive.mcap"], "nothing is left of its pieces"
    assert happened(robot, CourierCode.GIVEN, "drive.mcap")
    assert happened(pc, CourierCode.DONE, f"{len(written)} messages written")


def test_topics_and_times_are_chosen(bridge: Bridge, bags: Path, fetched: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(4))
    pc, _ = two_sides(bridge, bags)
    begin, end = BEGAN + SECOND, BEGAN + 2 * SECOND
    done(pc, fetch(pc, "drive.mcap", "/tf", begin=begin, end=end))
    expected = [each for each in written if each.channel.topic == "/tf" and begin <= each.time <= end]
    assert in_bag(fetched / "robot1-drive.mcap") == expected


def test_without_the_right_nothing_is_listed_or_given(bridge: Bridge, bags: Path) -> None:
    write_bag(bags / "drive.mcap", messages(1))
    pc, _ = two_sides(bridge, bags, may=False)
    (group,) = pc.do(ListRecordings("robot1")).result(60)
    assert not group.recordings
    assert "may: {recordings: true}" in group.problem
    assert pc.do(ListRecordings(here=True)).result(60) == ()
    with pytest.raises(EngineError, match=r"may: \{recordings: true\}"):
        fetch(pc, "drive.mcap")


def test_topics_that_it_may_not_read_are_left_out(bridge: Bridge, bags: Path, fetched: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(1, topics=("/scan", "/secret")))
    pc, _ = two_sides(bridge, bags, deny=("/secret",))
    (drive,) = listed(pc).values()
    assert [each.name for each in drive.topics] == ["/scan"]
    with pytest.raises(EngineError, match="has no topic /secret that this side may read"):
        fetch(pc, "drive.mcap", "/secret")
    done(pc, fetch(pc, "drive.mcap"))
    assert in_bag(fetched / "robot1-drive.mcap") == [each for each in written if each.channel.topic == "/scan"]


def test_a_recording_that_changes_ends_the_fetch(bridge: Bridge, bags: Path, fetched: Path) -> None:
    write_bag(bags / "drive.mcap", messages(20, 5000))
    with slow_link(bridge, 500_000):
        pc, _ = two_sides(bridge, bags)
        name = fetch(pc, "drive.mcap")
        eventually(lambda: report(pc, name).taken > 0, what="a piece has come")
        with (bags / "drive.mcap").open("ab") as file:
            file.write(b"more")
        eventually(lambda: report(pc, name).state is FetchState.FAILED, what="it ends")
        assert "has changed since it was listed" in report(pc, name).reason
        assert not [*fetched.iterdir()]


def test_a_fetch_outlives_cuts_and_restarts_of_each_side(bridge: Bridge, bags: Path, fetched: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(240, 5000))
    with slow_link(bridge, 600_000) as relay:
        pc, robot = two_sides(bridge, bags)
        name = fetch(pc, "drive.mcap")

        def goes_on(than: int) -> None:
            eventually(
                lambda: (found := report(pc, name)).taken > than or found.state is FetchState.DONE, what="it goes on"
            )

        for cut in range(20):
            goes_on(report(pc, name).taken)
            relay.cut()
            if cut == 6:
                robot.stop()
                robot = bridge.client(features=robot_features(bags))
            elif cut == 13:
                had = report(pc, name).taken
                pc.stop()
                pc = bridge.server()
                eventually(partial(fetches, pc), what="it is taken up")
                assert report(pc, name).taken >= had, "what had come is there"
        assert report(pc, name).state is not FetchState.DONE, "all of them came in between"
        relay.rate = None
        done(pc, name)
    assert in_bag(fetched / "robot1-drive.mcap") == written


def test_a_damaged_recording_comes_up_to_the_damage(bridge: Bridge, bags: Path, fetched: Path) -> None:
    written = write_bag(bags / "drive.mcap", messages(30, 5000))
    data = bytearray((bags / "drive.mcap").read_bytes())
    middle = len(data) // 2
    data[middle : middle + 1000] = bytes(1000)
    (bags / "drive.mcap").write_bytes(data)
    pc, _ = two_sides(bridge, bags)
    found = done(pc, fetch(pc, "drive.mcap"))
    assert "it is cut off or damaged" in found.reason
    assert 0 < found.messages < len(written)
    assert in_bag(fetched / "robot1-drive.mcap") == written[: found.messages]


def test_where_a_recording_is_stays_untold(bridge: Bridge, bags: Path) -> None:
    """Neither by its name, nor by the reason why it cannot be read."""
    (bags / "drive.mcap").write_bytes(b"no recording")
    pc, _ = two_sides(bridge, bags)
    (drive,) = listed(pc).values()
    assert drive.problem.startswith("drive.mcap is no recording")
    with pytest.raises(EngineError, match=r"no topic that this side may read: drive\.mcap is no recording"):
        fetch(pc, "drive.mcap")


def test_a_fetch_is_given_up(bridge: Bridge, bags: Path, fetched: Path) -> None:
    write_bag(bags / "drive.mcap", messages(20, 5000))
    with slow_link(bridge, 500_000):
        pc, _ = two_sides(bridge, bags)
        name = fetch(pc, "drive.mcap")
        eventually(lambda: report(pc, name).taken > 0, what="a piece has come")
        pc.do(CancelFetch(name)).result(60)
        assert report(pc, name).state is FetchState.FAILED
        assert not [*fetched.iterdir()]
        with pytest.raises(EngineError, match="there is no fetch"):
            pc.do(CancelFetch(name)).result(60)


def test_orders_that_are_given_up_take_one_thread(bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place in a file without an index takes minutes to find, and a peer may ask 20 times in one."""
    write_bag(bags / "drive.mcap", messages(1))
    free, busy, most = threading.Event(), [0], [0]

    def held(*_: object) -> None:
        busy[0] += 1
        most[0] = max(most[0], busy[0])
        free.wait(60)
        busy[0] -= 1
        raise FetchError("as it is tried")

    CUTTER.set(monkeypatch, held)
    pc, _ = two_sides(bridge, bags)
    for number in range(3):
        name = fetch(pc, "drive.mcap")
        eventually(lambda name=name: report(pc, name).state is FetchState.FETCHING, what="it is asked for")
        if number < 2:
            eventually(lambda: busy[0], what="the first one is looked for")
            time.sleep(0.3)
            pc.do(CancelFetch(name)).result(60)
    time.sleep(0.5)
    free.set()
    eventually(lambda: report(pc, name).state is FetchState.FAILED, what="the last one is answered")
    assert most == [1]


def test_one_comes_after_the_other(bridge: Bridge, bags: Path, fetched: Path) -> None:
    names = [f"drive{number}.mcap" for number in range(3)]
    written = {name: write_bag(bags / name, messages(1, seed=number)) for number, name in enumerate(names)}
    pc, _ = two_sides(bridge, bags)
    for name in [fetch(pc, each) for each in names]:
        done(pc, name)
    for name in names:
        assert in_bag(fetched / f"robot1-{name}") == written[name]
    with pytest.raises(EngineError, match="several recordings drive"):
        fetch(pc, "drive")
    assert done(pc, fetch(pc, "drive1")).name == "robot1-drive1-2"


def test_a_fetch_that_cannot_begin_later_is_logged(bridge: Bridge, bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By then, no operator may wait for the answer."""
    pc, _ = two_sides(bridge, bags)
    with pytest.raises(EngineError):
        fetch(pc, "drive.mcap")
    assert not happened(pc, CourierCode.FAILED)
    LISTED_WITHIN.set(monkeypatch, 0.0)
    with pytest.raises(EngineError):
        fetch(pc, "drive.mcap")
    reason = FetchProblem.UNKNOWN(link="robot1", name="drive.mcap")
    assert happened(pc, CourierCode.FAILED, FetchProblem.NONE, name="drive.mcap", reason=reason)
