"""The main screen, key by key, on an engine that plays a script."""

import csv
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from tests.console.driving import (
    NARROW,
    drive,
    ended,
    engine_as,
    engine_of,
    gone,
    notices,
    on_main,
    put,
    scripted_app,
    shown,
    text,
    until,
)
from tests.console.scripted import CALL_ROUTES, FAULTY, LINK, NOW, ROUTES, ScriptedEngine, refused, route
from tests.support.long import long
from textual.pilot import Pilot
from textual.widgets import Button

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import PauseTopics
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import Event, Ledger, Level, State
from rsb_console.app import ConsoleApp
from rsb_console.notation import formats
from rsb_console.screens.dialog import ConfirmScreen
from rsb_console.screens.main import EmptyTable
from rsb_console.session.exports import export_topics

if TYPE_CHECKING:
    from rsb_bridge.control.control_server import ControlServer


@on_main()
async def test_freezing_holds_the_view_only_and_says_so(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("space")
    await shown(pilot, "VIEW FROZEN")
    engine_of(app).happened.append(Event(5, NOW, Level.ERROR, "route.refused", "meanwhile"))
    put(app, route("/new"), links=(replace(LINK, state=State.DOWN, reason="gone"),))
    await shown(pilot, "✗ DOWN")  # the status line goes on
    await shown(pilot, "/robot1/scan")
    await gone(pilot, "meanwhile")
    assert engine_of(app).commands == []
    await pilot.press("space")
    await shown(pilot, "/new")
    await shown(pilot, "meanwhile")


@on_main()
async def test_refresh_rate(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("minus")
    await shown(pilot, "LIVE 2 Hz")
    await pilot.press("plus", "plus", "plus")
    await shown(pilot, "LIVE 10 Hz")


def test_over_ssh_it_begins_at_two_hertz(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SSH_CONNECTION", "10.0.0.1 50000 10.0.0.2 22")
    app = scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "LIVE 2 Hz")

    drive(app, steps)


@on_main(NARROW)
async def test_narrow_screen_opens_detail_and_log_over_table(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "Ledger")
    await pilot.press("enter")
    await shown(pilot, "Ledger")
    await gone(pilot, "STATE▼")
    await pilot.press("escape")
    await shown(pilot, "STATE▼")
    await pilot.press("l", "z")
    await gone(pilot, "STATE▼")
    await shown(pilot, "encrypted")
    await pilot.press("escape")
    await shown(pilot, "STATE▼")


@on_main((60, 12))
async def test_even_smaller_it_works(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "✗  /robot2/scan")
    await pilot.press("l")
    await shown(pilot, "/robot2/scan channel 3")
    await pilot.press("l", "G")
    await shown(pilot, "/tf")


@on_main()
async def test_zoom(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("z")
    await gone(pilot, "Ledger")
    await gone(pilot, "Log")
    await pilot.press("z")
    await shown(pilot, "Ledger")


@on_main()
async def test_pause_and_resume(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("p")
    await until(pilot, lambda: engine_of(app).commands == [("pause", "/robot2/scan", True)], "pause")
    await pilot.press("j", "j", "p")
    await until(pilot, lambda: engine_of(app).commands[1:] == [("pause", "/initialpose", False)], "resume")
    assert not notices(app), "the log has it"


@on_main()
async def test_quitting_while_linked_asks_with_focus_on_no(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("q")
    await shown(pilot, "Quit?")
    await until(pilot, lambda: app.focused is app.screen.query_one("#no", Button), "the focus on No")
    await pilot.press("enter")
    await gone(pilot, "Quit?")
    for key in ("ctrl+q", "ctrl+c"):
        await pilot.press(key)
        await shown(pilot, "Quit?")
        await pilot.press("escape")
        await gone(pilot, "Quit?")
    assert app.is_running
    await pilot.press("q", "y")
    await until(pilot, lambda: ended(app), "the end")


@on_main()
async def test_quitting_unlinked_asks_as_long_as_bridge_runs(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, state=State.DOWN),))
    await pilot.press("q")
    await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
    await pilot.press("n")
    await until(pilot, lambda: app.screen is app.main, "the main screen")
    engine_of(app).now = replace(engine_of(app).now, running=False)
    await pilot.press("q")
    await until(pilot, lambda: ended(app), "the end")


@on_main(readonly=True)
async def test_quitting_while_read_only_asks_too(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("q")
    await until(pilot, lambda: isinstance(app.screen, ConfirmScreen), "the question")
    await until(pilot, lambda: app.focused is app.screen.query_one("#no", Button), "the focus on No")
    await pilot.press("y")
    await until(pilot, lambda: ended(app), "the end")


@on_main()
async def test_an_unencrypted_link_is_an_alarm_however_narrow(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, encrypted=False, cipher=""),))
    await shown(pilot, "NOT ENCRYPTED")
    await gone(pilot, "encrypted ✓")
    await pilot.resize_terminal(50, 20)
    await shown(pilot, "NOT ENCRYPTED")


@on_main()
async def test_link_nobody_has_joined_is_no_fault(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, state=State.WAITING, reason="not connected yet"),), role="server")
    await shown(pilot, "◌ WAIT")
    await pilot.press("c")
    await shown(pilot, "esc close")
    assert "✗ DOWN" not in text(app).split("Links")[1].split("esc close")[0].split("not connected")[0]
    put(app, links=(replace(LINK, state=State.DOWN, reason="Connection refused"),))
    await pilot.press("escape")
    await shown(pilot, "✗ DOWN")


@on_main()
async def test_links_with_fault_have_line_on_main_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    gone_robot = replace(LINK, name="robot2", state=State.DOWN, cause="lost", reason="cable pulled", since=NOW)
    put(app, links=(LINK, gone_robot), role="server")
    since = formats.time_of_day(NOW)[:5]
    await shown(pilot, f"✗ robot2: missing since {since}, last seen at {LINK.peer}: cable pulled")
    differ = replace(LINK, name="robot2", state=State.DOWN, cause="wrong_key", reason="the keys of 'robot2' differ: …")
    put(app, links=(LINK, differ), role="server")
    await shown(pilot, "✗ robot2: the keys of 'robot2' differ")
    twice = replace(LINK, cause="name_taken", warning="a namesake at 10.0.0.9")
    for role in ("server", "client"):
        put(app, links=(twice,), role=role)
        await shown(pilot, "! robot1: a namesake at 10.0.0.9")
        assert " !1" in text(app).splitlines()[-1]
    put(app, links=(LINK,), role="server")
    await gone(pilot, "a second client")


@on_main()
async def test_what_is_wrong_is_counted_by_kind(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/resting", State.RESTING))
    await shown(pilot, "◎ 1 resting")
    lasting = [state for state in State if state not in (State.DISARMING, State.RESTING)]
    put(app, *(route(f"/{state}", state) for state in lasting if state is not State.LATE))
    await shown(pilot, "9 topics")
    for words in (
        "✗ 1 down",
        "▲ 1 stale",
        "■ 1 stopped",
        "≈ 1 slow",
        "◇ 1 unheard",
        "◌ 1 wait",
        "‖ 1 paused",
        "⊘ 1 disarmed",
        "● 1 ok",
    ):
        await shown(pilot, words)
    put(app, *(route(f"/{state}", state) for state in lasting))
    await shown(pilot, "10 topics ✗1 ▲1 ■1 ◔1 ≈1 ◇1 ◌1 ‖1 ⊘1 ●1 │")  # words no longer fit
    await shown(pilot, "f ✗1 ▲1 ■1 ◔1 ≈1 ◇1 ◌1  ")
    await pilot.press("f")
    await shown(pilot, "7 of 10")
    await pilot.resize_terminal(39, 20)
    await shown(pilot, "10 topics ✗1 ▲1 ■1 ◔1 ≈1 ◇1 ◌1 ‖1 ⊘1 …")
    assert "? help" in text(app).splitlines()[-1]
    put(app, *ROUTES, links=(LINK, replace(LINK, name="robot2", state=State.DOWN)))
    await shown(pilot, "f ✗1 ▲1  c ✗1  ? help  q quit")


@on_main((100, 30))
async def test_the_domain_is_not_cut_at_100_columns(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, links=(replace(LINK, encrypted=False),), address="192.168.100.200:49152")
    await shown(pilot, "192.168.100.200:49152")
    top = text(app).splitlines()[0]
    assert "domain 3" in top
    assert "NOT ENCRYPTED" in top


@on_main(path=Path("robot1.yaml"))
async def test_session_named_like_its_file_is_named_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert text(app).splitlines()[0].count("robot1") == 1


@on_main(ascii_only=True)
async def test_ascii_is_what_goes_out(app: ConsoleApp, pilot: Pilot[None]) -> None:
    assert text(app).isascii()
    await shown(pilot, "enter detail")
    await pilot.press("question_mark")
    await shown(pilot, "Next line")
    assert text(app).isascii()
    await pilot.press("escape", "q")
    await shown(pilot, "Quit?")
    assert text(app).isascii()


@on_main()
async def test_copy_and_export(
    app: ConsoleApp, pilot: Pilot[None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    await pilot.press("y")
    assert app.clipboard == "/robot2/scan"
    await pilot.press("f", "x")
    await until(pilot, lambda: list(tmp_path.glob("rsb-topics-*.csv")), "a table")
    await pilot.press("l", "y", "x")
    await until(pilot, lambda: list(tmp_path.glob("rsb-log-*.txt")), "a log")
    assert "No route to host" in app.clipboard
    (table,) = tmp_path.glob("*.csv")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["topic"] for row in rows] == FAULTY
    assert [row["kind"] for row in rows] == ["topic"] * len(FAULTY)
    assert rows[1]["dropped_total"] == "19"
    assert rows[1]["asked"] == ""
    (log,) = tmp_path.glob("*.txt")
    lines = log.read_text().splitlines()
    assert len(lines) == 4
    assert lines[-1].startswith("2027-01-15T07:59:55+0000 ERROR route robot1 /robot2/scan")


def test_an_export_tells_kinds_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rows = list(csv.DictReader(export_topics((*CALL_ROUTES, ROUTES[0])).read_text().splitlines()))
    assert [row["kind"] for row in rows] == ["service", "service", "action", "parameters", "topic"]
    called = rows[0]
    calls = CALL_ROUTES[0].calls
    assert calls is not None
    figures = {name: str(getattr(calls, name)) for name in ("asked", "answered", "expired", "lost", "in_flight")}
    assert {name: called[name] for name in figures} == figures
    assert called["refused"] == str(sum(calls.refused.values()))
    assert called["offered"] == called["dropped_total"] == ""
    assert {each.name for each in fields(Ledger)} - {"dropped", "waiting_since"} <= called.keys()


@on_main()
async def test_an_export_that_cannot_be_written_is_said(
    app: ConsoleApp, pilot: Pilot[None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    await pilot.press("x")
    await shown(pilot, "Not exported")


class Dying(ScriptedEngine):
    """An engine that ends by itself, as after a fault of ROS's."""

    def die(self) -> None:
        self.happened.append(Event(5, NOW, Level.ERROR, "engine.error", "node broken"))
        self.now = replace(self.now, running=False, links=(), routes=())


@pytest.mark.parametrize("temporary", [False, True])
def test_dead_engine_explains_itself_and_starts_anew(temporary: bool) -> None:
    ended: list[str] = []
    resources = ExitStack()
    resources.callback(ended.append, "the demo's robot")
    app = scripted_app(make_engine=Dying, path=Path("there/nav2.yaml"), temporary=temporary, resources=resources)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        dead = engine_as(app, Dying)
        dead.die()
        app.pull()
        await shown(pilot, "✗ STOPPED: R starts it again")
        await shown(pilot, "✗ robot1: node broken")  # not an earlier error
        await shown(pilot, "The bridge does not run. R starts it again")
        assert text(app).count("node broken") == 2  # banner and log have the reason, status line and table the way on
        await pilot.press("R")
        await shown(pilot, "● LINKED")
        await shown(pilot, "/robot2/scan")
        assert app.engine is not dead
        assert engine_of(app).base == Path("there")
        assert engine_of(app).session == dead.session
        assert ended == []

    drive(app, steps)


def touched() -> dict[str, Any]:
    path = Path("demo.yaml").resolve()
    path.touch()
    return {"path": path}


@pytest.mark.usefixtures("folder")
@on_main(before=touched, temporary=True)
async def test_demo_session_is_neither_unsaved_nor_recent(app: ConsoleApp, pilot: Pilot[None]) -> None:
    from rsb_console.session.recent_sessions import recent_sessions

    engine_of(app).session = msgspec.structs.replace(engine_of(app).session, topics=(Topic("/new", "transmit"),))
    assert recent_sessions() == []
    await pilot.press("w")  # is kept elsewhere, if at all
    await shown(pilot, "Save as")
    await pilot.press("escape", "q")
    await shown(pilot, "The bridge stops")
    await gone(pilot, "Not saved")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"session": None, "path": None}, EmptyTable.NO_SESSION(opens="o", new="f2", welcome="f5")[:60]),
        ({"session": None, "path": None, "readonly": True}, EmptyTable.NO_SESSION_READ_ONLY().partition(":")[0]),
        ({}, "No topics yet. a adds one."),
        ({"readonly": True}, "No topics yet."),
    ],
)
@pytest.mark.parametrize("size", [*long((120, 36)), NARROW])
def test_an_empty_screen_says_what_to_press(size: tuple[int, int], options: dict[str, Any], words: str) -> None:
    app = scripted_app(routes=(), **options)

    async def steps(pilot: Pilot[None]) -> None:
        if "session" in options:
            await shown(pilot, "Open a session")
            await pilot.press("escape")
            await until(pilot, lambda: "no session" in text(app).splitlines()[0], "the header too")
        await until(pilot, lambda: words in " ".join(text(app).split()), words)

    drive(app, steps, size)


@on_main(NARROW)
async def test_a_dialog_has_the_only_keys(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "q quit")
    await pilot.press("f5")
    await shown(pilot, "? every key")
    await gone(pilot, "q quit")
    await pilot.press("question_mark")
    await shown(pilot, "Next line")
    await pilot.press("escape", "escape")
    await shown(pilot, "q quit")


def test_engine_that_cannot_start_explains_itself() -> None:
    from rsb_bridge.api import EngineError

    class Broken(ScriptedEngine):
        def start(self) -> None:
            self.now = replace(self.now, running=False, links=(), routes=())
            number = self.happened[-1].number + 1  # the console may have read all before it
            self.happened.append(
                Event(number, NOW, Level.ERROR, EventCode.ENGINE_NOT_STARTED, "port 49152 taken: choose another one")
            )
            raise EngineError("port 49152 taken: choose another one")

    class Server:
        is_open = True

        def close(self) -> None:
            self.is_open = False

    server = Server()
    app = scripted_app(make_engine=Broken, serve=lambda *_: (cast("ControlServer", server), None))

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "✗ robot1: port 49152 taken: choose another one")  # the banner
        await shown(pilot, "ERROR engine port 49152 taken")  # the log
        assert not server.is_open  # nobody attaches to it
        assert app.is_running

    drive(app, steps)


@on_main(landmark="p pause")
async def test_a_refused_command_is_said_in_words(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).answering = lambda command: refused("route gone") if isinstance(command, PauseTopics) else None
    await pilot.press("p")
    await shown(pilot, "route gone")
