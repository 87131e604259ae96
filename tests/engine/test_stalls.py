"""A link that stalls for less than it takes to be given up."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from tests.support import constants
from tests.support.bridge import balance, carries, linked, settled
from tests.support.domain import text
from tests.support.long import long
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain
    from tests.support.relay import Relay

RATE = 100  # Hz
STALL = 3.0  # s


@pytest.mark.parametrize("size", [2_000, *long(50_000)])
def test_an_auto_topic_loses_nothing(
    size: int, bridge: Bridge, relay: Relay, robot: Domain, pc: Domain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages of a reliable topic wait meanwhile, and arrive when the link goes on."""
    constants.DEAD_AFTER.set(monkeypatch, 30.0)  # on a slow machine the stall is longer
    constants.TCP_GIVEN_UP_AFTER_MS.set(monkeypatch, 30_000)
    out, there = robot.publisher("/count"), pc.listener("/count")
    server, client = bridge.both(Topic("/count", "transmit"))
    carries([out], server, ["/count"])
    sent: list[bytes] = []

    def publish_for(seconds: float) -> None:
        began = time.monotonic()
        for number in range(int(seconds * RATE)):
            sent.append(text(f"{len(sent)}" + " " * size))
            out.publish(sent[-1])
            if time.monotonic() > began + seconds:
                return  # a slow machine publishes fewer, so that the stall is no longer than it should be
            time.sleep(max(0.0, began + (number + 1) / RATE - time.monotonic()))

    publish_for(1.0)
    relay.stall()
    publish_for(STALL)
    relay.stall(False)
    publish_for(1.0)
    count = len(sent)
    ledger = settled(client, "/count", count)
    assert linked(client)
    assert (ledger.delivered, ledger.dropped, ledger.lost_in_dds) == (count, {}, 0)
    assert balance(ledger) == count
    eventually(lambda: len(there.payloads) == count, what="everything heard")
    assert there.payloads == sent
