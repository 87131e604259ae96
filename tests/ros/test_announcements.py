"""Announcements between bridges are bounded for any announcer, and read without polling."""

from __future__ import annotations

import asyncio
import contextlib
import json
import tracemalloc
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.offline import loop

from rsb_bridge.cdr.known_types import serialize_string, string_bytes
from rsb_bridge.model.hops import MOST_BRIDGES
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.announcements import LONGEST, Announcements, Origin
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage, RosError

if TYPE_CHECKING:
    from collections.abc import Hashable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.ros.ros_interface import OnFailure, Sink, TopicSpec

__all__ = ["loop"]

CHAT = "/chat"
MIB = 1 << 20


class Publisher:
    """Keeps what it publishes.

    Attributes:
        published: announcements, with the time (s) of each.
    """

    gid = b"announcer"
    subscriber_count = 0
    acknowledged = True
    refuses = False

    def __init__(self, loop: VirtualLoop) -> None:
        self.published: list[tuple[float, bytes]] = []
        self._loop = loop

    def assert_liveliness(self) -> None:
        pass

    def publish(self, payload: bytes) -> None:
        self.published.append((self._loop.time(), string_bytes(payload)))

    def close(self) -> None:
        pass


class FakeRos(NoRos):
    """A domain whose publishers a test sets.

    Attributes:
        announcers: the publishers of announcements that the graph has.
        asked: how often it was asked for them.
        subscribed: how often announcements were subscribed to.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self.publisher = Publisher(loop)
        self.announcers: list[Endpoint] = []
        self.asked = 0
        self.subscribed = 0
        self.sink: Sink | None = None
        self.fail: OnFailure | None = None

    def publishers(self, topic: str) -> list[Endpoint]:
        self.asked += topic == ANNOUNCEMENT_TOPIC
        return self.announcers if topic == ANNOUNCEMENT_TOPIC else []

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: object = None,
        **_: object,
    ) -> Any:
        self.sink, self.fail = sink, on_failure
        self.subscribed += 1
        return SimpleNamespace(close=lambda: None)

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Publisher:
        return self.publisher

    def announce(self, announcer: Endpoint, content: bytes) -> None:
        assert self.sink is not None
        self.sink([RawMessage(serialize_string(content), 0, announcer.gid)])


class Domain:
    """The announcements of one bridge in a domain.

    Attributes:
        changes: how often the bridge was called for news.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self.ros = FakeRos(loop)
        self.changes = 0
        self.warnings: list[str] = []
        self.announcements = Announcements(self.ros, loop, self.warnings.append)
        self.announcements.start(self._changed)
        self._loop = loop

    def _changed(self) -> None:
        self.changes += 1

    def wait(self, seconds: float) -> None:
        self._loop.run_until_complete(asyncio.sleep(seconds))


@pytest.fixture
def domain(loop: VirtualLoop) -> Domain:
    return Domain(loop)


def endpoint(node: str, gid: bytes) -> Endpoint:
    return Endpoint(f"/{node}", "", "", Qos(), gid)


def bridge_announcement(*gids: bytes, via: str = "rsb_there/chat") -> bytes:
    publishers = [{"topic": CHAT, "gid": gid.hex(), "via": [via]} for gid in gids]
    return json.dumps({"version": 1, "publishers": publishers}).encode()


def test_announcement_is_read_at_once_without_polling(domain: Domain) -> None:
    other, chat = endpoint("rsb_other", b"other"), endpoint("rsb_other", b"chat")
    domain.ros.announcers = [other]
    domain.announcements.update()
    assert domain.announcements.origin_of(chat) is None  # a bridge's that has not said so
    before = domain.changes
    domain.ros.announce(other, bridge_announcement(b"chat"))
    domain.wait(0.001)
    assert domain.changes > before
    assert domain.announcements.origin_of(chat) == Origin(("rsb_there/chat",))
    domain.wait(1.0)
    asked, changes = domain.ros.asked, domain.changes
    domain.wait(3600.0)
    assert (domain.ros.asked, domain.changes) == (asked, changes)


def test_the_same_announcement_again_is_no_news(domain: Domain) -> None:
    other = endpoint("rsb_other", b"other")
    domain.ros.announcers = [other]
    domain.ros.announce(other, bridge_announcement(b"chat"))
    domain.wait(1.0)
    asked, changes = domain.ros.asked, domain.changes
    for _ in range(100):
        domain.ros.announce(other, bridge_announcement(b"chat"))
        domain.wait(0.1)
    assert (domain.ros.asked, domain.changes) == (asked, changes)


def test_many_nodes_are_looked_at_once_each(domain: Domain) -> None:
    """A robot's publishers are no bridges': the graph is asked once for each node, not at each look."""
    domain.wait(1.0)
    before = domain.ros.asked
    for _ in range(20):
        for number in range(500):
            assert domain.announcements.origin_of(endpoint(f"node{number}", b"%d" % number)) == Origin(())
    assert domain.ros.asked - before == 500


@pytest.mark.long
def test_strangers_neither_fill_memory_nor_drown_bridge(domain: Domain) -> None:
    """A hundred of them announce 1 MiB of garbage each, and then thousands of publishers each."""
    other, chat = endpoint("rsb_other", b"other"), endpoint("rsb_other", b"chat")
    strangers = [endpoint(f"stranger{number}", b"%04d" % number) for number in range(100)]
    domain.ros.announcers = [other, *strangers]
    domain.announcements.update()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for stranger in strangers:
            domain.ros.announce(stranger, b"x" * MIB)
        domain.ros.announce(other, bridge_announcement(b"chat"))
        assert tracemalloc.get_traced_memory()[0] - before < 20 * MIB
        domain.wait(0.001)
        assert domain.announcements.origin_of(chat) == Origin(("rsb_there/chat",))
        domain.wait(10.0)
        announcement = bridge_announcement(*(b"%08d" % number for number in range(2_000)))
        for stranger in strangers:
            domain.ros.announce(stranger, announcement)
            domain.wait(0.3)
        assert tracemalloc.get_traced_memory()[0] - before < 80 * MIB
    finally:
        tracemalloc.stop()
    assert len(domain.announcements.bridges) <= MOST_BRIDGES
    assert domain.announcements.origin_of(chat) == Origin(("rsb_there/chat",))
    assert len(domain.warnings) < 5


def test_local_origin_is_known_and_not_announced(domain: Domain) -> None:
    """A via without a hop is invalid: others would ignore the whole announcement."""
    announcements = domain.announcements
    announcements.announce("/diagnostics", "own", endpoint("rsb_robot1", b"ours"), Origin(()))
    announcements.announce(CHAT, "robot1", endpoint("rsb_robot1", b"theirs"), Origin(("rsb_there/chat",)))
    domain.wait(1.0)
    said = json.loads(domain.ros.publisher.published[-1][1])
    assert [each["gid"] for each in said["publishers"]] == [b"theirs".hex()]
    assert announcements.origin_of(endpoint("rsb_robot1", b"ours")) == Origin(())
    assert [each.gid for each in announcements.own_publishers("/diagnostics", besides="robot1")] == [b"ours"]


def test_one_link_cannot_fill_announcement(domain: Domain) -> None:
    """A peer names 16 hops of 340 characters for each topic; the other links' topics can be announced all the same."""
    via = tuple(f"{number:02}".ljust(340, "x") for number in range(16))
    announcements = domain.announcements

    def announce(link: str, number: int, origin: Origin) -> None:
        announcements.announce(f"/t{number}", link, endpoint("rsb_robot1", f"{link}{number}".encode()), origin)

    def fill() -> None:
        for number in range(1000):
            announce("bad", number, Origin(via))

    with pytest.raises(RosError, match="bridge fewer topics"):
        fill()
    for number in range(1000):
        announce("good", number, Origin(via[:1]))
    domain.wait(1.0)
    assert len(domain.ros.publisher.published[-1][1]) < LONGEST
    announcements.withdraw(b"bad0")
    announce("bad", 1000, Origin(via))


def test_full_announcement_of_short_entries_fits(domain: Domain) -> None:
    via = ("x" * 340,)
    for link in range(5):
        with contextlib.suppress(RosError):
            for number in range(5000):
                of = endpoint("rsb_robot1", b"%d of %d" % (number, link))
                domain.announcements.announce(CHAT, link, of, Origin(via))
    domain.wait(1.0)
    assert 0.9 * LONGEST < len(domain.ros.publisher.published[-1][1]) <= LONGEST


def test_restless_announcement_is_published_within_bytes(domain: Domain) -> None:
    via = tuple(f"{number:02}".ljust(340, "x") for number in range(16))
    endpoints = [endpoint("rsb_robot1", b"%d" % number) for number in range(150)]
    for second in range(10):
        for each in endpoints:
            domain.announcements.announce(CHAT, "link", each, Origin(via, live=second % 2 == 0))
        for change in range(100):
            domain.announcements.announce(CHAT, "link", endpoints[0], Origin((*via[1:], f"{change}/chat")))
            domain.wait(0.01)
    published = domain.ros.publisher.published
    assert len(published) > 10
    assert sum(len(content) for _, content in published) < 12 * LONGEST


def test_a_subscription_that_fails_is_opened_again(domain: Domain) -> None:
    assert domain.ros.fail is not None
    domain.ros.fail(RosError("take failed"))
    domain.wait(60.0)
    assert domain.ros.subscribed == 2
    assert len(domain.warnings) == 1
    assert "take failed" in domain.warnings[0]
