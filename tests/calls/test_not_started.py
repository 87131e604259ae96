"""A service whose node has not started, runs, has ended: what both sides say, and what `status` makes of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.calls.ledgers import called
from tests.support.bridge import now, route
from tests.support.waiting import eventually

from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import Cause
from rsb_console.command.status import waiting, wrong

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


def says(engine: Engine, service: str) -> tuple[State, str]:
    found = route(engine, service)
    return found.state, found.cause


def test_a_node_that_has_not_started_is_no_fault_and_one_that_has_gone_is_until_a_new_link_knows_of_none_before_it(
    bridge: Bridge, relay: Relay, near: CallNode, far: CallNode, service: str
) -> None:
    engines = bridge.both(called(service))
    for engine in engines:
        eventually(lambda engine=engine: says(engine, service) == (State.WAITING, Cause.NO_SERVER))
        assert wrong(now(engine)) == []
        assert len(waiting(now(engine))) == 1
    far.serve(service)
    near.waits_for(service)
    assert near.call(service).right
    for engine in engines:
        eventually(lambda engine=engine: says(engine, service) == (State.OK, Cause.NONE))
        assert wrong(now(engine)) == waiting(now(engine)) == []
    far.unserve(service)
    for engine in engines:
        eventually(lambda engine=engine: says(engine, service) == (State.DOWN, Cause.SERVER_GONE))
        assert len(wrong(now(engine))) == 1
    relay.cut()
    for engine in engines:
        eventually(lambda engine=engine: says(engine, service) == (State.WAITING, Cause.NO_SERVER))
