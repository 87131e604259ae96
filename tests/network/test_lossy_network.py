"""A wire that loses, doubles, delays and reorders packets."""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import TYPE_CHECKING

from tests.network.hosts import Cable
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Host

_LOSS, _DOUBLED, _DELAY, _JITTER = "0.05", "0.05", "0.01", "0.05"


def test_every_message_is_accounted_for(network: Network, robot: Host, pc: Host) -> None:
    """5 % lost, 5 % doubled, 10 to 60 ms late: messages arrive whole and once (`Bridge.settled` checks it)."""
    wire = network.host("wire")
    for cable in (Cable(robot, wire), Cable(wire, pc)):
        cable.single()
    robot.address("eth0", "10.99.1.2/24")
    pc.address("eth0", "10.99.1.1/24")
    between = wire.start(sys.executable, "-m", "tests.network.wire", "eth0", "eth1", _LOSS, _DOUBLED, _DELAY, _JITTER)
    bridge = network.bridge(
        robot,
        pc,
        "10.99.1.1",
        {"topic": "/scan", "protocol": "udp"},
        {"topic": "/cloud", "protocol": "udp"},
        {"topic": "/odom", "protocol": "tcp"},
    )
    said = {"/scan": 200, "/cloud": 80, "/odom": 80}
    bridge.listen(pc=tuple(said))
    bridge.robot.talk("/scan", rate=50, count=said["/scan"])
    bridge.robot.talk("/cloud", rate=20, size=6_000, count=said["/cloud"])
    bridge.robot.talk("/odom", rate=20, count=said["/odom"])
    eventually(lambda: bridge.robot.said() == said, what="all said")

    eventually(lambda: {topic: bridge.client.ledger(topic).offered for topic in said} == said, what="all offered")
    ledgers = bridge.settled(*said)
    assert {topic: ledger.offered for topic, ledger in ledgers.items()} == said
    scan, cloud, odom = (ledgers[topic] for topic in said)
    assert set(scan.dropped) == {"lost on the way"}
    assert 0 < scan.dropped["lost on the way"] / said["/scan"] < 0.12
    assert cloud.dropped["incomplete"] > 0  # of five fragments, some came
    assert odom.delivered == said["/odom"]
    heard = bridge.pc.heard("/scan")
    assert any(later.number < earlier.number for earlier, later in pairwise(heard))  # handed on as they came
    between.kill()
    between.wait()
