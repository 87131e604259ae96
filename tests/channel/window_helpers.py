"""Helpers of `test_window` and others."""

from __future__ import annotations

from rsb_bridge.model.transport_traits import Ages

QUEUES_MUCH = Ages(0.1, 0.3, 0.15, 1.0)
"""As of a transport that takes all that the window allows, such as Zenoh."""
