"""Tiles of text that features add to the pictures."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.installed_features import added

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.widgets.lines import Line


class TileLines:
    """The text of one tile. It is made with the tile, and asked for lines while the tile is in sight.

    Attributes:
        name: in layouts and in the list of things to look at; no topic's name.
        about: a description, behind the name in that list.
        link: the link to the robot that it is for, or an empty string for all of them.
    """

    name: ClassVar[str]
    about: ClassVar[str]

    def __init__(self, console: Console, link: str) -> None:
        self.console = console
        self.link = link

    async def renew(self) -> None:
        """Ask an engine for new figures. Called each second, once the call before has returned."""

    def lines(self, height: int) -> Sequence[Line]:
        """Return at most `height` lines to show now."""
        raise NotImplementedError

    @property
    def routes(self) -> list[RouteSnapshot]:
        """The routes of its robot."""
        return [each for each in self.console.snapshot().routes if self.link in ("", each.link)]


@cache
def added_tiles() -> Mapping[str, type[TileLines]]:
    """Return all that features add, by their names."""
    return {each.name: each for each in added("tiles", name_of=lambda tile: tile.name)}
