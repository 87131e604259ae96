"""Both sides of an association count the same control messages: those that one sends, and the other handles."""

from __future__ import annotations

import asyncio
from itertools import product
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from std_msgs.msg import String
from tests.engine.outlive_helpers import OUTLIVES
from tests.support.bridge import happened, linked
from tests.support.inside import inside
from tests.support.rogue import Rogue
from tests.support.slices import Handlers
from tests.support.virtual_time import VirtualLoop
from tests.support.waiting import eventually
from tests.wire.messages_helpers import KINDS, filled

from rsb_bridge.config.keys import read_key
from rsb_bridge.link.association import Association
from rsb_bridge.link.control_channel import ControlChannel, entries_in_slices
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Topic
from rsb_bridge.wire.codec import WHOLE, ReportParts, decode, decoders, encode, report_entries
from rsb_bridge.wire.events import MessageReceived
from rsb_bridge.wire.messages import Neighbours, Ping, Pong, Report, Settled, TopicList
from rsb_bridge.wire.protocol_error import Broken
from rsb_bridge.wire.records import ReceivedReport

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.link.link import Link
    from rsb_bridge.wire.messages import ControlMessageBase


def association_of() -> Association:
    return Association(bytes(8), "there", MagicMock())


def report(routes: int) -> Report:
    """Return a report of about 320 bytes a route, as of one that is late on a busy machine."""
    return Report(received=(ReceivedReport(route=1, type="a/msg/B" + "x" * 240, malformed="y" * 50),) * routes)


@pytest.mark.parametrize("is_long", [False, True], ids=["short", "long"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_both_sides_agree_which_types_count(kind: type[ControlMessageBase], is_long: bool) -> None:
    here, there = association_of(), association_of()
    content = msgspec.msgpack.encode(filled(msgspec.inspect.type_info(kind)))
    here.sends(decode(content), content)
    there.handles(type(decoders()[is_long].decode(content)))
    assert here.could_have_handled(there.handled)
    assert not here.could_have_handled(there.handled + 1)


class Stream:
    """One way of a connection, whose receiver may pause it, and whose sender waits while it is congested."""

    handler: Any = None
    received_at = 0.0
    congested = paused = False

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def pause_reading(self) -> None:
        self.paused = True

    def resume_reading(self) -> None:
        self.paused = False

    def abort(self, reason: str) -> None:
        raise AssertionError(reason)


class Side:
    """One side of an association: its control channel, and how it counts."""

    def __init__(self) -> None:
        self.stream = Stream()
        self.association = association_of()
        connection: Any = SimpleNamespace(send_encoded=_framed, receive_data=_contents)
        handlers = Handlers(self._handle)
        stream: Any = self.stream
        self.channel = ControlChannel(stream, connection, handlers, lambda *_: None, self.association.handles)

    def send(self, message: ControlMessageBase) -> None:
        content = encode(message)
        self.association.sends(message, content)
        self.channel.send_encoded(content)

    def ping(self) -> None:
        self.send(Ping(1, 0, self.association.handled))

    def _handle(self, message: Any) -> Any:
        match message:
            case Report() | ReportParts():
                return entries_in_slices(report_entries(message), lambda _: None)
            case Ping():
                self.association.acknowledge(message.handled)
                self.send(Pong(1, 0, 0, 0))
            case Neighbours():  # an answer that counts
                self.send(Settled(1))
        return None


def _framed(content: bytes) -> bytes:
    return len(content).to_bytes(4, "big") + content


def _contents(data: bytes) -> list[MessageReceived]:
    events = []
    while data:
        size = int.from_bytes(data[:4], "big")
        events.append(MessageReceived(data[4 : 4 + size]))
        data = data[4 + size :]
    return events


async def carry(sides: tuple[Side, Side]) -> None:
    """Carry what both sides have sent, until neither has anything to say or to do."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    while any(side.stream.sent or side.stream.paused for side in sides):
        assert not loop.errors
        for side, other in (sides, sides[::-1]):
            if side.stream.sent and not other.stream.paused:
                sent, side.stream.sent = b"".join(side.stream.sent), []
                other.channel.received(sent)
        await asyncio.sleep(0.001)


MESSAGES = st.one_of(
    st.builds(report, st.integers(0, 60)),
    st.builds(Settled, st.integers(1, 9)),
    st.builds(lambda count: Neighbours(bridges=("x" * 250,) * count), st.integers(1, 40)),
    st.builds(lambda size: TopicList(1, bytes(size)), st.integers(0, 2 * WHOLE)),
)


@given(st.lists(st.tuples(st.booleans(), st.lists(MESSAGES, max_size=12), st.booleans()), max_size=12))
def test_counts_agree_through_slices_and_congestion(rounds: list[tuple[bool, list[ControlMessageBase], bool]]) -> None:
    async def main() -> None:
        here, there = Side(), Side()
        for by_here, messages, congested in rounds:
            by = here if by_here else there
            by.stream.congested = congested
            for message in messages:
                by.send(message)
                by.ping()
            await asyncio.sleep(0.001)
            if congested:
                by.stream.congested = False
                by.channel.writable()
            await carry((here, there))
        for by, other in ((here, there), (there, here)):
            by.ping()
            await carry((here, there))
            assert other.association.acknowledged == by.association.handled
            assert not other.association.could_have_handled(by.association.handled + 1), "a message is not handled"

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())


def test_real_side_counts_no_long_report(bridge: Bridge) -> None:
    server = bridge.server()
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        rogue.route("/long", "tcp", Qos())  # a proposal and a description, which count
        long = report(26)
        assert isinstance(decode(encode(long)), ReportParts)
        rogue.say(long, Ping(1, 0, 0))
        rogue.wait_for(Pong)
        assert rogue.wait_for(Ping).handled == 2
        assert linked(server)


def link_of(engine: Engine) -> Link:
    (link,) = inside(engine).role.links()
    return link


def test_association_outlives_long_reports(bridge: Bridge, relay: Relay, robot: Domain, pc: Domain) -> None:
    """On a connection that resumes it, the reports of 25 routes go together, and name the nodes that hear each."""
    topics = [f"/sensor{number}" for number in range(30)]
    for topic in topics:
        robot.publisher(topic)
    hearing = [Node(f"hears_{number}_{'x' * 60}", context=pc.node.context) for number in range(4)]
    try:
        for node, topic in product(hearing, topics):
            node.create_subscription(String, topic, lambda _: None, 10)
        server, client = bridge.both(*(Topic(topic, "transmit") for topic in topics), outlive=OUTLIVES)

        def broken() -> list[str]:
            lost = (happened(side, EventCode.LINK_LOST, Broken.HANDLED_WRONG) for side in (server, client))
            return [event.text for event in lost if event is not None]

        heard = [len(hearing)] * len(topics)
        eventually(lambda: broken() or [len(route.subscribers) for route in client.snapshot().routes] == heard)
        before = link_of(client).association
        relay.cut()
        eventually(lambda: broken() or happened(client, EventCode.LINK_UP, "goes on"))
        # The third is a second younger than the reports.
        eventually(lambda: broken() or all(link_of(side).keepalive.answered_pings > 2 for side in (server, client)))
        assert not broken()
        assert link_of(client).association is before
    finally:
        for node in hearing:
            node.destroy_node()
