"""Tiles of what this console knows: the rates of topics, and the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Level, Wording, escape_text
from rsb_console.feature_console import STATE_SIGN, TileLines
from rsb_console.notation import formats
from rsb_console.widgets.log import LOOK as LEVEL_LOOK
from rsb_console.widgets.log import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import Event, RouteSnapshot
    from rsb_console.feature_console import Console, Line

_EVENTS = 500
"""Lines of the log that a tile keeps, more than a screen has."""


class TileText(Wording):
    NO_TOPICS = "no topic is bridged"
    NO_EVENTS = "no event yet"


class RatesLines(TileLines):
    """State, rate and age of each bridged topic, the faults first."""

    name = "rates"
    about = "of all bridged topics"

    def lines(self, height: int) -> Sequence[Line]:
        routes = sorted(self.routes, key=lambda each: (each.state.rank, each.topic))
        now = self.console.snapshot().time
        return [_rate_line(route, now) for route in routes[:height]] or [((TileText.NO_TOPICS(), "dim"),)]


def _rate_line(route: RouteSnapshot, now: float) -> Line:
    rate = formats.hertz(route.rate) + formats.beside_rate(route)
    return (
        (f"{STATE_SIGN[route.state]} ", route.state),
        (f"{rate:>9}  ", route.state),
        (f"{'-' if route.last_at is None else formats.age_of(route.last_at, now):>5}  ", "dim"),
        (escape_text(route.topic), ""),
    )


class LogLines(TileLines):
    """The newest events of the bridge, the newest last."""

    name = "log"
    about = "of this bridge"

    def __init__(self, console: Console, link: str) -> None:
        super().__init__(console, link)
        self._events: list[Event] = []

    def lines(self, height: int) -> Sequence[Line]:
        if (engine := self.console.engine) is not None:
            last = self._events[-1].number if self._events else 0
            new = engine.events(last)
            self._events = [*self._events, *(each for each in new if each.level is not Level.DEBUG)][-_EVENTS:]
        events = self._events[-height:]
        return [((plain(each), LEVEL_LOOK[each.level]),) for each in events] or [((TileText.NO_EVENTS(), "dim"),)]
