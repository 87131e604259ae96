"""A best-effort topic of which a link carries a part: the rest stays in DDS, and is accounted for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.engine.slow_tunnel_helpers import ages, publishing
from tests.support.bridge import carries, linked, outgoing
from tests.support.domain import BEST_EFFORT
from tests.support.relay import Relay
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.ledger import NOT_TAKEN

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain

_TUNNEL = 20_000
"""Bytes/s: two messages a second."""


def test_what_cannot_cross_is_not_taken(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    out, there = robot.publisher("/camera", qos=BEST_EFFORT), pc.listener("/camera", qos=BEST_EFFORT)
    server = bridge.server()
    with Relay(("127.0.0.1", bridge.port), rate=1e6) as relay:
        client = bridge.client(Topic("/camera", "transmit"), server_port=relay.port)
        eventually(lambda: linked(client) and linked(server), what="linked")
        carries([out], server, ["/camera"])
        sender = outgoing(client, "/camera")
        before = sender.facts.ledger
        outside = before.offered + before.unsubscribed + before.lost_in_dds
        relay.rate = _TUNNEL
        with publishing(out, 30.0, 10_000) as published:
            eventually(lambda: sender.facts.ledger.dropped.get(NOT_TAKEN, 0) > 100)
            crossed = len(there.payloads)
            eventually(lambda: len(there.payloads) > crossed + 5)
            verdict = sender.route.verdict()
            relay.rate = 1e7
            # Once there is room, all are taken as they come.
            eventually(lambda: sender.subscription.demand is None)
            crossed = len(there.payloads)
            eventually(lambda: len(there.payloads) > crossed + 30)
        assert verdict.cause in {Cause.QUEUE_FULL, Cause.LOSSY, Cause.LATE}
        assert max(ages(there, relay)[-20:]) < 1.0

        def accounted() -> bool:
            ledger = sender.facts.ledger
            return ledger.offered + ledger.unsubscribed + ledger.lost_in_dds - outside == published.count

        eventually(lambda: not sender.facts.ledger.open)
        eventually(accounted)
        assert sender.facts.ledger.lost_in_dds == before.lost_in_dds
