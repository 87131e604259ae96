"""A service that nobody calls and a map that was published once, on a path that is bad for a minute."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause

if TYPE_CHECKING:
    from tests.network.bridging import Bridge, Program
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_BAD_FOR = 60.0
_LOSS = 50
"""% of the packets each way: connections stall for longer than they are kept, and the link itself is lost at times."""
_CALM_FOR = 20.0
_STATUSES = 20
"""Of 10 s, in which a link that was lost in the bad minute would have noticed it."""
_SERVICE = "/load_map"


def test_nothing_is_down_after_bad_minute_without_debts(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    """Both used to be down until somebody called or published, through restarts, and the reason blamed the MTU."""
    near, far = network.callers_and_servers(robot, pc)
    far.serve(_SERVICE)
    bridge = network.bridge(
        robot, pc, "10.99.1.1", {"topic": "/map", "qos": "latched"}, services=({"service": _SERVICE},)
    )
    bridge.listen(pc=("/map",))
    bridge.robot.talk("/map", rate=1.0, count=1, latched=True)
    bridge.pc.hears("/map", after=0.0)
    _settled(bridge)

    bad = time.time()
    cable.lose(_LOSS)
    time.sleep(_BAD_FOR)
    cable.lose_no_more()
    for side in (bridge.client, bridge.server):
        eventually(lambda side=side: _link_is_well(side), what="the link is well")
    _stays(bridge, _settled(bridge) + _CALM_FOR)
    for side in (bridge.client, bridge.server):
        assert not [each for each in side.routes_since(bad) if "MTU" in each["reason"]]

    bridge.client.close()
    bridge.client = bridge.client.again()
    bridge.client.happens(EventCode.LINK_UP)
    _stays(bridge, _settled(bridge) + _CALM_FOR)
    near.waits_for(_SERVICE)
    assert near.call(_SERVICE, 1).right


def _link_is_well(side: Program) -> bool:
    """Whether the link was up and without a fault in the last seconds."""
    statuses = [each["status"] for each in side.log if "status" in each][-_STATUSES:]
    return all(link["state"] == State.OK and not link["cause"] for each in statuses for link in each["links"].values())


def _settled(bridge: Bridge) -> float:
    """Wait until both sides have both routes as they are without a fault, and return the time, s since the epoch."""
    for side in (bridge.client, bridge.server):
        eventually(
            lambda side=side: (
                side.route("/map").get("state") == State.OK and side.route(_SERVICE).get("cause") == Cause.NO_CALL
            ),
            what="both are well",
        )
    return time.time()


def _stays(bridge: Bridge, until: float) -> None:
    """Wait until `until` (s since the epoch), and assert that nothing was wrong in between."""
    since = time.time()
    for side in (bridge.client, bridge.server):
        eventually(lambda side=side: any(each["time"] > until for each in side.log if "status" in each))
        assert {each["state"] for each in side.routes_since(since)} <= {State.OK, State.WAITING}
