"""Very many calls at once, and very large ones: each answer is right, and comes to the caller that asked."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from tests.calls.ledgers import balanced, called, nothing_left, settled
from tests.support import constants
from tests.support.inside import inside
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode

_LARGE = 5_000_000


def test_thousand_calls_are_answered_in_any_order(
    bridge: Bridge, near: CallNode, far: CallNode, another: Callable[[int], CallNode], service: str
) -> None:
    """No answer is given before all thousand have arrived."""
    far.serve(service, gather=1000, delay=(0.0, 0.2))
    second = another(bridge.robot.id)
    engines = server, client = bridge.both(called(service))
    callers = near, second
    with balanced(*engines):
        for caller in callers:
            caller.waits_for(service)
        for caller in callers:
            caller.begin(service, 500, at_once=500)
        outcomes = [caller.settled(service) for caller in callers]

        assert all(outcome.right for outcome in outcomes), outcomes
        assert far.served(service) == (1000, 0, 0, 0)
        for engine in (client, server):
            settled(engine, service, asked=1000, answered=1000)
    nothing_left(*engines)


def test_burst_to_a_node_that_keeps_ten(
    bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More calls than its depth come at once, as after a gap of the link. It is busy for 20 ms a call.

    A busy machine may let it stand still for longer than the 0.5 s after which it gets the next calls all the same.
    """
    constants.CALLS_SILENT.set(monkeypatch, 60.0)
    far.serve(service, depth=10, busy=0.02)
    engines = server, client = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        assert near.call(service, 60, at_once=60).right
        assert far.served(service) == (60, 0, 0, 0)
        for engine in (client, server):
            settled(engine, service, asked=60, answered=60)
    nothing_left(*engines)


def test_requests_wait_for_a_standing_bridge(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    """They wait in its DDS. Responses are never many: a node has at most eight requests that it may not have read."""
    far.serve(service)
    engines = _, client = bridge.both(called(service))
    stands, goes_on = threading.Event(), threading.Event()

    def stand() -> None:
        stands.set()
        goes_on.wait(30.0)

    with balanced(*engines):
        near.waits_for(service)
        inside(client).context.call(stand)
        assert stands.wait(30.0)
        near.begin(service, 200, at_once=200)
        eventually(lambda: near.outcome(service).asked == 200)
        goes_on.set()
        assert near.settled(service).right
        for engine in engines:
            settled(engine, service, asked=200, answered=200)
    nothing_left(*engines)


def test_five_megabytes_each_way(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    """Also several at once, and small ones of another service between them."""
    small = f"{service}_small"
    far.serve(service, small)
    engines = server, client = bridge.both(called(service), called(small))
    with balanced(*engines):
        near.waits_for(service, small)
        near.begin(small, 40, rate=20)
        assert near.call(service, 6, at_once=3, size=_LARGE, response=_LARGE).right
        assert near.settled(small).right
        assert far.served(service) == (6, 0, 0, 0)
        for engine in (client, server):
            settled(engine, service, asked=6, answered=6)
    nothing_left(*engines)
