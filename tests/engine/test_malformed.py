"""A peer's messages are checked against their types before ROS gets them: a real node keeps its memory."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support import constants

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from tests.support.bridge import carries, feedback_listeners, happened, heard, linked, listeners, route, settled
from tests.support.domain import LATCHED
from tests.support.fibonacci import ACTION
from tests.support.frames import write_frame
from tests.support.participants import KnownNode
from tests.support.rogue import Rogue
from tests.support.waiting import eventually

from rsb_bridge.config.keys import read_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.native.typesupport import hash_of, installed_class
from rsb_bridge.route.calls.goals import accepted_by

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.fibonacci import FibonacciServer

    from rsb_bridge.api import EngineApi
    from rsb_bridge.ros.node import RosNode
    from rsb_bridge.ros.ros_interface import Request, ServiceServer

EIGHT = bytes.fromhex("00 01 00 00 00 00 00 10")
"""A sequence of 2^28 elements, and none of them."""
FEWER = bytes.fromhex("00 01 00 00 00 00 20 00")
"""The same with 2^21 elements, for which a node of limited memory has room."""
PARAMETERS = "rcl_interfaces/srv/SetParameters"
FIBONACCI = "test_msgs/action/Fibonacci"
SET = "/victim/set_parameters"
GROWS_LESS_THAN = 50 << 20
"""Bytes."""
_NODE = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import SubscriptionEventCallbacks
def say(word):
    return lambda _: print(word, flush=True)
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("victim")
matched = SubscriptionEventCallbacks(matched=say("matched"))
node.create_subscription(DiagnosticArray, sys.argv[2], say("report"), 10, event_callbacks=matched)
print("ready", flush=True)
rclpy.spin(node)
"""


class Victim:
    """A stock rclpy node in a process of its own.

    Its topic is its own, since DDS takes a killed node for a living one for 20 s: a publisher that has matched the last
    victim's subscription does not know this one's yet, and what it publishes then never comes here.

    Attributes:
        topic: that it listens to.
    """

    _numbers = itertools.count()

    def __init__(self, domain_id: int) -> None:
        self.topic = f"/report{next(self._numbers)}"
        command = (sys.executable, "-c", _NODE, str(domain_id), self.topic)
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self.says("ready")
        self._before = self._peak()

    def says(self, word: str) -> None:
        """Wait for a word of its output: ``matched`` after it has found a publisher, ``report`` for each message."""
        eventually(lambda: word in self._lines, what=word)

    def _read(self) -> None:
        assert self._process.stdout is not None
        self._lines.extend(line.strip() for line in self._process.stdout)

    @property
    def is_well(self) -> bool:
        """Whether it runs, and never had much more memory than it began with."""
        return self._process.poll() is None and self._peak() - self._before < GROWS_LESS_THAN

    def _peak(self) -> int:
        """The largest resident memory so far."""
        lines = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) << 10

    def close(self) -> None:
        self._process.kill()
        self._reader.join()
        self._process.communicate()


@pytest.fixture
def victim(pc: Domain) -> Iterator[Victim]:
    made = Victim(pc.id)
    yield made
    made.close()


@pytest.fixture
def caller(robot: Domain) -> Iterator[RosNode]:
    """Makes raw calls in the client's domain."""
    made = KnownNode(robot.id, "caller")
    made.start()
    yield made
    made.stop()


def array(*names: str) -> bytes:
    values = [KeyValue(key="k", value="v")]
    return bytes(serialize_message(DiagnosticArray(status=[DiagnosticStatus(name=n, values=values) for n in names])))


def refused(engine: EngineApi, name: str) -> dict[str, int]:
    calls = route(engine, name).calls
    assert calls is not None
    return calls.refused


def calls_raw(caller: RosNode, service: str, kind: str, *payloads: bytes, waits: bool = False) -> list[Any]:
    """Call a service as soon as the bridge offers it; its answers, the first of which it may wait for."""
    answers: list[Any] = []
    client = caller.call_service(service, kind, caller.installed_service_hash(kind) or "", answers.extend)
    eventually(lambda: client.ready)
    for payload in payloads:
        client.call(payload)
    if waits:
        eventually(lambda: answers)
    return answers


def test_eight_bytes_of_request_do_not_reach_node(bridge: Bridge, victim: Victim, caller: RosNode) -> None:
    server, client = bridge.both(Topic(SET, "transmit", kind="service", timeout=20.0))
    right = EIGHT[:4] + bytes(4)
    answers = calls_raw(caller, SET, PARAMETERS, FEWER, EIGHT, right)
    eventually(lambda: answers)
    assert victim.is_well
    for engine in (server, client):
        eventually(lambda engine=engine: refused(engine, SET) == {"malformed": 2})
    assert len(answers) == 1
    request = "rcl_interfaces/srv/SetParameters_Request"
    assert happened(server, EventCode.ROUTE_MALFORMED, f"{request} from robot1: param")
    eventually(lambda: happened(client, EventCode.ROUTE_MALFORMED, f"{request} to robot1: param"))


@pytest.mark.parametrize("sender_knows", [True, False])
def test_too_long_calls_are_refused_by_either_side(
    sender_knows: bool, bridge: Bridge, victim: Victim, caller: RosNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sender_knows:
        constants.SENT_CALL_LIMIT.set(monkeypatch, 1000)
    server, client = bridge.both(Topic(SET, "transmit", kind="service", timeout=20.0))
    short = EIGHT[:4] + bytes(4)
    first = calls_raw(caller, SET, PARAMETERS, short)
    eventually(lambda: first)
    constants.CALL_LIMIT.set(monkeypatch, 1000)
    answers = calls_raw(caller, SET, PARAMETERS, EIGHT[:4] + bytes(2000), short)
    eventually(lambda: answers)
    eventually(lambda: refused(client, SET) == {"too large": 1})
    assert refused(server, SET) == ({} if sender_knows else {"too large": 1})
    assert sender_knows or happened(server, EventCode.ROUTE_TOO_LARGE, "robot1 sent 2,004 bytes")
    assert len(answers) == 1


def test_a_hostile_peer_cannot_send_them_either(
    bridge: Bridge, victim: Victim, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has no ROS of its own; what it sends of a type that the node expects goes over the link as it is."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    server = bridge.server()
    kind: Any = installed_class("diagnostic_msgs/msg/DiagnosticArray")
    bad = array("a")[:12] + bytes(4) + FEWER[4:]
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        number = rogue.route(victim.topic, "tcp", Qos(), ("diagnostic_msgs/msg/DiagnosticArray", hash_of(kind)))
        stream, writer = rogue.stream(number)
        eventually(lambda: listeners(server, victim.topic))
        victim.says("matched")
        for payload in (bad, b"", EIGHT, bad[:5], array("x", "y")[:60]):
            stream.sendall(write_frame(writer, payload, 0))
        stream.sendall(write_frame(writer, array("one"), 0))
        victim.says("report")
        assert victim.is_well
    assert happened(server, EventCode.ROUTE_MALFORMED, "from robot1")


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_latched_and_compressed_messages_are_checked_too(
    compression: Any, bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    out = robot.publisher("/kept", DiagnosticArray, LATCHED)
    server, client = bridge.both(Topic("/kept", "transmit", compression=compression))
    listener = pc.listener("/kept", DiagnosticArray, LATCHED)
    out.publish(array("good"))
    heard(listener, 1)
    out.publish(array("bad" * 1000)[:2000])
    eventually(lambda: route(client, "/kept").ledger.dropped == {"malformed": 1})
    for engine in (server, client):
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_MALFORMED, "status[].name"))
    out.publish(array("good"))
    assert heard(listener, 2)[1] == array("good")
    assert linked(server)


def test_eight_bytes_of_response_do_not_reach_caller(
    bridge: Bridge, caller: RosNode, pc: Domain, request: pytest.FixtureRequest
) -> None:
    far = KnownNode(pc.id, "server")
    far.start()
    request.addfinalizer(far.stop)
    hash_ = far.installed_service_hash(PARAMETERS) or ""
    responses = iter([EIGHT, EIGHT[:4] + bytes(4)])
    made: list[ServiceServer] = []

    def answer(asked: Sequence[Request]) -> None:
        for each in asked:
            made[0].answer(each.caller, next(responses))

    made.append(far.serve("/set", PARAMETERS, hash_, answer))
    server, client = bridge.both(Topic("/set", "transmit", kind="service", timeout=20.0))
    right = EIGHT[:4] + bytes(4)
    answers = calls_raw(caller, "/set", PARAMETERS, right)
    eventually(lambda: refused(client, "/set") == {"malformed": 1})
    assert not answers
    response = "rcl_interfaces/srv/SetParameters_Response"
    assert happened(client, EventCode.ROUTE_MALFORMED, f"{response} from robot1: results")
    eventually(lambda: happened(server, EventCode.ROUTE_MALFORMED, f"{response} to robot1: results"))
    answers = calls_raw(caller, "/set", PARAMETERS, right)
    eventually(lambda: len(answers) == 1)


def test_a_malformed_goal_is_rejected_at_once(
    bridge: Bridge, server: FibonacciServer, pc: Domain, request: pytest.FixtureRequest
) -> None:
    near = KnownNode(pc.id, "near")
    near.start()
    request.addfinalizer(near.stop)
    pc_engine, robot_engine = bridge.both(Topic(ACTION, "receive", kind="action"))
    goal = EIGHT[:4] + bytes(range(16))
    [answer] = calls_raw(near, f"{ACTION}/_action/send_goal", f"{FIBONACCI}_SendGoal", goal, waits=True)
    assert accepted_by(answer.payload) is False
    for engine in (pc_engine, robot_engine):
        eventually(lambda engine=engine: refused(engine, ACTION) == {"malformed": 1})
    assert server.orders == []


def test_malformed_feedback_is_not_published(
    bridge: Bridge, server: FibonacciServer, robot: Domain, pc: Domain
) -> None:
    kind: Any = installed_class(f"{FIBONACCI}_FeedbackMessage")
    listener = pc.listener(f"{ACTION}/_action/feedback", kind)
    out = robot.publisher(f"{ACTION}/_action/feedback", kind)
    pc_engine, _ = bridge.both(Topic(ACTION, "receive", kind="action"))
    eventually(lambda: listener.matched and out.get_subscription_count() and feedback_listeners(pc_engine))
    goal = EIGHT[:4] + bytes(range(16))
    out.publish(goal + EIGHT[4:])
    out.publish(goal + bytes(4))
    assert heard(listener, 1) == [goal + bytes(4)]
    assert happened(pc_engine, EventCode.ROUTE_MALFORMED, "test_msgs/action/Fibonacci_FeedbackMessage from robot1")


def test_the_check_is_switched_while_it_runs(bridge: Bridge, robot: Domain, pc: Domain, tmp_path: Path) -> None:
    server, client = bridge.both(Topic("/report", "transmit"))
    listener = pc.listener("/report", DiagnosticArray)
    out = robot.publisher("/report", DiagnosticArray)
    carries([out], server, ["/report"])
    short, session = array("x", "y")[:60], server.session
    server.use_file(tmp_path / "server.yaml")
    for number, (check, published) in enumerate([(True, 0), (False, 1), (True, 1)], 1):
        save(msgspec.structs.replace(session, check_messages=check), tmp_path / "server.yaml")
        assert server.reload().result(60).failed == ()
        out.publish(short)
        assert settled(client, "/report", number).delivered == published
    assert heard(listener, 1) == [short]
