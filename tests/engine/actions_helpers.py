"""Helpers of `test_actions` and others."""

from __future__ import annotations

from tests.support.fibonacci import ACTION

from rsb_bridge.model.session import Topic

FIBONACCI = Topic(ACTION, "receive", kind="action")
"""The robot provides it."""
