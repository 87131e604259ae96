"""A restart, step by step as it happens."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button

from rsb_bridge.api import EngineError
from rsb_console.look.glyphs import DONE, FAILED
from rsb_console.widgets.lines import Line, LiveLines

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_bridge.api import EngineApi

RUNNING = "◌"


class Steps(LiveLines, can_focus=False):
    """What is done and what is being done, each with the time it took."""

    def __init__(self) -> None:
        super().__init__(id="steps")
        self._steps: list[tuple[str, float]] = []
        self._end: tuple[str, str] | None = None

    @property
    def line_count(self) -> int:
        """One a step, and how it ended."""
        return len(self._steps) + (self._end is not None)

    def line(self, index: int) -> Line:
        if index == len(self._steps):
            assert self._end is not None
            look, message = self._end
            return ((f"{DONE if look == 'ok' else FAILED} ", look), (message, look))
        message, began = self._steps[index]
        if index == len(self._steps) - 1 and self._end is None:
            return ((f"{RUNNING} ", "waiting"), (message, "strong"))
        ended = self._steps[index + 1][1] if index + 1 < len(self._steps) else self._ended
        failed = index == len(self._steps) - 1 and self._end is not None and self._end[0] == "down"
        sign = (f"{FAILED} ", "down") if failed else (f"{DONE} ", "ok")
        return (sign, (f"{message:<60}", ""), (f"{ended - began:6.2f} s", "dim"))

    def add(self, message: str) -> None:
        self._steps.append((message, time.monotonic()))
        self._lay_out()

    def end(self, look: str, message: str) -> None:
        self._ended = time.monotonic()
        self._end = (look, message)
        self._lay_out()

    def _lay_out(self) -> None:
        self.styles.height = self.line_count
        self.sync()


class RestartScreen(ModalScreen[None]):
    """Restarts as soon as it is shown; may be left at any time, the restart goes on.

    Args:
        engine: what to restart.
    """

    BINDINGS: ClassVar = [Binding("escape,q", "dismiss", show=False)]

    def __init__(self, engine: EngineApi) -> None:
        super().__init__()
        self._engine = engine
        self.steps = Steps()

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -steps") as dialog:
            dialog.border_title = "Restart"
            yield self.steps
            with Horizontal(classes="buttons"):
                yield Button("Close", compact=True)

    def on_button_pressed(self) -> None:
        self.dismiss()

    @work
    async def on_mount(self) -> None:

        def step(message: str) -> None:  # on the engine's thread, which must not wait for us
            self.call_later(self.steps.add, message)

        try:
            await asyncio.wrap_future(self._engine.restart(step))
        except EngineError as error:
            self.steps.end("down", str(error))
        else:
            self.steps.end("ok", "restarted")
