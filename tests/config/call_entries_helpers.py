"""Helpers of `test_call_entries` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.model.session import Topic


def called(topic: Topic) -> tuple[str, str, str]:
    """Return the name that no two entries may share, because one side's callers would have two servers."""
    name = (topic.remote_topic or topic.topic) if topic.direction == "receive" else topic.topic
    return topic.kind, topic.direction, name
