"""Bridges behind bridges: in a row, in a ring, and where two offer the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import AT_ONCE, balanced, called, counts, nothing_left, settled
from tests.support.bridge import linked, route
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine


def _both(bridge: Bridge, topic: Topic, server: int, client: int) -> tuple[Engine, Engine]:
    """A further bridge: a server in one domain, a client in another."""
    bridge.move()
    engines = (
        bridge.start(bridge.server_session(domain_id=server)),
        bridge.start(bridge.client_session(topic, domain_id=client)),
    )
    eventually(lambda: all(linked(engine) for engine in engines), what="linked")
    return engines


def test_two_bridges_in_a_row_carry_calls(
    bridge: Bridge, near: CallNode, third: Domain, another: Callable[[int], CallNode], service: str
) -> None:
    """From the robot by the PC to a third domain; the offer goes all the way back when the server goes."""
    last = another(third.id)
    last.serve(service)
    engines = bridge.both(called(service))
    further = _both(bridge, called(service), third.id, bridge.pc.id)
    with balanced(*engines, *further):
        near.waits_for(service)
        outcome = near.call(service, 300, at_once=100, response=10_000)
        assert outcome.right, outcome
        assert outcome.servers == [last.pid]
        for engine in (*engines, *further):
            settled(engine, service, asked=300, answered=300)
        last.unserve(service)
        near.waits_for_none(service, AT_ONCE)
    nothing_left(*engines, *further)


def test_ring_of_bridges_offers_nothing_that_nobody_serves(
    bridge: Bridge, near: CallNode, far: CallNode, service: str
) -> None:
    """One bridge takes the robot's calls to the PC, another the PC's to the robot.

    What the first offers on the robot is not offered to the PC again: its own server is there. When that goes, no offer
    keeps the other alive.
    """
    far.serve(service)
    there = bridge.both(called(service))
    near.waits_for(service)
    back = _both(bridge, Topic(service, "receive", kind="service"), bridge.pc.id, bridge.robot.id)
    eventually(lambda: route(back[0], service).reason, what="the second says why it offers nothing")
    assert near.call(service, 50, at_once=10).right
    assert far.served(service).requests == 50
    assert route(back[0], service).state != State.OK

    far.unserve(service)
    near.waits_for_none(service)
    far.waits_for_none(service)
    far.serve(service)
    near.waits_for(service)
    assert near.call(service, 50, at_once=10).right
    nothing_left(*there, *back)


def test_two_links_with_one_service_answer_once(bridge: Bridge, near: CallNode, far: CallNode, service: str) -> None:
    """A second bridge between the same domains gets the reason that the service exists already."""
    far.serve(service)
    first = bridge.both(called(service))
    near.waits_for(service)
    second = _both(bridge, called(service), bridge.pc.id, bridge.robot.id)
    clients = (first[1], second[1])

    def refused() -> list[Engine]:
        return [each for each in clients if route(each, service).state == State.DOWN]

    eventually(lambda: len(refused()) == 1, what="one of them is refused")  # on a quiet machine the second
    near.waits_for(service)
    assert near.call(service, 50, at_once=10).right
    assert far.served(service) == (50, 0, 0, 0)
    eventually(lambda: sum(counts(each, service).answered for each in clients) == 50)
    assert sum(counts(each, service).asked for each in clients) == 50
