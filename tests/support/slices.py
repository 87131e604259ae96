"""Doing at once what a link does in slices."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.link.control_channel import Slices


def finish(work: Slices | None) -> None:
    """Do all that is left of a message."""
    for _ in work or ():
        pass
