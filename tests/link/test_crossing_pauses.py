"""Both sides pause and resume at once, or while the link is down: they end up in the same state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.bridge import happened, linked, route
from tests.support.inside import inside
from tests.support.waiting import eventually, holds

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

    from rsb_bridge.engine import Engine


def press(engine: Engine, *states: bool) -> None:
    (route,) = engine.snapshot().routes  # at once: a stalled link is given up after five seconds
    for paused in states:
        engine.pause(route.key, paused).result(60)


def paused(engine: Engine) -> bool:
    """Ask the route itself: on a link that is down, the snapshot shows only that."""
    return any(each.paused for link in inside(engine).links() for each in link.routes.values())


def both(bridge: Bridge, robot: Domain) -> tuple[Engine, Engine]:
    robot.publisher("/chat")
    server, client = bridge.both(Topic("/chat", "transmit"))
    eventually(lambda: route(server, "/chat").type_name and route(client, "/chat").type_name)
    return server, client


def test_presses_that_cross(bridge: Bridge, relay: Relay, robot: Domain) -> None:
    """All other orders of presses and their messages are tested in tests/route."""
    server, client = both(bridge, robot)
    relay.stall()
    press(client, True)
    press(server, True, False)
    relay.stall(False)
    eventually(lambda: paused(client) is paused(server) is False and linked(client))
    holds(lambda: paused(client) is paused(server) is False and linked(client), 0.5)
    assert client.session.topics[0].paused is False


@pytest.mark.parametrize("operator", ["client", "server"])
def test_a_press_while_the_link_is_down(operator: str, bridge: Bridge, relay: Relay, robot: Domain) -> None:
    server, client = both(bridge, robot)
    relay.stall(new=True)
    eventually(lambda: not linked(client) and not linked(server))
    press(client if operator == "client" else server, True)
    relay.stall(False)
    eventually(lambda: route(client, "/chat").state == route(server, "/chat").state == "paused")
    other, whose = (server, "robot1") if operator == "client" else (client, "server")
    event = eventually(lambda: happened(other, EventCode.OPERATOR_PAUSED), what="it is among the other side's actions")
    assert event.who.startswith(f"{whose} says: ")
    assert event.from_peer


def test_a_client_that_starts_again_begins_as_its_session_says(bridge: Bridge, robot: Domain) -> None:
    server, client = both(bridge, robot)
    press(server, True, False, True)
    eventually(lambda: paused(client))
    client.stop()
    client = bridge.client(Topic("/chat", "transmit"))
    eventually(lambda: linked(client) and not paused(server) and not paused(client))
    holds(lambda: not paused(server) and not paused(client), 0.5)
