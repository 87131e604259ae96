"""A link that loses every third packet, and one that is cut: one cause on both sides, and never a wrong one."""

from __future__ import annotations

import time
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from tests.support.waiting import eventually

from rsb_bridge.model.verdict import Cause, LinkCause

if TYPE_CHECKING:
    from tests.network.bridging import Bridge
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_TOPICS = (
    {"topic": "/odom", "protocol": "tcp"},
    {"topic": "/scan", "protocol": "udp"},
    {"topic": "/cmd", "protocol": "tcp", "direction": "receive"},
)
_SIZE = 700
"""Bytes of a message: less than a packet."""


@pytest.fixture
def bridge(network: Network, robot: Host, pc: Host, cable: Cable) -> Bridge:
    cable.single()
    bridge = network.bridge(robot, pc, "10.99.1.1", *_TOPICS)
    bridge.listen(pc=("/odom", "/scan"), robot=("/cmd",))
    for node, topic in ((bridge.robot, "/odom"), (bridge.robot, "/scan"), (bridge.pc, "/cmd")):
        node.talk(topic, rate=20, size=_SIZE)
    for node, topic in ((bridge.pc, "/odom"), (bridge.pc, "/scan"), (bridge.robot, "/cmd")):
        node.hears(topic)
    return bridge


def test_every_third_packet_lost_is_one_cause(bridge: Bridge, cable: Cable) -> None:
    cable.lose(30)
    for side in (bridge.client, bridge.server):
        eventually(lambda side=side: side.link().get("cause") == LinkCause.LOSSY, what="the link is lossy")
    began = time.time()
    for side in (bridge.client, bridge.server):
        eventually(lambda side=side: len(side.links_since(began)) >= 60, what="half a minute")
        links = side.links_since(began)
        assert {link["cause"] for link in links} <= {LinkCause.LOSSY, LinkCause.NONE, LinkCause.SILENT}
        lossy = [link for link in links if link["cause"] == LinkCause.LOSSY]
        assert len(lossy) >= 0.9 * len(links)
        assert len({link["reason"] for link in lossy}) <= 4
        assert 0.2 < lossy[-1]["loss"]["out"] < 0.45
        for route in side.routes_since(began):
            if route["state"] not in ("ok", "waiting"):
                assert route["cause"] in (Cause.LOSSY, Cause.LINK_DOWN), route["reason"]
        for topic in {route["topic"] for route in side.routes_since(began)}:
            states = [route["state"] for route in side.routes_since(began) if route["topic"] == topic]
            assert sum(one != other for one, other in pairwise(states)) <= 3, states  # it was about ten
