"""A robot with two ways to the PC, whose streams use both by Multipath TCP."""

from __future__ import annotations

import time
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from tests.network.bridging import EACH_WAY
from tests.network.hosts import Cable
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.transport import multipath

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Host

_PC = "10.50.0.1"
"""On no cable, so that both lead there."""
_ODOM = EACH_WAY[1]
_CUT = 8.0  # s: beyond the silence that ends a link


@pytest.fixture
def cables(robot: Host, pc: Host) -> tuple[Cable, Cable]:
    """A usual way and a backup, as an operator sets them up."""
    if reason := multipath.problem():
        pytest.skip(f"this kernel has no Multipath TCP: {reason}")
    usual, backup = Cable(robot, pc), Cable(robot, pc)
    usual.address(("10.99.1.2/24", "10.99.1.1/24"))
    backup.address(("10.99.2.2/24", "10.99.2.1/24"))
    pc.address("lo", f"{_PC}/32")
    robot.route("10.99.1.1")
    for command in (
        "ip route add default via 10.99.2.1 dev eth1 table 42",
        "ip rule add from 10.99.2.2 table 42",
        "ip mptcp endpoint add 10.99.2.2 dev eth1 subflow backup",
        "ip mptcp limits set subflows 2 add_addr_accepted 2",
    ):
        robot.run(*command.split())
    for host in (robot, pc):
        host.run("sh", "-c", "echo 1000 > /proc/sys/net/ipv4/tcp_rto_max_ms || true")  # since Linux 6.15
    return usual, backup


def test_cut_of_one_way_loses_nothing(network: Network, robot: Host, pc: Host, cables: tuple[Cable, Cable]) -> None:
    bridge = network.bridge(robot, pc, _PC, _ODOM, both={"multipath": True})
    bridge.listen(pc=("/odom",))
    bridge.robot.talk("/odom", rate=20)
    bridge.client.happens(EventCode.LINK_WAY, "via eth0 (eth1 ready)")
    bridge.server.happens(EventCode.LINK_WAY, "via 10.99.1.2 (10.99.2.2 ready)")
    bridge.pc.hears("/odom", 60.0)
    cut_at = time.time()
    cables[0].cut()
    bridge.client.happens(EventCode.LINK_WAY, "via eth1 (eth0 not ready)", within=_CUT, since=cut_at)
    bridge.server.happens(EventCode.LINK_WAY, "via 10.99.2.2 (10.99.1.2 not ready)", within=_CUT, since=cut_at)
    time.sleep(max(0.0, cut_at + _CUT - time.time()))
    cables[0].mend()
    bridge.client.happens(EventCode.LINK_WAY, "via eth0 (eth1 ready)", since=cut_at)
    said = bridge.robot.hush()["/odom"]
    ledger = bridge.settled("/odom")["/odom"]
    assert not ledger.dropped, ledger
    heard = bridge.pc.heard("/odom")
    assert [each.number for each in heard] == [*range(1, said + 1)]
    silence = max(second.came - first.came for first, second in pairwise(heard)) / 1e9
    assert silence < 4.0, silence  # on a quiet machine it is 0.5
    for side in (bridge.client, bridge.server):
        assert not side.happened(EventCode.LINK_LOST)
        assert not side.happened(EventCode.LINK_PATH_FAULT)
        assert all(link["state"] == "ok" for link in side.links_since(cut_at))


def test_end_without_multipath_makes_plain_connection(
    network: Network, robot: Host, pc: Host, cables: tuple[Cable, Cable]
) -> None:
    pc.run("sh", "-c", "echo 0 > /proc/sys/net/mptcp/enabled")
    bridge = network.bridge(robot, pc, _PC, _ODOM, both={"multipath": True})
    bridge.listen(pc=("/odom",))
    bridge.robot.talk("/odom", rate=20)
    bridge.pc.hears("/odom", 60.0)
    eventually(lambda: bridge.client.link().get("rtt"), what="a status of the link")
    assert not bridge.client.happened(EventCode.LINK_WAY)
    assert not bridge.server.happened(EventCode.LINK_WAY)
