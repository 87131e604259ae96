"""The table of refused clients is bounded, and nobody who tries is displaced from it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tests.support.virtual_time import VirtualClock

from rsb_bridge.link.refused_clients import FORGOTTEN_AFTER, MOST, MOST_OF_ONE_HOST, RefusedClients
from rsb_bridge.link.roles import ClientRole, ServerRole
from rsb_bridge.link.server_end import ServerEnd
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.context import Context


def at(host: str) -> Any:
    return SimpleNamespace(host=host, peer=f"{host}:4242")


def test_a_flood_of_names(context: Context) -> None:
    refused = RefusedClients(context)
    refused.record_attempt(at("10.0.0.9"), "robot9", LinkCause.UNKNOWN_NAME, "")
    for number in range(1000):
        refused.record_attempt(at("10.0.0.66"), f"x{number}", LinkCause.UNKNOWN_NAME, "")
        refused.record_attempt(at(f"2001:db8::{number:x}"), f"x{number}", LinkCause.UNKNOWN_NAME, "")
    assert len(refused.shown()) == 1 + 2 * MOST_OF_ONE_HOST
    for number in range(1000):
        refused.record_attempt(at(f"10.1.{number // 250}.{number % 250}"), "x", LinkCause.UNKNOWN_NAME, "")
    assert len(refused.shown()) == MOST
    assert refused.shown()[0].name == "robot9"


def test_it_is_listed_until_it_tries_no_more(loop: VirtualLoop, context: Context) -> None:
    refused = RefusedClients(context)
    for attempt in range(1, 10):
        refused.record_attempt(at("10.0.0.9"), "robot9", LinkCause.UNKNOWN_NAME, "")
        loop.jump(12.0)
        refused.tick()
        assert [each.attempts for each in refused.shown()] == [attempt]
    loop.jump(FORGOTTEN_AFTER)
    refused.tick()
    assert not refused.shown()


def test_refused_client_hides_reason_only_briefly(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    """Anybody who knows its name may have tried."""
    link = ServerRole(make_context(role="server"), {"robot1": ()}).links()[0]
    end = link.end
    assert isinstance(end, ServerEnd)
    link.status.down(LinkCause.SILENT, "the peer is silent")
    missing_since = link.snapshot().since
    loop.jump(3600.0)
    for _ in range(5):
        end.refused(at("10.0.0.9"), LinkCause.WRONG_KEY, "the keys differ")
        loop.jump(12.0)
        link.tick()
        assert (link.snapshot().cause, link.snapshot().since) == (LinkCause.WRONG_KEY, missing_since)
    loop.jump(FORGOTTEN_AFTER)
    link.tick()
    now = link.snapshot()
    assert (now.cause, now.reason, now.since) == (LinkCause.SILENT, "the peer is silent", missing_since)


def test_time_of_link_follows_clock_that_is_set(loop: VirtualLoop, make_context: Callable[..., Context]) -> None:
    context = make_context()
    assert isinstance(context.clock, VirtualClock)
    link = ClientRole(context, {"robot1": ()}).links()[0]
    began = link.snapshot().since
    loop.jump(9.0)
    context.clock.epoch += 1e8  # a robot without a battery learns the time from the network
    assert link.snapshot().since == began + 1e8
