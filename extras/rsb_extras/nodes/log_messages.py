"""Lines of /rosout (rcl_interfaces/msg/Log), read from their bytes."""

from __future__ import annotations

import struct
from typing import NamedTuple

from rsb_extras.nodes.node_data import log_text

TYPE = "rcl_interfaces/msg/Log"
WARN = 30
_LEVEL_AT, _NAME_AT = 12, 16  # bytes, after the encapsulation header of 4, the stamp of 8, the level and its padding
_HEADS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_READ = 4096
"""Bytes of a text that are looked at: a line may be as long as it likes."""


class Logged(NamedTuple):
    """A line. Its logger is that of a node, ``namespace.node``, or a child of it."""

    level: int
    logger: str
    text: str


def read_log(payload: bytes) -> Logged | None:
    """Return a line of level WARN or more, or None for others and for what is no line."""
    order = _HEADS.get(payload[:2])
    if order is None or len(payload) < _NAME_AT + 4 or payload[_LEVEL_AT] < WARN:
        return None
    name, end = _string(payload, _NAME_AT, order)
    text, _ = _string(payload, end, order)
    return None if text is None or name is None else Logged(payload[_LEVEL_AT], name, log_text(text))


def _string(payload: bytes, at: int, order: str) -> tuple[str | None, int]:
    """Return a string and where the next field begins, or None for what is cut off."""
    at += -at % 4
    if at + 4 > len(payload):
        return None, at
    (length,) = struct.unpack_from(f"{order}I", payload, at)
    end = at + 4 + length
    if end > len(payload):
        return None, at
    return payload[at + 4 : min(end - 1, at + 4 + _READ)].decode("utf-8", "replace"), end
