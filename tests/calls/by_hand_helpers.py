"""Helpers of `test_by_hand` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.bridge import route
from tests.support.waiting import eventually

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi


def ready(engine: EngineApi, name: str) -> None:
    """Wait until it can be called on the callers' side."""
    eventually(lambda: all(each.done for each in route(engine, name).stages if each.name == "offered"), what="offered")
