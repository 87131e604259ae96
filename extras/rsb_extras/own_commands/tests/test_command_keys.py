"""Keys that run an operator's commands, on the main screen and on the links, and the pane of their output."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import (
    drive,
    engine_of,
    gone,
    is_shown,
    notices,
    notified,
    on_main,
    put,
    scripted_app,
    shown,
    shown_at_the_end,
    text,
    until,
)
from tests.console.scripted import LINK, route
from tests.console.terminal import Terminal
from tests.console.tmux import Tmux
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State
from rsb_console.screens.links_screen import LinksScreen
from rsb_console.screens.main import MainText
from rsb_console.screens.message_screen import MessageScreen
from rsb_extras.own_commands import command_keys
from rsb_extras.own_commands.command_keys import OwnCommandText, robot_of
from rsb_extras.own_commands.output_screen import OutputScreen
from rsb_extras.own_commands.own_command import CommandMistake
from rsb_extras.own_commands.running import KEPT_LINES, RUNNING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.console.driving import Decorator
    from textual.pilot import Pilot

    from rsb_bridge.model.wording import Wording
    from rsb_console.app import ConsoleApp

TOPIC = "/robot2/scan"
"""Under the cursor at first."""


@pytest.fixture(autouse=True)
def _ends() -> Iterator[None]:
    """Leave no command to the next test."""
    yield
    RUNNING.end()
    eventually(lambda: not len(RUNNING), what="no command left")


def with_commands(
    *sizes: tuple[int, int], landmark: str | Wording = TOPIC, readonly: bool = False, **commands: str
) -> Decorator:
    """A test's steps run with an operator's commands, each as YAML by its key."""

    def written() -> dict[str, Any]:
        lines = (f"  {key}: {fields}" for key, fields in commands.items())
        Path("console.yaml").write_text("\n".join(("commands:", *lines)))
        return {"config": Path().resolve()}

    def decorate(steps: Callable[..., Any]) -> Any:
        test = on_main(*sizes, landmark=landmark, before=written, readonly=readonly)(steps)
        return pytest.mark.usefixtures("folder")(test)

    return decorate


def output_of(app: ConsoleApp) -> list[str]:
    assert isinstance(app.screen, OutputScreen)
    return app.screen.command.output.lines


@with_commands(
    (120, 36), (40, 12), landmark="▌✗", Y='{run: "echo {topic} {type} {link} {robot} {state}; exit 3", where: topic}'
)
async def test_key_shows_what_its_command_prints(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("Y")
    await shown(pilot, "exit code 3")
    expected = f"{TOPIC} sensor_msgs/msg/LaserScan robot1 10.0.0.20 down"
    assert output_of(app) == [expected]
    in_pane = "".join(line.strip("│ ") for line in text(app).splitlines())
    assert expected.replace(" ", "") in in_pane.replace(" ", "")
    await pilot.press("escape")
    assert app.screen is app.main


@with_commands(Y='{run: "echo ran >> ran.txt", where: link, confirm: true, description: restart it}')
async def test_question_shows_the_whole_command_first(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("Y")
    await shown(pilot, OwnCommandText.ASKS, name="restart it")
    await shown(pilot, "echo ran >> ran.txt")
    assert app.focused is not None
    assert app.focused.id == "no"
    await pilot.press("enter")
    await until(pilot, lambda: app.screen is app.main, "the main screen")
    assert not Path("ran.txt").exists()
    await pilot.press("Y", "y")
    await shown(pilot, "exit code 0")
    assert Path("ran.txt").read_text() == "ran\n"


@with_commands(Y='{run: "touch made; echo {topic}", where: topic}')
@pytest.mark.parametrize("name", ["/a;touch injected", "/$(touch injected)", "/a b", "-x"])
async def test_hostile_name_runs_nothing(app: ConsoleApp, pilot: Pilot[None], name: str) -> None:
    put(app, route(name))
    await pilot.press("Y")
    await notified(pilot, OwnCommandText.UNSAFE, name="topic")
    assert app.screen is app.main
    assert not Path("made").exists()
    assert not Path("injected").exists()


@with_commands(Y='{run: "echo {type}", where: topic}')
async def test_unknown_type_is_said(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, route("/scan", type_name=""))
    await pilot.press("Y")
    await notified(pilot, OwnCommandText.EMPTY, name="type")


@with_commands(Y='{run: "echo here; sleep 1000"}')
async def test_closed_pane_leaves_its_command_running(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("Y")
    await shown(pilot, "here")
    first = RUNNING.find("echo here; sleep 1000")
    await pilot.press("escape", "Y")
    await shown(pilot, "here")
    assert RUNNING.find("echo here; sleep 1000") is first
    await pilot.press("s")
    await shown(pilot, "ended by SIGTERM")
    await gone(pilot, "s stop")


@with_commands(Y='{run: "while [ ! -e go ]; do sleep 0.05; done; exit 4", description: waits}')
async def test_end_behind_a_closed_pane_is_told(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("Y")
    await shown(pilot, "s stop")
    await pilot.press("escape")
    Path("go").touch()
    await notified(pilot, OwnCommandText.ENDED, name="waits")
    assert "exit code 4" in notices(app)[-1].message


@with_commands(Y=f'{{run: "seq {KEPT_LINES + 500}"}}')
async def test_pane_follows_and_scrolls(app: ConsoleApp, pilot: Pilot[None]) -> None:
    at_the_end = f" {KEPT_LINES + 499} "  # the last number is in the command, too, which is shown before the end is
    await pilot.press("Y")
    await shown(pilot, "exit code 0")
    await shown(pilot, at_the_end)
    await shown_at_the_end(pilot, "lines are kept", "g")  # it may still follow what it drew before
    await shown(pilot, "exit code 0")
    await shown_at_the_end(pilot, at_the_end)


@with_commands(Y='{run: "sleep 1000 # {topic}", where: topic}')
async def test_commands_at_once_are_limited(app: ConsoleApp, pilot: Pilot[None]) -> None:
    for number in range(command_keys.MOST):
        put(app, route(f"/topic{number}"))
        await pilot.press("Y", "escape")
    await until(pilot, lambda: len(RUNNING) == command_keys.MOST, "as many as possible")
    put(app, route("/one_more"))
    await pilot.press("Y")
    await notified(pilot, OwnCommandText.TOO_MANY, most=command_keys.MOST)
    assert app.screen is app.main


@with_commands(
    (120, 100), landmark="read-only", readonly=True, Y='{run: "touch made", description: changing}',
    Z='{run: "echo looked", changes: false, description: looking}',
)  # fmt: skip
async def test_readonly_leaves_commands_that_change_nothing(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("Y")
    await notified(pilot, MainText.READ_ONLY)
    assert app.screen is app.main
    await pilot.press("Z")
    await shown(pilot, "exit code 0")
    assert output_of(app) == ["looked"]
    assert not Path("made").exists()
    await pilot.press("escape", "question_mark")
    await shown(pilot, "Own commands")
    await shown(pilot, "looking")
    assert not is_shown(app, "changing")


@with_commands(Y='{run: "echo {topic}", where: topic}', Z='{run: "echo {link}", where: link}')
async def test_keys_are_grey_without_what_they_need(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine = engine_of(app)
    engine.now = replace(engine.now, routes=())
    app.pull()
    assert app.main.check_action("command_Y", ()) is None
    assert app.main.check_action("command_Z", ()), "there is only one link"
    engine.now = replace(engine.now, links=(LINK, replace(LINK, name="robot2")), role="server")
    app.pull()
    assert app.main.check_action("command_Z", ()) is None
    await pilot.press("Y", "Z")
    assert app.screen is app.main


@with_commands((200, 36), Y='{run: "echo found", description: find it}')
async def test_footer_and_palette_have_the_command(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await shown(pilot, "Y find it")
    await pilot.press("colon", *"find it")
    await shown(pilot, "find it")
    await pilot.press("enter")
    await shown(pilot, "exit code 0")
    assert output_of(app) == ["found"]


@with_commands(Y='{run: "echo {link} {robot} {state}", where: link}', Z='{run: "echo {topic}", where: topic}')
async def test_links_have_the_keys_of_links(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine = engine_of(app)
    engine.now = replace(engine.now, links=(LINK, replace(LINK, name="robot2", state=State.DOWN)), role="server")
    app.pull()
    await pilot.press("c")
    await until(pilot, lambda: isinstance(app.screen, LinksScreen), "the links")
    await pilot.press("Z")
    assert isinstance(app.screen, LinksScreen)
    await pilot.press("Y")
    await shown(pilot, "exit code 0")
    assert output_of(app) == ["robot2 robot2 down"]
    await pilot.press("escape")
    assert isinstance(app.screen, LinksScreen)


@with_commands(Y='{run: "echo nothing"}')
async def test_keys_of_commands_stay_out_of_screens(app: ConsoleApp, pilot: Pilot[None]) -> None:
    app.push_screen(MessageScreen(app, route("/map")))
    await pilot.pause()
    await pilot.press("Y")
    assert isinstance(app.screen, MessageScreen)


@with_commands(landmark=CommandMistake.NO_PLACEHOLDER, Y='{run: "echo {robt}"}')
async def test_mistake_is_one_toast(app: ConsoleApp, pilot: Pilot[None]) -> None:
    (notice,) = notices(app)
    assert "console.yaml: commands.Y.run: {robt}" in notice.message
    await pilot.press("Y")
    assert app.screen is app.main


@pytest.mark.parametrize(
    ("role", "address", "robot"),
    [
        ("client", "10.0.0.20:49152", "10.0.0.20"),
        ("client", "[fe80::1%eth0]:49152", "fe80::1%eth0"),
        ("client", "robot.local:49152", "robot.local"),
        ("client", "AA:BB:CC:DD:EE:FF channel 3", "AA:BB:CC:DD:EE:FF"),
        ("client", "", ""),
        ("server", "0.0.0.0:49152", "robot7"),
    ],
)
def test_robot_is_the_other_side(role: str, address: str, robot: str) -> None:
    app = scripted_app()

    async def steps(pilot: Pilot[None]) -> None:
        await shown(pilot, TOPIC)
        engine = engine_of(app)
        engine.now = replace(engine.now, role=role, address=address)
        assert robot_of(app, "robot7") == robot

    drive(app, steps)


TERMINAL = r"""
commands:
  Y: {run: "echo begin {topic}; sleep 0.3; printf 'a\\033[31mb\\033[2J\\n'; tty; exit 5", where: topic}
  f9: {run: "read -r answer; echo \"answer: $answer\"; read -r again; exit 6", interactive: true, description: asks}
"""


@pytest.fixture
def in_tmux(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Tmux]:
    """The console in tmux, with the commands of `TERMINAL`."""
    if shutil.which("tmux") is None:
        pytest.skip("needs tmux")
    config = folder / "config" / "rsb-console"
    config.mkdir(parents=True)
    (config / "console.yaml").write_text(TERMINAL)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(config.parent))
    monkeypatch.chdir(Path(__file__).parents[4])
    path = os.pathsep.join(filter(None, sys.path))
    console = shlex.join([sys.executable, "-m", "tests.console.scripted_console"])
    with Tmux(folder, "env", f"PYTHONPATH={path}", "sh", "-c", f"exec {console}") as tmux:
        tmux.wait_for(TOPIC)
        yield tmux


def pressed(tmux: Tmux, key: str, words: str) -> str:
    """Press a key until its effect is there: the console ignores it while it starts."""
    deadline = time.monotonic() + 120
    while words not in (picture := tmux.picture):
        assert time.monotonic() < deadline, picture
        tmux("send-keys", key)
        time.sleep(0.5)
    return picture


def test_key_runs_a_real_command_in_a_terminal(in_tmux: Tmux) -> None:
    pressed(in_tmux, "Y", f"begin {TOPIC}")
    picture = in_tmux.wait_for("exit code 5")
    assert "ab\\x1b" not in picture
    assert "│ ab " in picture
    assert "not a tty" in picture
    in_tmux("send-keys", "Escape")
    in_tmux.wait_for("LIVE")


def test_interactive_command_gets_the_terminal_and_gives_it_back(in_tmux: Tmux) -> None:
    pressed(in_tmux, "Y", "exit code 5")  # it has started: F9 again would be an answer to the command
    in_tmux("send-keys", "Escape")
    in_tmux.wait_for("exit code 5", there=False)
    in_tmux.wait_for("LIVE")
    in_tmux("send-keys", "F9")
    eventually(lambda: in_tmux.makes_signals)  # until then keys are the console's, which ignores them
    in_tmux("send-keys", "hello", "Enter")
    in_tmux.wait_for("answer: hello")
    in_tmux("send-keys", "C-z", "bye", "Enter")
    in_tmux.wait_for("asks: exit code 6")
    in_tmux.wait_for("LIVE")
    in_tmux("send-keys", "F9")
    eventually(lambda: in_tmux.makes_signals)
    in_tmux("send-keys", "C-c")
    in_tmux.wait_for("asks: ended by SIGINT")
    pressed(in_tmux, "Y", "exit code 5")


CHANGING = """
import itertools, sys
from pathlib import Path
from rsb_console.command.app_run import run_app
from rsb_console.app import ConsoleApp
from tests.console.driving import scripted_app
changes, ready = itertools.count(), ConsoleApp.on_ready
def change(app):
    app.notify(f"change {next(changes)}", timeout=0.05)
    Path(sys.argv[1], "changes").write_text(str(changes))
ConsoleApp.on_ready = lambda self: [ready(self), self.set_interval(0.05, lambda: change(self))]
run_app(scripted_app(config=Path(sys.argv[1])), mouse=False)
"""


def test_what_changes_while_a_command_has_the_terminal_is_shown_after_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "console.yaml").write_text(TERMINAL)
    monkeypatch.chdir(Path(__file__).parents[4])
    environ = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    changes = folder / "changes"
    with Terminal(sys.executable, "-c", CHANGING, str(folder), environ=environ) as terminal:
        terminal.wait_for(TOPIC)
        terminal.type("\x1b[20~")  # F9
        terminal.wait_for("\x1b[?1049l")
        before = changes.read_text()
        eventually(lambda: changes.read_text() not in ("", before), what="a change")
        before = changes.read_text()
        eventually(lambda: changes.read_text() not in ("", before), what="another one, once the first was drawn")
        mark = len(terminal.output)
        terminal.type("\n\n")
        terminal.wait_for("exit code 6", after=mark)
        terminal.type("\x03y")


ENDING = """
commands:
  Y: {run: "echo $$ >{folder}/pane; sleep 1000"}
  f9: {run: "echo $$ >{folder}/terminal; trap '' TERM; echo reads; cat", interactive: true}
"""
CONSOLE = """
import sys
from pathlib import Path
from rsb_console.command.app_run import run_app
from tests.console.driving import scripted_app
run_app(scripted_app(config=Path(sys.argv[1])), mouse=False)
"""


@pytest.mark.parametrize("hangs_up", [True, False])
def test_end_of_the_console_ends_its_commands(folder: Path, monkeypatch: pytest.MonkeyPatch, hangs_up: bool) -> None:
    (folder / "console.yaml").write_text(ENDING.replace("{folder}", str(folder)))
    monkeypatch.chdir(Path(__file__).parents[4])
    environ = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    pane = folder / "pane"
    with Terminal(sys.executable, "-c", CONSOLE, str(folder), environ=environ) as terminal:
        terminal.wait_for(TOPIC)
        terminal.type("Y")
        terminal.wait_for("s stop")
        eventually(lambda: pane.exists() and pane.read_text(), what="a command with a pane")
        terminal.type("q\x1b[20~")  # F9
        terminal.wait_for("reads")
        if hangs_up:
            terminal.hang_up()
        else:
            terminal.kill(signal.SIGTERM)
        terminal.exit_code()
    for file in (pane, folder / "terminal"):
        process = Path("/proc", file.read_text().strip())
        eventually(lambda process=process: not process.exists(), what=f"the end of the one in the {file.name}")
