"""Helpers of `test_time_by_event` and others."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_bridge.route.route import Route


def shown_by(route: Route) -> tuple[RouteSnapshot, float, float] | None:
    """Return the snapshot of a half that shows the same, and its times on the loop's clock; else None."""
    if not route.shows_the_same:
        return None
    shown, to_loop = route.snapshot(), route.context.now() - route.context.wall()
    assert shown.latency_p50 is None, "then its uncertainty, which changes, is not shown"
    times = shown.since + to_loop, (shown.last_at or 0.0) + to_loop * (shown.last_at is not None)
    return replace(shown, latency_uncertainty=None, since=0.0, last_at=None), *times


def differences(before: tuple[RouteSnapshot, float, float], now: tuple[RouteSnapshot, float, float]) -> list[object]:
    """Return the fields that differ; times may differ a little, as clocks do."""
    times = [pair for pair in zip(before[1:], now[1:], strict=True) if abs(pair[0] - pair[1]) > 0.2]
    figures = [(getattr(before[0], each.name), getattr(now[0], each.name)) for each in fields(now[0])]
    return [*times, *(pair for pair in figures if pair[0] != pair[1])]
