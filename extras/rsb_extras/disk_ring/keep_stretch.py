"""What a console asks an engine for: a stretch of the ring on disk."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.feature_api import TEXT_LENGTH, Command, Effect, Seconds, sanitize_text

_PATH = 4096
"""Characters of a path: Linux's PATH_MAX."""
NOTE_LENGTH = 200  # characters


class StretchAnswer(msgspec.Struct, frozen=True):
    """A stretch that is being kept.

    Attributes:
        path: of its folder, on the engine's machine, once it is whole.
        host: name of that machine.
        before: s before the command that are kept, as far as the ring has them.
        after: s after it.
    """

    path: Annotated[str, Meta(max_length=_PATH)]
    host: Annotated[str, Meta(max_length=TEXT_LENGTH)]
    before: Seconds
    after: Seconds


class KeepStretch(Command[StretchAnswer], frozen=True, tag="keep_stretch"):
    """Keep the stretch of the ring around now, with a note.

    Attributes:
        ago: s since the moment that is meant: an operator has written a note meanwhile.
    """

    always = Effect.HARMLESS  # a new folder beside others
    refreshes = False
    note: Annotated[str, Meta(max_length=NOTE_LENGTH)] = ""
    ago: Seconds = 0.0

    def checked(self, result: StretchAnswer) -> StretchAnswer:
        path, host = sanitize_text(result.path, _PATH), sanitize_text(result.host)
        return msgspec.structs.replace(result, path=path, host=host)
