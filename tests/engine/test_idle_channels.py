"""Channels that end while they owe nothing: an outage ends them, too, and no route is down for it afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING

from std_srvs.srv import SetBool
from tests.support.bridge import now, route
from tests.support.domain import LATCHED, text
from tests.support.inside import inside
from tests.support.waiting import eventually, holds

from rsb_bridge.model.reason import EndCode, Reason
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

TIMED_OUT = Reason("it has timed out", EndCode.TIMED_OUT)


def lose_channel(engine: Engine) -> None:
    """End the only route's channel, as the kernel does if keepalive packets get no answer; wait for the next one."""
    (link,), context = inside(engine).role.links(), inside(engine).context
    (half,) = link.routes.values()
    eventually(lambda: half.connected)
    opening = half.id
    context.call(lambda: half.channel_lost(TIMED_OUT))
    eventually(lambda: half.connected and half.id != opening)


def never_down(server: Engine, client: Engine) -> bool:
    return all(each.state is not State.DOWN for engine in (server, client) for each in now(engine).routes)


def test_idle_latched_topic_is_not_down_after_outage(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out = robot.publisher("/map", qos=LATCHED)
    listener = pc.listener("/map", qos=LATCHED)
    server, client = bridge.both(Topic("/map", "transmit"))
    out.publish(text("map"))
    eventually(lambda: listener.payloads and route(client, "/map").ledger.open == 0)
    for _ in range(2):
        lose_channel(client)
    holds(lambda: never_down(server, client), 3)


def test_uncalled_service_is_not_down_after_outage(bridge: Bridge, pc: Domain) -> None:
    pc.serve("/lamp", SetBool)
    server, client = bridge.both(Topic("/lamp", "transmit", kind="service"))
    eventually(lambda: route(client, "/lamp").cause == "no_call")
    for side in (client, server):
        lose_channel(side)
    holds(lambda: never_down(server, client), 3)
