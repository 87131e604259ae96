"""A program at a running bridge, by the client of the package mcp, over stdin and stdout."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import find, route
from tests.support.domain import LATCHED, text
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_extras.mcp_server.mcp_tools import TOOLS, ToolError, ToolProblem, bounded

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.commands import Ran
    from tests.support.control import Machine

    from rsb_bridge.engine import Engine

READING = {"status", "verdicts", "topics", "topic", "message", "nodes", "history", "events"}
CHANGING = {"add_topic", "remove_topic", "pause_topic", "resume_topic"}
CHAT = Topic("/chat", "transmit", type="std_msgs/msg/String")
DRIVE = Topic("/cmd_vel", "receive", type="geometry_msgs/msg/Twist", paused=True)
NASTY = "\x1b[2Jlens\u202e is dirty"


class Program:
    """What a program may do at one bridge."""

    def __init__(self, machine: Machine, *options: str) -> None:
        self._environ = {key: value for key, value in machine.environ.items() if isinstance(value, str)}
        self._options = options

    def run(self, *calls: tuple[str, dict[str, Any]]) -> tuple[set[str], list[tuple[Any, bool]]]:
        """Return the names of the offered tools, and each call's answer, with whether it is an error."""
        return asyncio.run(self._run(calls))

    async def _run(self, calls: tuple[tuple[str, dict[str, Any]], ...]) -> tuple[set[str], list[tuple[Any, bool]]]:
        client_module = pytest.importorskip("mcp.client", reason="the extra mcp")
        from mcp.client.stdio import StdioServerParameters, stdio_client

        words = ["-P", "-m", "rsb_console", "mcp", *self._options]
        server = StdioServerParameters(command=sys.executable, args=words, env=self._environ)
        async with client_module.Client(stdio_client(server)) as client:
            names = {each.name for each in (await client.list_tools()).tools}
            answers = []
            for name, given in calls:
                answer = await client.call_tool(name, given)
                assert json.loads(answer.content[0].text) == answer.structured_content
                answers.append((answer.structured_content, answer.is_error))
            return names, answers


@pytest.fixture
def robot_side(bridge: Bridge, machine: Machine) -> Engine:
    """A robot's bridge that a program may reach, with a latched message."""
    bridge.robot.publisher("/chat", qos=LATCHED).publish(text(NASTY))
    server, client = bridge.both(CHAT, DRIVE)
    listener = bridge.pc.listener("/chat", qos=LATCHED)
    eventually(lambda: listener.payloads, what="a message")
    machine.serve(client)
    assert route(server, "/chat")
    return client


def test_each_reading_tool_answers(robot_side: Engine, machine: Machine) -> None:
    program = Program(machine)
    names, answers = program.run(
        ("status", {}),
        ("verdicts", {"all": True}),
        ("topics", {"part": "cha"}),
        ("topic", {"topic": "/chat"}),
        ("message", {"topic": "/chat"}),
        ("nodes", {"here": True}),
        ("history", {"last": "30m"}),
        ("events", {}),
    )
    assert names == READING
    assert not [answer for answer, is_error in answers if is_error]
    status, verdicts, topics, topic, message, nodes, history, events = (answer for answer, _ in answers)
    assert status["name"] == "robot1"
    assert "routes" not in status
    assert sum(status["topics_by_state"].values()) == 2
    assert [(each["topic"], each["state"]) for each in verdicts["topics"]] == [("/cmd_vel", "paused")]
    assert [each["topic"] for each in topics["topics"]] == ["/chat"]
    assert topic["type"] == "std_msgs/msg/String"
    assert message["message"]["data"] == r"\x1b[2Jlens\u202e is dirty"
    assert isinstance(nodes["nodes"], list)
    assert history["name"] == "robot1"
    assert any("connected" in json.dumps(each) for each in events["lines"])


def test_changes_are_offered_only_where_they_are_allowed(robot_side: Engine, machine: Machine) -> None:
    new = {"topic": "/more", "direction": "transmit", "type": "std_msgs/msg/String"}
    names, ((answer, is_error),) = Program(machine).run(("add_topic", new))
    assert names == READING
    assert is_error
    assert answer["error"] == ToolProblem.NO_TOOL(name="add_topic")
    names, answers = Program(machine, "--allow-changes").run(
        ("add_topic", new | {"max_rate": "5"}),
        ("pause_topic", {"topic": "/chat"}),
    )
    assert names == READING | CHANGING
    assert [is_error for _, is_error in answers] == [False, False]
    eventually(lambda: route(robot_side, "/chat").state == "paused", what="paused")
    _, answers = Program(machine, "--allow-changes").run(
        ("resume_topic", {"topic": "/chat"}), ("remove_topic", {"topic": "/more"})
    )
    assert [is_error for _, is_error in answers] == [False, False]
    eventually(lambda: route(robot_side, "/chat").state != "paused", what="resumed")
    eventually(lambda: find(robot_side, "/more") is None, what="removed")


def test_what_moves_a_robot_is_not_offered(robot_side: Engine, machine: Machine) -> None:
    moving = {"direction": "receive", "type": "geometry_msgs/msg/Twist"}
    plain = {"direction": "receive", "type": "std_msgs/msg/String"}
    for entry in (Topic("/dock", "transmit", kind="action"), Topic("/unknown", "receive")):
        robot_side.pause(robot_side.add_topic(entry).result(30), paused=True).result(30)
    calls: list[tuple[str, dict[str, Any]]] = [
        ("resume_topic", {"topic": "/dock"}),
        ("resume_topic", {"topic": "/unknown"}),
        ("add_topic", moving | {"topic": "/drive"}),
        ("add_topic", plain | {"topic": "/x", "remote_topic": "/cmd_vel"}),
        ("add_topic", plain | {"topic": "/**"}),
        ("resume_topic", {"topic": "/cmd_vel"}),
        *((name, {"topic": "/cmd_vel"}) for name in ("arm", "disarm", "publish", "call", "goal", "edit", "stop")),
    ]
    _, answers = Program(machine, "--allow-changes").run(*calls)
    assert [is_error for _, is_error in answers] == [True] * len(calls)
    assert {route(robot_side, name).state for name in ("/cmd_vel", "/dock", "/unknown")} == {State.PAUSED}
    assert find(robot_side, "/drive") is None
    assert find(robot_side, "/x") is None


def test_mistakes_are_answers(robot_side: Engine, machine: Machine) -> None:
    _, answers = Program(machine, "robot1").run(
        ("topic", {"topic": "/none"}),
        ("topic", {"topic": "--control=/tmp/x"}),
        ("topic", {}),
        ("status", {"more": "1"}),
        ("nodes", {"here": "yes"}),
        ("history", {"last": "1 day"}),
        ("nodes", {"link": "--here"}),
        ("nodes", {"link": "Robot 1, the blue one"}),
    )
    assert [is_error for _, is_error in answers] == [True] * 8
    assert "link is invalid" in answers[6][0]["error"]
    assert "no link 'Robot 1, the blue one'" in answers[7][0]["error"]
    assert "/none" in answers[0][0]["error"]
    _, answers = Program(machine, "robot7").run(("status", {}), ("events", {}))
    for answer, is_error in answers:
        assert is_error
        assert "robot7" in answer["error"]
    assert robot_side.snapshot().routes


def test_without_the_package_the_remedy_is_named(ran: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcp", None)
    for name in [each for each in sys.modules if each.startswith("mcp.")]:
        monkeypatch.delitem(sys.modules, name)
    found = ran("mcp")
    assert found.code == 1
    assert found.err == "rsb-console: mcp is not installed: pip install 'rsb-console[mcp]'\n"


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_a_terminal_gets_a_hint_and_ends_it(ending: signal.Signals) -> None:
    pytest.importorskip("mcp", reason="the extra mcp")
    terminal, end = pty.openpty()
    words = [sys.executable, "-P", "-m", "rsb_console", "mcp"]
    process = subprocess.Popen(words, stdin=end, stdout=end, stderr=end, start_new_session=True)
    os.close(end)
    try:
        said = b""
        while b"a program starts this" not in said:
            said += os.read(terminal, 4096)
        process.send_signal(ending)
        assert process.wait(180) == -ending
    finally:
        process.kill()
        process.wait()
        os.close(terminal)


# -- answers


def test_answers_are_bounded_and_clean() -> None:
    found = bounded({"a": list(range(1000)), "b": "x" * 5000, "\x1b[2J": {"c": NASTY}})
    assert found["a"][-1] == {"left_out": 800}
    assert len(found["b"]) == 2001
    assert found[r"\x1b[2J"] == {"c": r"\x1b[2Jlens\u202e is dirty"}
    deep: Any = 1
    for _ in range(500):
        deep = [deep]
    assert "left_out" in json.dumps(bounded(deep))
    for much in (list(range(200)), ["x" * 3000] * 200, {f"{number:0200}": 1 for number in range(200)}):
        assert len(json.dumps(bounded([[much] * 200] * 200))) < 200_000


@pytest.mark.parametrize("name", sorted(TOOLS))
def test_schemas_and_checks_agree(name: str) -> None:
    tool = TOOLS[name]
    assert tool.schema["required"] == [each.name for each in tool.arguments if each.required]
    with pytest.raises(ToolError):
        tool.check({"unknown": "1"})
    for each in tool.arguments:
        with pytest.raises(ToolError):
            tool.check({each.name: 5})
        for option in ("--json", "--json\n", "a\0", "\ud800"):
            with pytest.raises(ToolError):
                tool.check({each.name: option})


def test_no_tool_arms_calls_or_publishes() -> None:
    given = {"topic": "/a", "direction": "transmit", "type": "std_msgs/msg/String"}
    commands = {tool.words(given)[0] for tool in TOOLS.values()}
    assert commands == {"status", "info", "echo", "nodes", "report", "events", "add", "remove", "pause", "resume"}
