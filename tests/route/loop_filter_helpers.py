"""Helpers of `test_loop_filter` and others."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from tests.support.offline import FakePeer, half_of

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.messages import Describe, Ready

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.ledger import RouteLedger
    from rsb_bridge.route.sending import OutgoingPath
    from rsb_bridge.wire.framing import Message


SCAN = "/scan"


TYPE = "std_msgs/msg/String"


TYPE_HASH = "RIHS01_" + 64 * "0"


FIRST, SECOND = b"first", b"second"


class Graph(NoRos):
    """A graph that a test changes.

    Attributes:
        nodes: the nodes of the topic's publishers, by their ids; an empty name: not known yet.
        asked: how often it was asked for them.
    """

    def __init__(self) -> None:
        self.nodes = {FIRST: "/talker"}
        self.asked = 0

    def publishers(self, topic: str) -> list[Endpoint]:
        if topic != SCAN:
            return []
        self.asked += 1
        return [Endpoint(node, TYPE, TYPE_HASH, Qos(), gid) for gid, node in self.nodes.items()]

    def installed_description(self, type_name: str) -> str | None:
        return None

    def ask_description(self, *_: object) -> str | None:
        return None

    def installed_hash(self, type_name: str) -> str | None:
        return TYPE_HASH

    def subscribe(self, _: object, sink: Any, *__: Any, **___: Any) -> Any:
        self.sink = sink

        class Subscription:
            matched = 1

            def close(self) -> None:
                pass

        return Subscription()


class Channel:
    """Takes everything.

    Attributes:
        sent: the payloads and flags so far.
        stood_still: s for which no receipt has come.
    """

    ready = True
    congested = False
    stood_still = 0.0
    batch_bytes = 1 << 20

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, int]] = []

    def takes(self, size: int) -> bool:
        return not self.congested and size <= self.batch_bytes

    def send(self, batch: Sequence[Message]) -> None:
        self.sent += [(payload, flags) for payload, _, flags in batch]

    @property
    def free(self) -> bool:
        return not self.congested

    def ask(self) -> None:
        pass

    def behind(self, now: float) -> bool:
        return False

    def still(self, now: float) -> float:
        return self.stood_still

    def datagrams(self, size: int) -> int:
        return 0

    def close(self, reason: str) -> None:
        pass

    def trouble(self) -> None:
        return None


class Peer(FakePeer):
    """Has a publisher for everything, and gives routes a channel."""

    def __init__(self) -> None:
        super().__init__()
        self.channel = Channel()

    def open_channel(self, route: Any) -> None:
        route.half.carried.channel = self.channel

    def answer(self, sender: Sender) -> None:
        described = [each for each in self.sent if isinstance(each, Describe)][-1]
        sender.peer_ready(Ready(route=described.route, sources=len(described.sources)))


class World(NamedTuple):
    sender: Sender
    graph: Graph
    peer: Peer
    context: Context
    loop: VirtualLoop

    def comes(self, gid: bytes, *payloads: bytes) -> None:
        self.path.offer([RawMessage(each, 0, gid) for each in payloads])

    @property
    def path(self) -> OutgoingPath:
        return self.sender.path

    @property
    def ledger(self) -> RouteLedger:
        return self.sender.counts

    @property
    def held(self) -> int:
        """The number of messages whose publisher is being looked up."""
        return self.sender.loop_filter.holds

    def wait(self, seconds: float) -> None:
        self.loop.run_until_complete(asyncio.sleep(seconds))

    @property
    def sent(self) -> list[bytes]:
        return [payload for payload, _ in self.peer.channel.sent]


def world_of(graph: Graph, context: Context, loop: VirtualLoop, **fields: Any) -> World:
    """Open a topic's sender; the topic has these settings."""
    peer = Peer()
    sender = half_of(Sender, context, Topic(SCAN, "transmit", **fields), peer)
    sender.route.open(1)
    sender.route.on_accepted()
    peer.answer(sender)
    return World(sender, graph, peer, context, loop)


@pytest.fixture
def world(loop: VirtualLoop, make_context: Callable[..., Context], request: pytest.FixtureRequest) -> World:
    """The topic has other settings where a test gives the fixture some."""
    graph = Graph()
    return world_of(graph, make_context(graph), loop, **getattr(request, "param", {}))
