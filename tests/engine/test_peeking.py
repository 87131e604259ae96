"""Looking at messages while they pass: on both sides, of types that are not installed, and within bounds."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from tests.engine.peeking_helpers import key
from tests.support import constants, replaced
from tests.support.bridge import STOPS_WITHIN, carries, linked, route, stage
from tests.support.domain import LATCHED, text
from tests.support.filled import filled
from tests.support.inside import inside
from tests.support.participants import KnownNode
from tests.support.waiting import eventually
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.link.extension import Denied
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import PEEK_LIMIT
from rsb_bridge.route import peeking
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Future

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.snapshot import PeekedMessage

ODOMETRY = "nav_msgs/msg/Odometry"


class Lacks(KnownNode):
    """A machine without message types: its node reports none, because a test cannot uninstall packages."""

    def installed_hash(self, type_name: str) -> str | None:
        return None

    def installed_description(self, type_name: str) -> str | None:
        return None


@pytest.fixture(autouse=True)
def _looks_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may take more than the 10 s that a look waits for a message."""
    constants.PEEKING_WAITS_AT_MOST.set(monkeypatch, 60.0)


def look(engine: Engine, topic: str, *, kept: bool = False) -> Future[PeekedMessage | None]:
    """Look at a topic; the engine waits for a message when this returns."""
    future = engine.peek(key(engine, topic), kept=kept)
    link = inside(engine).role.links()[0]
    eventually(lambda: future.done() or any(wanted(link)))
    return future


def wanted(link: Link) -> list[bool]:
    """Return a link's topics that have a viewer."""
    return [
        each.half.flow.peek_slot.wanted
        for each in tuple(link.routes.values())
        if isinstance(each.half, Sender | Receiver)
    ]


def seen(future: Future[PeekedMessage | None]) -> PeekedMessage:
    message = future.result(90)
    assert message is not None
    return message


def test_both_sides_see_the_next_message(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    listener, publisher = pc.listener("/odom", Odometry), robot.publisher("/odom", Odometry)
    server, client = bridge.both(Topic("/odom", "transmit", compression="zstd"))
    carries([publisher], server, ["/odom"])
    eventually(lambda: not any(link.clock_offset is None for link in server.snapshot().links))
    futures = [look(client, "/odom"), look(server, "/odom")]
    payload = serialize_message(filled(Odometry))
    publisher.publish(payload)
    sent, received = map(seen, futures)
    for message in (sent, received):
        assert (message.payload, message.size) == (payload, len(payload))
        assert (message.type_name, message.type_hash) == (ODOMETRY, route(client, "/odom").type_hash)
        assert abs(message.time - time.time()) < 30
        assert not message.is_kept
    assert (sent.outgoing, received.outgoing) == (True, False)
    assert (sent.latency, sent.clock_offset) == (None, None)
    assert received.latency is not None
    assert received.clock_offset is not None
    assert eventually(lambda: listener.payloads) == [payload]


def test_nothing_is_copied_unless_somebody_looks(
    bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener, publisher = pc.listener("/chat"), robot.publisher("/chat")
    server, _ = bridge.both(Topic("/chat", "transmit"))
    carries([publisher], server, ["/chat"])
    copies: list[object] = []
    replaced.PEEK_SLOT_PUT.set(monkeypatch, lambda *message: copies.append(message))
    for number in range(50):
        publisher.publish(text(f"message {number}"))
    eventually(lambda: len(listener.payloads) == 50)
    assert copies == []


def test_a_latched_topic_shows_what_late_joiners_get(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    pc.listener("/map", OccupancyGrid, LATCHED)
    publisher = robot.publisher("/map", OccupancyGrid, LATCHED)
    payload = serialize_message(filled(OccupancyGrid))
    publisher.publish(payload)
    server, client = bridge.both(Topic("/map", "transmit"))
    eventually(lambda: stage(server, "/map", "published"))
    for engine in (client, server):
        message = seen(engine.peek(key(engine, "/map"), kept=True))
        assert (message.payload, message.is_kept) == (payload, True)


def test_of_a_large_message_the_beginning_is_shown(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    publisher = robot.publisher("/blob")
    pc.listener("/blob")
    server, _ = bridge.both(Topic("/blob", "transmit"))
    carries([publisher], server, ["/blob"])
    future = look(server, "/blob")
    payload = text("x" * 3 * PEEK_LIMIT)
    publisher.publish(payload)
    message = seen(future)
    assert (message.size, message.payload) == (len(payload), payload[:PEEK_LIMIT])


def test_nobody_waits_for_ever_nor_in_numbers(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    _, client = bridge.both(Topic("/chat", "transmit"))
    route_key = key(client, "/chat")
    waiting = [client.peek(route_key) for _ in range(peeking.LOOKERS)]
    with pytest.raises(EngineError, match=str(peeking.LOOKERS)):
        client.peek(route_key).result(60)
    for future in waiting:
        future.cancel()
    constants.PEEKING_WAITS_AT_MOST.set(monkeypatch, 0.2)

    def all_again() -> bool:
        futures = [client.peek(route_key) for _ in range(peeking.LOOKERS)]
        return [_unless_refused(future) for future in futures] == [[None]] * peeking.LOOKERS

    eventually(all_again, what="their places are free again")
    eventually(lambda: not any(wanted(inside(client).role.links()[0])))
    with pytest.raises(EngineError, match=pattern(Denied.NO_ROUTE)):
        client.peek("nonsense").result(60)


def _unless_refused(future: Future[Any]) -> list[Any]:
    try:
        return [future.result(60)]
    except EngineError:
        return []


# --- types


def described(engine: Engine, topic: str) -> str:
    """Wait for the type, and return its description."""

    eventually(lambda: route(engine, topic).type_hash)
    return engine.describe(key(engine, topic)).result(30)


def pair(bridge: Bridge, topic: Topic, *, client_lacks: bool = False, server_lacks: bool = False) -> list[Engine]:
    """A server and a client, on machines that may have no types."""
    engines = [
        bridge.start(bridge.server_session(), Lacks(bridge.pc.id, "pc") if server_lacks else None),
        bridge.start(bridge.client_session(topic), Lacks(bridge.robot.id, "robot") if client_lacks else None),
    ]
    eventually(lambda: all(map(linked, engines)), what="linked")
    return engines


@pytest.mark.parametrize("direction", ["transmit", "receive"])
def test_other_side_describes_type_missing_here(
    direction: Any, bridge: Bridge, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    publisher, _ = near.publisher("/odom", Odometry), far.listener("/odom", Odometry)
    server, client = pair(bridge, Topic("/odom", direction), server_lacks=True)
    carries([publisher], server if direction == "transmit" else client, ["/odom"])
    description = read_description(described(server, "/odom"), route(server, "/odom").type_hash)
    future = look(server, "/odom")
    publisher.publish(filled(Odometry))
    decoded = decode(description, seen(future).payload)
    assert decoded.problem == ""
    assert decoded.message["child_frame_id"] == "größer"
    replaced.ASK_FOR_TYPE.set(monkeypatch, None)
    assert described(server, "/odom"), "it is remembered"


@pytest.fixture
def spinning(robot: Domain) -> Iterator[None]:
    """The robot's node serves its services, as programs do."""
    executor = SingleThreadedExecutor(context=robot.context)
    executor.add_node(robot.node)
    ends = threading.Event()

    def spin() -> None:
        while not ends.is_set():
            executor.spin_once(0.05)

    thread = threading.Thread(target=spin)
    thread.start()
    yield
    ends.set()
    thread.join()
    executor.remove_node(robot.node)
    executor.shutdown()


@pytest.mark.usefixtures("spinning")
def test_node_describes_type_installed_nowhere(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    robot.publisher("/odom", Odometry)
    server, client = pair(bridge, Topic("/odom", "transmit"), client_lacks=True, server_lacks=True)
    for engine in (server, client):
        assert hash_of_text(described(engine, "/odom")) == route(client, "/odom").type_hash


def test_the_engine_stops_in_time_while_somebody_looks(bridge: Bridge, robot: Domain) -> None:
    robot.publisher("/odom", Odometry)
    _, client = pair(bridge, Topic("/odom", "transmit"), client_lacks=True, server_lacks=True)
    eventually(lambda: route(client, "/odom").type_hash)
    looking, asking = client.peek(key(client, "/odom")), client.describe(key(client, "/odom"))
    began = time.monotonic()
    client.stop()
    assert time.monotonic() - began < STOPS_WITHIN
    eventually(lambda: looking.done() and asking.done())
