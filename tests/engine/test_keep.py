"""Messages wait for a link that is away: with `keep` all of some time, and without it N of each publisher."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tests.engine.outlive_helpers import OUTLIVES, away, numbers
from tests.support.bridge import balance, carries, outgoing, route, settled
from tests.support.domain import text
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.model.keep import Keep
from rsb_bridge.model.session import Topic
from rsb_bridge.route.catching_up import LATE

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link

TEN, HUNDRED = QoSProfile(depth=10), QoSProfile(depth=100)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def link_of(engine: Engine) -> Link:
    (link,) = inside(engine).role.links()
    return link


class Cut:
    """A topic from robot to PC over a link that is away."""

    def __init__(
        self, bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, edited: Topic | None = None, **keys: Any
    ) -> None:
        qos = keys.pop("node_qos", TEN)
        self.out = [robot.publisher("/events", qos=qos), robot.publisher("/events", qos=qos)]
        self.there = pc.listener("/events", qos=qos)
        self.server, self.client = bridge.both(Topic("/events", "transmit", **keys), outlive=OUTLIVES)
        carries(self.out, self.server, ["/events"])
        self.opening = outgoing(self.client, "/events").route.id
        if edited is not None:
            self.client.edit_topic(route(self.client, "/events").key, edited).result(60)
        self._relay = relay
        relay.refuse()
        relay.cut()
        eventually(lambda: away(self.client) and away(self.server))
        self._came = len(self.there.payloads)

    @property
    def offered(self) -> int:
        return outgoing(self.client, "/events").facts.ledger.offered

    def publish(self, count: int, first: int = 0, *, publisher: int = 0, size: int = 0) -> None:
        """Have the bridge take numbered messages, a few at a time, as its subscription keeps ten, too."""
        before = self.offered
        for number in range(count):
            self.out[publisher].publish(text(f"{first + number}" + " " * size))
            if number % 5 == 4 or number == count - 1:
                eventually(lambda least=before + number + 1: self.offered >= least)

    def come_back(self, count: int) -> list[int]:
        """Return the numbers of the messages that come as the link is back, once there are so many."""
        late_at = time.monotonic() + LATE  # younger ones come together
        eventually(lambda: time.monotonic() > late_at)
        self._relay.refuse(False)
        deadline = time.monotonic() + 60
        while len(self.there.payloads) < self._came + count and time.monotonic() < deadline:  # as a node that spins
            time.sleep(0.001)
        ledger = settled(self.client, "/events", self.offered)
        assert balance(ledger) == ledger.offered
        assert outgoing(self.client, "/events").route.id == self.opening
        return numbers(self.there.payloads[self._came :])

    def dropped(self) -> dict[str, int]:
        return dict(route(self.client, "/events").ledger.dropped)


@pytest.mark.parametrize("qos", ["auto", 10, {"reliability": "best_effort"}], ids=str)
def test_all_of_its_time_waits_and_overruns_nobody(
    bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, qos: Any
) -> None:
    """Each of 600 messages comes to a node that keeps a hundred; best effort needs more, as DDS may lose it."""
    best_effort = isinstance(qos, dict)
    cut = Cut(bridge, relay, robot, pc, qos=qos, keep=60, node_qos=BEST_EFFORT if best_effort else HUNDRED)
    cut.publish(600)
    assert cut.come_back(600) == [*range(600)]
    assert cut.dropped() == {}


def test_older_messages_wait_as_qos_promises(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    cut = Cut(bridge, relay, robot, pc, qos=10, keep=4)
    cut.publish(50)
    cut.publish(30, publisher=1)
    kept_until = time.monotonic() + 4
    eventually(lambda: time.monotonic() > kept_until)
    cut.publish(5, 30, publisher=1)
    assert cut.dropped() == {"outage": 25}  # of the one that published; of the silent one once the link is back
    assert sorted(cut.come_back(20)) == sorted([*range(40, 50), *range(25, 35)])
    assert cut.dropped() == {"outage": 65}


@pytest.mark.parametrize("own", [False, True])
def test_bytes_are_limited_and_oldest_go(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, *, own: bool) -> None:
    cut = Cut(bridge, relay, robot, pc, keep=Keep(60, 0.1) if own else 60)
    budget = link_of(cut.client).budget
    budget.keep.limit = 1 << 20 if own else 100_000
    cut.publish(30, size=10_000)
    assert budget.keep.held == 0 if own else 90_000 < budget.keep.held <= 100_000
    assert cut.dropped() == {"keep full": 21}
    assert cut.come_back(9) == [*range(21, 30)]
    assert budget.keep.held == budget.waiting.held == 0


def test_newest_of_each_publisher_wait(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """DDS would do the same for a reader that is away: a busy publisher pushes out no message of a quiet one."""
    cut = Cut(bridge, relay, robot, pc, qos=10)
    cut.publish(8)
    cut.publish(100, 100, publisher=1)
    assert cut.come_back(18) == [*range(8), *range(190, 200)]


def test_open_topic_begins_to_keep(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    cut = Cut(bridge, relay, robot, pc, Topic("/events", "transmit", qos=10, keep=60), qos=10)
    cut.publish(100)
    assert cut.come_back(100) == [*range(100)]


def test_peer_alone_makes_nobody_keep_more(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """The server's session does not list the topic, so that a client's size counts as a part of what all share."""
    out, there = pc.publisher("/orders", qos=TEN), robot.listener("/orders", qos=TEN)
    server, client = bridge.both(Topic("/orders", "receive", keep=Keep(60, 500)), outlive=OUTLIVES)
    carries([out], client, ["/orders"])
    relay.refuse()
    relay.cut()
    eventually(lambda: away(client) and away(server))
    came = len(there.payloads)
    for number in range(5):
        out.publish(text(f"{number}" + " " * 10_000))
    eventually(lambda: link_of(server).budget.keep.held > 50_000)
    relay.refuse(False)
    eventually(lambda: numbers(there.payloads[came:]) == [*range(5)])
    assert link_of(server).budget.keep.held == 0
