"""A cable that is cut and mended, and firewalls that eat a part of what crosses."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from tests.network.bridging import EACH_WAY
from tests.support.waiting import eventually

from rsb_bridge.channel.udp_channel import Silence
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_PC = "10.99.1.1"
_BACK_WITHIN = 60.0


def own_ends(host: Host, destination: str) -> list[str]:
    """Return the ports of a host's connections to another port."""
    found = host.run("ss", "--tcp", "--numeric", "--no-header", "state", "established", "dst", destination)
    return [line.split()[2].rpartition(":")[2] for line in found.splitlines()]


def test_short_cut_is_survived_long_one_heals(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    bridge = network.bridge(robot, pc, _PC, *EACH_WAY)
    bridge.all_talk()

    cable.cut()
    time.sleep(1.0)  # to cut and mend it takes four processes, within the 5 s of silence that end a link
    cable.mend()
    bridge.all_flow(_BACK_WITHIN)
    for side, topic in ((bridge.client, "/scan"), (bridge.server, "/cmd")):  # a report has the lost messages
        eventually(lambda: side.ledger(topic).dropped.get("lost on the way"), what=f"{topic} lost some")  # noqa: B023
    assert not bridge.client.happened(EventCode.LINK_LOST)

    began = time.time()
    cable.cut()
    for side in (bridge.client, bridge.server):
        assert side.happens(EventCode.LINK_LOST, "the peer is silent") - began > 3.5
    bridge.client.happens(EventCode.LINK_UNREACHABLE)
    cable.mend()
    bridge.all_flow(_BACK_WITHIN)

    said = bridge.robot.hush()
    ledgers = bridge.settled("/scan", "/odom")
    assert not ledgers["/odom"].dropped
    for topic, ledger in ledgers.items():
        # What is published between link and subscription is nobody's.
        assert ledger.offered <= said[topic]


def test_firewalled_route_is_named_and_returns(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    """UDP is dropped, and one of the TCP connections: by a firewall that has forgotten it, without a word."""
    scan, odom, *others = EACH_WAY
    bridge = network.bridge(robot, pc, _PC, scan, odom | {"port": 49153}, *others)
    bridge.all_talk()
    own_end, *_ = own_ends(robot, ":49153")
    pc.wall(f"iif eth0 tcp sport {own_end} drop", "iif eth0 meta l4proto udp drop")
    bridge.client.happens(EventCode.LINK_STREAM_REOPENED)
    bridge.client.happens(EventCode.LINK_UDP_BLOCKED, Silence.NO_ANSWER(port=49152, host="10.99.1.1"))
    bridge.server.happens(EventCode.LINK_UDP_BLOCKED, Silence.NOTHING_MORE)
    eventually(lambda: bridge.client.route("/scan").get("state") == "down", what="/scan is shown as down")
    bridge.pc.hears("/odom", _BACK_WITHIN)  # on another connection
    assert bridge.client.ledger("/scan").dropped["lost on the way"] > 0

    pc.nft("delete table inet wall")
    bridge.client.happens(EventCode.LINK_UDP_RESTORED)
    bridge.all_flow(_BACK_WITHIN)
    assert not bridge.client.happened(EventCode.LINK_LOST)
    assert not bridge.server.happened(EventCode.ROUTE_REMOVED)
    bridge.robot.hush()
    bridge.settled("/scan", "/odom")


def test_topic_goes_on_after_firewalls_reset(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    """The kernel of the robot hears of it, and that of the PC when something comes or goes next."""
    scan, odom, *others = EACH_WAY
    bridge = network.bridge(robot, pc, _PC, scan, odom | {"port": 49153}, *others)
    bridge.all_talk()
    for _ in range(2):
        began = time.time()
        pc.wall(f"iif eth0 tcp sport {{ {', '.join(own_ends(robot, ':49153'))} }} reject with tcp reset")
        for side in (bridge.client, bridge.server):
            side.happens(EventCode.LINK_STREAM_REOPENED, since=began)
        pc.nft("delete table inet wall")
        bridge.all_flow(_BACK_WITHIN)
    for side in (bridge.client, bridge.server):
        assert not side.happened(EventCode.ROUTE_CHANNEL_LOST)
        assert not side.happened(EventCode.LINK_LOST)
    bridge.robot.hush()
    assert not bridge.settled("/odom")["/odom"].dropped
