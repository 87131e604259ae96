"""Two hosts on one cable: every size, by IPv4 and IPv6, in large packets and in small ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_MEGABYTE = 1_000_000


@pytest.mark.parametrize(
    ("mtu", "address", "fragments"),
    [(1500, "10.99.1.9", ("IpFragCreates", "IpReasmReqds")), (1280, "fd99::9", ("Ip6FragCreates", "Ip6ReasmReqds"))],
)
def test_every_size_crosses_and_no_packet_is_fragmented(
    network: Network, robot: Host, pc: Host, cable: Cable, mtu: int, address: str, fragments: tuple[str, ...]
) -> None:
    """Also where the server is called by another of its addresses than the one it would answer from by itself."""
    pc.address("eth0", "10.99.1.9/24", "fd99::9/128")
    cable.mtu(mtu)
    bridge = network.bridge(
        robot,
        pc,
        address,
        {"topic": "/odom", "protocol": "udp"},
        {"topic": "/camera", "protocol": "udp"},
        {"topic": "/map", "protocol": "tcp"},
        {"topic": "/goal", "protocol": "udp", "direction": "receive"},
    )
    bridge.listen(pc=("/odom", "/camera", "/map"), robot=("/goal",))
    bridge.pc.talk("/goal", rate=5, size=_MEGABYTE, count=5)
    said = {"/odom": 100, "/camera": 8, "/map": 3}
    bridge.robot.talk("/odom", rate=50, count=said["/odom"])
    bridge.robot.talk("/camera", rate=5, size=_MEGABYTE, count=said["/camera"])
    bridge.robot.talk("/map", rate=2, size=8 * _MEGABYTE, count=said["/map"])

    eventually(lambda: {topic: len(bridge.pc.heard(topic)) for topic in said} == said, what="all from the robot")
    eventually(lambda: len(bridge.robot.heard("/goal")) == 5, what="all of /goal")
    for topic, ledger in bridge.settled(*said).items():
        assert (ledger.offered, ledger.delivered) == (said[topic], said[topic])
    for host in (robot, pc):
        assert [host.count(counter) for counter in fragments] == [0, 0]
