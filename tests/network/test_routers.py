"""Networks between: address translation that changes its mind, and a robot that changes networks."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from tests.network.bridging import EACH_WAY
from tests.network.hosts import Cable
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Host

_PC = "10.99.2.1"
_BACK_WITHIN = 60.0


def test_address_translation_changes_its_mind(network: Network, robot: Host, pc: Host) -> None:
    """The router forgets its UDP mapping and makes another one; then it gets another address itself."""
    router = network.router()
    inside, outside = Cable(robot, router), Cable(router, pc)
    inside.address(("10.99.1.2/24", "10.99.1.1/24"))
    outside.address(("10.99.2.2/24", f"{_PC}/24"))
    robot.route("10.99.1.1")
    router.nft("add table ip nat; add chain ip nat out { type nat hook postrouting priority 100; }")
    router.nft("add rule ip nat out oif eth1 meta l4proto udp masquerade to :40000-40999")
    router.nft("add rule ip nat out oif eth1 masquerade")
    for timeout in ("udp_timeout", "udp_timeout_stream"):
        router.run("sh", "-c", f"echo 1 > /proc/sys/net/netfilter/nf_conntrack_{timeout}")
    bridge = network.bridge(robot, pc, _PC, *EACH_WAY)
    bridge.all_talk()

    router.nft("insert rule ip nat out oif eth1 meta l4proto udp masquerade to :41000-41999")
    router.nft("add table ip wall; add chain ip wall in { type filter hook prerouting priority -300; }")
    router.nft("add rule ip wall in meta l4proto udp drop")
    time.sleep(2.5)  # so the mapping expires
    router.nft("delete table ip wall")
    bridge.all_flow(_BACK_WITHIN)
    assert not bridge.client.happened(EventCode.LINK_LOST)

    router.run("ip", "address", "delete", "10.99.2.2/24", "dev", "eth1")
    router.address("eth1", "10.99.2.3/24")
    bridge.server.happens(EventCode.LINK_UP, "10.99.2.3")
    bridge.all_flow(_BACK_WITHIN)
    bridge.robot.hush()
    bridge.settled("/scan", "/odom")


def test_a_robot_goes_from_one_network_to_another(network: Network, robot: Host, pc: Host) -> None:
    """The second one carries smaller packets, as is found out on the way."""
    router = network.router()
    wifi, cellular, wired = Cable(robot, router), Cable(robot, router), Cable(router, pc)
    wifi.address(("10.99.1.2/24", "10.99.1.1/24"))
    cellular.address(("10.99.3.2/24", "10.99.3.1/24"))
    wired.address(("10.99.2.2/24", f"{_PC}/24"))
    pc.route("10.99.2.2")
    robot.run("ip", "route", "add", "default", "via", "10.99.1.1", "metric", "1")
    robot.run("ip", "route", "add", "default", "via", "10.99.3.1", "metric", "2")
    bridge = network.bridge(robot, pc, _PC, *EACH_WAY, {"topic": "/camera", "protocol": "udp"})
    bridge.all_talk()

    wired.mtu(1280)
    left = time.time()
    robot.run("ip", "link", "set", "eth0", "down")
    bridge.client.happens(EventCode.LINK_LOST, "10.99.1.2 to 10.99.3.2")
    assert bridge.server.happens(EventCode.LINK_UP, "10.99.3.2", since=left) - left < _BACK_WITHIN
    bridge.all_flow(_BACK_WITHIN)

    bridge.listen(pc=("/camera",))
    bridge.robot.talk("/camera", rate=5, size=100_000)
    bridge.pc.hears("/camera")

    def whole() -> bool:  # once the router's word about the smaller packets has come
        fragmented = robot.count("IpFragCreates")
        bridge.pc.hears("/camera")
        return robot.count("IpFragCreates") == fragmented

    eventually(whole, what="packets that nobody has to fragment")
    bridge.robot.hush()
    bridge.settled("/scan", "/odom", "/camera")
