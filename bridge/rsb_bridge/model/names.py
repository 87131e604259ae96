"""Names: which topics ROS accepts, what a client's topic is called on the server, and what a session's files are."""

from __future__ import annotations

import re
from functools import lru_cache

_PART = r"[A-Za-z_][A-Za-z0-9_]*"
_TOPIC = re.compile(rf"(/{_PART})+")
_PREFIX = re.compile(rf"{_PART}(/{_PART})*")

_DIGITS = re.compile(r"([0-9]{1,18})")

_STEM_LENGTH = 64


def file_stem(name: str, number: int = 1) -> str:
    """A session's name as a file's name without suffix; the number tells sessions of one name apart."""
    safe = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:_STEM_LENGTH].lstrip(".") or "_"
    return safe if number == 1 else f"{safe}-{number}"


@lru_cache(maxsize=4096)
def natural_order(name: str) -> tuple[tuple[str, int], ...]:
    """A sort key by which ``robot2`` comes before ``robot10``."""
    parts = _DIGITS.split(name)
    return tuple((text, int(digits or 0)) for text, digits in zip(parts[::2], [*parts[1::2], ""], strict=True))


def is_topic_name(name: str) -> bool:
    """Whether a name is absolute and well-formed (rmw/validate_full_topic_name.h); its length is not looked at."""
    return _TOPIC.fullmatch(name) is not None


def is_prefix(name: str) -> bool:
    """Whether topic names are well-formed with ``/<name>`` before them."""
    return _PREFIX.fullmatch(name) is not None


def well_formed(name: str) -> str:
    """The closest name that ROS accepts, without a leading slash; may be empty."""
    parts = (re.sub(r"[^A-Za-z0-9_]", "_", part) for part in name.lstrip("~").split("/") if part)
    return "/".join(f"_{part}" if part[0].isdecimal() else part for part in parts)


def server_topic(topic: str, client: str) -> str:
    """What the server calls a client's topic where `use_name` is set: ``/scan`` is ``/robot1/scan``."""
    return f"/{client}{topic}"


def client_topic(topic: str, client: str) -> str | None:
    """The inverse of `server_topic`; None where the topic has no such prefix."""
    prefix = f"/{client}"
    return topic.removeprefix(prefix) if topic.startswith(f"{prefix}/") else None
