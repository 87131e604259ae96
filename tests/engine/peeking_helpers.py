"""Helpers of `test_peeking` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.support.bridge import route

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine


def key(engine: Engine, topic: str) -> str:
    return route(engine, topic).key
