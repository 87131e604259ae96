"""A tile: one view of a robot beside others, such as a camera's picture, the rates of topics, or the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.cells import cell_len
from textual.content import Content

from rsb_bridge.feature_api import Level, Wording, escape_text
from rsb_console.actions.all_actions import BY_ID
from rsb_console.feature_console import ACTIONS, STATE_SIGN, fit
from rsb_console.notation import formats
from rsb_console.widgets.log import LOOK as LEVEL_LOOK
from rsb_console.widgets.log import plain
from rsb_extras.pictures.picture_pane import PicturePane
from rsb_extras.pictures.picture_rows import Part

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.feature_api import Event, RouteSnapshot
    from rsb_console.feature_console import CameraSight, Console
    from rsb_console.terminal.terminal_facts import TerminalFacts
    from rsb_extras.pictures.layouts import Subject
    from rsb_extras.pictures.picture_rows import Row

ON_ROBOT = {action.id: action.on_robot for action in ACTIONS if action.on_robot is not None}
FRAME = 4
"""Cells that the frame takes from a line of keys."""
_EVENTS = 500
"""Lines of the log that a tile keeps, more than a screen has."""
_REDRAWN_EVERY = 0.5  # s; a round figure


class TileText(Wording):
    RATES = "rates"
    LOG = "log"
    NO_TOPICS = "no topic is bridged"
    NO_EVENTS = "no event yet"


class Tile(PicturePane):
    """One view among others, or alone on the screen. It costs nothing while it is hidden.

    Attributes:
        subject: what it shows.
        is_on: whether it is in sight.
    """

    def __init__(self, console: Console, subject: Subject) -> None:
        super().__init__()
        self.console = console
        self.subject = subject
        self.is_on = False

    def keys(self) -> Sequence[str]:
        """Return its keys with their labels, the more important ones first."""
        return self.robot_keys()

    @property
    def where(self) -> str:
        """The link to the side that it shows, or an empty string if that is unknown, or this side."""
        return self.subject.link

    @property
    def routes(self) -> list[RouteSnapshot]:
        """Those to the robot that it shows: nobody watches another one here, whose map is not this one."""
        where = self.where
        return [each for each in self.console.snapshot().routes if where in ("", each.link)]

    def sight(self) -> CameraSight | None:
        """Return how old the camera's picture in sight is, or None if it shows none."""
        return None

    def robot_keys(self) -> list[str]:
        """Return the keys of actions that its robot takes."""
        routes = self.routes
        return [
            f"{action.key} {BY_ID[name].label}"
            for name, action in ON_ROBOT.items()
            if self.app.check_action(name, ()) and any(map(action.suits, routes))
        ]

    def turn(self, *, on: bool) -> None:
        """Begin to show it, or end, as it is hidden."""
        if on != self.is_on:
            self.is_on = on
            (self.begin if on else self.end)()
            if not on:
                self.take_image_away()

    def begin(self) -> None:
        raise NotImplementedError

    def end(self) -> None:
        raise NotImplementedError

    def on_resize(self) -> None:
        if self.is_on:
            self.fit()

    def on_unmount(self) -> None:
        self.turn(on=False)

    def fit(self) -> None:
        """Take its present size."""
        raise NotImplementedError

    def _suit_terminal(self, facts: TerminalFacts) -> None:
        super()._suit_terminal(facts)
        if self.is_on:
            self.fit()

    def show_keys(self, more: Sequence[str]) -> None:
        """Show its keys, and those of the screen, on its frame; none if they are for another tile."""
        first = more[:2] if len(more) > 1 else ()  # how to leave a tile for the next one comes before what it can do
        keys = ["esc", *first, *self.keys(), *more[len(first) :]] if self.has_focus else []
        text = joined(keys, self.size.width - FRAME)
        self.border_subtitle = Content(f" {text} " if text else "")


class _LinesTile(Tile):
    """A tile of this console's own facts, drawn from time to time while it is in sight."""

    title: str

    def begin(self) -> None:
        self.entitle(f" {self.title} ")
        self._timer = self.set_interval(_REDRAWN_EVERY, self.fit)
        self.fit()

    def end(self) -> None:
        self._timer.stop()

    def fit(self) -> None:
        self.show([fit_row(row, self.size.width) for row in self.rows(self.size.height)])

    def rows(self, height: int) -> list[Row]:
        raise NotImplementedError


class RatesTile(_LinesTile):
    """State, rate and age of each bridged topic, the faults first."""

    title = TileText.RATES()

    def rows(self, height: int) -> list[Row]:
        routes = sorted(self.routes, key=lambda each: (each.state.rank, each.topic))
        now = self.console.snapshot().time
        return [_rate_row(route, now) for route in routes[:height]] or [(Part(TileText.NO_TOPICS(), "dim"),)]


def _rate_row(route: RouteSnapshot, now: float) -> Row:
    rate = formats.hertz(route.rate) + formats.beside_rate(route)
    return (
        Part(f"{STATE_SIGN[route.state]} ", route.state),
        Part(f"{rate:>9}  ", route.state),
        Part(f"{'-' if route.last_at is None else formats.age_of(route.last_at, now):>5}  ", "dim"),
        Part(escape_text(route.topic)),
    )


class LogTile(_LinesTile):
    """The newest events of the bridge, the newest last."""

    title = TileText.LOG()

    def __init__(self, console: Console, subject: Subject) -> None:
        super().__init__(console, subject)
        self._events: list[Event] = []

    def rows(self, height: int) -> list[Row]:
        if (engine := self.console.engine) is not None:
            last = self._events[-1].number if self._events else 0
            new = engine.events(last)
            self._events = [*self._events, *(each for each in new if each.level is not Level.DEBUG)][-_EVENTS:]
        events = self._events[-height:]
        return [(Part(plain(each), LEVEL_LOOK[each.level]),) for each in events] or [
            (Part(TileText.NO_EVENTS(), "dim"),)
        ]


def joined(parts: Sequence[str], width: int) -> str:
    """Join as many parts as have room in so many cells, at least the first two."""
    shown = list(parts)
    while cell_len(text := " · ".join(shown)) > width and len(shown) > 2:
        shown.pop()
    return text


def fit_row(row: Iterable[Part], width: int) -> Row:
    """Cut a row to so many cells."""
    return tuple(Part(text, style) for text, style in fit(tuple((part.text, part.style) for part in row), width))
