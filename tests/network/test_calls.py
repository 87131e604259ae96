"""Calls over a network that is slow, loses packets or is cut."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from tests.calls.ledgers import balanced, counts, settled
from tests.support.waiting import eventually

from rsb_bridge.control.remote_engine import RemoteEngine
from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.network.bridging import Bridge
    from tests.network.conftest import Network
    from tests.network.hosts import Cable, Host

_PC = "10.99.1.1"
_SERVICE = {"service": "/map", "timeout": 10.0}
_LOSS, _DOUBLED, _DELAY, _JITTER = "0.05", "0", "0.2", "0"


def test_cut_delays_calls(network: Network, robot: Host, pc: Host, cable: Cable) -> None:
    """Also one with which the link is lost: it stays offered, and each call is answered once."""
    near, far = network.callers_and_servers(robot, pc)
    far.serve("/map")
    bridge = network.bridge(robot, pc, _PC, services=(_SERVICE,))
    with _attached(bridge) as (client, server), balanced(client, server):
        near.waits_for("/map")
        assert near.call("/map", 10).right

        cable.cut()
        near.begin("/map", 5, at_once=5)
        eventually(lambda: counts(client, "/map").in_flight == 5, what="under way")
        cable.mend()
        outcome = near.settled("/map")
        assert outcome.right, outcome
        assert not bridge.client.happened(EventCode.LINK_LOST)

        cable.cut()
        near.begin("/map", 5, at_once=5)
        cut = bridge.client.happens(EventCode.LINK_LOST)
        assert counts(client, "/map").in_flight == 5
        cable.mend()
        bridge.client.happens(EventCode.LINK_UP, since=cut)
        outcome = near.settled("/map")
        assert outcome.right, outcome
        assert near.call("/map", 10).right
        settled(client, "/map", asked=30, answered=30, lost=0)
        assert far.served("/map").again == 0
        eventually(lambda: not counts(server, "/map").in_flight)


@contextlib.contextmanager
def _attached(bridge: Bridge) -> Iterator[tuple[RemoteEngine, RemoteEngine]]:
    """Both engines, the client's first."""
    with contextlib.ExitStack() as resources:
        engines = RemoteEngine(bridge.client.control), RemoteEngine(bridge.server.control)
        for engine in engines:
            engine.start()
            resources.callback(engine.stop)
        yield engines
