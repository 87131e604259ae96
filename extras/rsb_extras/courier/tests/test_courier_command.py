"""The command ``record``: lists, fetches and their progress, and what it says of wrong usage."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from msgspec.structs import replace
from tests.console.scripted import ScriptedEngine, answers

from rsb_console.command.shell import FAILURE, OK, USAGE
from rsb_extras.courier.completed_recording import ClockSource, CompletedClock, CompletedRecording
from rsb_extras.courier.completed_text import completed_lines
from rsb_extras.courier.courier_command import CourierCommandText
from rsb_extras.courier.courier_records import LATEST
from rsb_extras.courier.courier_requests import (
    CancelFetch,
    FetchRecording,
    FetchState,
    ListFetches,
    ListRecordings,
    RecordingGroup,
)
from rsb_extras.courier.tests.courier_places import ANSWERED_WITHIN, WAITED_WITHIN
from rsb_extras.courier.tests.scripted_answers import BEGAN, COMPLETED, DONE, DRIVE, FETCH

if TYPE_CHECKING:
    from tests.support.commands import Ran
    from tests.support.control import Machine

    from rsb_bridge.model.commands import Command

Run = Callable[..., "Ran"]
SECOND = 1_000_000_000


@pytest.fixture
def asked(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What a bridge was asked for, whose fetch has gone on at each look until it is done."""
    known: Any = answers()
    commands: list[Any] = []
    states = [replace(FETCH, state=FetchState.WAITING, reason="the link was lost"), FETCH]
    done = replace(FETCH, state=FetchState.DONE, share=1.0, messages=18_000, path="/var/lib/drive.mcap")

    def looked(_: ListFetches) -> Any:
        return (states.pop(0) if states else done,)

    def noted(command: Any) -> Any:
        commands.append(command)
        return FETCH.name if isinstance(command, FetchRecording) else None

    for kind, reply in ((ListFetches, looked), (FetchRecording, noted), (CancelFetch, noted)):
        monkeypatch.setitem(known, kind, reply)
    machine.have(ScriptedEngine())
    return commands


def silent_at(kind: type[Command[Any]]) -> ScriptedEngine:
    """Return an engine that does not answer one kind of command."""

    class Silent(ScriptedEngine):
        def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
            return Future() if isinstance(command, kind) else super()._execute(command, step)

    return Silent()


def test_recordings_of_both_sides_are_listed(machine: Machine, ran: Run) -> None:
    machine.serve()
    listed = ran("record", "list")
    lines = listed.out.splitlines()
    assert listed.code == OK
    assert lines[0].split() == ["RECORDING", "SIDE", "BEGIN", "SPAN", "SIZE", "CAUSE", "TOPICS"]
    assert lines[1].split()[:3] == ["noon.mcap", "this", "side"]
    assert lines[2].split()[0] == DRIVE.name
    assert lines[2].endswith("90 s  184 MB  fault  2")
    assert lines[3] == "robot1-drive of the server: 25%, 42 MB, 1.5 MB/s, 84 s left, fetching"
    found = ran("record", "list", "robot1", "--json").json
    assert [each["name"] for each in found["recordings"]] == [DRIVE.name]
    assert found["recordings"][0]["topics"][0] == {
        "name": "/scan", "type": "sensor_msgs/msg/LaserScan", "messages": 900,
    }  # fmt: skip
    assert found["fetches"][0]["rate"] == 1_500_000
    assert [found["fetches"][0][key] for key in ("messages", "path", "reason", "completed")] == [0, "", "", None]


def test_a_fetch_is_waited_for_without_a_bar_where_no_terminal_is(asked: list[Any], ran: Run) -> None:
    done = ran("record", "get", "robot1", DRIVE.name, "/scan")
    assert (done.code, done.err) == (OK, "")
    assert done.out == "18,000 messages, 42 MB crossed: /var/lib/drive.mcap\n"
    assert asked == [FetchRecording("robot1", DRIVE.name, ("/scan",))]


def test_a_terminal_has_a_bar(asked: list[Any], ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    done = ran("record", "get", "robot1", DRIVE.name)
    assert "[.....#" not in done.out
    assert "[#####...............] 25%, 42 MB, 1.5 MB/s, 84 s left, fetching" in done.out
    assert "the link was lost" in done.out


@pytest.mark.parametrize(
    ("options", "begin", "end"),
    [
        (("--from", "-30"), BEGAN + 60 * SECOND, LATEST),
        (("--from", "10", "--to", "20.5"), BEGAN + 10 * SECOND, BEGAN + 20_500_000_000),
        (("--to", "2026-07-30T10:15:30+00:00"), 0, BEGAN + 30 * SECOND),
    ],
)
def test_times_are_of_the_recording(options: tuple[str, ...], begin: int, end: int, asked: list[Any], ran: Run) -> None:
    done = ran("record", "get", "robot1", DRIVE.name, "--no-wait", "--json", *options)
    assert done.json == {"ok": True, "fetch": "robot1-drive"}
    assert asked == [FetchRecording("robot1", DRIVE.name, (), begin, end)]


def test_completing_tells_what_is_missing_and_why(machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[Any] = []
    known: Any = answers()

    def noted(command: FetchRecording) -> str:
        commands.append(command)
        return DONE.name

    monkeypatch.setitem(known, FetchRecording, noted)
    monkeypatch.setitem(known, ListFetches, lambda _: (replace(DONE, completed=COMPLETED),))
    machine.have(ScriptedEngine())
    words = ("record", "get", "robot1", DRIVE.name, "--complete", "/scan", "--with", "noon.mcap")
    lines = ran(*words).out.splitlines()
    assert commands == [FetchRecording("robot1", DRIVE.name, ("/scan",), completes=True, live="noon.mcap")]
    assert lines[1:3] == [
        "1.0 MB of 9.0 MB of messages over there were missing here, and are fetched",
        "times are of this side's clock: those of the other side -1.500000 s, by 900 messages (within 0.002000 s)",
    ]
    assert lines[3] == "/scan (/front/scan over there): 900 live, 80 fetched, 12 in neither recording"
    assert lines[4].endswith(": 12 messages, the other side's recording has lost them")
    assert lines[5:] == [
        "  any time to any time: the other side's recording begins later",
        "  3 more, shorter ones",
    ]
    found = ran(*words, "--json").json["completed"]
    assert msgspec.convert(found, CompletedRecording) == COMPLETED


def test_a_file_tells_what_is_missing(machine: Machine, ran: Run) -> None:
    machine.serve()
    told = ran("record", "missing", "robot1-noon-completed.mcap").out.splitlines()
    assert told[2] == "/scan (/front/scan over there): 900 live, 80 fetched, 12 in neither recording"
    found = ran("record", "missing", "robot1-noon-completed.mcap", "--json").json
    assert msgspec.convert(found["completed"], CompletedRecording) == COMPLETED


@pytest.mark.parametrize(
    ("source", "text"), [("link", "by the link's measurement"), ("none", "by nothing: no message came live")]
)
def test_a_clock_that_no_message_shows_is_told(source: str, text: str) -> None:
    (_, line) = completed_lines(CompletedRecording(CompletedClock(ClockSource(source)), ()))
    assert text in line


def test_problem_of_a_named_link_names_it(machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    known: Any = answers()
    monkeypatch.setitem(known, ListRecordings, lambda _: (RecordingGroup("robot1", problem="no courier"),))
    machine.have(ScriptedEngine())
    found = ran("record", "list", "robot1")
    assert (found.code, found.out) == (FAILURE, "")
    assert "robot1: no courier" in found.err


def test_a_failed_fetch_is_a_failure(machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = replace(DONE, state=FetchState.FAILED, reason="the recording has changed")
    known: Any = answers()
    monkeypatch.setitem(known, ListFetches, lambda _: (failed,))
    machine.have(ScriptedEngine())
    found = ran("record", "get", "robot1", DRIVE.name, "--json")
    assert (found.code, found.json["ok"], found.json["error"]) == (FAILURE, False, "the recording has changed")


def test_a_list_that_takes_long_leaves_the_fetch_to_the_bridge(
    machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    WAITED_WITHIN.set(monkeypatch, 0.1)
    machine.have(silent_at(FetchRecording))
    found = ran("record", "get", "robot1", DRIVE.name)
    text = CourierCommandText.ASKED(link="robot1", name=DRIVE.name, seconds=0.1)
    assert (found.code, found.out, text in found.err) == (FAILURE, "", True)
    assert ran("record", "get", "robot1", DRIVE.name, "--no-wait", "--json").json == {"ok": False, "error": text}


def test_a_bridge_that_falls_silent_may_go_on(machine: Machine, ran: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    ANSWERED_WITHIN.set(monkeypatch, 0.1)
    machine.have(silent_at(ListFetches))
    found = ran("record", "get", "robot1", DRIVE.name)
    assert (found.code, CourierCommandText.GOES_ON(name=DONE.name) in found.err) == (FAILURE, True)


def test_a_fetch_is_given_up(asked: list[Any], ran: Run) -> None:
    assert ran("record", "cancel", "robot1-drive").out == "robot1-drive is given up\n"
    assert asked == [CancelFetch("robot1-drive")]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("record --from 3", "record takes no --from"),
        ("record list a b", "give one link at most"),
        ("record get robot1", "give a link and a recording"),
        ("record get robot1 x --seconds 3", "record get takes no --seconds"),
        ("record list --to 3", "record list takes no --to"),
        (f"record get robot1 {DRIVE.name} --with noon", "give both"),
        ("record list --complete", "record list takes no --complete"),
        ("record cancel", "give the name of one fetch"),
        ("record missing", "give one recording of this side"),
        ("record get robot1 x --from noon", "--from noon: give seconds"),
        ("record get robot1 x --from 3", "x does not say when it begins"),
        (f"record get robot1 {DRIVE.name} --from 20 --to 10", "--to is before --from"),
    ],
)
def test_wrong_usage_names_the_remedy(line: str, text: str, machine: Machine, ran: Run) -> None:
    machine.serve()
    refused = ran(*line.split())
    assert (refused.code, text in refused.err) == (USAGE, True), refused
