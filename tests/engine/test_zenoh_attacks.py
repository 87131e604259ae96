"""Bridges in a Zenoh network in which somebody without a key publishes and announces anything.

What crosses is counted by the publishers and the listeners, outside of the bridges.
"""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("zenoh")  # an extra

from tests.support.bridge import carries, connections, happened, link, linked, now
from tests.support.domain import text
from tests.support.waiting import eventually
from tests.support.zenoh_attacker import Attacker, Stranger
from tests.support.zenoh_router import Router

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic, ZenohSettings
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause
from rsb_bridge.transport.zenoh.endpoint import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Any

    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

SECONDS = 6.0
LOST = (EventCode.LINK_LOST, EventCode.LINK_CLOSED, EventCode.LINK_CLOSED_BY_PEER, EventCode.ROUTE_CHANNEL_LOST)


@pytest.fixture
def router() -> Iterator[Router]:
    made = Router()
    yield made
    made.close()


def over(router: Router) -> dict[str, Any]:
    return {"server_ip": "zenoh", "server_port": 0, "zenoh": ZenohSettings(connect=(router.endpoint,))}


def losses(engine: Engine) -> list[str]:
    return [event.text for event in engine.events() if event.code in LOST]


@pytest.mark.parametrize(
    "attack", ["ends", "first_ends", "firsts", "following", "ahead", "windows", "deletes", "churn"]
)
def test_a_link_that_is_up_stays_up_and_loses_nothing(
    attack: str, bridge: Bridge, router: Router, robot: Domain, pc: Domain
) -> None:
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    server, client = bridge.both(Topic("/odom", "transmit", qos={"depth": 100}), **over(router))
    carries([out], server, ["/odom"])
    before, attacker, published = connections(server), Attacker(router.endpoint, attack), 0
    with closing(attacker):
        until = time.monotonic() + SECONDS
        while time.monotonic() < until:
            out.publish(text(f"odom {published}"))
            published += 1
            time.sleep(0.02)
        sent = attacker.stop()
    assert sum(sent.values()) > 100
    assert losses(server) == losses(client) == []
    assert connections(server) == before
    eventually(lambda: [each for each in there.payloads if b"odom" in each] == [
        text(f"odom {number}") for number in range(published)
    ])  # fmt: skip


def test_a_link_comes_up_though_each_of_its_streams_is_answered_by_a_stranger(
    bridge: Bridge, router: Router, robot: Domain, pc: Domain
) -> None:
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    with closing(Attacker(router.endpoint, "answers")) as attacker:
        server, client = bridge.server(**over(router)), bridge.client(Topic("/odom", "transmit"), **over(router))
        began = time.monotonic()
        eventually(lambda: linked(server) and linked(client), within=10.0, what="linked")
        assert time.monotonic() - began < 10.0
        carries([out], server, ["/odom"])
        out.publish(text("through"))
        eventually(lambda: text("through") in there.payloads)
        assert attacker.stop()["samples"] > 0
    assert connections(server) == 1


@pytest.mark.parametrize("count", [1, 30, 1000])
def test_announced_servers_that_are_none_cost_seconds_and_no_link(bridge: Bridge, router: Router, count: int) -> None:
    stranger = Stranger(router.endpoint, "fleet")
    tokens = [stranger.declare(f"{ROOT}/fleet/here/server/{number:016x}/fake") for number in range(count)]
    try:
        server = bridge.server(**over(router))
        eventually(lambda: happened(server, EventCode.ENGINE_LISTENING), within=30.0)
        began = time.monotonic()
        client = bridge.client(**over(router))
        eventually(lambda: linked(client), within=30.0, what="linked")
        took = time.monotonic() - began
        assert took < 2.0 + count / 200
        told = [each for each in client.events() if each.code == EventCode.LINK_UNPROVEN_SERVERS]
        assert len(told) == 1
        assert str(count) in told[0].text
        eventually(lambda: link(client).cause == LinkCause.UNPROVEN_SERVERS)
        assert link(client).state is State.OK
        assert str(count) in link(client).warning
        assert len([each for each in server.events() if each.code == EventCode.ENGINE_OTHER_SERVERS]) == 1
        assert now(server).running
    finally:
        del tokens
        stranger.session.close()


def test_tokens_that_come_and_go_all_the_time_keep_no_client_out(bridge: Bridge, router: Router) -> None:
    server = bridge.server(**over(router))
    with closing(Attacker(router.endpoint, "churn", hz=100.0)) as attacker:
        eventually(lambda: happened(server, EventCode.ENGINE_OTHER_SERVERS))
        client = bridge.client(**over(router))
        eventually(lambda: linked(client), within=15.0, what="linked")
        time.sleep(SECONDS)
        assert attacker.stop()["tokens"] > 500
    assert linked(client)
    for engine in (server, client):
        assert len(engine.events()) < 40
