"""Bridges in a Zenoh network in which somebody without a key publishes and announces anything.

What crosses is counted by the publishers and the listeners, outside of the bridges.
"""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.long import long

pytest.importorskip("zenoh")  # an extra

from tests.support.bridge import carries, connections, happened, link, linked, now
from tests.support.domain import text
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause
from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.endpoint import ROOT
from rsb_extras.zenoh.tests.zenoh_attacker import Attacker, Stranger
from rsb_extras.zenoh.tests.zenoh_router import Router
from rsb_extras.zenoh.tests.zenoh_router import stranger as router_session

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

    from rsb_bridge.engine import Engine

SECONDS = 4.0
LOST = (EventCode.LINK_LOST, EventCode.LINK_CLOSED, EventCode.LINK_CLOSED_BY_PEER, EventCode.ROUTE_CHANNEL_LOST)


def over(router: Router) -> dict[str, Any]:
    return {"server_ip": "zenoh", "server_port": 0, "features": {"zenoh": ZenohSettings(connect=(router.endpoint,))}}


def losses(engine: Engine) -> list[str]:
    return [event.text for event in engine.events() if event.code in LOST]


@pytest.mark.parametrize(
    "attack", ["first_ends", "ahead", "churn", *long("ends", "firsts", "following", "windows", "deletes")]
)
def test_running_link_stays_up_and_loses_nothing(
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


def test_link_comes_up_despite_answering_stranger(bridge: Bridge, router: Router, robot: Domain, pc: Domain) -> None:
    there, out = pc.listener("/odom"), robot.publisher("/odom")
    with closing(Attacker(router.endpoint, "answers")) as attacker:
        server, client = bridge.server(**over(router)), bridge.client(Topic("/odom", "transmit"), **over(router))
        eventually(lambda: linked(server) and linked(client), what="linked")
        carries([out], server, ["/odom"])
        out.publish(text("through"))
        eventually(lambda: text("through") in there.payloads)
        assert attacker.stop()["samples"] > 0
    assert connections(server) == 1


@pytest.mark.parametrize("count", [30, *long(1, 1000)])
def test_false_servers_cost_seconds_and_no_link(bridge: Bridge, router: Router, count: int) -> None:
    stranger = Stranger(router.endpoint, "fleet")
    tokens = [stranger.declare(f"{ROOT}/fleet/here/server/{number:016x}/fake") for number in range(count)]
    try:
        server = bridge.server(**over(router))
        eventually(lambda: happened(server, EventCode.ENGINE_LISTENING))
        with router_session(router) as another:
            eventually(lambda: len(list(another.liveliness().get(f"{ROOT}/fleet/here/server/*/*"))) == count + 1)
        client = bridge.client(**over(router))
        eventually(lambda: linked(client), what="linked")  # one after another, a thousand would take 5,000 s
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
        stranger.close()


def test_changing_tokens_keep_no_client_out(bridge: Bridge, router: Router) -> None:
    server = bridge.server(**over(router))
    with (
        closing(Stranger(router.endpoint, "fleet")) as witness,
        closing(Attacker(router.endpoint, "churn", hz=100.0)) as attacker,
    ):
        eventually(lambda: happened(server, EventCode.ENGINE_OTHER_SERVERS))
        client = bridge.client(**over(router))
        eventually(lambda: linked(client), what="linked")  # one after another, it would take far longer
        time.sleep(SECONDS)
        eventually(lambda: len(witness.tokens) > 600)  # a busy machine leaves less time to the attacker, too
        assert attacker.stop()["tokens"] > 500
    assert linked(client)
    for engine in (server, client):
        assert len(engine.events()) < 40


def test_stranger_that_relays_server_is_told_apart(bridge: Bridge, router: Router) -> None:
    """It could hold up or drop what it likes, and the client could not tell it from a second server."""
    relay = Relay(router.endpoint)
    try:
        server = bridge.server(**over(router))
        eventually(lambda: relay.server)
        client = bridge.client(**over(router))
        eventually(lambda: relay.passed_on)
        eventually(lambda: linked(server) and linked(client), what="linked")
        assert link(client).peer == f"zenoh ({router.endpoint})"
        assert relay.ADDRESS not in eventually(lambda: link(server).peer)
        relay.drop()
        received = link(server).rx_bytes_total
        eventually(lambda: link(server).rx_bytes_total > received, what="more of the client")
        assert relay.ADDRESS not in eventually(lambda: link(server).peer)
    finally:
        relay.close()


class Relay:
    """A stranger that announces a server, and passes everything on between clients and the genuine server.

    Attributes:
        server: address of the genuine one.
        passed_on: keys of the samples that it has passed on.
    """

    ADDRESS = "f" * 16

    def __init__(self, endpoint: str) -> None:
        self.server = ""
        self.passed_on: list[str] = []
        self._client = ""
        self._drops = False
        self._stranger = Stranger(endpoint, "fleet")
        session = self._stranger.session
        self._token = self._stranger.declare(f"{ROOT}/fleet/here/server/{self.ADDRESS}/fake")
        self._seen = session.liveliness().declare_subscriber(f"{ROOT}/fleet/here/server/*/*", self._see, history=True)
        self._heard = session.declare_subscriber(f"{ROOT}/fleet/at/{self.ADDRESS}/*/*", self._pass_on)

    def _see(self, sample: Any) -> None:
        address = str(sample.key_expr).split("/")[4]
        if address != self.ADDRESS:
            self.server = address

    def _pass_on(self, sample: Any) -> None:
        sender, stream = str(sample.key_expr).split("/")[4:]
        if self._drops or not self.server:  # whose look at other servers may come before its announcement
            return
        if sender != self.server:
            self._client = sender
        to = self._client if sender == self.server else self.server
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        key = f"{ROOT}/fleet/at/{to}/{self.ADDRESS}/{stream}"
        self._stranger.session.put(key, sample.payload.to_bytes(), attachment=attachment)
        self.passed_on.append(key)

    def drop(self) -> None:
        """Pass nothing on any more."""
        self._drops = True

    def close(self) -> None:
        self._stranger.close()
