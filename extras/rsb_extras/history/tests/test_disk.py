"""The history on disk: whole lines, a bound, one warning when the disk fails, and a complete recovery after kill -9."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zstandard
from tests.support.waiting import eventually

from rsb_bridge.config.state_folder import searched_folders, state_folder
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level, State
from rsb_extras.history import history_files
from rsb_extras.history.bridge_files import Claim, Files, kept_bridges
from rsb_extras.history.history_codes import HistoryCode
from rsb_extras.history.history_files import Disk, EventFile, HistoryFileError
from rsb_extras.history.tests import history_places
from rsb_extras.history.tests.world import World, brief

if TYPE_CHECKING:
    from collections.abc import Iterator


def crash(disk: Disk) -> None:
    """Let go of the files as a process does that is killed."""
    claim = disk._claim
    assert claim is not None
    claim.close()


def disk_of(world: World, folder: Path) -> Disk:
    """Its `turn` is called by the test, on the recorder's own thread: that has ended."""
    world.recorder._has_ended = True
    return Disk(folder, "robot1", "client", world.events, world.recorder, world.clock)


def say(world: World, text: str, **fields: Any) -> None:
    world.events.add(Level.INFO, EventCode.ROUTE_PAUSED, text, **fields)


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def codes(world: World) -> list[str]:
    return [event.code for event in world.events.after(0)]


def test_events_are_lines_of_json(tmp_path: Path) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path / "rsb-console")
    say(world, "paused", link="robot1", topic="/scan", who="anna", old="flowing", new="paused")
    world.events.add(Level.DEBUG, EventCode.LINK_UP, "of no interest")
    say(world, "plain")
    disk.turn()
    first, second = lines(tmp_path / "rsb-console" / "robot1.jsonl")
    assert first == {
        "time": world.clock.wall, "level": "INFO", "code": "route.paused", "source": "route", "text": "paused",
        "link": "robot1", "topic": "/scan", "who": "anna", "old": "flowing", "new": "paused",
    }  # fmt: skip
    assert second["text"] == "plain"
    assert (tmp_path / "rsb-console").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "rsb-console" / "robot1.jsonl").stat().st_mode & 0o777 == 0o600


def test_each_field_of_an_event_is_kept(tmp_path: Path) -> None:
    values: dict[str, Any] = {f.name: f"some {f.name}" for f in dataclasses.fields(Event) if f.type == "str"}
    event = Event(number=0, time=1.0, level=Level.ERROR, since=0.5, from_peer=True, **values)
    (tmp_path / "robot1.jsonl").write_bytes(history_files.encode_event(event))
    assert list(history_files.read_events(tmp_path / "robot1.jsonl", 0.0)) == [event]


def test_a_peers_text_is_clean_and_bounded(tmp_path: Path) -> None:
    world = World("/scan")
    say(world, "a\nb\x1b[31m\u202ec\u200fd" + "x" * 10_000, link="\x07evil")
    disk_of(world, tmp_path).turn()
    assert (tmp_path / "robot1.jsonl").stat().st_size < 2500
    (line,) = lines(tmp_path / "robot1.jsonl")
    assert str(line["text"]).startswith("a�b�[31m�c�d")
    assert line["link"] == "�evil"


def test_path_that_is_no_utf_8_ends_nothing(tmp_path: Path) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path)
    say(world, "caf\udce9.yaml is read again", who="an\udce9")
    disk.turn()
    (line,) = lines(tmp_path / "robot1.jsonl")
    assert (line["text"], line["who"]) == ("caf\\udce9.yaml is read again", "an\\udce9")


def test_the_files_have_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    history_places.HISTORY_FILE_BYTES.set(monkeypatch, 2000)
    file = EventFile(tmp_path / "robot1.jsonl")
    for number in range(1000):
        file.write([Event(number, float(number), Level.INFO, "x.y", f"event {number}")])
    file.close()
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["robot1.1.jsonl", "robot1.2.jsonl", "robot1.3.jsonl", "robot1.4.jsonl", "robot1.jsonl"]
    assert all(path.stat().st_size <= 2000 for path in tmp_path.iterdir())
    found = [event.text for event in history_files.read_events(tmp_path / "robot1.jsonl", 0.0)]
    assert found == [f"event {number}" for number in range(1000 - len(found), 1000)]
    assert len(found) > 80


def test_a_torn_line_costs_no_other(tmp_path: Path) -> None:
    path = tmp_path / "robot1.jsonl"
    path.write_bytes(history_files.encode_event(Event(1, 1.0, Level.INFO, "x.y", "whole")) + b'{"time": 2.0, "lev')
    file = EventFile(path)
    file.write([Event(2, 3.0, Level.INFO, "x.y", "after")])
    file.close()
    assert [event.text for event in history_files.read_events(path, 0.0)] == ["whole", "after"]


@pytest.mark.parametrize("damage", [b'{"text": "\xa6"}', b'{"a":' + b"[" * 100_000, b"[]", b"\0"], ids=range(4))
def test_a_damaged_line_costs_no_other(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "robot1.jsonl"
    before, after = (history_files.encode_event(Event(1, 1.0, Level.INFO, "x.y", text)) for text in ("before", "after"))
    path.write_bytes(before + damage + b"\n" + after)
    assert [event.text for event in history_files.read_events(path, 0.0)] == ["before", "after"]


def test_file_that_is_moved_away_is_begun_anew(tmp_path: Path) -> None:
    file = EventFile(tmp_path / "robot1.jsonl")
    file.write([Event(1, 1.0, Level.INFO, "x.y", "before")])
    (tmp_path / "robot1.jsonl").rename(tmp_path / "taken.jsonl")
    file.write([Event(2, 2.0, Level.INFO, "x.y", "after")])
    file.close()
    assert [line["text"] for line in lines(tmp_path / "robot1.jsonl")] == ["after"]


@pytest.fixture
def no_room() -> Iterator[None]:
    """No file of this process grows beyond 4 kB: the kernel refuses, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk_is_told_once_then_retried(tmp_path: Path, no_room: None) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path)
    for number in range(100):
        say(world, f"event {number} {'x' * 100}")
        world.go(1)
        disk.turn()
    assert codes(world).count(HistoryCode.FILE_FAILED) == 1
    told = next(event for event in world.events.after(0) if event.code == HistoryCode.FILE_FAILED)
    assert f"{tmp_path}: File too large" in told.text
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    world.go(10)
    disk.turn()
    assert codes(world).count(HistoryCode.FILE_AGAIN) == 1
    world.go(10)
    disk.turn()
    texts = [str(line["text"]) for line in lines(tmp_path / "robot1.jsonl")]
    assert [text.split()[1] for text in texts if text.startswith("event ")] == [str(number) for number in range(100)]
    assert texts.count(told.text) == 1


def test_unsaved_time_line_is_soon_tried_again(tmp_path: Path) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path)
    disk.turn()
    path = tmp_path / "robot1.history"
    path.unlink()
    path.mkdir()  # events can be written, the time line cannot
    world.put("/scan", State.DOWN, "no publisher")
    for _ in range(2):
        world.go(10)
        disk.turn()
    assert codes(world).count(HistoryCode.FILE_FAILED) == 1
    assert HistoryCode.FILE_AGAIN not in codes(world)
    path.rmdir()
    world.go(10)
    disk.turn()
    assert path.is_file()
    assert codes(world).count(HistoryCode.FILE_AGAIN) == 1


def test_events_that_were_lost_meanwhile_are_counted(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    world = World("/scan")
    disk = disk_of(world, tmp_path / "file" / "rsb-console")
    for number in range(7000):
        say(world, f"event {number}")
    disk.turn()
    (tmp_path / "file").unlink()
    world.go(10)
    disk.turn()
    assert "2,001 events are missing" in world.events.after(0)[-1].text, "the warning among them"


def test_last_events_of_killed_process_are_not_forgotten(tmp_path: Path) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path)
    world.go(60)
    disk.turn()
    world.go(4)
    say(world, "paused by anna", who="anna")
    disk.turn()
    assert history_files.read_history(tmp_path / "robot1.history").actions == (), "not saved yet"
    crash(disk)
    world.clock.go(60)
    again = World("/scan", clock=world.clock)
    disk_of(again, tmp_path).turn()
    again.go(10)
    report = again.report(120)
    assert [each.text for each in report.actions] == ["paused by anna"]
    assert [round(gap.seconds) for gap in report.gaps] == [61], "it ran until its last event"


def test_time_line_is_saved_soon_after_events(tmp_path: Path) -> None:
    world = World("/scan")
    disk = disk_of(world, tmp_path)
    path = tmp_path / "robot1.history"
    saves: list[int] = []
    for second in range(1000):
        if second == 500:
            world.put("/scan", State.DOWN, "no publisher")
        before = path.stat().st_ino if path.exists() else 0
        disk.turn()
        if path.stat().st_ino != before:
            saves.append(second)
        world.go(1)
    assert any(500 <= second < 506 for second in saves)
    assert len(saves) < 14


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"nonsense", "damaged"),
        (zstandard.compress(b"nonsense"), "damaged"),
        (zstandard.compress(msgspec.msgpack.encode({"version": 99})), "another version"),
        (zstandard.compress(msgspec.msgpack.encode({"version": 1, "name": 3})), "damaged"),
        (zstandard.compress(b"\xa1\xa6"), "damaged"),
        (b"\x28\xb5\x2f\xfd\xe0" + (1 << 40).to_bytes(8, "little") + b"\1\0\0", "too large"),
    ],
)
def test_bad_file_is_set_aside_with_warning(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "robot1.history"
    path.write_bytes(content)
    world = World("/scan")
    disk_of(world, tmp_path).turn()
    (warning,) = (event for event in world.events.after(0) if event.code == HistoryCode.SET_ASIDE)
    assert str(path) in warning.text
    assert why in warning.text
    assert (tmp_path / "robot1.history.bad").read_bytes() == content
    assert history_files.read_history(path).name == "robot1", "a new one is there already"


@pytest.mark.parametrize("within", [60, 6000])
def test_clock_days_behind_at_start_is_awaited(tmp_path: Path, within: int) -> None:
    world = World("/scan")
    world.put("/scan", State.DOWN, "no publisher")
    world.go(100)
    disk = disk_of(world, tmp_path)
    disk.turn()
    crash(disk)
    world.clock.wall -= 1e8  # as on a machine without a battery
    world = World("/scan", clock=world.clock)
    disk = disk_of(world, tmp_path)
    disk.turn()
    world.go(within)
    disk.turn()
    world.clock.wall += 1e8
    disk.turn()
    world.go(10)
    assert len(world.outages(within + 200)) == (within == 60)
    assert (tmp_path / "robot1.history.bad").exists() == (within != 60)
    assert codes(world).count(HistoryCode.CLOCK_SET) == 1


def test_a_torn_file_is_noticed(tmp_path: Path) -> None:
    world = World("/scan")
    world.go(3000)
    path = tmp_path / "robot1.history"
    history_files.write_history(path, world.recorder.save())
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(HistoryFileError, match="damaged"):
        history_files.read_history(path)
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :])
    with pytest.raises(HistoryFileError, match="damaged"):
        history_files.read_history(path)


def test_irreplaceable_file_is_read_all_the_same(tmp_path: Path) -> None:
    world = World("/scan")
    world.go(60)
    world.put("/scan", State.DOWN, "no publisher")
    world.go(60)
    history_files.write_history(tmp_path / "robot1.history", world.recorder.save())
    (tmp_path / "robot1.lock").symlink_to("/dev/full")  # as a read-only disk: no file can be opened for writing
    again = World("/scan", clock=world.clock)
    disk_of(again, tmp_path).turn()
    again.go(10)
    assert brief(again.outages())[0] == ("/scan", 60, "down", "no publisher")


def test_bridges_of_one_name_have_own_files(tmp_path: Path) -> None:
    client, server = Claim(tmp_path, "robot1", "client"), Claim(tmp_path, "robot1", "server")
    assert (client.files.stem, server.files.stem) == ("robot1", "robot1-2")
    client.close()
    server.close()
    server = Claim(tmp_path, "robot1", "server")
    assert server.files.stem == "robot1-2", "each has its own again, in any order of starts"
    server.close()


def test_the_folder(tmp_path: Path) -> None:
    assert state_folder({"STATE_DIRECTORY": "/var/lib/rsb-console:/x"}) == Path("/var/lib/rsb-console")
    assert state_folder({"XDG_STATE_HOME": "/s"}) == Path("/s/rsb-console")
    assert state_folder({}) == Path("~/.local/state/rsb-console").expanduser()
    assert Path("/var/lib/rsb-console") in searched_folders({})


RUNS = """
import sys, time
from pathlib import Path
from dataclasses import replace
from rsb_extras.history.history_files import Disk
from rsb_extras.history.tests.world import World
from rsb_extras.history.tests.hand_clock import HandClock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Level, State
clock = HandClock()
clock.go(float(sys.argv[2]))
world = World("/scan", clock=clock)
world.put("/scan", State.DOWN, "no publisher")
world.go(60)
world.recorder.start()
disk = Disk(Path(sys.argv[1]), "robot1", "client", world.events, world.recorder, world.clock)
disk.start()
number = 0
while True:
    number += 1
    world.events.add(Level.INFO, EventCode.ROUTE_PAUSED, f"event {number}", who="anna")
    world.clock.go(0.1)
    world.renew()
    if number == 100:
        print("runs", flush=True)
    time.sleep(0.001)
"""


def test_killed_and_started_again(tmp_path: Path) -> None:
    root = Path(__file__).parents[4]
    path = os.pathsep.join(str(root / name) for name in ("", "bridge", "console", "extras"))
    environ = os.environ | {"PYTHONPATH": path}
    kept = tmp_path / "robot1.history", tmp_path / "robot1.jsonl"
    for number in range(3):
        with subprocess.Popen(
            [sys.executable, "-c", RUNS, str(tmp_path), str(1e4 * number)],
            stdout=subprocess.PIPE,
            env=environ,
            cwd=root,
        ) as process:
            assert process.stdout
            assert process.stdout.readline() == b"runs\n"
            eventually(lambda: all(path.exists() and path.stat().st_size for path in kept), what="something is written")
            process.send_signal(signal.SIGKILL)
    files = Files(tmp_path, "robot1")
    saved = history_files.read_history(files.history)
    # Its clock advances 0.1 s with each event, so a long time may pass between the save and the last of them.
    died = max(saved.time, *(event.time for event in history_files.read_events(files.events, 0.0)))
    report = history_files.report(files, died + 100, 86400.0)
    assert not report.running
    assert report.outages
    assert "anna" in {each.who for each in report.actions}
    assert report.gaps[-1].seconds >= 100
    assert all(set(line) >= {"time", "text"} for line in lines(files.events)), "whole lines only"


def test_what_is_kept_is_found(tmp_path: Path) -> None:
    world = World("/scan")
    (tmp_path / "rsb-console").mkdir()
    history_files.write_history(tmp_path / "rsb-console" / "robot1.history", world.recorder.save())
    found = kept_bridges({"XDG_STATE_HOME": str(tmp_path)})
    assert [files.stem for files in found if files.folder == tmp_path / "rsb-console"] == ["robot1"]
