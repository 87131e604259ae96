"""A topic's latest message, decoded if its type is available."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.content import Content

from rsb_bridge.api import EngineError
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.notation import formats
from rsb_console.notation.glyphs import STATE_SIGN, STATE_WORD
from rsb_console.screens.dialog import FullScreen
from rsb_console.session.reading import KnownTypes, age_text, hex_lines, how_it_came, message_lines, plain, read_message
from rsb_console.terminal.driver import copy
from rsb_console.widgets.lines import ScrolledLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from textual.app import ComposeResult
    from textual.screen import Screen

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.session.reading import ReadMessage
    from rsb_console.widgets.lines import Line

_ITEMS = 64
_STEPS = 20_000
"""Most values to decode: about 100 ms in its own thread."""
_HEX = 1024  # bytes
_MOST_LINES = 2_000
"""Lines of a message that are shown. A round figure: the event loop, for which keys wait, cuts each of them at every
drawing."""
_TRIED_AGAIN_AFTER = 1.0  # s, a round figure: the reason on the screen is at most so old
_KEYS = " esc back · space hold · {other}y copy "


@dataclass(frozen=True)
class MessageView:
    """A way to show a topic's messages other than as text.

    Attributes:
        name: of what it shows, after the key that goes on to it.
        suits: whether it is the usual way for messages of a type.
        screen: makes a screen for a console and a topic. Its result is true if they are to be shown in the next way.
    """

    name: str
    suits: Callable[[str], bool]
    screen: Callable[[Console, RouteSnapshot], Screen[bool]]


class MessageText(Wording):
    """Texts of the message screen."""

    WAITING = "waiting for a message, {waited}"


class MessageScreen(FullScreen[bool]):
    """Shows the newest message of one topic, until the operator leaves or chooses the other way (then True).

    Args:
        other: name of the other way to show messages, or an empty string.
    """

    BINDINGS: ClassVar = [
        Binding("escape,q,enter,v", "dismiss", show=False),
        Binding("space", "hold", show=False),
        Binding("y", "copy", show=False),
        Binding("t", "other", show=False),
    ]

    def __init__(self, console: Console, route: RouteSnapshot, other: str = "") -> None:
        super().__init__()
        self.console, self._route, self._other = console, route, other
        self._types = KnownTypes(time.monotonic)
        self._read: ReadMessage | None = None
        self._goes_on = asyncio.Event()  # cleared: the message that is shown is held
        self._goes_on.set()
        self._content: list[Line] = []
        self._laid_out_for: tuple[ReadMessage, int] | None = None
        self._problem = ""
        self._waits_since = time.monotonic()

    def compose(self) -> ComposeResult:
        self._pane = ScrolledLines(classes="dialog -whole")
        self._pane.border_title = Content(f" {escape_text(self._route.topic)} ")
        self._pane.border_subtitle = Content(_KEYS.format(other=f"t {self._other} · " if self._other else ""))
        yield self._pane

    def on_mount(self) -> None:
        self.set_interval(1.0, self._draw)
        self.call_after_refresh(self._draw)
        self._follow()

    def on_resize(self) -> None:
        self.call_after_refresh(self._lay_out_anew)

    # -- messages -----------------------------------------------------------------------------------------------------

    @work
    async def _follow(self) -> None:
        """Take messages until the screen is closed."""
        first = True
        while True:
            try:
                engine = self.console.engine
                if engine is None:
                    raise EngineError("no session runs")
                # Once only: a message that is kept for late joiners comes at once, and would come again and again.
                peeked = await asyncio.wrap_future(engine.peek(self._route.key, kept=first))
                # Behind the request: a message that comes while the screen is held is not shown.
                await self._goes_on.wait()
                if peeked is not None:
                    known = self._types.get(peeked.type_hash)
                    if known is None:
                        known = self._types.put(peeked.type_hash, *await self._described())
                    self._read = await asyncio.to_thread(read_message, peeked, *known, items=_ITEMS, steps=_STEPS)
                    await self._lay_out()
                    self._waits_since = time.monotonic()
                    first = False
                self._problem = ""
            except EngineError as error:
                self._problem = str(error)
                await asyncio.sleep(_TRIED_AGAIN_AFTER)
            self._draw()

    async def _lay_out(self) -> None:
        """Lay the message out for the present width, off the event loop: a long one takes too long for it."""
        width = self._pane.scrollable_content_region.width
        if self._read is not None and self._laid_out_for != (self._read, width):
            laid_out_for = self._read, width
            self._content = await asyncio.to_thread(content_lines, *laid_out_for)
            self._laid_out_for = laid_out_for

    @work(exclusive=True, group="layout")
    async def _lay_out_anew(self) -> None:
        await self._lay_out()
        self._draw()

    async def _described(self) -> tuple[str | None, str]:
        try:
            assert self.console.engine is not None
            return await asyncio.wrap_future(self.console.engine.describe(self._route.key)), ""
        except EngineError as error:
            return None, str(error)

    # -- the picture --------------------------------------------------------------------------------------------------

    def _draw(self) -> None:
        if self._pane.is_attached:
            self._pane.show(self._lines())

    def _lines(self) -> Iterator[Line]:
        routes = self.console.snapshot().routes
        route = next((each for each in routes if each.key == self._route.key), None)
        yield from self._state_lines(route)
        if self._read is None:
            return
        peeked = self._read.peeked
        yield ((escape_text(peeked.type_name), "strong"), (f"  {how_it_came(peeked)}", ""))
        if route is not None and peeked.outgoing and route.latency_p50 is not None:
            p50 = formats.latency(route.latency_p50, route.latency_uncertainty)
            yield ((f"over the link p50 {p50}", "dim"),)
        if self._read.age is not None:
            yield ((age_text(self._read.age), "dim" if self._read.age.latency is not None else "stale"),)
        yield ()
        yield from self._content

    def _state_lines(self, route: RouteSnapshot | None) -> Iterator[Line]:
        """Yield the reason why no messages come, and the time since the last one."""
        if not self._goes_on.is_set():
            yield (("HELD: space goes on", "paused"),)
            return
        waited = time.monotonic() - self._waits_since
        if self._problem:
            yield ((escape_text(self._problem), "down"),)
        elif waited >= 1:
            state: Line = ()
            if route is not None and route.state is not State.OK:
                reason = f" {route.reason}" if route.reason else ""
                state = ((f"  {STATE_SIGN[route.state]} {STATE_WORD[route.state]}{reason}", route.state.value),)
            yield ((MessageText.WAITING(waited=formats.age(self.console.as_seen(waited))), "waiting"), *state)

    # -- keys ---------------------------------------------------------------------------------------------------------

    def action_other(self) -> None:
        if self._other:
            self.dismiss(True)

    def action_hold(self) -> None:
        """Hold the shown message, or continue."""
        if self._goes_on.is_set():
            self._goes_on.clear()
        else:
            self._goes_on.set()
            self._waits_since = time.monotonic()
        self._draw()

    @work(exclusive=True, group="copy")
    async def action_copy(self) -> None:
        """Copy the decoded part of the message, off the event loop, as `_lay_out`."""
        if self._read is None or self._read.decoded is None:
            return
        message = self._read.decoded.message

        def whole_text() -> str:
            return "\n".join(plain(line) for line in message_lines(message, 1 << 20))  # no line is wrapped

        self.notify(copy(self.app, await asyncio.to_thread(whole_text)), timeout=3, markup=False)


def content_lines(read: ReadMessage, width: int) -> list[Line]:
    """Format the message as YAML or hex, with a note if it is incomplete."""
    if read.decoded is not None:
        lines = list(islice(message_lines(read.decoded.message, width), _MOST_LINES + 1))
    else:
        lines = list(hex_lines(read.peeked.payload, _HEX))
    if len(lines) > _MOST_LINES:
        lines[-1] = ((f"… only the first {formats.thousands(_MOST_LINES)} lines are shown", "stale"),)
    if read.problem:
        lines += [(), ((escape_text(read.problem), "stale"),)]
    return lines
