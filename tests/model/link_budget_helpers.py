"""Helpers of `test_link_budget` and others."""

from __future__ import annotations

from dataclasses import replace

from tests.console.scripted import LINK, NOW

from rsb_bridge.model.capacity import Capacity, CapacitySource
from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot


def snapshot(
    *routes: RouteSnapshot, carries: float | None = None, source: CapacitySource = CapacitySource.FULL
) -> Snapshot:
    capacity = None if carries is None else Capacity(carries, source, NOW - 180.0)
    link = replace(LINK, capacity_out=capacity)
    return Snapshot(NOW, "robot1", "client", "10.0.0.20", 3, running=True, links=(link,), routes=routes)
