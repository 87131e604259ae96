"""The memory that a peer can occupy on the other side is bounded per link, and other links do not notice."""

from __future__ import annotations

import contextlib
import itertools
import signal
import socket
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from tests.support import constants
from tests.support.bridge import carries, happened, heard, linked, route, settled
from tests.support.domain import text
from tests.support.inside import inside, socket_of
from tests.support.rogue import BLOB, Rogue
from tests.support.stopping import stop
from tests.support.waiting import eventually

from rsb_bridge.channel.udp_channel import ServerUdpChannel
from rsb_bridge.config.keys import read_key
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.reason import EndCode
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.distribution import package_of
from rsb_bridge.route.latched import PUBLISHER_COST
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.wire.framing import MESSAGE_LIMIT, UNFINISHED_LIMIT
from rsb_bridge.wire.messages import Close, Propose, Ready, Refuse

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link

ROUTES = 8
LISTENER = """
import sys
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("stopped")
node.create_subscription(String, "/large", lambda message: print(len(message.data), flush=True), QoSProfile(depth=10))
rclpy.spin(node)
"""
WORDS = f"the link's incomplete messages would take more than {UNFINISHED_LIMIT:,} bytes"


@pytest.fixture
def server(bridge: Bridge) -> Engine:
    return bridge.server()


@pytest.fixture
def rogue(bridge: Bridge, server: Engine, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rogue]:
    """It sends no pings: the server does not give it up for that, however long a slow machine takes."""
    constants.DEAD_AFTER.set(monkeypatch, 60.0)
    with contextlib.closing(Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret)) as made:
        yield made


def link_of(server: Engine) -> Link:
    return next(iter(inside(server).role.links()))


def received(server: Engine, topic: str) -> int:
    """How many messages of a topic have come, published or not."""
    routes = tuple(link_of(server).routes.values())
    return sum(each.half.path.received for each in routes if isinstance(each.half, Receiver) and each.topic == topic)


def test_on_streams(bridge: Bridge, server: Engine, rogue: Rogue, robot: Domain, pc: Domain) -> None:
    """Eight times the longest message, all but its end: half of that is kept; then a robot is served as ever.

    They come in chunks: a stream takes no frame that is as long.
    """
    assert ROUTES * MESSAGE_LIMIT >= 2 * UNFINISHED_LIMIT
    link = link_of(server)
    for number in range(ROUTES):
        stream, writer = rogue.stream(rogue.route(f"/begun{number}", "tcp", Qos()))
        rogue.begin_chunks(stream, writer)
        assert link.budget.unfinished.held <= UNFINISHED_LIMIT
    eventually(lambda: happened(server, EventCode.ROUTE_CHANNEL_LOST, WORDS))
    assert linked(server)
    rogue.close()
    eventually(lambda: not linked(server) and link.budget.unfinished.held == 0)
    there, out = pc.listener("/beat"), robot.publisher("/beat")
    bridge.client(Topic("/beat", "transmit"))
    carries([out], server, ["/beat"])
    out.publish(text("x" * (8 << 20)))
    heard(there, 1)
    eventually(lambda: link.budget.unfinished.held == 0)


def test_on_datagrams(server: Engine, rogue: Rogue) -> None:
    """The last fragment never comes: routes share what one of them could have, and it is all given back in time."""
    writers = [rogue.datagrams(rogue.route(f"/begun{number}", "udp", Qos())) for number in range(3)]
    rogue.probe()
    link = link_of(server)
    eventually(
        lambda: any(isinstance(each, ServerUdpChannel) for each in link.carriers()),
        what="the server has heard the probe",
    )
    highest, began = 0, time.monotonic()
    while time.monotonic() < began + 4.0 or highest <= MESSAGE_LIMIT // 16:  # a starved server may have read little
        assert time.monotonic() < began + 60.0
        for writer in writers:
            rogue.udp.send(writer.write(bytes(120_000), 0, 0, 60_000)[0])
        highest = max(highest, link.budget.unfinished.held)
    assert highest <= UNFINISHED_LIMIT
    eventually(lambda: link.budget.unfinished.held == 0)


def test_of_answers_that_are_not_taken(server: Engine, rogue: Rogue, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is small here, and the kernel holds little and does not give up a peer that takes nothing."""
    constants.CONTROL_MOST_WAITING.set(monkeypatch, 1 << 12)
    eventually(lambda: linked(server))
    control = link_of(server).control
    assert control is not None
    control.stream.give_up_after(60.0)
    socket_of(control.stream).setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    rogue.takes_little()
    numbers = itertools.count()

    def ask(times: int) -> None:
        with contextlib.suppress(OSError):
            for number in itertools.islice(numbers, times):
                topic = f"/x{number}"
                rogue.say(Propose(route=2 * number + 1, topic=topic, remote_topic=topic, from_client=True))

    def is_given_up() -> bool:
        ask(1)  # the kernel holds more answers at one time than at another
        return bool(happened(server, EventCode.LINK_LOST, "is not reading")) and not linked(server)

    ask(4_000)  # more are not read at once
    eventually(is_given_up)


def test_for_late_joiners(bridge: Bridge, server: Engine, robot: Domain, pc: Domain) -> None:
    """The oldest is dropped at the given depth; a topic that would keep too much gets a remedy."""
    link = link_of(server)
    names = ("/fits", "/hoards")
    link.budget.kept.limit = 10_000_000 + len(names) * PUBLISHER_COST
    keep_all = {"durability": "transient_local", "history": "keep_all"}
    qos: dict[str, Any] = {"/fits": {"durability": "transient_local", "depth": 2}, "/hoards": keep_all}
    theres = [pc.listener(name) for name in names]
    outs = [
        robot.publisher(name, qos=QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)) for name in names
    ]
    client = bridge.client(*(Topic(name, "transmit", qos=qos[name], compression="zstd") for name in names))
    carries(outs, server, names)
    for count in range(1, 9):  # one by one: of more than wait for the stream at once, only two would be kept
        for out in outs:
            out.publish(text("x" * 1_500_000))
        heard(theres[0], count)
        eventually(lambda count=count: received(server, "/hoards") == count)
    assert settled(client, "/fits", 8).delivered == 8
    ledger = settled(client, "/hoards", 8)
    assert (ledger.delivered, ledger.dropped) == (4, {"latched full": 4})
    assert "a smaller depth" in route(server, "/hoards").last_error
    client.remove_topic(route(client, "/hoards").key).result(60)
    eventually(lambda: 3_000_000 <= link.budget.kept.held - PUBLISHER_COST < 3_001_000)
    client.remove_topic(route(client, "/fits").key).result(60)
    eventually(lambda: link.budget.kept.held == 0)


def test_compressed_messages_that_grow_too_much(bridge: Bridge, server: Engine, robot: Domain, pc: Domain) -> None:
    """Messages that are a few kB on the wire and MBs here have a limit per link; the others are served as before."""
    link = link_of(server)
    link.budget.expansion.over_time = TokenBucket(burst=4_000_000, per_second=0.0, now=0.0)
    names = ("/grows", "/grows_too")
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    out, there = robot.publisher("/plain"), pc.listener("/plain")
    client = bridge.client(
        *(Topic(name, "transmit", compression="zstd") for name in names), Topic("/plain", "transmit")
    )
    carries([*outs, out], server, [*names, "/plain"])
    for count in range(1, 5):
        outs[0].publish(text("x" * 900_000))
        heard(theres[0], count)
    for _ in range(3):
        outs[0].publish(text("x" * 900_000))
        outs[1].publish(text("x" * 900_000))
    assert settled(client, "/grows", 7).dropped == {"expands too much": 3}
    assert settled(client, "/grows_too", 3).dropped == {"expands too much": 3}
    assert "without compression" in route(server, "/grows").last_error
    out.publish(text("x" * 900_000))
    heard(there, 1)


def test_many_large_messages_at_once(bridge: Bridge, server: Engine, robot: Domain, pc: Domain) -> None:
    """Eight topics of 8 MB, all at the same moment, three times."""
    names = [f"/large{number}" for number in range(ROUTES)]
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    client = bridge.client(*(Topic(name, "transmit") for name in names))
    carries(outs, server, names)
    payload = text("x" * ((8 << 20) - 100))
    for count in (1, 2, 3):
        for out in outs:
            out.publish(payload)
        for there in theres:
            assert heard(there, count)[-1] == payload
    for name in names:
        assert settled(client, name, 3).delivered == 3
    assert link_of(server).budget.unfinished.held == 0


def test_a_subscriber_that_is_stopped(
    bridge: Bridge, server: Engine, robot: Domain, pc: Domain, tmp_path: Path
) -> None:
    """DDS would hold as many messages for it as the depth says. Small topics go on, and this one once it goes on."""
    budget = link_of(server).budget.unacknowledged
    budget.limit = 2_400_000
    out, small, there = robot.publisher("/large"), robot.publisher("/small"), pc.listener("/small")
    topics = Topic("/large", "transmit", qos={"depth": 10_000}), Topic("/small", "transmit")
    printed = tmp_path / "sizes"
    published = 0

    def took(size: int) -> bool:
        nonlocal published
        published += 1
        out.publish(text("x" * size))
        return str(size) in printed.read_text().split()

    with (
        printed.open("w") as file,
        subprocess.Popen([sys.executable, "-c", LISTENER, str(pc.id)], stdout=file) as program,
        contextlib.ExitStack() as ends,
    ):
        ends.callback(program.kill)
        client = bridge.client(*topics)
        carries([out, small], server, ["/large", "/small"])
        eventually(lambda: took(1))
        settled(client, "/large", published)
        stop(program.pid)
        for _ in range(20):
            out.publish(text("x" * 200_000))
        ledger = settled(client, "/large", published + 20)
        # How many depends on what DDS has acknowledged by then; tests/route/test_volatile.py counts them.
        assert ledger.dropped.keys() == {"slow subscriber"}
        assert budget.held <= budget.limit // 2
        assert happened(server, EventCode.ROUTE_SLOW_SUBSCRIBER, "restart the subscriber")
        small.publish(text("still"))
        heard(there, 1)
        program.send_signal(signal.SIGCONT)
        eventually(lambda: took(200_001))
    client.remove_topic(route(client, "/large").key).result(60)
    eventually(lambda: budget.held == 0)


def test_types_that_are_not_installed(bridge: Bridge, server: Engine, rogue: Rogue) -> None:
    """A peer may name any; topics share one, and what a topic that is gone had, the next one may have."""
    types = link_of(server).budget.types
    types.limit = 2

    def described(topic: str, name: str) -> tuple[int, Ready | Refuse]:
        return rogue.describe(topic, "tcp", Qos(), (f"made_up_msgs/msg/{name}", BLOB[1]))

    routes = [described(f"/t{number}", name) for number, name in enumerate(("First", "First", "Second"))]
    assert [type(answer) for _, answer in routes] == [Ready] * 3
    _, refused = described("/more", "Third")
    assert isinstance(refused, Refuse)
    assert package_of("made_up_msgs") in refused.reason
    assert happened(server, EventCode.ROUTE_TYPE_DIFFERS, "have 2 types that are not installed on this side")
    rogue.say(Close(route=routes[-1][0], reason="", code=EndCode.REMOVED))
    assert isinstance(described("/then", "Third")[1], Ready)
    rogue.close()
    eventually(lambda: not linked(server))
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as again:
        for name in ("First", "Third"):
            assert isinstance(again.describe("/t0", "tcp", Qos(), (f"made_up_msgs/msg/{name}", BLOB[1]))[1], Ready)
            again.say(Close(route=1, reason=""))
            assert types.used <= 2
