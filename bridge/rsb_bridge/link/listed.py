"""What a session's lists say of one link, on the side that has the session: topics by their names, and patterns."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.session import Topic


def listed_topics(link: Link) -> tuple[Topic, ...]:
    """What this side proposes, as operators have left it. May be called from any thread."""
    return (*link.proposed.all(), *link.patterns.all())


def list_topic(link: Link, topic: Topic) -> str:
    """Bridge one more topic, or follow one more pattern; its key.

    Raises:
        LinkError: it has a mistake, or is there already.
    """
    return link.patterns.add(topic) if topic.is_pattern else link.proposed.add(topic).key
