"""A tile: one view of a robot beside others, such as a camera's picture or the rates of topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.cells import cell_len
from textual.content import Content

from rsb_console.actions.all_actions import BY_ID
from rsb_console.feature_console import ACTIONS
from rsb_extras.pictures.picture_pane import PicturePane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.feature_api import RouteSnapshot
    from rsb_console.feature_console import CameraSight, Console
    from rsb_console.terminal.terminal_facts import TerminalFacts
    from rsb_extras.pictures.layouts import Subject

ON_ROBOT = {action.id: action.on_robot for action in ACTIONS if action.on_robot is not None}
FRAME = 4
"""Cells that the frame takes from a line of keys."""


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


def joined(parts: Sequence[str], width: int) -> str:
    """Join as many parts as have room in so many cells, at least the first two."""
    shown = list(parts)
    while cell_len(text := " · ".join(shown)) > width and len(shown) > 2:
        shown.pop()
    return text
