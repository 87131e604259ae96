"""Tests' way into a running engine."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.engine import Engine
    from rsb_bridge.engine.bridge import Bridge


def inside(engine: Engine) -> Bridge:
    """Return the parts of a running engine, which belong to its loop."""
    assert engine._bridge is not None
    return engine._bridge
