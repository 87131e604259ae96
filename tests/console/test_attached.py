"""The console on a bridge of another process: it shows and does the same, and leaves the bridge running."""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.console.driving import drive, scripted_app, shown, text, until
from tests.console.live import COMMAND, Pair, end, talker
from tests.console.scripted import ScriptedEngine, route
from tests.console.tmux import Tmux
from tests.support.control import Machine
from tests.support.forker import Forked
from tests.support.waiting import eventually
from textual.pilot import Pilot

from rsb_bridge.config.session_file import load, save
from rsb_bridge.control import bridges
from rsb_bridge.model.session import Topic
from rsb_console.actions.action import Group
from rsb_console.app import ConsoleApp
from rsb_console.operations.save_operations import SaveQuestion
from rsb_console.operations.session_operations import SessionQuestion, attach_instead
from rsb_console.operations.topic_operations import OperationText
from rsb_console.screens.dialog import OfferScreen
from rsb_console.screens.welcome_screen import WelcomeScreen

CHATTER = f"/console_{os.getpid()}/attached"


@pytest.fixture
def engine(machine: Machine, tmp_path: Path) -> ScriptedEngine:
    """It is served, with its file."""
    made = ScriptedEngine()
    save(made.session, tmp_path / "nav2.yaml")
    made.use_file(tmp_path / "nav2.yaml")
    machine.serve(made, file=tmp_path / "nav2.yaml")
    return made


def attached_app(machine: Machine, **options: object) -> ConsoleApp:
    return scripted_app(session=None, path=None, attach_to=machine.folder / "robot1.sock", **options)


def test_attached_console_shows_and_operates_engine(machine: Machine, engine: ScriptedEngine, tmp_path: Path) -> None:
    app = attached_app(machine)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        await shown(pilot, "attached  ")
        await shown(pilot, "/robot2/scan channel 3: No route to host")  # the log, too
        assert (app.path, app.saved) == (tmp_path / "nav2.yaml", engine.session)
        await pilot.press("p")
        await until(pilot, lambda: engine.commands == [("pause", "/robot2/scan", True)], "paused there")
        engine.now = replace(engine.now, routes=(route("/new"),))
        await shown(pilot, "/new")

    drive(app, steps)
    app.stop()
    assert eventually(lambda: bridges.ask(machine.folder / "robot1.sock").info)  # its thread may stand still for 2 s


def test_end_of_bridge_is_told_and_return(machine: Machine, engine: ScriptedEngine) -> None:
    app = attached_app(machine)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        machine.served[-1].close("the bridge was stopped")
        await shown(pilot, "NOT ATTACHED: the bridge was stopped")
        await until(pilot, lambda: "● ok" not in text(app), "unknown states are not OK")
        await pilot.press("R")
        await shown(pilot, "start it there")
        await until(pilot, lambda: not (machine.folder / "robot1.sock").exists(), "its socket is gone")
        machine.serve(ScriptedEngine(routes=(route("/again"),)))
        await shown(pilot, "/again")
        await until(pilot, lambda: "NOT ATTACHED" not in text(app), "attached")

    drive(app, steps)
    app.stop()


def test_quitting_names_what_the_bridge_has_not_saved(machine: Machine, engine: ScriptedEngine, tmp_path: Path) -> None:
    app = attached_app(machine)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        engine.session = msgspec.structs.replace(engine.session, topics=(Topic("/new", "transmit"),))
        await shown(pilot, "● unsaved")
        await pilot.press("q")
        await shown(pilot, SessionQuestion.GOES_ON_UNSAVED, changes="added /new")
        await pilot.press("n", "w", "y")
        await until(pilot, lambda: ("save",) in engine.commands, "the bridge knows")
        await until(pilot, lambda: "unsaved" not in text(app), "saved")
        assert load(tmp_path / "nav2.yaml") == engine.session
        await pilot.press("q")
        await shown(pilot, "Quit?")
        await until(pilot, lambda: "added /new" not in text(app), "nothing is lost")

    drive(app, steps)
    app.stop()


def test_a_bridge_elsewhere_saves_its_session_itself(machine: Machine, engine: ScriptedEngine) -> None:
    app = attached_app(machine)

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        app.path = app.saved = app.file = None  # as of a bridge whose file is on another machine
        engine.session = msgspec.structs.replace(engine.session, topics=(Topic("/new", "transmit"),))
        await shown(pilot, "● unsaved")
        await pilot.press("q")
        await shown(pilot, SessionQuestion.GOES_ON_UNSAVED, changes=SaveQuestion.UNNAMED())
        await pilot.press("n", "w")
        await shown(pilot, SaveQuestion.SAVE_THERE, name="robot1")
        await pilot.press("y")
        await until(pilot, lambda: engine.commands == [("save",)], "saved there")

    drive(app, steps)
    app.stop()


def test_a_session_that_runs_already_is_offered_instead(machine: Machine, engine: ScriptedEngine) -> None:
    def serve(*_: object) -> tuple[None, bridges.RunningBridge]:
        return None, bridges.ask(machine.folder / "robot1.sock")

    app = scripted_app(serve=serve)

    async def answer(pilot: Pilot[None]) -> None:
        await shown(pilot, SessionQuestion.ALREADY_RUNS, name="robot1")
        assert app.engine is None, "a second bridge has not even begun"
        await pilot.press("n")
        await until(pilot, lambda: isinstance(app.screen, WelcomeScreen), "the welcome screen")
        app.main.run_worker(attach_instead(app.main, serve()[1]), group=Group.SESSION, exclusive=True)
        await until(pilot, lambda: isinstance(app.screen, OfferScreen), "the offer")
        await pilot.press("enter")  # the focus is on Yes
        await until(pilot, lambda: app.attached_to == "robot1", "attached")

    drive(app, answer)
    app.stop()

    watching = scripted_app(serve=serve, readonly=True)

    async def look(pilot: Pilot[None]) -> None:
        await shown(pilot, "/robot2/scan")
        assert watching.attached_to == "robot1"
        await shown(pilot, "read-only")

    drive(watching, look)
    watching.stop()


# --- with real processes


@pytest.fixture
def pair(tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Pair:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    return Pair(tmp_path, Topic(CHATTER, "transmit"))


@pytest.fixture
def headless(pair: Pair) -> Iterator[list[Forked]]:
    """The client's bridge without a console, the newest last."""
    processes = [run_headless(pair)]
    yield processes
    end(processes[-1])


def run_headless(pair: Pair) -> Forked:
    streams: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return Forked("rsb_console", "run", "--no-ui", str(pair.client_path), **streams)


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
def test_attaching_in_a_terminal(pair: Pair, headless: list[Forked], tmp_path: Path, machine: Machine) -> None:
    eventually(lambda: bridges.running_bridges(machine.environ))
    with pair.server(), talker(CHATTER), Tmux(tmp_path, "sh") as tmux:
        tmux("send-keys", f"{COMMAND} attach robot1", "Enter")  # the server's bridge may run by now, too
        tmux.wait_for("attached  ")
        tmux.wait_for("● LINKED")
        tmux.wait_for("◇ UNHEARD")
        tmux("send-keys", "p")
        tmux.wait_for("PAUSED")
        tmux("send-keys", "p")
        tmux.agree(OperationText.RESUME(topic=CHATTER))  # behind tmux, a key may have come late
        tmux.wait_for("◇ UNHEARD")
        tmux("send-keys", "q")
        tmux.agree("The bridge robot1 goes on")
        tmux.wait_for("Topics", there=False)
        assert headless[-1].poll() is None

        tmux("send-keys", "C-u", f"{COMMAND} run {pair.client_path}", "Enter")  # a late y may stand in the line
        tmux.agree(SessionQuestion.ALREADY_RUNS(name="robot1"))
        tmux.wait_for("◇ UNHEARD")

        headless[-1].send_signal(signal.SIGKILL)
        headless[-1].wait()
        tmux.wait_for("NOT ATTACHED")
        tmux.wait_for("◇ UNHEARD", there=False)
        headless.append(run_headless(pair))
        tmux.wait_for("● LINKED")
        tmux.wait_for("◇ UNHEARD")
        tmux("send-keys", "q")
        tmux.agree("The bridge robot1 goes on")
        tmux.wait_for("Topics", there=False)

        tmux("send-keys", "C-u", f"{COMMAND}", "Enter")
        tmux.wait_for("●  robot1")
        tmux("send-keys", "Enter")
        tmux.wait_for("◇ UNHEARD")
        assert headless[-1].poll() is None
