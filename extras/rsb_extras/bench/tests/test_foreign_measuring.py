"""What a peer proposes and sends to measure a link becomes no topic."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.link.foreign_proposals_helpers import link, rogue
from tests.support.frames import write_frame
from tests.support.inside import inside
from tests.support.waiting import eventually

from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client
from rsb_bridge.wire.messages import Accept, Propose, Refuse
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.benchmark import BENCH

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain


def test_nobody_measures_without_leave(bridge: Bridge) -> None:
    server = bridge.server()
    with rogue(bridge) as client:
        proposed: dict[str, Any] = {"purpose": BENCH.name, "type": BENCH.type_name, "from_client": True}
        client.say(Propose(route=1, topic="bench/1", remote_topic="bench/1", **proposed))
        answer = client.wait_for(Refuse, Accept)
        assert isinstance(answer, Refuse)
        assert answer.code == "denied"
        assert "add bench: {}" in answer.reason
        assert not link(server).routes


def test_nothing_that_peer_sends_to_measure_reaches_ros(bridge: Bridge, pc: Domain) -> None:
    """A description of another type than the route's ends it."""
    entry = Client("robot1", key_file=bridge.key_file, features={LIMITS.name: BenchmarkLimits()})
    server = bridge.server(key_file=None, clients=(entry,))
    with rogue(bridge) as client:
        string = ("std_msgs/msg/String", "RIHS01_" + "0" * 64)
        proposed = {"purpose": BENCH.name, "type": BENCH.type_name}
        _, answer = client.describe(BENCH.route_name("tcp", "transmit"), "tcp", Qos(), string, **proposed)
        assert isinstance(answer, Refuse)
        assert answer.code == "type_differs"
        stream, frames = client.stream(client.internal(BENCH, ("tcp", "transmit"), "tcp"))
        for _ in range(10):
            stream.sendall(write_frame(frames, b"\0\1\0\0" + bytes(100), 0, 0))
        drains = inside(server).context.internal[BENCH.name].drains
        eventually(lambda: sum(each.messages for each in drains.values()) == 10)
        assert not [name for name, _ in pc.node.get_topic_names_and_types() if "bench" in name]
