"""No message goes unaccounted for: the ledger against what publisher and subscriber counted themselves."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from tests.support.bridge import balance, carries, route, settled
from tests.support.domain import BEST_EFFORT, text
from tests.support.relay import message_number
from tests.support.waiting import eventually

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


def test_datagrams_that_are_lost(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Every tenth datagram, then the last three: what is not heard is counted as lost, nothing twice."""
    there, out = pc.listener("/count", qos=BEST_EFFORT), robot.publisher("/count", qos=BEST_EFFORT)
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
    ledger = settled(client, "/count", 300, delivered=lambda: 300 - len(lost))
    assert len(lost) >= 30
    hears_just(there, ledger.delivered)
    assert ledger.dropped == {"lost on the way": len(lost)}
    assert balance(ledger) == 300


def test_fragments_that_are_lost_late_and_twice(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Messages of four datagrams, in any order: a whole one arrives once, a torn one expires, the rest adds up."""
    there, out = pc.listener("/count", qos=BEST_EFFORT), robot.publisher("/count", qos=BEST_EFFORT)
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
    least = 100 - len(torn) - len(held)
    ledger = settled(client, "/count", 100, delivered=lambda: max(least, len(there.payloads)))
    assert len(set(there.payloads)) == len(there.payloads)
    assert ledger.delivered + sum(ledger.dropped.get(each, 0) for each in ("incomplete", "lost on the way")) == 100
    assert ledger.delivered <= 100 - len(torn)
    assert balance(ledger) == 100


def test_what_is_lost_of_a_reliable_topic_comes_again(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """Small messages and large ones, of which datagrams get lost, come late, or come twice."""
    there, out = pc.listener("/count"), robot.publisher("/count")
    _, client = lossy(bridge, relay, out, "/count", "reliable")
    chance, lost, held = random.Random(1), [], list[bytes]()

    def jumble(datagram: bytes) -> list[bytes]:
        if message_number(datagram) is None:
            return [datagram]
        fate = chance.random()
        if fate < 0.2:
            lost.append(datagram)
            return []
        if fate < 0.3:
            held.append(datagram)
            return []
        late, held[:] = held[:], []
        return [datagram, *late, datagram]

    relay.to_server = jumble
    publish(out, range(50))
    publish(out, range(50, 100), size=200_000)
    ledger = settled(client, "/count", 100)
    assert lost
    assert (ledger.delivered, ledger.dropped, balance(ledger)) == (100, {}, 100)
    hears_just(there, 100)
    assert [int(each[8:].split(b" ")[0].rstrip(b"\0")) for each in there.payloads] == [*range(100)]


def hears_just(there: Listener, count: int) -> None:
    """As many messages come as the ledger says were delivered: published, that is. DDS brings them a moment later."""
    eventually(lambda: len(there.payloads) >= count, what=f"{count} messages")
    assert len(there.payloads) == count


def lossy(
    bridge: Bridge, relay: Relay, out: Publisher, topic: str, reliability: str = "best_effort"
) -> tuple[Engine, Engine]:
    """Both engines, with a UDP topic that is open."""
    qos = {"depth": 1000, "reliability": reliability}
    server, client = bridge.both(Topic(topic, "transmit", protocol="udp", qos=qos))
    carries([out], server, [topic])
    return server, client
