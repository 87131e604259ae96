"""The ledger against the counts of a publisher and a listener in other processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support.counting import TOPIC, Count, CountedBridge
from tests.support.locks import domains_of
from tests.support.long import long
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic
from rsb_extras.zenoh import ZenohSettings

RATE = 400.0
_OUTAGES = 3
"""The beginning, a cut, and a kill."""


@pytest.fixture(scope="module")
def domains() -> tuple[int, int]:
    """The client's, and the server's."""
    first = domains_of("programs")
    return first, first + 1


def check(count: Count) -> None:
    """Compare the ledger with the counts from outside."""
    ledger = count.ledger
    assert ledger["offered"] == ledger["delivered"] + count.ended + ledger["unknown"], count
    assert (ledger["waiting"], ledger["in_flight"], count.doubled) == (0, 0, 0), count
    assert count.received <= ledger["delivered"] + ledger["unknown"], f"arrived messages are counted as lost: {count}"
    # DDS brings a new publisher's messages only to listeners that have found it: such an outage ends later
    outages = sum(count.gaps[:_OUTAGES])
    known = count.received + count.ended + ledger["lost_in_dds"] + count.never_taken
    assert 0 <= count.published - known <= ledger["unknown"] + max(0, outages - count.never_taken), count
    assert ledger["missed_while_down"] + ledger["unsubscribed"] == count.never_taken, count


def through(counted: CountedBridge, cut: Callable[[], None]) -> tuple[Count, float]:
    """Freeze the receiving bridge, cut the link, kill the receiving bridge; each time messages go on afterwards.

    Return the seconds, too, from a report of the receiving bridge until it was dead.
    """
    counted.flows(RATE)
    eventually(lambda: counted.listener.ask()["heard"] > RATE)
    counted.freeze(1.0)
    more(counted)
    cut()
    more(counted)
    eventually(lambda: (topic := counted.client.topic()) and topic["in_flight"] <= RATE, what="a young report")
    reported_at = time.monotonic()
    seconds = counted.restart() - reported_at
    more(counted)
    return counted.settled(), seconds


def more(counted: CountedBridge) -> None:
    """Wait until messages arrive as they are published: a receiver holds late ones up, for longer on a busy machine."""

    def lag() -> float:
        newest = counted.listener.ask()["newest"]
        return counted.publisher.ask()["published"] - newest if newest > published + RATE / 2 else float("inf")

    published = counted.publisher.ask()["published"]
    eventually(lambda: lag() < RATE / 2)


@pytest.mark.parametrize("protocol", ["udp", *long("tcp")])
def test_a_freeze_a_cut_and_a_kill(protocol: Any, tmp_path: Path, domains: tuple[int, int]) -> None:
    from tests.support.relay import same_port

    topic = Topic(TOPIC, "transmit", protocol=protocol, expected_rate=RATE)
    port = free_port()
    with (
        same_port(port) as relay,
        CountedBridge(tmp_path, domains, topic, address=(relay.target[0], relay.host), port=port) as counted,
    ):
        count, seconds = through(counted, relay.cut)
    check(count)
    assert count.ledger["unknown"] <= (3 + seconds) * RATE, "a receiver reports each second"


def test_freeze_router_that_is_killed_and_kill(tmp_path: Path, domains: tuple[int, int]) -> None:
    pytest.importorskip("zenoh")
    from rsb_extras.zenoh.tests.zenoh_router import Router

    router = Router()

    def cut() -> None:
        router.kill()
        time.sleep(0.1)
        router.start()

    settings = {
        "server_ip": "zenoh",
        "server_port": 0,
        "features": {"zenoh": ZenohSettings(connect=(router.endpoint,))},
    }
    topic = Topic(TOPIC, "transmit", expected_rate=RATE)
    try:
        with CountedBridge(tmp_path, domains, topic, settings=settings) as counted:
            count, _ = through(counted, cut)
    finally:
        router.close()
    check(count)
