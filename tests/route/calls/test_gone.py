"""A service whose server has gone, and one whose next server is not known well enough yet."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from tests.route.calls.gone_helpers import LAMP, Graph, providing

from rsb_bridge.model.snapshot import Stage
from rsb_bridge.model.verdict import Cause
from rsb_bridge.wire.headers import CallFrame, What
from rsb_bridge.wire.records import VerdictRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context
    from rsb_bridge.route.calls.provider import Provider


def looks(half: Provider) -> Cause | None:
    """Look at the graph again; return why nobody can be called, or None."""
    half.route.advance()
    trouble = half.facts.end.unavailable()
    return trouble.cause if trouble is not None else None


def test_providing_side_shows_how_far_calls_get(make_context: Callable[..., Context]) -> None:
    ros = Graph()
    half = providing(ros, make_context)
    stages = []
    for found in ([], [LAMP, LAMP._replace(type_name="zoo/srv/A", gid=b"other")], [LAMP]):
        ros.found = found
        half.route.advance()
        stages.append([(each.done, each.detail) for each in half.servers.stages()])
    nobody, several, one = stages
    assert nobody == [(False, "no server of /set in domain 0"), (None, ""), (None, "")]
    assert (several[0], several[1][0]) == ((True, "/lamp"), False)
    assert "disagree on the type" in several[1][1]
    assert one[:2] == [(True, "/lamp"), (True, LAMP.type_name)]
    half.route.judged.receive(VerdictRecord("waiting", Cause.SERVED_HERE, "later"), 0.0)
    assert half.servers.stages()[2] == Stage("offered", None, "later")
    half.under_way.clients.retry.failed("rcl", ())
    assert half.servers.stages()[2] == Stage("offered", False, "rcl; trying again")
    half.route.close("over")


def test_unknown_server_has_not_gone(make_context: Callable[..., Context]) -> None:
    """DDS may tell of its node a moment after its endpoints."""
    ros = Graph()
    half = providing(ros, make_context)
    causes = []
    for found in ([], [LAMP], [], [LAMP._replace(node="")], []):
        ros.found = found
        causes.append(looks(half))
    assert causes == [Cause.NO_SERVER, None, Cause.SERVER_GONE, Cause.NO_SERVER, Cause.SERVER_GONE]
    peer: Any = half.route.peer
    peer.connections += 1
    assert looks(half) is Cause.NO_SERVER, "a new link knows of none before it"
    half.route.close("over")


def test_call_may_have_reached_unseen_server(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """DDS matches a server before the graph is looked at again; only later ones can't have got the call."""
    ros = Graph()
    half = providing(ros, make_context)
    in_flight = []
    for gid in (b"first", b"second", b"third"):
        ros.found = [LAMP._replace(gid=gid)]
        looks(half)
        if gid == b"first":
            loop.run_until_complete(asyncio.sleep(1.0))  # its type is loaded
            half.deliver([(CallFrame(What.CALL, 0, 1, 0, bytes(4)).pack(), 0, 0)])
        in_flight.append(half.flow.calls.in_flight)
    assert in_flight == [1, 1, 0]
    half.route.close("over")


def test_unmatched_server_is_looked_at_ever_less(make_context: Callable[..., Context], loop: VirtualLoop) -> None:
    """DDS shows a killed server for up to 40 s."""
    ros = Graph()
    ros.found, ros.client.ready = [LAMP], False
    half = providing(ros, make_context)
    looks(half)
    loop.run_until_complete(asyncio.sleep(40.0))
    assert 40 < ros.looks < 100
    ros.found = [LAMP, LAMP._replace(gid=b"next")]
    looks(half)
    ros.client.ready = True
    loop.run_until_complete(asyncio.sleep(0.1))
    assert half.under_way.entries, "and the next one soon again"
    half.route.close("over")
