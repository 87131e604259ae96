"""More calls than a link carries: refused and counted, never queued, and all is as before when the storm is over."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import AT_ONCE, Counts, balanced, called, counts, nothing_left, settled
from tests.support import constants
from tests.support.bridge import route
from tests.support.waiting import eventually, holds

from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    import pytest
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.calls import CallsSnapshot

_SILENT = 60.0
"""s; a link that stalls is the same link afterwards, however busy the machine."""


def test_calls_beyond_those_under_way_are_refused(
    bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.CALLS_UNDER_WAY.set(monkeypatch, 50)
    far.serve(service, delay=None)
    engines = server, client = bridge.both(called(service, timeout=5.0))
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 200, at_once=200)
        found = settled(client, service, asked=200, expired=50, refused=150)
        assert found.refused == {"calls under way": 150}
        eventually(lambda: far.served(service).requests == 50)
        settled(server, service, asked=50, expired=50)
        for engine in (client, server):
            eventually(lambda engine=engine: route(engine, service).state == State.SLOW, what="told")
        _is_as_before(near, far, service)
    nothing_left(*engines)


def test_calls_beyond_the_bytes_of_requests_are_refused(
    bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    constants.BYTES_UNDER_WAY.set(monkeypatch, 1_000_000)
    far.serve(service, delay=(0.5, 0.5), gather=9)
    engines = _, client = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        near.begin(service, 90, at_once=90, size=100_000)
        found = eventually(lambda: _over(client, service, 90))
        assert found.refused.keys() == {"bytes under way"}
        assert found.answered >= 9
        _gives_up(near, service, found.answered)
        _is_as_before(near, far, service)
    nothing_left(*engines)


def test_calls_beyond_the_bytes_of_responses_are_refused(
    bridge: Bridge, relay: Relay, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Responses wait where the network stalls; the kernel takes some megabytes of them."""
    constants.DEAD_AFTER.set(monkeypatch, _SILENT)
    constants.BYTES_UNDER_WAY.set(monkeypatch, 1_000_000)
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


def test_calls_beyond_those_of_a_second_are_refused(
    bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is that of a link's services together, or a service's max_rate."""
    slow = f"{service}_slow"
    constants.CALLS_A_SECOND.set(monkeypatch, 100.0)
    far.serve(service, slow)
    engines = server, client = bridge.both(called(service), called(slow, max_rate=5.0))
    with balanced(*engines):
        near.waits_for(service, slow)
        for name, rate in ((slow, 5.0), (service, 100.0)):
            many = 8 * int(rate)  # as many as it lets pass in 8 s
            near.begin(name, many, at_once=many)
            eventually(lambda name=name, many=many: counts(client, name).asked == many)
            found = counts(client, name)
            assert found.refused.keys() == {"calls a second"}
            passed = [each.answered + each.in_flight for each in (found, counts(client, slow))]
            assert passed[0] < many
            assert rate <= (passed[0] if name == slow else sum(passed)), "what the slow one took counts for the link"
        for name, many in ((service, 800), (slow, 40)):
            eventually(lambda name=name: not counts(client, name).in_flight)
            answered = counts(client, name).answered
            _gives_up(near, name, answered)
            found = eventually(lambda name=name, answered=answered: _answered(server, name, answered))
            assert found.asked < many, "what is refused does not cross"
        _is_as_before(near, far, service)
    nothing_left(*engines)


def test_a_paused_service_is_not_offered_and_a_resumed_one_is(
    bridge: Bridge, near: CallNode, far: CallNode, service: str
) -> None:
    far.serve(service)
    engines = _, client = bridge.both(called(service))
    with balanced(*engines):
        near.waits_for(service)
        assert near.call(service, 5).right
        key = route(client, service).key
        client.pause(key, True).result(60)
        near.waits_for_none(service, AT_ONCE)
        client.pause(key, False).result(60)
        near.waits_for(service)
        assert near.call(service, 5).right
        settled(client, service, **Counts(asked=10, answered=10)._asdict())
    nothing_left(*engines)


def test_a_service_is_not_offered_again_before_the_other_side_has_resumed_it(
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


def _answered(server: Engine, service: str, answered: int) -> CallsSnapshot | None:
    """Wait until so many calls are answered and none is in flight, and return the counts.

    There may be more: the server's side refuses some, too, where they come to it at once that were made one by one.
    """
    found = counts(server, service)
    return found if found.answered == answered and not found.in_flight else None


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
