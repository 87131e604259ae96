"""No message goes unaccounted for: the ledger against what publisher and subscriber counted themselves."""

from __future__ import annotations

import random
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.bridge import (
    balance,
    carries,
    connections,
    happened,
    heard,
    linked,
    outgoing,
    protocol_of,
    route,
    settled,
)
from tests.support.domain import text
from tests.support.inside import ledger_of
from tests.support.relay import message_number
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


def publish(publisher: Publisher, numbers: range, size: int = 0) -> None:
    """Publish the numbers, each in a message of its own."""
    for number in numbers:
        publisher.publish(text(f"{number}" + " " * size))


@pytest.mark.parametrize("direction", ["transmit", "receive"])
def test_everything_arrives_on_a_good_line(direction: Any, bridge: Bridge, robot: Domain, pc: Domain) -> None:
    near, far = (robot, pc) if direction == "transmit" else (pc, robot)
    names = ("/tcp", "/udp")
    theres, outs = [far.listener(name) for name in names], [near.publisher(name) for name in names]
    server, client = bridge.both(*(Topic(n, direction, protocol=protocol_of(n), qos={"depth": 1000}) for n in names))
    sender, receiver = (client, server) if direction == "transmit" else (server, client)
    carries(outs, receiver, names)
    for name, there, out in zip(names, theres, outs, strict=True):
        publish(out, range(500))
        assert heard(there, 500) == [text(f"{number}") for number in range(500)]
        ledger = settled(sender, name, 500)
        assert (ledger.delivered, ledger.dropped, ledger.lost_in_dds) == (500, {}, 0)
        eventually(lambda name=name, ledger=ledger: route(receiver, name).ledger == ledger)


def test_datagrams_that_are_lost(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Every tenth datagram, then the last three: what is not heard is counted as lost, nothing twice."""
    there, out = pc.listener("/count"), robot.publisher("/count")
    _, client, lost = *lossy(bridge, relay, out, "/count"), []
    kept = iter(range(1_000_000))

    def lose_some(datagram: bytes) -> list[bytes]:
        number = message_number(datagram)
        if number is None or not (next(kept) % 10 == 0 or number > 297):
            return [datagram]
        lost.append(number)
        return []

    relay.to_server = lose_some
    publish(out, range(300))
    ledger = settled(client, "/count", 300)
    assert len(lost) >= 30
    assert ledger.delivered == 300 - len(lost)
    hears_just(there, ledger.delivered)
    assert ledger.dropped == {"lost on the way": len(lost)}
    assert balance(ledger) == 300


def test_fragments_that_are_lost_late_and_twice(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Messages of four datagrams, in any order: a whole one arrives once, a torn one expires, the rest adds up."""
    there, out = pc.listener("/count"), robot.publisher("/count")
    _, client = lossy(bridge, relay, out, "/count")
    chance, torn, held = random.Random(1), set[int](), []

    def jumble(datagram: bytes) -> list[bytes]:
        number = message_number(datagram)
        if number is None:
            return [datagram]
        fate = chance.random()
        if fate < 0.05:
            torn.add(number)
            return []
        if fate < 0.2:
            held.append(datagram)
            return []
        late, held[:] = held[:], []
        return [datagram, *late, datagram]

    relay.to_server = jumble
    publish(out, range(100), size=200_000)
    eventually(lambda: route(client, "/count").ledger.offered == 100)
    eventually(lambda: torn, what="a datagram that the relay has lost")
    relay.to_server = lambda datagram: [datagram]
    ledger = settled(client, "/count", 100)
    hears_just(there, ledger.delivered)
    assert len(set(there.payloads)) == ledger.delivered
    assert ledger.delivered + sum(ledger.dropped.get(each, 0) for each in ("incomplete", "lost on the way")) == 100
    assert 100 - len(torn) - len(held) <= ledger.delivered <= 100 - len(torn)
    assert balance(ledger) == 100


def hears_just(there: Listener, count: int) -> None:
    """As many messages come as the ledger says were delivered: published, that is. DDS brings them a moment later."""
    eventually(lambda: len(there.payloads) >= count, what=f"{count} messages")
    assert len(there.payloads) == count


def lossy(bridge: Bridge, relay: Relay, out: Publisher, topic: str) -> tuple[Engine, Engine]:
    """Both engines, with a UDP topic that is open."""
    server, client = bridge.both(Topic(topic, "transmit", protocol="udp", qos={"depth": 1000}))
    carries([out], server, [topic])
    return server, client


def test_a_link_that_is_cut(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Three times amid traffic: what the other side published is delivered, also what it had not reported yet."""
    names = ("/tcp", "/udp")
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    server, client = bridge.both(*(Topic(n, "transmit", protocol=protocol_of(n), qos={"depth": 1000}) for n in names))
    for number in range(1, 4):
        carries(outs, server, names)
        before = [len(there.payloads) for there in theres]
        for out in outs:
            publish(out, range(100))
        for there, count in zip(theres, before, strict=True):
            heard(there, count + 50)
        # What DDS still holds for the client when its subscription ends was never offered.
        eventually(lambda taken=100 * number: [ledger_of(outgoing(client, n)).offered for n in names] == [taken, taken])
        made = connections(client)
        relay.cut()
        eventually(lambda made=made: connections(client) > made and linked(client) and linked(server))
    carries(outs, server, names)
    for name, there, out in zip(names, theres, outs, strict=True):
        publish(out, range(10))
        ledger = settled(client, name, 310)
        hears_just(there, ledger.delivered)
        assert ledger.delivered >= 150
        assert set(ledger.dropped) <= {"link lost"}
        assert balance(ledger) == 310


def test_a_link_that_stalls_until_it_is_given_up(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Messages in queues and sockets are counted: as replaced while the link may recover, and then as lost."""
    there, out = pc.listener("/count"), robot.publisher("/count")
    server, client = bridge.both(Topic("/count", "transmit", qos=20))
    carries([out], server, ["/count"])
    relay.stall()
    published = 0

    def overflows() -> bool:
        nonlocal published
        ledger = ledger_of(outgoing(client, "/count"))  # a snapshot's would come too late
        publish(out, range(5), size=500_000)
        published += 5
        eventually(lambda: ledger.offered == published, what="DDS has lost none")
        return "queue full" in ledger.dropped

    eventually(overflows)
    eventually(lambda: happened(client, EventCode.LINK_LOST, "the peer is silent"))
    eventually(lambda: linked(client))
    carries([out], server, ["/count"])
    publish(out, range(10))
    heard(there, 10)
    lost_in_dds = route(client, "/count").ledger.lost_in_dds
    ledger = settled(client, "/count", published + 10 - lost_in_dds)
    hears_just(there, ledger.delivered)
    assert ledger.dropped["link lost"] >= 20
    assert balance(ledger) + ledger.lost_in_dds == published + 10


def test_a_client_that_starts_again_around_a_cut(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """The server's count for the first process is not taken for the second's, though their route ids are equal."""
    pc.listener("/count")
    out = robot.publisher("/count")
    server, first = lossy(bridge, relay, out, "/count")
    publish(out, range(100))
    settled(first, "/count", 100)
    first.stop()
    eventually(lambda: not out.get_subscription_count(), what="the first one's subscription is gone")
    relay.to_server = lambda datagram: [] if message_number(datagram) else [datagram]
    second = bridge.client(Topic("/count", "transmit", protocol="udp", qos={"depth": 1000}))
    carries([out], server, ["/count"])
    publish(out, range(5))
    eventually(lambda: route(second, "/count").ledger.offered == 5)
    made = connections(second)
    relay.cut()
    eventually(lambda: connections(second) > made)
    relay.to_server = lambda datagram: [datagram]
    eventually(lambda: linked(second) and linked(server))
    carries([out], server, ["/count"])
    publish(out, range(10))
    ledger = settled(second, "/count", 15)
    assert (ledger.delivered, ledger.dropped_total) == (10, 5)
    eventually(lambda: route(server, "/count").ledger == ledger)


def test_pausing_under_traffic(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """From either side; messages taken before are delivered, messages published meanwhile are not counted."""
    there, out = pc.listener("/count"), robot.publisher("/count")
    server, client = bridge.both(Topic("/count", "transmit", qos={"depth": 1000}))
    for engine in (client, server):
        carries([out], server, ["/count"])
        publish(out, range(100))
        engine.pause(route(engine, "/count").key, True).result(60)
        for side in (client, server):
            eventually(lambda side=side: route(side, "/count").state == "paused")
        eventually(lambda: not out.get_subscription_count())
        publish(out, range(50))
        engine.pause(route(engine, "/count").key, False).result(60)
    carries([out], server, ["/count"])
    publish(out, range(1000, 1007))
    eventually(lambda: there.payloads and there.payloads[-1] == text("1006"))
    offered = len(there.payloads)
    ledger = settled(client, "/count", offered)
    assert ledger.delivered == offered <= 207
    assert ledger.dropped == {}


def test_a_highest_rate(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    names = ("/tcp", "/udp")
    theres, outs = [pc.listener(name) for name in names], [robot.publisher(name) for name in names]
    server, client = bridge.both(*(Topic(n, "transmit", protocol=protocol_of(n), max_rate=20.0) for n in names))
    carries(outs, server, names)
    began = time.monotonic()
    for number in range(200):
        for out in outs:
            out.publish(text(f"{number}"))
        time.sleep(max(0.0, began + number / 100 - time.monotonic()))
    for name, there in zip(names, theres, strict=True):
        ledger = settled(client, name, 200)
        seconds = time.monotonic() - began  # the client may have taken the last of them only now
        assert ledger.delivered == 200 - ledger.throttled
        hears_just(there, ledger.delivered)
        assert 0 < ledger.delivered <= 20 * seconds + 2
