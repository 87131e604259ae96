"""The table of refused clients is bounded, and nobody who tries is displaced from it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from rsb_bridge.link.refused_clients import FORGOTTEN_AFTER, MOST, MOST_OF_ONE_HOST, RefusedClients
from rsb_bridge.model.verdict import LinkCause

if TYPE_CHECKING:
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
