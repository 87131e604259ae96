"""Machines that lose power and come back."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from tests.network.bridging import EACH_WAY

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_BACK_WITHIN = 60.0
_DDS_WITHIN = 120.0


def test_either_side_loses_power_and_comes_back(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    """The server's machine is up again at once; the client's stays away, and nothing tells the server.

    How soon a client calls again is tested on a clock of the test's own (tests/link). DDS may take long to find who is
    there: the nodes live on while their bridge is killed, as they would not on a machine that lost power.
    """
    bridge = network.bridge(robot, pc, "10.99.1.1", *EACH_WAY)
    bridge.all_talk()

    bridge.server.kill()
    bridge.client.happens(EventCode.LINK_LOST)
    bridge.client.happens(EventCode.LINK_UNREACHABLE)
    bridge.server = bridge.server.again()
    up = bridge.server.happens(EventCode.ENGINE_LISTENING)
    assert bridge.client.happens(EventCode.LINK_UP, since=up) - up < _BACK_WITHIN
    bridge.all_flow(_DDS_WITHIN)

    cable.cut()
    bridge.client.kill()
    off = time.time()
    assert bridge.server.happens(EventCode.LINK_LOST, "the peer is silent", since=off) - off < 30
    cable.mend()
    bridge.client = bridge.client.again()
    up = bridge.client.happens(EventCode.LINK_CONNECTING)
    assert bridge.client.happens(EventCode.LINK_UP) - up < _BACK_WITHIN
    bridge.all_flow(_DDS_WITHIN)
    bridge.robot.hush()
    bridge.settled("/scan", "/odom", since=off)
