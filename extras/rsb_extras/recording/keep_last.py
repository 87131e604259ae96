"""What a console asks an engine for: a file of the last messages."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import TEXT_LENGTH, Command, Count, Effect, Name, Seconds, sanitize_text

TOPICS_NAMED = 10
RECORDINGS = "recordings"
"""The name of their folder, in the bridge's state folder."""
RING = "ring"
"""The name of the folder of rings on disk, in the bridge's state folder."""
FETCHED = "fetched"
"""The name of the folder in it, with those that came from the other side of a link."""
LARGEST = 512 << 20
"""Bytes of a recording that is copied. `record_rules.MEGABYTES` allows half as much of messages."""
_PATH = 4096
"""Characters of a path: Linux's PATH_MAX."""


class KeptRecording(msgspec.Struct, frozen=True):
    """A recording that was written.

    Attributes:
        path: of the file, on the engine's machine.
        host: name of that machine.
        seconds: from the first message to the last.
        size: bytes of the file.
        undescribed: topics whose types the file does not define, as nobody describes them; the first ones.
        too_large: messages without a place in the ring, since it was switched on.
    """

    path: Annotated[str, Meta(max_length=_PATH)]
    host: Annotated[str, Meta(max_length=TEXT_LENGTH)]
    messages: Count
    topics: Count
    seconds: Seconds
    size: Count
    undescribed: Annotated[tuple[Name, ...], Meta(max_length=TOPICS_NAMED)] = ()
    too_large: Count = 0


class KeepLast(Command[KeptRecording], frozen=True, tag="keep_last"):
    """Write the last messages of all bridged topics to a new file on the engine's machine.

    Attributes:
        seconds: how many, or None for all that are kept.
    """

    always = Effect.HARMLESS  # a new file beside others
    refreshes = False
    seconds: Annotated[float, Meta(gt=0)] | None = None

    def checked(self, result: KeptRecording) -> KeptRecording:
        path, host = sanitize_text(result.path, _PATH), sanitize_text(result.host)
        return msgspec.structs.replace(result, path=path, host=host)
