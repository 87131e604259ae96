"""The two sides agree on type, QoS and port, or say why they do not."""

from __future__ import annotations

import errno
import os
import socket
from typing import TYPE_CHECKING, Any, TypeAlias

import pytest
from rclpy.action import ActionServer
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Int32
from std_srvs.srv import SetBool
from tests.support.addresses import foreign_address
from tests.support.bridge import carries, find, happened, heard, link, now, route, says
from tests.support.domain import BEST_EFFORT, LATCHED, text
from tests.support.long import long, long_cases
from tests.support.participants import KnownNode
from tests.support.ports import free_port, taken
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.description import (
    HASH_PREFIX,
    FieldType,
    MessageField,
    MessageType,
    TypeDescription,
    TypeDifference,
    hash_of_text,
    text_of,
)
from rsb_bridge.config.keys import KeyFileProblem, fingerprint, read_key, write_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import join_first
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.ros.ros_interface import TopicSpec
from rsb_bridge.transport.listening import ListenProblem
from rsb_bridge.transport.streams import StreamProblem

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine


INT32, STRING = "std_msgs/msg/Int32", "std_msgs/msg/String"


def test_types_by_any_name(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """From the publishers, short as in the thesis, in full, and from the subscribers on the other side."""
    full = "sensor_msgs/msg/LaserScan"
    names = {"/auto": "auto", "/short": "LaserScan", "/half": "sensor_msgs/LaserScan", "/full": full}
    listeners = {topic: pc.listener(topic, LaserScan) for topic in (*names, "/theirs")}
    publishers = {topic: robot.publisher(topic, LaserScan) for topic in names}
    topics = [Topic(topic, "transmit", type=name) for topic, name in names.items()]
    server, client = bridge.both(*topics, Topic("/theirs", "transmit", qos="default"))
    eventually(lambda: route(client, "/theirs").type_name == full)
    publishers["/theirs"] = robot.publisher("/theirs", LaserScan)
    carries(publishers.values(), server, listeners)
    for publisher in publishers.values():
        publisher.publish(LaserScan())
    for topic, listener in listeners.items():
        heard(listener, 1)
        assert route(server, topic).type_name == full


@pytest.fixture
def other(bridge: Bridge, robot: Domain) -> Iterator[KnownNode]:
    """A node of another program in the robot's domain; it ends before the bridge does."""
    node = KnownNode(robot.id, "other")
    node.start()
    yield node
    node.stop()


_OTHER_FIELDS = MessageField("data", FieldType(8, 0, 0, "")), MessageField("unit", FieldType(17, 0, 0, ""))
OTHER = text_of(TypeDescription(MessageType(INT32, _OTHER_FIELDS), ()))
DIFFERENCE = (
    TypeDifference.OTHER_TYPE(field="data", there="int32", here="int64"),
    TypeDifference.ONLY_HERE(field="unit", type="string"),
)


class OtherVersions(KnownNode):
    """A stand-in for another version, because two versions of a package cannot be installed together."""

    def installed_hash(self, type_name: str) -> str | None:
        return hash_of_text(OTHER) if type_name == INT32 else super().installed_hash(type_name)

    def installed_description(self, type_name: str) -> str | None:
        return OTHER if type_name == INT32 else super().installed_description(type_name)


@pytest.mark.parametrize("direction", ["transmit", *long("receive")])
def test_versions_of_a_type_that_differ(direction: Any, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    near = robot if direction == "transmit" else pc
    near.publisher("/count", Int32)
    sessions = [bridge.server_session(), bridge.client_session(Topic("/count", direction))]
    receiving = 0 if direction == "transmit" else 1
    nodes: list[KnownNode | None] = [None, None]
    nodes[receiving] = OtherVersions((pc if direction == "transmit" else robot).id, "other")
    server, client = (bridge.start(session, ros) for session, ros in zip(sessions, nodes, strict=True))
    for engine in (server, client):
        eventually(lambda engine=engine: says(engine, "/count", INT32, *DIFFERENCE))
        assert (route(engine, "/count").state, route(engine, "/count").cause) == (State.DOWN, Cause.REFUSED)


SET = "std_srvs/srv/SetBool"
_Versions: TypeAlias = "dict[str, tuple[str, str]]"
NUMBER, UNIT = MessageField("data", FieldType(6, 0, 0, "")), MessageField("unit", FieldType(17, 0, 0, ""))


class OtherServices(KnownNode):
    """A stand-in with another version of each service in `others`: the texts of its request's and response's types."""

    others: _Versions

    def installed_service_hash(self, type_name: str) -> str | None:
        installed = super().installed_service_hash(type_name)
        if installed is None or type_name not in self.others:
            return installed
        texts = zip(installed.split("+"), self.others[type_name], strict=True)
        return "+".join(hash_of_text(text) if text else type_hash for type_hash, text in texts)

    def installed_description(self, type_name: str) -> str | None:
        service, _, half = type_name.rpartition("_")
        other = self.others[service][half == "Response"] if service in self.others else ""
        return other or super().installed_description(type_name)


def half_of(type_name: str, *fields: MessageField) -> str:
    return text_of(TypeDescription(MessageType(type_name, fields), ()))


REQUEST = half_of(f"{SET}_Request", NUMBER)
RESPONSE = half_of(f"{SET}_Response", UNIT)
IN_REQUEST = TypeDifference.IN_REQUEST(difference=TypeDifference.OTHER_TYPE(field="data", there="bool", here="int32"))
IN_RESPONSE = TypeDifference.IN_RESPONSE(
    difference=join_first(
        [
            TypeDifference.ONLY_THERE(field="success", type="bool"),
            TypeDifference.ONLY_THERE(field="message", type="string"),
            TypeDifference.ONLY_HERE(field="unit", type="string"),
        ],
        3,
    )
)


def with_other_services(bridge: Bridge, topic: Topic, caller: Domain, others: _Versions) -> list[Engine]:
    """Start both sides, of which that with the callers has other versions of some services."""
    node = OtherServices(caller.id, "other")
    node.others = others
    callers = 1 if topic.direction == "transmit" else 0
    nodes = [None, node] if callers else [node, None]
    sessions = [bridge.server_session(), bridge.client_session(topic)]
    return [bridge.start(session, ros) for session, ros in zip(sessions, nodes, strict=True)]


def clashes(engine: Engine, name: str, type_name: str, *words: str) -> bool:
    found = find(engine, name)
    conflict = found is not None and (found.state, found.cause) == (State.DOWN, Cause.TYPE_CONFLICT)
    return conflict and says(engine, name, type_name, *words)


@pytest.mark.parametrize(
    ("direction", "halves", "named", "unnamed"),
    [
        ("transmit", (REQUEST, ""), IN_REQUEST, "response"),
        *long_cases(
            ("receive", ("", RESPONSE), IN_RESPONSE, "request"),
            ("transmit", (REQUEST, RESPONSE), f"{IN_REQUEST}; {IN_RESPONSE}", HASH_PREFIX),
        ),
    ],
)
def test_versions_of_a_service_that_differ(
    direction: Any, halves: tuple[str, str], named: str, unnamed: str, bridge: Bridge, robot: Domain, pc: Domain
) -> None:
    caller, provider = (robot, pc) if direction == "transmit" else (pc, robot)
    provider.serve("/set", SetBool)
    engines = with_other_services(bridge, Topic("/set", direction, kind="service"), caller, {SET: halves})
    for engine in engines:
        eventually(lambda engine=engine: clashes(engine, "/set", SET, named))
        assert unnamed not in route(engine, "/set").reason
        assert not says(engine, "/set", HASH_PREFIX)


def test_versions_of_an_action_that_differ(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    test_msgs = pytest.importorskip("test_msgs.action", reason="no package with an action is installed")
    server = ActionServer(pc.node, test_msgs.Fibonacci, "/count_up", lambda goal: test_msgs.Fibonacci.Result())
    result = "test_msgs/action/Fibonacci_GetResult"
    other = half_of(f"{result}_Response", MessageField("status", FieldType(6, 0, 0, "")))
    status = TypeDifference.OTHER_TYPE(field="status", there="int8", here="int32")
    only_there = TypeDifference.ONLY_THERE(field="result", type="test_msgs/action/Fibonacci_Result")
    difference = TypeDifference.IN_RESPONSE(difference=join_first([status, only_there], 3))
    topic = Topic("/count_up", "transmit", kind="action")
    try:
        for engine in with_other_services(bridge, topic, robot, {result: ("", other)}):
            eventually(lambda engine=engine: clashes(engine, "/count_up", result, difference))
    finally:
        server.destroy()


def test_two_sides_in_one_domain_would_loop(bridge: Bridge, robot: Domain) -> None:
    """Both sides report it."""
    words = "both sides publish /loop in one ROS domain"
    publisher = robot.publisher("/loop")
    server, client = bridge.server(domain_id=robot.id), bridge.client(Topic("/loop", "transmit"))
    eventually(lambda: publisher.publish(text("round")) or says(client, "/loop", words))
    for engine in (server, client):
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_LOOP, words))
        eventually(lambda engine=engine: route(engine, "/loop").state is State.DOWN)


def test_client_learns_of_its_name_before_topics(bridge: Bridge) -> None:
    """The server's session may set it for all its clients, or for each."""
    clients = (Client("robot1", key_file=bridge.key_file), Client("robot2", use_name=False))
    server = bridge.server(use_name=True, clients=clients, shared_keys=True)
    client = bridge.client()
    eventually(lambda: link(client).state is State.OK)
    assert link(client).use_name
    assert [each.use_name for each in now(server).links] == [True, False]


def test_qos_follows_the_publishers(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A best-effort publisher, then a latched one in its place, then both: what is published always crosses."""
    there = pc.listener("/chat", qos=QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT))
    best_effort = robot.publisher("/chat", qos=BEST_EFFORT)
    server, client = bridge.both(Topic("/chat", "transmit"))

    def crosses(publisher: Any, expected: Qos) -> None:
        eventually(lambda: (route(server, "/chat").qos, route(client, "/chat").qos) == (expected, expected))
        carries([publisher], server, ["/chat"])
        count = len(there.payloads)
        publisher.publish(text("new"))
        heard(there, count + 1)

    crosses(best_effort, Qos("best_effort", depth=0))
    ends = (Qos("best_effort"), Qos("best_effort"))
    eventually(lambda: [end_qos(side) for side in (server, client)] == [ends, ends])
    robot.node.destroy_publisher(best_effort)
    latched = robot.publisher("/chat", qos=LATCHED)
    crosses(latched, Qos(durability="transient_local", depth=0))
    late = pc.listener("/chat", qos=LATCHED)
    assert heard(late, 1) == [text("new")]
    ends = (Qos(durability="transient_local"), Qos(durability="transient_local"))  # the stricter of two subscriptions
    eventually(lambda: [end_qos(side) for side in (server, client)] == [ends, ends])
    crosses(robot.publisher("/chat", qos=BEST_EFFORT), Qos("best_effort", depth=0))


def end_qos(side: Engine) -> tuple[Qos | None, Qos | None]:
    """Return the QoS of the publishers where /chat begins, and of the subscriptions where it ends."""
    chat = route(side, "/chat")
    return chat.publisher_qos, chat.subscriber_qos


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_a_topic_port_that_is_taken(protocol: Any, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Both sides report it; once the port is free, trying again opens the topic."""
    port, out, there = free_port(), robot.publisher("/chat"), pc.listener("/chat")
    with taken(port, socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM):
        server, client = bridge.both(Topic("/chat", "transmit", protocol=protocol, port=port))
        for engine in (server, client):
            eventually(
                lambda engine=engine: says(
                    engine, "/chat", ListenProblem.TAKEN(kind=protocol.upper(), address=f"127.0.0.1:{port}")
                )
            )
    client.retry().result(60)
    carries([out], server, ["/chat"])

    def crosses() -> bool:
        out.publish(text("at last"))
        return text("at last") in there.payloads

    eventually(crosses)  # UDP promises no message


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_server_whose_port_is_taken(kind: Any, bridge: Bridge) -> None:
    """It reports it, and frees the ports that it had bound before."""
    words = pattern(ListenProblem.TAKEN, address=f"127.0.0.1:{bridge.port}")
    with taken(bridge.port, kind), pytest.raises(EngineError, match=words):
        bridge.server()
    bridge.server()


def test_addresses_that_will_not_do(bridge: Bridge) -> None:
    foreign = foreign_address()
    words = pattern(ListenProblem.NOT_OF_THIS_MACHINE, address=f"{foreign}:{bridge.port}")
    with pytest.raises(EngineError, match=words):
        bridge.server(server_ip=foreign)
    with pytest.raises(EngineError, match=pattern(ListenProblem.NAME_UNKNOWN)):
        bridge.server(server_ip="no-such-host.invalid")
    client = bridge.client(server_ip="no-such-host.invalid")
    eventually(lambda: happened(client, EventCode.LINK_UNREACHABLE, f"no-such-host.invalid:{bridge.port}: "))
    assert link(client).cause == LinkCause.UNREACHABLE
    nobody = bridge.client(server_ip="localhost")
    eventually(lambda: link(nobody).attempts > 1)
    why = StreamProblem.REFUSED(error=os.strerror(errno.ECONNREFUSED))
    refused = f"localhost:{bridge.port}: {why}"
    eventually(lambda: refused in link(nobody).reason)


def test_a_channel_of_the_servers_ports_number(bridge: Bridge, robot: Domain) -> None:
    """It is not the port that is bound already: without Bluetooth it is not available, and the topic reports it."""
    place = {"server_ip": "127.0.0.12", "server_port": 11, "bluetooth_address": "5C:F3:70:9A:1B:2E"}
    try:
        socket.create_server(("127.0.0.12", 11)).close()
    except PermissionError:
        pytest.skip("port 11 may not be bound here")
    robot.publisher("/beat")
    _, client = bridge.both(Topic("/beat", "transmit", protocol="bluetooth", port=11), **place)
    eventually(lambda: says(client, "/beat", "refused by the other side", "Bluetooth"))


def test_keys_that_are_missing(bridge: Bridge) -> None:
    with pytest.raises(EngineError, match=pattern(KeyFileProblem.NOT_GIVEN, name="robot1")):
        bridge.server(key_file=None)
    with pytest.raises(EngineError, match=r"lost\.key"):
        bridge.client(key_file="lost.key")


def test_a_key_in_the_home_folder(bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`~` in key_file is whose program it is, wherever the session file lies."""
    home = tmp_path / "home"
    home.mkdir()
    write_key(home / "bridge.key")
    monkeypatch.setenv("HOME", str(home))
    bridge.folder = tmp_path / "elsewhere"
    server, client = bridge.both(key_file="~/bridge.key")
    mark = fingerprint(read_key(home / "bridge.key"))
    assert {link(server).fingerprint, link(client).fingerprint} == {mark}
    with pytest.raises(EngineError, match=pattern(KeyFileProblem.NO_SUCH_FILE, path=home / "lost.key")):
        bridge.client(key_file="~/lost.key")


def test_replaced_type_while_old_publisher_shows(other: KnownNode, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """For example after kill -9.

    Both sides name type and node at once, traffic goes on; it recovers when the old one goes.
    """
    strings, old = pc.listener("/state"), robot.publisher("/state")
    server, client = bridge.both(Topic("/state", "transmit"))
    carries([old], server, ["/state"])
    new = other.advertise(TopicSpec("/state", INT32, "", Qos()), "other")
    for engine in (server, client):
        eventually(lambda engine=engine: happened(engine, EventCode.ROUTE_TYPE_CHANGED, INT32))
    old.publish(text("still"))
    heard(strings, 1)
    for engine in (server, client):
        eventually(lambda engine=engine: route(engine, "/state").state is State.UNHEARD)
        # DDS tells of a publisher before it tells whose it is.
        eventually(lambda engine=engine: says(engine, "/state", INT32, f"/{other.node_name}"))
    pc.clear()
    robot.node.destroy_publisher(old)
    numbers = pc.listener("/state", Int32)
    eventually(lambda: new.subscriber_count and route(server, "/state").type_name == INT32)

    def crosses() -> bool:
        new.publish(serialize_message(Int32(data=7)))
        return bool(numbers.payloads)

    eventually(crosses)
    eventually(lambda: crosses() and route(client, "/state").reason == "")


def test_a_type_that_the_session_does_not_name(other: KnownNode, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """A publisher of another type comes instead.

    Both sides report it at once, and it recovers once the right one is back.
    """
    strings, out = pc.listener("/state"), robot.publisher("/state")
    server, client = bridge.both(Topic("/state", "transmit", type="String"))
    carries([out], server, ["/state"])
    out.publish(text("on"))
    heard(strings, 1)
    robot.node.destroy_publisher(out)
    wrong = other.advertise(TopicSpec("/state", INT32, "", Qos()), "other")
    assert eventually(lambda: happened(client, EventCode.ROUTE_TYPE_CHANGED, INT32))
    assert eventually(lambda: happened(server, EventCode.ROUTE_CLOSED, INT32))
    for engine in (server, client):
        eventually(lambda engine=engine: says(engine, "/state", INT32, STRING, f"/{other.node_name}"))
        assert route(engine, "/state").state is not State.OK
    wrong.close()
    out = robot.publisher("/state")
    carries([out], server, ["/state"])
    out.publish(text("again"))
    assert heard(strings, 2)[-1] == text("again")
