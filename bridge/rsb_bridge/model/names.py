"""Names of topics and nodes, on either side of a link."""

from __future__ import annotations

import re
from functools import lru_cache

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_TOPIC = re.compile(rf"(/{_PART})+")
_PREFIX = re.compile(rf"{_PART}(/{_PART})*")

_DIGITS = re.compile(r"([0-9]+)")


def other_side(role: str, link: str) -> str:
    """Return the name of a link's other side: a client's link has the client's own name."""
    return "the server" if role == "client" else link


@lru_cache(maxsize=4096)
def natural_order(name: str) -> tuple[tuple[str, int], ...]:
    """Return a sort key by which ``robot2`` comes before ``robot10``."""
    parts = _DIGITS.split(name)
    return tuple((text, int(digits or 0)) for text, digits in zip(parts[::2], [*parts[1::2], ""], strict=True))


def is_topic_name(name: str) -> bool:
    """Whether a name is absolute and well-formed (rmw/validate_full_topic_name.h); its length is not looked at."""
    return _TOPIC.fullmatch(name) is not None


def is_prefix(name: str) -> bool:
    """Whether topic names are well-formed with ``/<name>`` before them."""
    return _PREFIX.fullmatch(name) is not None


def well_formed(name: str) -> str:
    """Return the closest name that ROS accepts, without a leading slash; may be empty."""
    parts = (re.sub(r"[^A-Za-z0-9_]", "_", part) for part in name.lstrip("~").split("/") if part)
    return "/".join(f"_{part}" if part[0].isdecimal() else part for part in parts)


def server_topic(topic: str, client: str) -> str:
    """Return the name on the server of a client's topic if `use_name` is set: ``/robot1/scan`` for ``/scan``."""
    return f"/{client}{topic}"


def client_topic(topic: str, client: str) -> str | None:
    """Return the inverse of `server_topic`, or None if the topic has no such prefix."""
    prefix = f"/{client}"
    return topic.removeprefix(prefix) if topic.startswith(f"{prefix}/") else None


_BRIDGE = re.compile(r"/_rsb_\w+_[0-9a-f]{8}")


def is_bridge(node: str) -> bool:
    """Whether a node's full name is a bridge's, which announces itself, on a busy machine some time later."""
    return _BRIDGE.fullmatch(node) is not None


OWN_NAMES = "/_rsb_bridge/"  # before the names of what bridges themselves publish or serve
ANNOUNCEMENT_TOPIC = f"{OWN_NAMES}published"
"""What the bridges of a domain tell each other; hidden from ``ros2 topic list``, and never bridged."""
OF_EVERY_NODE = ("/parameter_events", "/rosout", ANNOUNCEMENT_TOPIC)
"""The topics that each node has, and each bridge; lists leave them out."""
