"""Servers that are killed while calls are in flight, and come back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import balanced, called, counts, nothing_left
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode


def test_server_killed_mid_call_is_replaced_at_once(
    bridge: Bridge, near: CallNode, another: Callable[[int], CallNode], service: str
) -> None:
    """DDS still sees the dead one for 20 s (docs/services.md); the service works with the new one all the same.

    As zenoh-plugin-ros2dds #367: "a killed and restarted node leaves its service dead for good".
    """
    mortal = another(bridge.pc.id)
    mortal.serve(service, delay=None)
    engines = _, client = bridge.both(called(service, timeout=3.0))
    with balanced(*engines):
        near.waits_for(service)
        for _ in range(2):
            arrived = eventually(lambda mortal=mortal: _arrives(near, mortal, service), what="the bridge is matched")
            near.begin(service, 10, at_once=10)
            eventually(
                lambda mortal=mortal, all_=arrived + 10: mortal.served(service).waiting >= all_, what="all arrived"
            )
            mortal.kill()
            near.give_up(service)
            successor = another(bridge.pc.id)
            successor.serve(service)
            eventually(lambda: near.call(service, 1, quiet=0.5).right, what="the new server answers")
            outcome = near.call(service, 20)
            assert outcome.right, outcome
            assert outcome.servers == [successor.pid]
            successor.unserve(service)
            successor.serve(service, delay=None)
            mortal = successor
            eventually(lambda: counts(client, service).in_flight == 0, what="the calls to the dead one are given up")
    nothing_left(*engines)


def _arrives(near: CallNode, far: CallNode, service: str) -> int:
    """Call once; how many calls have arrived. The offer may be older than the server, which DDS is still matching."""
    near.begin(service)
    return far.served(service).waiting
