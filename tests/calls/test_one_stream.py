"""Calls that share one stream with everything else of their link, as on Bluetooth, and are paused from the start."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.calls.ledgers import called
from tests.support import replaced
from tests.support.bridge import happened, link, route
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.calls import CallNode


@pytest.mark.parametrize(("who", "own"), [(0, False), (1, True)])
def test_calls_paused_from_start_cross_shared_stream_later(
    who: int, own: bool, bridge: Bridge, near: CallNode, far: CallNode, service: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that come before there is a channel for them would be dropped, and the next seal would not hold."""
    replaced.TCP_MULTIPLEXED.set(monkeypatch, True)  # there is no radio here
    far.serve(service)
    engines = bridge.both(called(service, paused=True, port=free_port() if own else None))
    for engine in engines:
        eventually(lambda engine=engine: route(engine, service).state == "paused")
    assert not near.ready(service)
    for _ in range(3):
        engines[who].pause(route(engines[who], service).key, False).result(60)
        near.waits_for(service)
        assert near.call(service, 50, at_once=10).right
        engines[who].pause(route(engines[who], service).key, True).result(60)
        near.waits_for_none(service)
    for engine in engines:
        assert link(engine).state == "ok"
        for code in (EventCode.LINK_LOST, EventCode.ROUTE_CALLS_BROKEN, EventCode.ROUTE_CHANNEL_LOST):
            assert happened(engine, code) is None
