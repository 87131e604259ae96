"""This side's nodes in a graph that a test plays: refused names, ends, lines, states, and what a peer may see."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zstandard
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from tests.support.offline import loop, make_context

from rsb_bridge.config.rights import Rights
from rsb_bridge.feature_api import Cause, RosError, State, Verdict
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Grant
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, NodeEnds, RawMessage
from rsb_extras.nodes.graph_nodes import read_nodes
from rsb_extras.nodes.lifecycle_states import SERVICE, TYPE, LifecycleStates
from rsb_extras.nodes.link_nodes import LinkNodes
from rsb_extras.nodes.node_data import AskNode, AskNodes, FoundBy, NodeChanges, NodeDetails, ProcessState
from rsb_extras.nodes.node_processes import NodeProcesses
from rsb_extras.nodes.node_watch import NodeWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context

__all__ = ["loop", "make_context"]

LIDAR = "/front/lidar"
SCAN = NodeEnds(publishes={"/scan": ["sensor_msgs/msg/LaserScan"]})
NO_PUBLISHER = Verdict(State.WAITING, Cause.NO_PUBLISHER, "no publisher of /scan", 0.0)
_GID = b"\x01\x0f\x12\x34" + bytes(20)


class Graph(NoRos):
    """A graph. Names with a ``-`` are refused, as rcl does."""

    def __init__(self) -> None:
        self.nodes: dict[str, NodeEnds] = {LIDAR: SCAN}
        self.gid = _GID
        self.clients: list[ScriptedClient] = []
        self.ready: set[str] = set()
        self.failure: Exception | None = None

    def node_names(self) -> list[str]:
        return list(self.nodes)

    def ends_of(self, node: str) -> NodeEnds:
        if "-" in node:
            raise RosError("the ROS graph cannot be read")
        return self.nodes.get(node, NodeEnds())

    def publishers(self, topic: str) -> list[Endpoint]:
        return [Endpoint(each, "", "", Qos(), self.gid) for each, ends in self.nodes.items() if topic in ends.publishes]

    def servers(self, service: str) -> list[Endpoint]:
        if self.failure is not None:
            raise self.failure
        return [Endpoint(service.removesuffix(SERVICE), TYPE, "", Qos(), _GID)]

    def call_service(self, service: str, *_: Any) -> Any:
        self.clients.append(ScriptedClient(service.removesuffix(SERVICE), self))
        return self.clients[-1]


class ScriptedClient:
    def __init__(self, node: str, graph: Graph) -> None:
        self.node, self.calls, self.closed = node, 0, False
        self._graph = graph

    @property
    def ready(self) -> bool:
        return self.node in self._graph.ready

    def call(self, _: bytes) -> int:
        self.calls += 1
        return self.calls

    def close(self) -> None:
        self.closed = True


class Processes:
    """Processes of nodes on this machine: none that a GUID tells, one by its name."""

    def __init__(self) -> None:
        self.pid, self.ended = 77, False

    def machine_of(self, _: bytes) -> str:
        return ""

    def pid_of(self, _: bytes) -> int:
        return 0

    def has_ended(self, _: bytes) -> bool:
        return self.ended

    def pid_by_name(self, names: set[str]) -> dict[str, int]:
        return dict.fromkeys(names, self.pid) if self.pid else {}

    def figures(self, pid: int, _: float) -> ProcessState | None:
        return ProcessState(pid, "lidar", 1, 1, 1, 0) if pid == self.pid else None


class World:
    """The watch of one side, in virtual time, and its end of a link."""

    def __init__(self, made_by: Callable[..., Context], loop: VirtualLoop, monkeypatch: pytest.MonkeyPatch) -> None:
        self.routes: dict[str, Any] = {}
        self.ros, self.processes, self.loop = Graph(), Processes(), loop
        self.context = made_by(self.ros)
        self.watch = self.context.shared(NodeWatch)
        self.sent: list[Any] = []
        monkeypatch.setattr(self.watch, "_processes", self.processes)
        self._changes = 0

    def passes(self, seconds: int = 1, *, changed: bool = False) -> None:
        """Tick each second."""
        for _ in range(seconds):
            self._changes += changed
            self.watch.tick(self._changes)
            self.loop.run_until_complete(asyncio.sleep(1.0))

    def link(self, *deny: Grant, **features: Any) -> LinkNodes:
        rights = Rights("the server", "robot1", "in the session file of robot1", (), deny, features=features)
        link: Any = SimpleNamespace(
            name="robot1",
            context=self.context,
            end=SimpleNamespace(rights=rights),
            spawn=self.loop.create_task,
            send=self.sent.append,
            routes=self.routes,
        )
        return LinkNodes(link)

    def answer(self, nodes: LinkNodes, question: Any, kind: type[Any]) -> Any:
        """Return what the peer is told."""
        nodes.messages[type(question)](question)
        self.loop.run_until_complete(asyncio.sleep(1.0))
        return msgspec.msgpack.decode(zstandard.decompress(self.sent.pop().packed), type=kind)


@pytest.fixture
def world(make_context: Callable[..., Context], loop: VirtualLoop, monkeypatch: pytest.MonkeyPatch) -> World:
    return World(make_context, loop, monkeypatch)


def outgoing(*endpoints: Endpoint) -> Any:
    half = SimpleNamespace(carried=SimpleNamespace(endpoints=endpoints))
    return SimpleNamespace(outgoing=True, local_topic="/scan", half=half)


# --- names and ends


def test_name_that_ros_refuses_hides_no_other_node() -> None:
    graph = Graph()
    graph.nodes = {"/a-b": SCAN, LIDAR: SCAN}
    found = read_nodes(graph, ["/a-b", LIDAR]).nodes
    assert found["/a-b"].ends == NodeEnds()
    assert found[LIDAR].ends == SCAN


def test_watch_is_ready_in_spite_of_a_refused_name(world: World) -> None:
    world.ros.nodes["/a-b"] = NodeEnds()
    world.passes(2)
    world.loop.run_until_complete(asyncio.wait_for(world.watch.ready(), 1.0))
    assert set(world.watch.book.nodes) == {"/a-b", LIDAR}


def test_publisher_of_a_topic_is_the_one_that_runs_or_ended_last(world: World) -> None:
    def publisher() -> str:
        state = world.watch.details("", "/scan").state
        return "" if state is None else state.name

    world.ros.nodes["/rear/lidar"] = SCAN
    world.passes(2, changed=True)
    del world.ros.nodes["/rear/lidar"]
    world.passes(2, changed=True)
    assert publisher() == LIDAR
    world.ros.nodes = {LIDAR: NodeEnds(publishes={"/points": ["a/msg/B"]})}
    world.passes(2, changed=True)
    assert publisher() == "/rear/lidar"
    world.passes(3700)
    assert publisher() == ""


def test_tool_that_comes_back_is_another_one(world: World) -> None:
    world.ros.nodes["/_tool"] = SCAN
    world.passes(2, changed=True)
    world.ros.gid = _GID[:6] + bytes([1]) + _GID[7:]
    world.passes(1, changed=True)
    node = world.watch.book.nodes["/_tool"]
    assert (node.ended, node.ends, node.publishes) == (None, 0, 1)
    assert world.watch.book.nodes[LIDAR].ends == 1


def test_end_of_a_silent_publisher_is_found_on_a_thread(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes, route = world.link(), outgoing(*world.ros.publishers("/scan"))
    silent = Verdict(State.STOPPED, Cause.PUBLISHER_SILENT, "silent", 0.0)
    assert nodes.explanation is not None
    world.passes(2, changed=True)
    world.processes.ended = True
    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(world.processes, "has_ended", None)  # not on the loop
        assert nodes.explanation(route, silent) is None
    world.passes()
    explained = nodes.explanation(route, silent)
    assert explained is not None
    assert LIDAR in explained.text


def test_verdict_is_made_again_once_its_node_has_ended(world: World) -> None:
    """DDS tells of a publisher's end before the graph is read."""
    nodes, again = world.link(), list[str]()
    for topic, verdict in (("/scan", NO_PUBLISHER), ("/flows", Verdict(State.OK, Cause.NONE, "", 0.0))):
        route = outgoing()
        route.verdict = lambda verdict=verdict: verdict
        route.judge_again = lambda topic=topic: again.append(topic)
        world.routes[topic] = route
    world.passes(2, changed=True)
    nodes.tick()
    assert again == []
    world.ros.nodes.clear()
    world.passes(2, changed=True)
    nodes.tick()
    nodes.tick()
    assert again == ["/scan"]


# --- what a peer may see


def test_hidden_node_is_not_named_in_a_verdict(world: World) -> None:
    shown, hidden = world.link(), world.link(show_nodes=False)
    world.passes(2, changed=True)
    world.ros.nodes.clear()
    world.passes(2, changed=True)
    assert shown.explanation is not None
    assert hidden.explanation is not None
    explained = shown.explanation(outgoing(), NO_PUBLISHER)
    assert explained is not None
    assert LIDAR in explained.text
    assert hidden.explanation(outgoing(), NO_PUBLISHER) is None


def test_question_without_a_right_is_no_look(world: World) -> None:
    world.passes(2)
    hidden = world.link(show_nodes=False)
    assert "does not show its nodes" in world.answer(hidden, AskNodes(1, 0, 0), NodeChanges).why_not
    assert world.answer(hidden, AskNode(1, LIDAR), NodeDetails).state is None
    assert not world.watch.is_looked_at
    assert world.answer(world.link(), AskNodes(1, 0, 0), NodeChanges).nodes
    assert world.watch.is_looked_at


def test_publisher_of_a_denied_topic_is_not_told(world: World) -> None:
    world.passes(2)
    nodes = world.link(Grant(topics="/scan"))
    assert world.answer(nodes, AskNode(1, topic="/scan"), NodeDetails).state is None
    found = world.answer(nodes, AskNode(2, LIDAR), NodeDetails)
    assert found.state.name == LIDAR
    assert found.left_out == 1
    assert world.answer(world.link(), AskNode(1, topic="/scan"), NodeDetails).state.name == LIDAR


# --- processes


def test_process_found_by_its_name_is_kept_while_it_lives(world: World) -> None:
    found = set()
    world.watch.look()
    world.passes(3)
    for _ in range(15):
        world.watch.look()
        world.passes()
        node = world.watch.book.nodes[LIDAR]
        found.add((node.pid, node.found_by))
    assert found == {(77, FoundBy.NAME)}
    world.processes.pid = 0
    for _ in range(4):
        world.watch.look()
        world.passes()
    node = world.watch.book.nodes[LIDAR]
    assert (node.pid, node.found_by, node.ended) == (0, FoundBy.NOT, None)


def test_process_with_unreadable_maps_is_no_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_process = tmp_path / "1"
    of_process.mkdir()
    (of_process / "cmdline").write_bytes(b"/sbin/init\0")
    (of_process / "stat").write_text(f"1 (init) S {' '.join('0' * 30)}")
    (of_process / "maps").write_bytes(b"libfastrtps.so")
    participant = _GID[:4] + b"\x01\x00" + bytes(6)
    assert NodeProcesses(_GID, tmp_path).pid_of(participant) == 1
    read = Path.read_bytes

    def refused(path: Path) -> bytes:
        if path.name == "maps":
            raise PermissionError
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", refused)
    processes = NodeProcesses(_GID, tmp_path)
    assert processes.pid_of(participant) == 0
    (of_process / "stat").unlink()
    assert not processes.has_ended(participant)


# --- lines and states


def test_line_that_comes_while_others_are_taken_is_taken(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.passes(2)
    heard: list[Callable[[list[RawMessage]], None]] = []
    monkeypatch.setattr(world.ros, "subscribe", lambda _, sink, *__: heard.append(sink), raising=False)
    monkeypatch.setattr(world.watch, "_log_hash", "RIHS01_")
    world.watch.look()
    world.passes()
    monkeypatch.setattr(world.loop, "call_soon_threadsafe", lambda work: work())  # the loop is as fast as can be
    for text in ("stalled", "stalled again"):
        line = bytes(serialize_message(Log(level=40, name="front.lidar.motor.left", msg=text)))
        heard[0]([RawMessage(line, 0)])
        shown = world.watch.book.nodes[LIDAR].line
        assert shown is not None
        assert shown.text == text


def test_managed_nodes_that_are_not_ready_keep_none_waiting(world: World) -> None:
    names = [f"/{number}" for number in range(9)]
    world.ros.ready = {"/8"}
    states = LifecycleStates(world.context, lambda _, __: None)
    for _ in range(20):
        states.ask(names)
        world.loop.run_until_complete(asyncio.sleep(1.0))
    assert {each.node: each.calls for each in world.ros.clients if each.calls}.keys() == {"/8"}


def test_clients_are_closed_when_nobody_looks(world: World) -> None:
    world.ros.nodes["/managed"] = NodeEnds(serves={f"/managed{SERVICE}": [TYPE]})
    world.watch.look()
    world.passes(5)
    assert [each.closed for each in world.ros.clients] == [False]
    world.passes(5)
    assert [each.closed for each in world.ros.clients] == [True]


def test_client_whose_opening_fails_is_opened_again(world: World) -> None:
    states = LifecycleStates(world.context, lambda _, __: None)
    world.ros.failure = ValueError("unforeseen")
    world.loop.set_exception_handler(lambda _, __: None)
    for failure in (world.ros.failure, None):
        world.ros.failure = failure
        states.ask(["/a"])
        world.loop.run_until_complete(asyncio.sleep(1.0))
    assert len(world.ros.clients) == 1
    states.close()
    states.ask(["/a"])
    states.close()
    states.ask(["/a"])
    world.loop.run_until_complete(asyncio.sleep(1.0))
    assert [each.closed for each in world.ros.clients] == [True, False]
