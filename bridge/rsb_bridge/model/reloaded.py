"""What became of a session file that was read again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Reloaded:
    """How the session file differed from what ran, in words.

    Attributes:
        changed: what the bridge does differently from now on; or would do, where it was only asked.
        left: what cannot change while the bridge runs, with the remedy.
        failed: what could not be done, with the reason.
    """

    changed: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
