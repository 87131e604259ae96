"""The command ``record --keep``, and what a console says of a stretch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import asdict

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import UsageError, attached, done, result
from rsb_extras.disk_ring.keep_stretch import NOTE_LENGTH, KeepStretch

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_extras.disk_ring.keep_stretch import StretchAnswer

_OTHERS = ("seconds", "output", "action", "begin", "end", "no_wait")
"""Arguments of `record` that do something else, also those of `rsb_extras.courier`, where it is installed."""


class KeptText(Wording):
    """What an operator reads of a stretch that is kept."""

    KEPT = "kept, from {before:.0f} s before to {after:.0f} s after: {path}"
    KEPT_THERE = "kept, from {before:.0f} s before to {after:.0f} s after: {path} on {host}"
    LATER = "the folder has this name once it is whole; of several causes at a time there is one"
    ALONE = "--keep goes with no other argument of record: the stretch is a folder on the bridge's machine"
    TOO_LONG = "the note has {length} characters: at most {most}"


def line_about(kept: StretchAnswer, *, here: bool) -> str:
    """Return what was kept; `here` says whether this machine's folder has that path."""
    text = KeptText.KEPT if here else KeptText.KEPT_THERE
    return text(before=kept.before, after=kept.after, path=kept.path, host=kept.host)


def keep(arguments: Namespace) -> int:
    if any(getattr(arguments, each, None) not in (None, False) for each in _OTHERS):
        raise UsageError(KeptText.ALONE())
    if len(arguments.keep) > NOTE_LENGTH:
        raise UsageError(KeptText.TOO_LONG(length=len(arguments.keep), most=NOTE_LENGTH))
    with attached(arguments) as engine:
        kept, here = result(engine.do(KeepStretch(arguments.keep))), engine.trusted
    return done(arguments, line_about(kept, here=here), KeptText.LATER(), **asdict(kept))
