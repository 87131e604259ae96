"""Servers that do not answer, that end while calls are in flight, and that come back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import AT_ONCE, balanced, called, counts, nothing_left, settled
from tests.support.bridge import route
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode


def test_calls_that_are_never_answered_expire_and_leave_nothing(
    bridge: Bridge, near: CallNode, far: CallNode, service: str
) -> None:
    """Both sides count and report them; the next server's calls are answered."""
    far.serve(service, delay=None)
    engines = server, client = bridge.both(called(service, timeout=4.0))
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 20, at_once=20)
        eventually(lambda: far.served(service).waiting == 20, what="all arrived")
        for engine in (client, server):
            settled(engine, service, asked=20, expired=20)
            eventually(lambda engine=engine: route(engine, service).state == State.SLOW, what="told")
        assert near.give_up(service).answered == 0
        nothing_left(*engines)

        far.unserve(service)
        near.waits_for_none(service)  # a call that comes between the two servers reaches neither
        far.serve(service)
        near.waits_for(service)
        assert near.call(service, 5).right
        settled(client, service, asked=25, expired=20, answered=5)


def test_an_offer_comes_and_goes_with_the_server(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    """Each time at once; calls in flight are lost when it ends, and no later call is."""
    far.serve(service, delay=None)
    engines = server, client = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        for _ in range(3):
            asked = counts(client, service).asked
            near.begin(service, 10, at_once=10)
            eventually(lambda: far.served(service).waiting == 10, what="all arrived")
            far.unserve(service)
            near.waits_for_none(service, AT_ONCE)
            lost = settled(client, service, asked=asked + 10, lost=asked + 10).lost
            settled(server, service, asked=lost, lost=lost)
            near.give_up(service)
            far.serve(service, delay=None)
            near.waits_for(service, within=AT_ONCE)
    nothing_left(*engines)


def test_a_server_that_was_killed_mid_call_is_replaced_at_once(
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
