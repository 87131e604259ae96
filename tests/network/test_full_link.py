"""A link of 1 Mbit/s that is asked for 8 times as much: what both sides say, and that no remedy makes it worse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.waiting import eventually

from rsb_bridge.model.verdict import Cause, LinkCause

if TYPE_CHECKING:
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_RIGHT = {Cause.LATE, Cause.LOSSY, Cause.QUEUE_FULL}


@pytest.mark.parametrize("queue", ["50ms", "400ms"])
@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_overloaded_link_says_that_it_is_full(
    protocol: str, queue: str, network: Network, robot: Host, pc: Host, cable: Cable
) -> None:
    cable.slow("1mbit", queue=queue)
    bridge = network.bridge(robot, pc, "10.99.1.1", {"topic": "/camera", "protocol": protocol})
    sides = bridge.client, bridge.server
    bridge.listen(pc=("/camera",))
    bridge.robot.talk("/camera", rate=20, size=50_000)
    eventually(lambda: all(side.link().get("cause") == LinkCause.FULL for side in sides), 40)
    eventually(lambda: all(side.route("/camera").get("cause") in _RIGHT for side in sides), 20)
    bridge.robot.hush()
