"""The key that keeps a stretch of the ring on disk, with a note."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError
from rsb_console.feature_console import Field, FormScreen, Spec
from rsb_extras.disk_ring.keep_command import KeptText, line_about
from rsb_extras.disk_ring.keep_stretch import NOTE_LENGTH, KeepStretch

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_console.feature_console import Console, MainScreen

_HELP = "What has happened. It may be empty. The time is that of the key, not of this form's end."


class NoteForm(FormScreen[str]):
    """Asks for the note of a stretch."""

    def __init__(self) -> None:
        super().__init__("Keep what was before, and comes after", [Field(Spec("note", "Note", _HELP))], "Keep")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        length = len(values["note"])
        return {"note": KeptText.TOO_LONG(length=length, most=NOTE_LENGTH)} if length > NOTE_LENGTH else {}

    def result(self, values: Mapping[str, str]) -> str:
        return values["note"].strip()


async def keep_event(screen: MainScreen) -> None:
    await keep_beside(screen.console)


async def keep_beside(console: Console, *_: object) -> None:
    """Keep what all topics had, whichever robot a screen shows."""
    now = asyncio.get_running_loop().time
    pressed = now()
    note = await console.ask(NoteForm())
    if note is None or console.engine is None:
        return
    try:
        kept = await asyncio.wrap_future(console.engine.do(KeepStretch(note, now() - pressed)))
    except EngineError as error:
        console.notify(str(error), title="Not kept", severity="warning", markup=False, timeout=15)
    else:
        text = f"{line_about(kept, here=console.engine.trusted)}\n{KeptText.LATER()}"
        console.notify(text, title="Kept", markup=False, timeout=15)
