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


def renew_snapshot(engine: Engine) -> None:
    """Have a running engine renew its snapshot soon, as it does after each command."""
    bridge = engine._bridge
    if bridge is None:
        return

    def renew() -> None:
        if not bridge._stopping.is_set():  # the last snapshot shows the end, and stays
            bridge._snapshots.refresh_now(bridge._role)

    bridge.context.call(renew)
