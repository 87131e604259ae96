"""The lines of a tile that shows no topic's messages, as features add it beside pictures."""

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
    """What one such tile shows. It is made with the tile, and asked while that is in sight.

    Attributes:
        name: as layouts and the list of what can be looked at have it; no topic's name.
        about: what it shows, behind its name in that list.
        link: the link to the robot that it is for, or an empty string for all of them.
    """

    name: ClassVar[str]
    about: ClassVar[str]

    def __init__(self, console: Console, link: str) -> None:
        self.console = console
        self.link = link

    async def renew(self) -> None:
        """Ask an engine for what is to be shown. It is called each second, but not before it has returned."""

    def lines(self, height: int) -> Sequence[Line]:
        """Return the lines that are shown now, as far as there is room for."""
        raise NotImplementedError

    @property
    def routes(self) -> list[RouteSnapshot]:
        """Those of the robot that it is for."""
        return [each for each in self.console.snapshot().routes if self.link in ("", each.link)]


@cache
def added_tiles() -> Mapping[str, type[TileLines]]:
    """Return all that features add, by their names."""
    return {each.name: each for each in added("tiles", name_of=lambda tile: tile.name)}
