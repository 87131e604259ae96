"""More answers than a link carries, and a pause while it stalls; `tests/simulation/test_calls.py` has the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import Counts, balanced, called, counts, nothing_left, settled
from tests.support import constants
from tests.support.bridge import route
from tests.support.waiting import eventually, holds

from rsb_bridge.route.peer_budget import CallLimits

if TYPE_CHECKING:
    import pytest
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.calls import CallsSnapshot

_SILENT = 60.0
"""s; a link that stalls is the same link afterwards, however busy the machine."""


def test_calls_beyond_the_bytes_of_responses_are_refused(
    bridge: Bridge, relay: Relay, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Responses wait where the network stalls; the kernel takes some megabytes of them."""
    constants.DEAD_AFTER.set(monkeypatch, _SILENT)
    constants.CALL_LIMITS.set(monkeypatch, CallLimits(bytes_under_way=1_000_000))
    far.serve(service, gather=90)
    engines = server, client = bridge.both(called(service, timeout=30.0))
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 89, at_once=89, response=500_000)
        eventually(lambda: far.served(service).waiting == 89)
        relay.stall()
        far.waits_for(service)
        far.begin(service)
        eventually(lambda: "bytes under way" in counts(server, service).refused)
        relay.stall(False)
        found = eventually(lambda: _over(client, service, 89))
        assert found.refused.keys() == {"bytes under way"}
        assert found.answered
        _gives_up(near, service, found.answered)
        far.give_up(service)
        _is_as_before(near, far, service)
    nothing_left(*engines)


def test_service_waits_for_peers_resume_before_new_offer(
    bridge: Bridge, relay: Relay, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its report from before the pause is outdated: a call would be refused there."""
    constants.DEAD_AFTER.set(monkeypatch, _SILENT)
    far.serve(service)
    engines = server, client = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        key = route(client, service).key
        relay.stall()
        client.pause(key, True).result(60)
        near.waits_for_none(service)
        client.pause(key, False).result(60)
        holds(lambda: not near.ready(service), 1.0)
        relay.stall(False)
        near.waits_for(service)
        assert near.call(service, 5).right
        settled(server, service, **Counts(asked=5, answered=5)._asdict())
        client.pause(key, False).result(60)  # which changes nothing
        holds(lambda: near.ready(service), 0.5)
        assert near.call(service, 5).right
    nothing_left(*engines)


def _over(client: Engine, service: str, asked: int) -> CallsSnapshot | None:
    """Wait until no call is in flight, and return the counts of so many calls."""
    found = counts(client, service)
    return found if found.asked == asked and not found.in_flight else None


def _gives_up(near: CallNode, service: str, answered: int) -> None:
    """Once so many answers have come: DDS delivers them a moment after the bridge has handed them over."""
    eventually(lambda: near.outcome(service).answered == answered)
    assert near.give_up(service).answered == answered


def _is_as_before(near: CallNode, far: CallNode, service: str) -> None:
    """Calls are answered, one by one, at once and with the delays of a server that does answer."""
    near.give_up(service)
    far.unserve(service)
    near.waits_for_none(service)  # a call that comes between the two servers reaches neither
    far.serve(service)
    near.waits_for(service)
    eventually(lambda: near.call(service, quiet=0.5).right)
    outcome = near.call(service, 20, rate=50)
    assert outcome.right, outcome
