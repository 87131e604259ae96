"""The engine: one session's bridge on threads of its own."""

from __future__ import annotations

from rsb_bridge.engine.engine import Engine, freeze_heap

__all__ = ["Engine", "freeze_heap"]
