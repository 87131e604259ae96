"""Arming on the console: the question, the marks, the keys, and a console that dies."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.arming_helpers import ARMED, DISARMED
from tests.console.driving import engine_of, gone, notified, on_main, put, shown, until
from tests.console.live import COMMAND, ELSEWHERE, HERE, Pair, bridging, talker
from tests.console.scripted import route
from tests.console.side import every_so_often
from tests.console.tmux import Tmux
from tests.support.commands import rsb_console
from tests.support.forker import Forked
from tests.support.long import long
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.control.protocol import RequestProblem
from rsb_bridge.model.by_hand import VelocityLimits
from rsb_bridge.model.commands import AnswerAsker
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, Driver, RouteSnapshot, State
from rsb_bridge.model.verdict import Cause
from rsb_console.notation.formats import DriverText
from rsb_console.operations.topic_operations import OperationText
from rsb_console.screens.help import HelpScreen
from rsb_console.screens.take_over import HandOverScreen, HandOverText

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

CHATTER = "/chatter"


async def arm(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("A")
    await shown(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).commands == [("arm", "/cmd_vel")], "armed")


@on_main()
async def test_question_that_names_topic_and_robot_comes_before(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, DISARMED)
    await shown(pilot, "A arm")
    await shown(pilot, "⊘ DISARMED")
    await pilot.press("A")
    await shown(pilot, "Arm /cmd_vel of robot1?")
    await pilot.press("enter")  # the focus is on No
    await gone(pilot, "Arm /cmd_vel of robot1?")
    assert engine_of(app).commands == []
    await arm(app, pilot)


JOYSTICK, TELEOP = Driver("/joystick", here=True), Driver("/teleop", here=True, rate=10.02)
HAND, NAV = Driver("", here=True, rate=0.0, by_hand=True), Driver("/nav", here=False)


@pytest.mark.parametrize(
    ("drivers", "text", "names"),
    [
        ((), DriverText.NOBODY, ""),
        ((HAND,), DriverText.NOBODY, ""),
        ((JOYSTICK,), DriverText.ONE, "/joystick"),
        ((JOYSTICK, TELEOP), DriverText.SEVERAL, "/joystick and /teleop (10 Hz)"),
        ((TELEOP, NAV), DriverText.SEVERAL, f"/teleop (10 Hz) and {DriverText.THERE(who='/nav')}"),
    ],
)
@on_main()
async def test_question_names_who_publishes_now(
    app: ConsoleApp, pilot: Pilot[None], drivers: tuple[Driver, ...], text: DriverText, names: str
) -> None:
    put(app, replace(DISARMED, drivers=drivers))
    await shown(pilot, "⊘ DISARMED")
    await pilot.press("A")
    await shown(pilot, text, **({"who": names} if names else {}))


@on_main()
async def test_several_drivers_are_counted_and_named(app: ConsoleApp, pilot: Pilot[None]) -> None:
    drivers = (replace(JOYSTICK, rate=5.0), TELEOP)
    put(app, replace(ARMED, cause=Cause.SEVERAL_PUBLISHERS, reason="both publish it", drivers=drivers))
    await shown(pilot, "◆ ARMED ×2 /cmd_vel")
    await shown(pilot, "both publish it")
    await shown(pilot, "/joystick (5 Hz)")
    await shown(pilot, "/teleop (10 Hz)")
    put(app, replace(ARMED, arming=None, cause=Cause.SEVERAL_PUBLISHERS, drivers=drivers))
    await shown(pilot, "● ok ×2    /cmd_vel")


@on_main()
async def test_paused_topic_is_resumed_before_anybody_is_asked(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, replace(DISARMED, state=State.PAUSED))
    await shown(pilot, "A arm")
    await pilot.press("A")
    await shown(pilot, "Not done")
    await gone(pilot, "Arm /cmd_vel of robot1?")
    assert engine_of(app).commands == []


@on_main()
async def test_armed_topic_is_marked_and_disarmed_at_once(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, ARMED)
    await shown(pilot, "◆ ARMED    /cmd_vel")
    await shown(pilot, "◆ 1 ARMED 42 s")
    await shown(pilot, "robot1 says: anna")
    await shown(pilot, "A disarm")
    await pilot.press("A")
    await until(pilot, lambda: engine_of(app).commands == [("disarm", "/cmd_vel")], "disarmed")


@on_main()
async def test_a_frozen_list_stops_nobody_from_disarming(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, DISARMED, route("/paused"))
    await shown(pilot, "⊘ DISARMED")
    await pilot.press("space")
    put(app, ARMED, route("/paused", State.PAUSED))
    await pilot.press("A")
    await until(pilot, lambda: engine_of(app).commands == [("disarm", "/cmd_vel")], "disarmed")
    await pilot.press("j", "p")
    await notified(pilot, OperationText.IS_ALREADY, topic="/paused")
    assert len(engine_of(app).commands) == 1


@on_main()
async def test_key_that_armed_disarms_wherever_cursor_is(app: ConsoleApp, pilot: Pilot[None]) -> None:
    camera = route("/camera")
    put(app, DISARMED, camera)
    await shown(pilot, "A arm")  # DISARMED comes first
    await arm(app, pilot)
    put(app, ARMED, camera)  # and goes down
    await shown(pilot, "◆ ARMED    /cmd_vel")
    assert app.main.topics.selected == ARMED
    for keys in (["A"], ["k", "A"]):
        await until(pilot, lambda: app.deadman.held, "an answer that this console holds it")
        engine_of(app).commands.clear()
        await pilot.press(*keys)
        await until(pilot, lambda: engine_of(app).commands == [("disarm", "/cmd_vel")], "disarmed")
    assert app.main.topics.selected == camera


def asked(seconds: float = 7.0, by: str = "bert on pts/2") -> RouteSnapshot:
    assert ARMED.arming is not None
    return replace(ARMED, arming=replace(ARMED.arming, asked_by=by, goes_in=seconds))


@pytest.mark.parametrize(("key", "gives"), [("y", True), ("n", False)])
@on_main()
async def test_the_holder_is_asked_wherever_the_operator_is(
    app: ConsoleApp, pilot: Pilot[None], key: str, gives: bool
) -> None:
    put(app, ARMED)
    await shown(pilot, "◆ ARMED    /cmd_vel")
    await pilot.press("question_mark")
    for seconds in (7.0, 6.0):
        put(app, asked(seconds))
        await shown(pilot, HandOverText.ASKS, who="bert on pts/2", seconds=seconds)
    await pilot.press(key)
    await until(pilot, lambda: engine_of(app).commands == [("answer_asker", "/cmd_vel", gives)], "the answer")
    put(app, asked(5.0))
    await gone(pilot, HandOverText.GIVE(topic="/cmd_vel", link="robot1"))


@on_main()
async def test_a_question_that_is_over_is_gone(app: ConsoleApp, pilot: Pilot[None]) -> None:
    title = HandOverText.GIVE(topic="/cmd_vel", link="robot1")
    put(app, asked())
    await shown(pilot, title)
    put(app, DISARMED)
    await gone(pilot, title)
    assert engine_of(app).commands == []


@on_main()
async def test_another_operators_question_is_another_one(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, asked())
    await shown(pilot, HandOverText.ASKS, who="bert on pts/2", seconds=7.0)
    first = app.screen
    put(app, asked(by="carla on pts/3"))
    await shown(pilot, HandOverText.ASKS, who="carla on pts/3", seconds=7.0)
    await until(pilot, lambda: isinstance(app.screen, HandOverScreen) and app.screen is not first, "a new question")
    await pilot.press("y")
    await until(pilot, lambda: engine_of(app).given[-1:] == [AnswerAsker("/cmd_vel", True, "carla on pts/3")], "it")


@on_main()
async def test_expired_question_closes_no_screen_above_it(app: ConsoleApp, pilot: Pilot[None]) -> None:
    title = HandOverText.GIVE(topic="/cmd_vel", link="robot1")
    put(app, asked())
    await shown(pilot, title)
    question = app.screen
    assert isinstance(question, HandOverScreen)
    await pilot.press("question_mark")
    put(app, DISARMED)
    question.show()
    assert isinstance(app.screen, HelpScreen)
    await pilot.press("escape")
    await gone(pilot, title)


@on_main()
async def test_only_the_holders_console_asks_its_operator(app: ConsoleApp, pilot: Pilot[None]) -> None:
    engine_of(app).holds = ()
    put(app, asked())
    await shown(pilot, "◆ ARMED    /cmd_vel")
    app.pull()
    await pilot.pause()
    assert app.screen is app.main


@on_main()
async def test_a_name_is_disarmed_everywhere(app: ConsoleApp, pilot: Pilot[None]) -> None:
    others = (
        replace(ARMED, key="far", link="robot2"),
        replace(ARMED, key="there", remote_topic="/elsewhere"),
        replace(DISARMED, key="not armed", link="robot3"),
        replace(ARMED, key="another", topic="/another"),
    )
    put(app, ARMED, *others)
    await shown(pilot, "/another")
    while app.main.topics.selected not in (ARMED, *others[:2]):
        await pilot.press("j")
    await pilot.press("A")
    await until(pilot, lambda: len(engine_of(app).commands) == 3, "disarmed")
    assert {command[1] for command in engine_of(app).commands} == {"/cmd_vel", "far", "there"}
    assert {command[0] for command in engine_of(app).commands} == {"disarm"}


@on_main()
async def test_demanding_and_limiting_lines_are_in_details(app: ConsoleApp, pilot: Pilot[None]) -> None:
    demanded = ArmingSnapshot(armed=False, demanded_by=("robot.yaml:14",))
    put(app, replace(DISARMED, arming=demanded, limits=VelocityLimits(0.5), limited_by=("robot.yaml:15",)))
    for words in ("robot.yaml:14", "at most 0.5 m/s by hand", "robot.yaml:15"):
        await shown(pilot, words)


@on_main()
async def test_a_state_is_named_as_in_programs(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, replace(DISARMED, state=State.DISARMING, cause="disarming"))
    await shown(pilot, f"{State.DISARMING.upper()}  /cmd_vel")  # the row, which has no room for the sign
    await shown(pilot, f"⊖ {State.DISARMING.upper()} ")  # the details


@on_main((80, 24))
async def test_the_marks_are_there_on_a_small_screen(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, ARMED)
    await shown(pilot, "◆ ARMED    /cmd_vel")
    await shown(pilot, "◆ 1 ARMED 42 s")


@on_main(ascii_only=True)
async def test_the_marks_are_there_in_ascii(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, ARMED)
    await shown(pilot, "* ARMED    /cmd_vel")


@on_main()
async def test_keys_keep_it_armed(app: ConsoleApp, pilot: Pilot[None]) -> None:
    put(app, DISARMED)
    await shown(pilot, "A arm")
    await arm(app, pilot)
    put(app, ARMED)
    app.pull()  # forgets the keys that armed it
    kept = engine_of(app).kept
    kept.clear()
    await until(pilot, lambda: len(kept) > 2, "signs of life")
    assert not any(kept)
    await pilot.press("j")
    await until(pilot, lambda: any(kept), "a key")
    app.pull()  # the app sees a key more than once, and a refresh may have come between
    kept.clear()
    await until(pilot, lambda: len(kept) > 2, "signs of life")
    assert not any(kept)
    await pilot.press("question_mark")
    await shown(pilot, "Next line")
    app.pull()
    kept.clear()
    await pilot.press("j")  # who reads the help does not watch the robot
    await until(pilot, lambda: len(kept) > 2, "signs of life")
    assert not any(kept)


@on_main()
async def test_what_need_not_be_armed_has_no_key(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await gone(pilot, "A arm")
    await pilot.press("A")
    await pilot.press("p")
    await until(pilot, lambda: engine_of(app).commands, "paused")
    assert [command[0] for command in engine_of(app).commands] == ["pause"]
    assert engine_of(app).kept == []


# --- with real processes

PATIENT = "tests.console.patient_bridge"


def armed_pair(folder: Path, domain: int) -> Pair:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    return Pair(folder, Topic(CHATTER, "transmit", arm=True, deadman=0.0), domains=(domain, domain + 1))


def json_of(line: str) -> dict[str, Any]:
    return dict(json.loads(line)) if line.startswith("{") else {}


class Robot:
    """The client's bridge, without a console, as others attach to it."""

    def __init__(self, control: Path) -> None:
        self.control = "--control", str(control)
        self._events_before = 0

    def command(self, *words: str, **streams: Any) -> Forked:
        return Forked("rsb_console", *words, *self.control, **streams)

    @contextlib.contextmanager
    def arming(self, *options: str, stdin: int = subprocess.DEVNULL) -> Iterator[tuple[Forked, str]]:
        """`rsb-console arm` while it holds the topic armed, and its first line.

        Where its process takes more than 5 s to start, it arms nothing, as a command that has come late; then it is
        given again.
        """
        first = ""
        while not first:
            pipes = {"stdin": stdin, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            with self.command("arm", *options, CHATTER, **pipes) as process:
                assert process.stdout is not None
                assert process.stderr is not None
                first = process.stdout.readline()
                if first and json_of(first).get("ok", True):
                    yield process, first
                else:
                    assert says(first + process.stderr.read(), RequestProblem.TOO_LATE)
                    first = ""

    def ask(self, *words: str) -> list[dict[str, Any]]:
        ran = rsb_console(*words, *self.control, "--json")
        return [json.loads(line) for line in ran.stdout.splitlines()]

    def topic(self) -> dict[str, Any]:
        answers = self.ask("topics")
        found = answers[0].get("topics") if answers else None
        return dict(found[0]) if found else {"state": "", "arming": {"armed": None}}

    def begin(self) -> None:
        """Wait until the topic is disarmed, and leave out the events of earlier tests."""
        self.is_set_up()
        self._events_before = len(every_so_often(self._all_events, "its events"))

    def _all_events(self) -> list[dict[str, Any]]:
        return [event for event in self.ask("events") if "code" in event]  # and no refusal

    def events(self, code: str) -> list[dict[str, Any]]:
        return [event for event in self._all_events()[self._events_before :] if event["code"] == code]

    def is_set_up(self) -> None:
        every_so_often(lambda: self.topic()["state"] == "disarmed", "disarmed")

    def is_armed(self) -> None:
        every_so_often(lambda: self.topic()["arming"]["armed"], "armed")

    def why_disarmed(self) -> str:
        causes = [event["cause"] for event in self.events("route.disarmed")]
        return causes[-1] if causes else ""


@pytest.fixture(scope="module")
def _robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """It is linked with a server, and its topic is published: three processes, which outlive each test's consoles."""
    folder = tmp_path_factory.mktemp("robot")
    pair = armed_pair(folder, HERE)
    made = Robot(folder / "robot.sock")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        with (
            pair.server(PATIENT),
            talker(CHATTER),
            bridging(pair.client_path, *made.control, program=PATIENT),
        ):
            yield made


@pytest.fixture
def robot(_robot: Robot) -> Robot:
    _robot.begin()
    return _robot


@pytest.mark.skipif(shutil.which("tmux") is None, reason="needs tmux")
@pytest.mark.parametrize("end", ["killed", *long("terminal gone")])
def test_a_console_that_dies_disarms(end: str, robot: Robot, tmp_path: Path) -> None:
    tmux = Tmux(tmp_path, str(COMMAND), "attach", *robot.control, size=(160, 40))
    try:
        tmux.wait_for("⊘ DISARMED")
        tmux("send-keys", "A")
        tmux.agree(f"Arm {CHATTER} of robot1?")
        tmux.wait_for("◆ ARMED")
        robot.is_armed()
        if end == "killed":
            os.kill(int(tmux("display-message", "-p", "#{pane_pid}")), signal.SIGKILL)
        else:
            tmux("kill-server")
    finally:
        with contextlib.suppress(subprocess.CalledProcessError):  # it ends with its last pane
            tmux("kill-server")
    # For the event itself: on a busy machine the state was seen without it.
    assert every_so_often(robot.why_disarmed, "disarmed") == "console_gone"


def test_dying_console_of_robot_disarms_other_side(tmp_path: Path) -> None:
    """Its bridge dies with it: the link drops."""
    pair = armed_pair(tmp_path, ELSEWHERE)
    here, there = Robot(tmp_path / "own.sock"), Robot(tmp_path / "server.sock")
    with (
        bridging(pair.server_path, *there.control),
        talker(CHATTER, domain=ELSEWHERE),
        Tmux(tmp_path, str(COMMAND), str(pair.client_path), *here.control) as tmux,
    ):

        def arms() -> object:
            """Arm it, again if a busy machine has stood still since. The screen may be late: then `A` would disarm."""
            if not here.topic()["arming"]["armed"]:
                before = here.events("operator.armed")
                tmux.wait_for("⊘ DISARMED")
                tmux("send-keys", "A")
                tmux.agree(f"Arm {CHATTER} of robot1?")
                every_so_often(lambda: len(here.events("operator.armed")) > len(before), "armed")
            at = there.topic()["arming"]
            return at["armed"] and at

        armed = every_so_often(arms, "armed on both sides")
        assert armed["here"] is False
        tmux("set-option", "-g", "remain-on-exit", "on")
        os.kill(int(tmux("display-message", "-p", "#{pane_pid}")), signal.SIGKILL)
        every_so_often(there.why_disarmed, "disarmed")
        assert there.why_disarmed() in ("link_lost", "channel_lost"), "in any order of the connections' ends"


@pytest.mark.parametrize("number", [signal.SIGKILL, *long(signal.SIGINT)], ids=["kill -9", "Ctrl-C"])
def test_the_command_holds_it_armed_while_it_runs(number: signal.Signals, robot: Robot) -> None:
    with robot.arming(stdin=subprocess.PIPE) as (arming, first):
        assert "ARMED" in first
        robot.is_armed()
        arming.send_signal(number)
        assert arming.wait(60) == (130 if number is signal.SIGINT else -signal.SIGKILL)
    robot.is_set_up()
    assert robot.why_disarmed() == "console_gone"


def test_command_that_stands_still_gets_nothing_from_holder(robot: Robot) -> None:
    """It got the topic after the countdown, though nobody was there who would have driven."""
    with robot.arming() as (holder, first), contextlib.ExitStack() as at_end:
        at_end.callback(holder.kill)
        assert "ARMED" in first
        processes: list[Forked] = []

        def asked_by() -> list[dict[str, Any]]:
            if not processes or processes[-1].poll() is not None:
                processes.append(ask())  # the one before took more than 5 s to start
            return robot.events("operator.asked")

        def ask() -> Forked:
            process = robot.command("arm", "--ask", CHATTER, stderr=subprocess.DEVNULL)
            at_end.enter_context(process)
            at_end.callback(process.kill)
            return process

        (asked,) = every_so_often(asked_by, "asked")
        asking = processes[-1]
        asking.send_signal(signal.SIGSTOP)
        (ended,) = every_so_often(lambda: robot.events("operator.withdrew"), "the end of the question")
        asking.send_signal(signal.SIGCONT)
        assert asking.wait(60) == 1
        assert asked["who"] == ended["who"]
        assert robot.topic()["arming"]["armed"]
        assert not robot.events("operator.disarmed")


def test_the_command_says_who_has_disarmed_it(robot: Robot) -> None:
    """It told the operator to arm again what a colleague had just disarmed."""
    with robot.arming("--json") as (arming, first):
        assert json.loads(first)["armed"] is True
        assert arming.stdout is not None
        assert robot.ask("disarm", CHATTER) == [{"ok": True}]
        (ended,) = map(json.loads, arming.stdout)
        assert arming.wait(60) == 1
    (event,) = eventually(lambda: robot.events("operator.disarmed"))
    assert event["who"]
    assert (ended["ok"], ended["cause"]) == (False, "operator")
    assert event["who"] in ended["error"]
    assert "rsb-console arm" not in ended["error"]
    assert robot.topic()["arming"]["why"] == "operator"
