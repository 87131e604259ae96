"""Helpers of `test_volatile` and others."""

from __future__ import annotations

from rsb_bridge.model.calls import Refused


def unwanted() -> Refused:
    """Look at a message that may not be published any more."""
    return Refused.TOO_OLD
