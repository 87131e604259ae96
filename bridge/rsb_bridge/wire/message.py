"""What all control messages have in common."""

from __future__ import annotations

import msgspec


class ControlMessageBase(msgspec.Struct, frozen=True, tag_field="message", tag=str.lower):
    """One control message: a msgpack map whose `message` is the type's name in lower case."""
