"""`call` and `param` as commands, on either side of a bridge, with stock nodes that answer."""

from __future__ import annotations

import json
import sys
import threading
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter
from tests.calls.by_hand_helpers import ready
from tests.support import constants
from tests.support.bridge import happened
from tests.support.commands import Ran
from tests.support.waiting import eventually

from rsb_bridge.control import bridges
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, Grant, Topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.control import Machine
    from tests.support.domain import Domain
    from tests.support.spun import Spun

VALUES: dict[str, tuple[Parameter.Type, Any]] = {
    "on": (Parameter.Type.BOOL, True),
    "rate": (Parameter.Type.INTEGER, -(2**63)),
    "gain": (Parameter.Type.DOUBLE, float("inf")),
    "frame": (Parameter.Type.STRING, "true"),
    "raw": (Parameter.Type.BYTE_ARRAY, [b"\x00", b"\xff"]),
    "flags": (Parameter.Type.BOOL_ARRAY, [True, False]),
    "ids": (Parameter.Type.INTEGER_ARRAY, [2**63 - 1]),
    "limits": (Parameter.Type.DOUBLE_ARRAY, [1.0, -0.5]),
    "names": (Parameter.Type.STRING_ARRAY, ["5", ""]),
}
"""All nine types of parameter."""


@pytest.fixture
def run(
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    machine: Machine,
) -> Callable[..., Ran]:
    """Run a command against what `machine` serves; a test that fails shows what all of them said."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    constants.BRIDGES_ASKED_FOR.set(monkeypatch, 60.0)  # s: how soon a busy machine answers is not what is tested

    def said(*words: str) -> Ran:
        done = Ran(capsys, *words)
        request.node.add_report_section("call", f"output of {' '.join(words)}", repr(done))
        return done

    return said


@pytest.fixture
def camera(start: Callable[..., Spun], robot: Domain) -> Spun:
    """A node with a parameter of each type, one that is read only, and one that it is particular about."""
    spun = start(robot, "camera")
    for name, (kind, value) in VALUES.items():
        spun.node.declare_parameter(name, Parameter(name, kind, value).value)
    spun.node.declare_parameter("serial", "A1", ParameterDescriptor(read_only=True, description="on its plate"))
    limits = ParameterDescriptor(floating_point_range=[FloatingPointRange(from_value=0.0, to_value=2.0, step=0.0)])
    spun.node.declare_parameter("zoom", 1.0, limits)

    def check(parameters: list[Parameter]) -> SetParametersResult:
        bad = any(each.name == "frame" and each.value == "moon" for each in parameters)
        return SetParametersResult(successful=not bad, reason="not as far as that" if bad else "")

    spun.node.add_on_set_parameters_callback(check)
    return spun


@pytest.mark.parametrize("on_server", [True, False])
def test_parameters_are_listed_read_set_and_dumped(
    bridge: Bridge, machine: Machine, camera: Spun, run: Callable[..., Ran], on_server: bool
) -> None:
    server, client = bridge.both(Topic("/camera", "receive", kind="parameters"), use_name=True)
    ready(server, "/robot1/camera")
    machine.serve(server if on_server else client)
    node = "/robot1/camera" if on_server else "/camera"

    assert set(VALUES) <= set(run("param", "list", node).out.split())
    assert run("param", "get", node, "rate").out == f"{-(2**63)}\n"
    assert run("param", "get", node, "frame").out == "'true'\n"
    assert json.loads(run("param", "get", node, "gain", "--json").out)["parameters"][0]["value"] == "Infinity"
    dumped = yaml.safe_load(run("param", "dump", node).out)[node]["ros__parameters"]
    assert dumped.items() >= {**{name: value for name, (_, value) in VALUES.items()}, "raw": [0, 255]}.items()
    assert json.loads(run("param", "dump", node, "--json").out)["parameters"]["ids"] == [2**63 - 1]
    described = yaml.safe_load(run("param", "describe", node, "zoom").out)["zoom"]
    assert (described["type"], described["range"]["high"]) == ("double", 2.0)

    for name, value, kind, is_now in (
        ("on", "false", "", False),
        ("rate", "7", "", 7),
        ("gain", "2", "double", 2.0),
        ("frame", "'5'", "", "5"),
        ("raw", "[7]", "byte_array", [b"\x07"]),
        ("flags", "[]", "bool_array", []),
        ("ids", "[1, 0x10]", "", [1, 16]),
        ("limits", "[1, 2.5]", "", [1.0, 2.5]),
        ("names", "['1', yes]", "", ["1", "yes"]),
    ):
        done = run("param", "set", node, name, value, "--yes", *(("--type", kind) if kind else ()))
        assert (done.code, done.err) == (0, "")
        found = camera.node.get_parameter(name).value
        assert (list(found or []) if isinstance(is_now, list) else found) == is_now


def test_refusal_of_node_is_told_in_its_words(
    bridge: Bridge, machine: Machine, camera: Spun, run: Callable[..., Ran]
) -> None:
    server, _ = bridge.both(Topic("/camera", "receive", kind="parameters"))
    ready(server, "/camera")
    machine.serve(server)
    for name, value, kind in (("frame", "moon", ""), ("rate", "fast", "string"), ("unknown", "1", "integer")):
        own = camera.node.set_parameters([Parameter(name, value=yaml.safe_load(value))]) if name != "unknown" else []
        words = "param", "set", "/camera", name, value, "--yes", *(("--type", kind) if kind else ())
        refused = run(*words)
        assert refused.code == 1
        assert all(each.reason in refused.err and each.reason for each in own)
        assert f"does not set {name}: " in refused.err
        assert not json.loads(run(*words, "--json").out)["ok"]
    for name, value, why in (
        ("serial", "B2", "it is read-only"), ("zoom", "9.0", "9.0 is not in its range"),
        ("unknown", "1", "has no parameter unknown: if it takes new ones, give --type"),
    ):  # fmt: skip
        assert why in run("param", "set", "/camera", name, value, "--yes").err
    for command in ("get", "describe"):
        assert run("param", command, "/camera", "unknown").code == 1


def test_who_may_not_call_sets_nothing(
    bridge: Bridge, machine: Machine, camera: Spun, start: Callable[..., Spun], pc: Domain, run: Callable[..., Ran]
) -> None:
    """A client whose server lets it serve and not call; its own node can be set from there."""
    start(pc, "planner").node.declare_parameter("speed", 1)
    client_of_ours = Client("robot1", key_file=bridge.key_file, allow=(Grant(services="/*", may="serve"),))
    server = bridge.server(clients=(client_of_ours,))
    client = bridge.client(
        Topic("/camera", "receive", kind="parameters"), Topic("/planner", "transmit", kind="parameters")
    )
    ready(server, "/camera")
    machine.serve(client)
    assert run("param", "get", "/camera", "on").code == 0
    refused = run("param", "set", "/planner", "speed", "2", "--yes", "--link", "robot1")
    assert refused.code == 1
    assert "does not let robot1 read parameters of /planner: add may: {nodes: [/planner]}" in refused.err


def test_goal_is_sent_awaited_and_cancelled_by_commands(
    bridge: Bridge, machine: Machine, pc: Domain, run: Callable[..., Ran]
) -> None:
    """It takes longer than the route's timeout; a command that stops waiting reports that the goal goes on."""
    fibonacci: Any = pytest.importorskip("tests.support.fibonacci")
    served = fibonacci.FibonacciServer(pc.id)
    printed: Any = sys.stderr  # as `capsys` has it until somebody reads it
    try:
        server, client = bridge.both(Topic("/fibonacci", "transmit", kind="action", timeout=2.5))
        ready(client, "/fibonacci")
        for number, engine in enumerate((client, server)):
            socket = machine.serve(engine)
            sent = run("call", "/fibonacci", "{goal: {order: 5}}", "--lane", "send_goal", "--json")
            answer = json.loads(sent.out)
            assert answer["response"]["accepted"], sent
            goal = f"{{goal_id: {answer['goal_id']}}}"
            hurried = run("call", "/fibonacci", goal, "--lane", "get_result", "--timeout", "3")
            assert hurried.code == 1
            assert "the goal goes on" in hurried.err
            results: list[Ran] = []

            def wait(goal: str = goal, results: list[Ran] = results) -> None:
                results.append(run("call", "/fibonacci", goal, "--lane", "get_result", "--json"))

            waiting = threading.Thread(target=wait)
            waiting.start()
            waiting.join(4)  # longer than the route's timeout: nothing tells of a call that is not given up
            assert waiting.is_alive()
            eventually(lambda: "executing" in printed.getvalue(), what="it tells what the goal does")
            cancel = f"goal_info: {{goal_id: {answer['goal_id']}}}"
            engine.call(engine.snapshot().routes[0].key, cancel, "cancel_goal").result(60)
            eventually(lambda number=number: len(served.cancels) > number, what="the cancel")
            served.finish(number=number, state="canceled")
            waiting.join(60)
            (said,) = results
            assert said.code == 0
            assert json.loads(said.out)["response"]["status"] == 5  # canceled
            ended = eventually(lambda engine=engine: happened(engine, EventCode.OPERATOR_CALL_ENDED, "get_result"))
            assert "answered" in ended.new
            socket.close()
            eventually(lambda: not bridges.running_bridges(machine.environ), what="only the next is served")
    finally:
        served.close()
