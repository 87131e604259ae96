"""Latched topics: who joins late on the far side gets what who joins late on the near side gets."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from tests.engine.latched_helpers import JOINS_LATE, latched
from tests.support import constants
from tests.support.bridge import connections, halves, linked, listeners, route, settled
from tests.support.domain import Domain, text
from tests.support.inside import inside, outputs_of
from tests.support.long import long
from tests.support.ports import free_port
from tests.support.relay import message_number
from tests.support.waiting import eventually, holds

from rsb_bridge.model.hops import node_of_hop
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.receiver import Receiver
from rsb_console.command.watching_commands import _carries

if TYPE_CHECKING:
    from pathlib import Path

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.model.transports import Protocol


def same_on_both_sides(robot: Domain, pc: Domain, topic: str, expected: list[bytes]) -> None:
    """A subscription that joins, on either side, hears just what is expected, each message once, and no more.

    On the far side it may hear more for a moment, until a publisher's depth has been found out.
    """

    def late() -> list[Counter[bytes]]:
        joined = [domain.listener(topic, qos=JOINS_LATE) for domain in (robot, pc)]
        for listener in joined:
            eventually(lambda listener=listener: len(listener.payloads) >= len(expected), what=f"{len(expected)} heard")
        with contextlib.suppress(AssertionError):
            holds(lambda: all(len(listener.payloads) == len(expected) for listener in joined), 0.5)
        heard = [Counter(map(bytes, listener.payloads)) for listener in joined]
        for domain, listener in zip((robot, pc), joined, strict=True):
            domain.node.destroy_subscription(listener.subscription)
        return heard

    eventually(lambda: late() == [Counter(expected)] * 2, what="the same on both sides")


def publish(publisher: Publisher, name: str, numbers: range) -> list[bytes]:
    messages = [text(f"{name} {number}") for number in numbers]
    for message in messages:
        publisher.publish(message)
    return messages


def restart(bridge: Bridge, engine: Engine) -> Engine:
    """Another process in an engine's place, as far as the other side can tell."""
    session = engine.session
    engine.stop()
    return bridge.start(session)


def test_two_bridges_in_a_row(
    bridge: Bridge, robot: Domain, pc: Domain, third: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one is restarted: the far end forgets what the old process brought, and keeps what the new one does."""
    constants.EXPLAINED_WITHIN.set(monkeypatch, 60.0)
    constants.LATCHED_GONE_AFTER.set(monkeypatch, 3.0)
    out = robot.publisher("/map", qos=latched(1))
    publish(out, "map", range(1))

    def connect(name: str, here: Domain, there: Domain) -> tuple[Engine, Engine]:
        changes: dict[str, Any] = {"name": name, "server_port": free_port()}
        server = bridge.start(bridge.server_session(domain_id=there.id, **changes))
        client = bridge.start(bridge.client_session(Topic("/map", "transmit"), domain_id=here.id, **changes))
        eventually(lambda: linked(client, name) and linked(server, name))
        return server, client

    near, first = connect("robot1", robot, pc)
    far, second = connect("robot2", pc, third)
    steady = third.listener("/map", qos=JOINS_LATE)
    eventually(lambda: steady.payloads)
    first = restart(bridge, first)
    eventually(lambda: linked(first, "robot1"))
    newest = publish(out, "map", range(1, 2))

    def late() -> list[bytes]:
        listener = third.listener("/map", qos=JOINS_LATE)
        eventually(lambda: listener.payloads, what="a late joiner hears something")
        with contextlib.suppress(AssertionError):
            holds(lambda: len(listener.payloads) < 2, 0.5)
        heard = [bytes(payload) for payload in listener.payloads]
        third.node.destroy_subscription(listener.subscription)
        return heard

    def said() -> str:
        engines = {"first": first, "near": near, "second": second, "far": far}
        events = sorted((each.time, name, each.text) for name, engine in engines.items() for each in engine.events())
        return "\n".join(f"{time:.3f} {name}: {text}" for time, name, text in events)

    def is_newest() -> bool:
        heard = late()
        assert heard == newest, heard
        return True

    try:
        # The message may overtake the bridge's announcement; then an open route is opened again later.
        eventually(lambda: brought_by(far, first), what="the far end keeps what the new process brings")
        eventually(lambda: late() == newest, what="the far end has the newest message only")
        holds(is_newest, 5.0)  # histories of publishers that are not there are dropped meanwhile
    except AssertionError as error:
        raise AssertionError(f"{error}\n{said()}") from None


def brought_by(receiver: Engine, sender: Engine) -> bool:
    """Whether all that an engine publishes has crossed another one's bridge."""
    node = inside(sender).context.ros.node_name
    outputs = [output for each in halves(receiver, Receiver) for output in tuple(outputs_of(each)._outputs)]
    return bool(outputs) and all(node in map(node_of_hop, output.came_by) for output in outputs)


@pytest.mark.parametrize("count", [25, *long(60)])
def test_tf_static_of_many_nodes(count: int, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Each has published twice and keeps one; they are there before the bridge, and it is restarted on either side."""
    outs = [robot.publisher("/tf_static", qos=latched(1)) for _ in range(count)]
    kept = [publish(out, f"frame {number}", range(2))[-1] for number, out in enumerate(outs)]
    server, client = bridge.both(Topic("/tf_static", "transmit"))
    steady = pc.listener("/tf_static", qos=JOINS_LATE)
    eventually(lambda: len(steady.payloads) == count)
    same_on_both_sides(robot, pc, "/tf_static", kept)
    ledger = settled(client, "/tf_static", count)
    assert (ledger.delivered, ledger.dropped, ledger.lost_in_dds) == (count, {}, 0)
    client = restart(bridge, client)
    eventually(lambda: linked(client))
    kept[3] = publish(outs[3], "moved", range(1))[0]
    eventually(lambda: len(steady.payloads) == count + 1)
    same_on_both_sides(robot, pc, "/tf_static", kept)
    assert Counter(map(bytes, steady.payloads)).most_common(1)[0][1] == 1
    restart(bridge, server)
    same_on_both_sides(robot, pc, "/tf_static", kept)


def heard_in_order(pc: Domain, topic: str, expected: list[bytes], joiners: int, within: float = 180.0) -> None:
    """Late joiners of the far side hear just what is expected, in order, and from one publisher."""
    eventually(lambda: len(pc.node.get_publishers_info_by_topic(topic)) == 1, within, "one publisher")
    for _ in range(joiners):
        listener = pc.listener(topic, qos=JOINS_LATE)
        eventually(lambda listener=listener: len(listener.payloads) >= len(expected), what=f"{len(expected)} heard")
        assert list(map(bytes, listener.payloads)) == expected
        pc.node.destroy_subscription(listener.subscription)


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
@pytest.mark.parametrize("published_before", [0, *long(3)])
def test_growing_history_is_heard_in_order(
    published_before: int, protocol: Protocol, bridge: Bridge, relay: Relay, robot: Domain, pc: Domain
) -> None:
    """Its publisher keeps more than it has published: its messages have one publisher, and nobody hears any twice."""
    out = robot.publisher("/path", qos=latched(10))
    messages = publish(out, "pose", range(published_before))
    server, client = bridge.both(Topic("/path", "transmit", protocol=protocol))
    steady = pc.listener("/path", qos=JOINS_LATE)
    eventually(lambda: out.get_subscription_count() == 1 and listeners(server, "/path") == 1)

    def grow(joiners: int) -> None:
        number = len(messages)
        messages.extend(publish(out, "pose", range(number, number + 1)))
        eventually(lambda: list(map(bytes, steady.payloads)) == messages, what="each message once")
        heard_in_order(pc, "/path", messages, joiners)

    for joiners in (0, 0, 0, 20):
        grow(joiners)
    again = connections(client) + 1
    relay.cut()
    eventually(lambda: connections(client) >= again and linked(client) and linked(server), what="linked again")
    grow(3)
    client = restart(bridge, client)
    eventually(lambda: linked(client) and linked(server))
    grow(3)
    steady.payloads.clear()
    server = restart(bridge, server)
    eventually(lambda: list(map(bytes, steady.payloads)) == messages, what="the whole history by a new process")
    heard_in_order(pc, "/path", messages, 20)
    grow(3)


@pytest.mark.parametrize("published_before", [3, *long(12, 0)])
def test_a_deeper_history(published_before: int, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """Five of 12 messages are kept, wherever the bridge starts; both sides keep the same.

    Once the first one is dropped, the far side keeps more, until another publisher there has five.
    """
    out = robot.publisher("/path", qos=latched(5))
    messages = publish(out, "pose", range(published_before))
    server, client = bridge.both(Topic("/path", "transmit"))
    steady, volatile = pc.listener("/path", qos=JOINS_LATE), pc.listener("/path")
    eventually(lambda: out.get_subscription_count() == 1 and volatile.matched and listeners(server, "/path") == 2)
    eventually(lambda: list(map(bytes, steady.payloads)) == messages[-5:])
    same_on_both_sides(robot, pc, "/path", messages[-5:])
    heard_before = len(volatile.payloads)

    def one_more() -> None:
        messages.extend(publish(out, "pose", range(len(messages), len(messages) + 1)))
        eventually(lambda: steady.payloads and bytes(steady.payloads[-1]) == messages[-1])

    def five_more() -> bool:
        for _ in range(5):
            one_more()
        with contextlib.suppress(AssertionError):
            heard_in_order(pc, "/path", messages[-5:], 1, within=5.0)
            return True
        return False

    while len(messages) < 12:
        one_more()
        if len(messages) in (1, 5):
            same_on_both_sides(robot, pc, "/path", messages[-5:])
    eventually(five_more, what="five, from one publisher")
    same_on_both_sides(robot, pc, "/path", messages[-5:])
    eventually(lambda: len(volatile.payloads) == len(messages) - published_before + heard_before)
    assert list(map(bytes, steady.payloads)) == messages[max(0, published_before - 5) :]
    client = restart(bridge, client)
    eventually(lambda: linked(client) and linked(server))
    one_more()
    one_more()
    same_on_both_sides(robot, pc, "/path", messages[-5:])
    restart(bridge, server)
    same_on_both_sides(robot, pc, "/path", messages[-5:])


@pytest.mark.parametrize("depth", [1, 5])
def test_late_joiner_hears_no_more_of_burst(depth: int, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out = robot.publisher("/path", qos=latched(depth))
    bridge.both(Topic("/path", "transmit"))
    steady = pc.listener("/path", qos=latched(1000))
    eventually(lambda: out.get_subscription_count() == 1)
    messages = publish(out, "pose", range(300))
    eventually(lambda: list(map(bytes, steady.payloads)) == messages)
    same_on_both_sides(robot, pc, "/path", messages[-depth:])


def is_fine(shown: RouteSnapshot) -> bool:
    """Whether a route is fine for every command: the table, `wait`, and the stages of the detail."""
    passed = all(each.done for each in shown.stages)
    return (shown.state, shown.cause, shown.reason) == (State.OK, Cause.NONE, "") and passed and _carries(shown)


def test_second_bridge_has_what_first_one_brought(
    bridge: Bridge, robot: Domain, pc: Domain, third: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Either route is opened again, and nothing new is published."""
    constants.EXPLAINED_WITHIN.set(monkeypatch, 60.0)  # a bridge's announcement may be late
    publish(robot.publisher("/map", qos=latched(1)), "map", range(1))
    engines: list[Engine] = []
    for name, here, there in (("robot1", robot, pc), ("robot2", pc, third)):
        changes: dict[str, Any] = {"name": name, "server_port": free_port()}
        engines.append(bridge.start(bridge.server_session(domain_id=there.id, **changes)))
        engines.append(bridge.start(bridge.client_session(Topic("/map", "transmit"), domain_id=here.id, **changes)))
    steady = third.listener("/map", qos=JOINS_LATE)
    pc.listener("/map", qos=JOINS_LATE)

    def fine() -> bool:
        return all(is_fine(route(engine, "/map")) for engine in engines)

    eventually(fine, what="fine at first")
    for engine in engines:
        engine.restart().result(60)
        eventually(fine, what="fine again")
    holds(fine, 1.0)
    assert len(steady.payloads) == 1


def test_message_arrives_together_with_proof_of_address(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain
) -> None:
    """The server let it fall, as its route took datagrams only in the loop's next turn; nothing else was published."""
    publish(robot.publisher("/map", qos=latched(1)), "map", range(1))
    heard = pc.listener("/map", qos=JOINS_LATE)
    probes: list[bytes] = []

    def together(datagram: bytes) -> list[bytes]:
        if message_number(datagram) is None:
            probes.append(datagram)
            return [datagram] if len(probes) == 1 else []
        passed, probes[1:] = [*probes[1:], datagram], []
        return passed

    relay.to_server = together
    bridge.both(Topic("/map", "transmit", protocol="udp"))
    eventually(lambda: heard.payloads)


@pytest.mark.parametrize(
    "how", ["client restarts", "server's process", *long("cut", "server restarts", "client's process")]
)
def test_newest_message_known_there_is_fine_after_reconnect(
    how: str, bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its publisher has published nothing new, so nothing crosses in the new opening."""
    constants.EXPLAINED_WITHIN.set(monkeypatch, 60.0)
    topics = "/tcp", "/udp", "/back"
    outs = [(pc if topic == "/back" else robot).publisher(topic, qos=latched(1)) for topic in topics]
    for out in outs:
        publish(out, "once", range(1))
    heard = [(robot if topic == "/back" else pc).listener(topic, qos=JOINS_LATE) for topic in topics]
    server, client = bridge.both(
        Topic("/tcp", "transmit"), Topic("/udp", "transmit", protocol="udp"), Topic("/back", "receive")
    )

    def fine() -> bool:
        found = [route(engine, topic) for engine in (client, server) for topic in topics]
        return all(map(is_fine, found))

    eventually(fine, what="fine at first")
    before = {engine: {topic: route(engine, topic).last_at for topic in topics} for engine in (client, server)}
    again = [connections(engine) + 1 for engine in (client, server)]
    match how:
        case "client restarts":
            client.restart().result(60)
        case "server restarts":
            server.restart().result(60)
        case "cut":
            relay.cut()
        case "client's process":
            client = restart(bridge, client)
        case "server's process":
            server = restart(bridge, server)
    if "process" not in how:
        eventually(lambda: [connections(engine) for engine in (client, server)] >= again, what="connected again")
    eventually(lambda: linked(client) and linked(server), what="linked again")
    eventually(fine, what="fine again")
    holds(fine, 1.0)
    for engine, times in before.items():
        if engine in (client, server):  # present listeners have heard them before
            for topic, last_at in times.items():
                crossed_again = "process" in how and (topic == "/back") is (how == "client's process")
                assert crossed_again or route(engine, topic).last_at == pytest.approx(last_at, abs=0.05)
    expected = 2 if how == "server's process" else 1
    assert [len(each.payloads) for each in heard[:2]] == [expected] * 2


def test_node_that_has_ended_is_heard_by_no_late_joiner(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The side that sees it end says so: nobody has to wait for what an unknown publisher may still be."""
    constants.LATCHED_GONE_AFTER.set(monkeypatch, 3600.0)
    ends, stays = (robot.publisher("/e_stop", qos=latched(1)) for _ in range(2))
    kept = publish(ends, "released", range(1)) + publish(stays, "pressed", range(1))
    bridge.both(Topic("/e_stop", "transmit"))
    same_on_both_sides(robot, pc, "/e_stop", kept)
    robot.node.destroy_publisher(ends)
    eventually(lambda: len(pc.node.get_publishers_info_by_topic("/e_stop")) == 1)
    same_on_both_sides(robot, pc, "/e_stop", kept[1:])


_RELEASES = """
import sys, time
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
context = Context()
context.init([], domain_id=int(sys.argv[1]))
node = Node("mortal", context=context, enable_rosout=False, start_parameter_services=False)
publisher = node.create_publisher(String, sys.argv[2], QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
publisher.publish(String(data="released"))
time.sleep(1000)
"""
_LISTED_FOR_LONG = """<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<participant profile_name="listed_for_long" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>3600</sec></leaseDuration>
</discovery_config></builtin></rtps></participant></profiles>
"""


@pytest.mark.parametrize("restarted", ["", "client", *long("server")])
def test_killed_node_is_heard_by_no_late_joiner(
    restarted: str, bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """DDS lists it all the time: who has joined before hears its successor last, who joins later nobody else.

    A bridge that is restarted once it is withdrawn does what was left to do.
    """
    topic = f"/e_stop_{restarted}"  # a node that outlives this case lists its killed publisher, too
    constants.SILENT_WITHIN.set(monkeypatch, 1.0)
    if restarted:
        constants.RESENT_AFTER.set(monkeypatch, 3600.0)

    def listed_there() -> int:
        return len(pc.node.get_publishers_info_by_topic(topic))

    profile = tmp_path / "listed.xml"
    profile.write_text(_LISTED_FOR_LONG)
    environment = {**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
    with subprocess.Popen((sys.executable, "-c", _RELEASES, str(robot.id), topic), env=environment) as mortal:
        try:
            server, client = bridge.both(Topic(topic, "transmit"))
            before = pc.listener(topic, qos=JOINS_LATE)
            eventually(lambda: len(before.payloads) == 1)
            # The bridge may have found it first.
            eventually(lambda: len(robot.node.get_publishers_info_by_topic(topic)) == 1, what="listed here")
        finally:
            mortal.kill()
    successor = robot.publisher(topic, qos=latched(2))
    (pressed,) = publish(successor, "pressed", range(1))
    if restarted:
        eventually(lambda: len(before.payloads) == 2, what="both are heard")
        eventually(lambda: listed_there() == 1, what="the killed one is withdrawn")
        constants.RESENT_AFTER.set(monkeypatch, 1.0)
        again = restart(bridge, client if restarted == "client" else server)
    expected = 4 if restarted == "server" else 3  # a new server publishes all that is kept
    eventually(lambda: len(before.payloads) == expected and bytes(before.payloads[-1]) == pressed, what="pressed last")
    eventually(lambda: listed_there() == 1, what="one history is left")
    same_on_both_sides(robot, pc, topic, [pressed])
    assert len(robot.node.get_publishers_info_by_topic(topic)) == 2
    if restarted == "client":  # the next process of the sending side knows what its predecessor sent again
        restart(bridge, again)
        (later,) = publish(successor, "later", range(1))
        eventually(lambda: bytes(before.payloads[-1]) == later, what="later is last")
        assert len(before.payloads) == expected + 1


def test_a_publisher_that_is_gone_leaves_no_history(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.LATCHED_GONE_AFTER.set(monkeypatch, 1.0)
    stays, goes = (robot.publisher("/tf_static", qos=latched(1)) for _ in range(2))
    kept = publish(stays, "stays", range(1)) + publish(goes, "goes", range(1))
    bridge.both(Topic("/tf_static", "transmit"))
    same_on_both_sides(robot, pc, "/tf_static", kept)
    robot.node.destroy_publisher(goes)
    eventually(lambda: len(pc.node.get_publishers_info_by_topic("/tf_static")) == 1)
    same_on_both_sides(robot, pc, "/tf_static", kept[:1])
    robot.node.destroy_publisher(stays)
    comes = robot.publisher("/tf_static", qos=latched(1))
    kept = publish(comes, "comes", range(1))
    there = pc.listener("/tf_static", qos=JOINS_LATE)
    # DDS may deliver the histories of the far side's two publishers in either order, while both are there.
    eventually(lambda: kept[0] in map(bytes, there.payloads) and there.matched == 1)
    same_on_both_sides(robot, pc, "/tf_static", kept)
