"""Large packets vanish on the way, and nobody says so: both sides name it, with the remedy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.waiting import eventually

from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.network.bridging import Program
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_PC = "10.99.1.1"
_LARGE = 20_000
"""Bytes of a message: more than a packet."""


def test_large_packets_that_vanish_without_a_word(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    topics = ({"topic": "/scan", "protocol": "udp"}, {"topic": "/odom", "protocol": "tcp"})
    bridge = network.bridge(robot, pc, _PC, *topics)
    bridge.listen(pc=("/scan", "/odom"))
    pc.nft(
        "add table inet narrow;"
        "add chain inet narrow in { type filter hook prerouting priority -500; };"
        "add rule inet narrow in iif eth0 meta length > 1200 drop"
    )
    for topic in ("/scan", "/odom"):
        bridge.robot.talk(topic, rate=5, size=_LARGE)
    for topic, cause, remedy in (("/scan", Cause.LOSSY, "protocol: tcp"), ("/odom", Cause.NO_PATH, "MTU")):
        for side, who in ((bridge.client, ""), (bridge.server, "robot1: ")):
            reason = eventually(lambda side=side, at=(topic, cause): _down(side, *at), what=f"{topic} down: {cause}")
            assert reason.startswith(who), reason
            assert remedy in reason, reason
    statuses = [each["status"]["routes"] for each in bridge.client.log if "status" in each]
    odom = [(each["state"], each["reason"]) for routes in statuses for each in routes if each["topic"] == "/odom"]
    first = next(reason for state, reason in odom if state == "down")
    assert "nothing gets through its data connection" in first, "it is told before the kernel gives the connection up"
    pc.nft("delete table inet narrow")
    for topic in ("/scan", "/odom"):
        for side in (bridge.client, bridge.server):
            eventually(lambda topic=topic, side=side: side.route(topic).get("state") == "ok", what=f"{topic} is ok")


def _down(side: Program, topic: str, cause: Cause) -> str:
    """Why a topic is down; empty: it is not, or for another cause."""
    shown = side.route(topic)
    return shown["reason"] if (shown.get("state"), shown.get("cause")) == ("down", cause) else ""
