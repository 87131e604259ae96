"""The command of `on_fault` as real processes: how many run, for how long, and how failures are reported."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from tests.console.scripted import LINK, NOW, SESSION, route
from tests.support.waiting import eventually

from rsb_bridge.model.clock import Clock
from rsb_bridge.model.faults import LASTS, ChangeKind, FaultChange
from rsb_bridge.model.snapshot import Level, RouteSnapshot, Snapshot, State
from rsb_bridge.telemetry.event_log import EventLog
from rsb_extras.exporters.exporter_codes import ExporterCode
from rsb_extras.exporters.fault_hook import (
    EVERY,
    FOR_LINKS,
    OUTPUT,
    RUNS_FOR,
    STARTS,
    STARTS_WITHIN,
    WAITING,
    FaultHook,
    StartLimit,
    WaitingChanges,
)
from rsb_extras.exporters.tests import exporter_places

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.context import Context

SLOW = route("/scan", State.SLOW, cause="slow")
STOPPED = route("/scan", State.STOPPED, cause="publisher_silent")


class Skipping(Clock):
    """A clock that can be set forward."""

    def __init__(self) -> None:
        self.skipped = 0.0

    def steady(self) -> float:
        return super().steady() + self.skipped


class Shown(tuple[RouteSnapshot, ...]):
    """Routes that note when the hook's thread has gone through them."""

    def __init__(self, _: tuple[RouteSnapshot, ...]) -> None:
        self.are_seen = threading.Event()

    def __iter__(self) -> Iterator[RouteSnapshot]:
        yield from super().__iter__()
        if threading.current_thread() is not threading.main_thread():
            self.are_seen.set()


class Hooked:
    """A hook whose command is a shell script, and what that has written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.clock = Skipping()
        self.events = EventLog(self.clock)
        self.context = SimpleNamespace(session=SESSION, events=self.events, clock=self.clock)
        self.hook = FaultHook(cast("Context", self.context), lambda: folder)

    def open(self, script: str = "cat >> told", name: str = "./tell") -> None:
        path = self.folder / "tell"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)
        self.names(name)

    def names(self, command: str | None) -> None:
        self.context.session = msgspec.structs.replace(SESSION, features={"on_fault": command})
        self.hook.open()

    def sees(self, *routes: RouteSnapshot, skip: float = LASTS) -> None:
        """Show a snapshot twice, so long apart that what it shows lasts."""
        for _ in range(2):
            shown = Shown(routes)
            self.clock.skipped += skip
            self.hook.tick(Snapshot(NOW, "robot1", "client", "", 0, running=True, links=(LINK,), routes=shown))
            eventually(shown.are_seen.is_set)

    @property
    def told(self) -> list[dict[str, Any]]:
        """Return the command's input, as far as it has written it down."""
        try:
            lines = (self.folder / "told").read_text().splitlines(keepends=True)
        except FileNotFoundError:
            return []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def warnings(self) -> list[str]:
        return self.said(Level.WARNING)

    def said(self, level: Level) -> list[str]:
        found = [(event.level, event.text) for event in self.events.after(0)]
        assert {event.code for event in self.events.after(0)} <= {ExporterCode.ON_FAULT}
        return [text for each, text in found if each is level]


@pytest.fixture
def hooked(tmp_path: Path) -> Iterator[Hooked]:
    made = Hooked(tmp_path)
    yield made
    asyncio.run(made.hook.close())
    made.hook.join()


def threads() -> set[threading.Thread]:
    """Return the hooks' threads of this process; one of an earlier test may take a while to end."""
    return {each for each in threading.enumerate() if each.name == "rsb-on-fault"}


def runs(pid_file: Path) -> bool:
    """Whether the process whose id a file holds runs; a zombie does not."""
    try:
        stat = Path("/proc", pid_file.read_text().strip(), "stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_command_hears_begin_other_cause_and_end(hooked: Hooked) -> None:
    hooked.open()
    for routes, count in ((SLOW, 1), (STOPPED, 2), (route("/scan"), 3)):
        hooked.sees(routes)
        eventually(lambda count=count: len(hooked.told) == count)
    found = [(told["event"], told["state"], told["cause"], told["previous_state"]) for told in hooked.told]
    assert found == [
        ("begun", "slow", "slow", ""),
        ("changed", "stopped", "publisher_silent", "slow"),
        ("over", "ok", "", "stopped"),
    ]
    assert [told["ongoing"] for told in hooked.told] == [1, 1, 0]
    assert hooked.events.after(0) == []


def test_without_a_command_there_is_no_thread(hooked: Hooked) -> None:
    before = threads()
    hooked.names(None)
    assert threads() <= before
    hooked.hook.tick(Snapshot(NOW, "robot1", "client", "", 0, running=True))


def test_command_runs_in_sessions_folder_without_bridges_descriptors(
    hooked: Hooked, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LD_LIBRARY_PATH", "PYTHONPATH", "NOTIFY_SOCKET", "WATCHDOG_USEC", "NTFY_TOPIC"):
        monkeypatch.setenv(name, "/nowhere")
    hooked.open("pwd > where; env > env; cat >> told")
    hooked.sees(SLOW)
    eventually(lambda: hooked.told)
    assert (hooked.folder / "where").read_text().strip() == str(hooked.folder.resolve())
    names = {line.partition("=")[0] for line in (hooked.folder / "env").read_text().splitlines()}
    assert {"NTFY_TOPIC", "PATH"} <= names
    assert not {"LD_LIBRARY_PATH", "PYTHONPATH", "NOTIFY_SOCKET", "WATCHDOG_USEC"} & names


def test_nothing_of_a_peer_is_in_its_arguments(hooked: Hooked) -> None:
    hooked.open('echo "$#" > count; cat >> told', name="./tell 'a $(reboot)' ';'")
    hooked.sees(replace(SLOW, reason="'; touch wicked; '", topic="/$(touch wicked)"))
    eventually(lambda: hooked.told)
    assert (hooked.folder / "count").read_text() == "2\n"
    assert not (hooked.folder / "wicked").exists()


def test_one_runs_at_once_waiting_ones_merge(hooked: Hooked, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.FAULT_COMMAND_RUNS_FOR.set(monkeypatch, 1e6)  # the clock is set forward
    hooked.open("mkdir alone || echo twice >> told; cat >> told; while [ ! -e go ]; do sleep 0.05; done; rmdir alone")
    hooked.sees(SLOW)
    eventually(lambda: hooked.told)
    for count in range(4):
        hooked.sees(replace(SLOW, cause=f"cause{count}"))
    (hooked.folder / "go").touch()

    def told_again() -> bool:
        hooked.sees(replace(SLOW, cause="cause3"))
        return len(hooked.told) >= 2

    eventually(told_again)
    first, second = hooked.told
    assert (first["merged"], second["merged"]) == (0, 3)
    assert (second["event"], second["cause"], second["previous_cause"]) == ("changed", "cause3", "slow")


def test_one_that_takes_long_ends_with_its_children(hooked: Hooked, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.FAULT_COMMAND_RUNS_FOR.set(monkeypatch, 100.0)
    exporter_places.FAULT_COMMAND_ENDS_WITHIN.set(monkeypatch, 0.3)
    hooked.open("trap '' TERM\nsleep 1000 & echo $! > child; echo $$ > parent; cat >> told; while :; do sleep 1; done")
    hooked.sees(SLOW)
    eventually(lambda: hooked.told)  # only then its time is over: a busy machine is slow to start it
    hooked.clock.skipped += 100.0
    eventually(hooked.warnings)
    eventually(lambda: not runs(hooked.folder / "parent") and not runs(hooked.folder / "child"))
    hooked.sees(STOPPED, skip=EVERY + LASTS)
    eventually(lambda: len(hooked.told) == 2, what="the next one runs")


@pytest.mark.filterwarnings("ignore:subprocess .* is still running:ResourceWarning")
def test_one_that_never_ends_holds_up_no_other(hooked: Hooked, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that waits for a disk takes no signal."""
    exporter_places.FAULT_COMMAND_ENDS_WITHIN.set(monkeypatch, 0.1)
    hooked.open("cat >> told; exec cat go")
    os.mkfifo(hooked.folder / "go")
    with exporter_places.SIGNAL_GROUP.during(lambda *_: None):
        hooked.sees(SLOW)
        eventually(lambda: hooked.told)
        hooked.clock.skipped += RUNS_FOR
        eventually(hooked.warnings)
    (hooked.folder / "go").write_text("")
    hooked.sees(STOPPED, skip=EVERY + LASTS)
    eventually(lambda: len(hooked.told) == 2, what="the next one runs")


def test_what_it_leaves_running_ends_with_it(hooked: Hooked) -> None:
    hooked.open("sleep 1000 & echo $! > child; cat >> told")
    hooked.sees(SLOW)
    eventually(lambda: hooked.told and not runs(hooked.folder / "child"))


def test_the_end_of_the_engine_ends_it(hooked: Hooked, monkeypatch: pytest.MonkeyPatch) -> None:
    exporter_places.FAULT_COMMAND_RUNS_FOR.set(monkeypatch, 1e6)  # its own time does not end it
    exporter_places.FAULT_COMMAND_ENDS_WITHIN.set(monkeypatch, 60.0)  # `join` waits until the thread has ended
    before = threads()
    hooked.open("echo $$ > parent; cat >> told; exec sleep 1000")
    (thread,) = threads() - before
    hooked.sees(SLOW)
    eventually(lambda: hooked.told)
    asyncio.run(hooked.hook.close())
    hooked.hook.join()
    assert not thread.is_alive()
    eventually(lambda: not runs(hooked.folder / "parent"))
    assert hooked.warnings() == []


@pytest.mark.parametrize("name", ["./gone", "no-such-program-at-all", "./plain", "./broken"])
def test_one_that_cannot_run_is_told_once(hooked: Hooked, name: str) -> None:
    (hooked.folder / "plain").write_text("#!/bin/sh\n")
    (hooked.folder / "broken").write_bytes(b"\0\1\2")
    (hooked.folder / "broken").chmod(0o755)
    hooked.names(name)
    for count in range(5):
        hooked.sees(replace(SLOW, cause=f"cause{count}"), skip=EVERY + LASTS)
    eventually(hooked.warnings)
    assert len(hooked.warnings()) == 1


def test_failing_one_is_told_once_until_it_works(hooked: Hooked) -> None:
    hooked.open("cat >> told; echo no network; [ -e works ]")

    def reported(cause: str) -> None:
        count = len(hooked.told)
        hooked.sees(replace(SLOW, cause=cause), skip=STARTS_WITHIN)
        eventually(lambda: len(hooked.told) == count + 1)
        eventually(lambda: len(hooked.said(Level.DEBUG)) == count + 1)

    for number in range(3):
        reported(f"fails{number}")
    assert len(hooked.warnings()) == 1
    (hooked.folder / "works").touch()
    reported("works")
    (hooked.folder / "works").unlink()
    reported("fails again")
    eventually(lambda: len(hooked.warnings()) == 2)


def test_its_output_is_logged_at_debug_in_part(hooked: Hooked) -> None:
    hooked.open("cat >> told; head -c 300000 /dev/zero | tr '\\0' x; printf '\\033[31m' >&2")
    hooked.sees(SLOW)
    (text,) = eventually(lambda: hooked.said(Level.DEBUG))
    assert OUTPUT <= len(text) <= OUTPUT + 100
    assert text.isprintable()
    assert hooked.warnings() == []


def test_one_that_does_not_read_is_fine(hooked: Hooked) -> None:
    hooked.open("exec 0<&-; touch done")
    hooked.sees(SLOW)
    eventually((hooked.folder / "done").exists)
    asyncio.run(hooked.hook.close())
    hooked.hook.join()
    assert hooked.warnings() == []


def test_another_command_is_told_of_what_lasts(hooked: Hooked) -> None:
    hooked.open()
    hooked.sees(SLOW)
    eventually(lambda: hooked.told)
    hooked.open("cat >> told")
    hooked.sees(SLOW)
    eventually(lambda: len(hooked.told) == 2)
    assert {told["event"] for told in hooked.told} == {"begun"}


def changed(number: int, kind: ChangeKind = ChangeKind.BEGUN, **changes: Any) -> FaultChange:
    return FaultChange(kind, route(f"/topic{number}", State.SLOW, **changes))


def of_link(kind: ChangeKind = ChangeKind.BEGUN) -> FaultChange:
    return FaultChange(kind, replace(LINK, state=State.DOWN, cause="lost"))


def kinds(changes: Iterable[FaultChange]) -> list[tuple[str, str, str]]:
    return [(*change.key, change.kind) for change in changes]


def test_limited_number_of_changes_waits_rest_is_counted() -> None:
    waiting = WaitingChanges()
    for number in range(WAITING + 50):
        waiting.add(changed(number))
    assert (len(waiting), waiting.merged) == (WAITING, 50)
    waiting.told(waiting.in_order())
    assert (len(waiting), waiting.merged) == (0, 0)
    for number in range(WAITING + 50):
        waiting.add(changed(number, ChangeKind.OVER))
    assert kinds(waiting.in_order()) == [("route", f"/topic{number}", "over") for number in range(WAITING)]


def test_of_one_topic_the_newest_change_waits() -> None:
    waiting = WaitingChanges()
    waiting.add(changed(0))
    waiting.add(changed(1))
    waiting.add(changed(0, ChangeKind.CHANGED, cause="slow"))
    assert kinds(waiting.in_order()) == [("route", "/topic1", "begun"), ("route", "/topic0", "begun")]
    assert waiting.in_order()[1].subject.cause == "slow"
    assert waiting.merged == 1


def test_end_is_told_only_after_begin() -> None:
    waiting = WaitingChanges()
    waiting.add(changed(0))
    waiting.add(changed(0, ChangeKind.OVER))
    waiting.add(changed(1, ChangeKind.OVER))
    assert kinds(waiting.in_order()) == []
    waiting.add(changed(0))
    waiting.told(waiting.in_order())
    waiting.add(changed(0, ChangeKind.OVER))
    assert kinds(waiting.in_order()) == [("route", "/topic0", "over")]
    waiting.add(changed(0))
    assert kinds(waiting.in_order()) == [("route", "/topic0", "changed")], "its end was not told"


def test_links_come_first_though_many_topics_failed_before() -> None:
    waiting = WaitingChanges()
    for number in range(WAITING):
        waiting.add(changed(number))
    waiting.add(of_link())
    assert kinds(waiting.in_order())[0] == ("link", "robot1", "begun")
    assert len(waiting) == WAITING


def test_many_at_once_are_one_command_with_list(hooked: Hooked) -> None:
    hooked.open()
    topics = [replace(SLOW, key=f"/topic{number}", topic=f"/topic{number}") for number in range(30)]
    hooked.sees(*topics)
    eventually(lambda: hooked.told)
    (told,) = hooked.told
    names = [told["name"], *(each["name"] for each in told["others"])]
    assert sorted(names) == sorted(each.topic for each in topics)
    assert {each["event"] for each in told["others"]} == {"begun"}
    assert (told["ongoing"], told["merged"]) == (30, 0)


def test_it_starts_once_second_and_ten_times_minute() -> None:
    limit = StartLimit()
    starts = [second / 4 for second in range(4 * 60 * 10) if limit.take(second / 4)]
    assert all(later - earlier >= EVERY for earlier, later in itertools.pairwise(starts))
    for begin in starts:
        assert sum(begin <= start < begin + STARTS_WITHIN for start in starts) <= STARTS
    assert len(starts) == STARTS * 10


def test_topics_leave_starts_to_links() -> None:
    limit = StartLimit()
    assert sum(limit.take(float(second), for_link=False) for second in range(60)) == STARTS - FOR_LINKS
    assert limit.take(59.5, for_link=True)
