"""Tiles of a robot side by side: pictures of topics, rates, the log, nodes. One alone fills the screen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.containers import Container
from textual.geometry import Size, Spacing

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import DIALOG, Field, FormScreen, FullScreen, LookOption, SideBox, Spec, added_tiles
from rsb_console.library_internals.textual_internals import DrawsChangesOnly
from rsb_extras.pictures.drawing import is_layer
from rsb_extras.pictures.layouts import LAYOUTS, Subject, as_written, written
from rsb_extras.pictures.line_tiles import LinesTile
from rsb_extras.pictures.look_screen import LookScreen
from rsb_extras.pictures.picture_tile import PictureTile
from rsb_extras.pictures.tile import ON_ROBOT, Tile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from textual.app import ComposeResult
    from textual.events import DescendantFocus

    from rsb_bridge.feature_api import RouteSnapshot
    from rsb_console.feature_console import Console, MainScreen
    from rsb_extras.pictures.picture import Cells, Pixels, Series

MOST_TILES = 9
"""Tiles on a screen: as many as one can look at. A round figure."""
_LEAST = Size(36, 9)
"""Cells of a tile at least; where fewer are left, only the one with the focus is shown."""
_WIDE = 3.2
"""Width of a tile over its height, in cells, above which two stand side by side: a camera's picture is twice as wide
as high, in characters that are twice as high as wide."""
_ROOM_EVERY = 0.1  # s; a round figure
_KEYS = ("tab next", "z zoom", "V add", "x close", "w keep")


_NAME_LENGTH = 40


class TilesText(Wording):
    FULL = "there are {limit} tiles: x closes one"
    KEPT = "layout {name} kept: V lists it"
    NAME = "give at most {limit} letters, digits, - and _"


class _NameScreen(FormScreen[str]):
    def __init__(self) -> None:
        spec = Spec("name", "Name", "V lists it under this name. One of the same name is replaced.", edited=True)
        super().__init__("Keep these tiles as a layout", [Field(spec)], "Keep")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        name = values["name"]
        is_good = 0 < len(name) <= _NAME_LENGTH and all(each.isalnum() or each in "-_" for each in name)
        return {} if is_good else {"name": TilesText.NAME(limit=_NAME_LENGTH)}

    def result(self, values: Mapping[str, str]) -> str:
        return values["name"]


class ViewScreen(FullScreen[bool], DrawsChangesOnly[bool]):
    """Shows tiles until it is closed. The result is true if messages are to be shown in another way.

    Attributes:
        pane: the tile that keys are for.
    """

    BINDINGS: ClassVar = [
        Binding("escape", "leave", show=False),
        Binding("q,v", "dismiss", show=False),
        Binding("t", "text", show=False),
        *(Binding(each.key, f"on_robot({name!r})", show=False) for name, each in ON_ROBOT.items()),
        Binding("V", "add", show=False),
        Binding("x", "close_tile", show=False),
        Binding("z", "zoom_tile", show=False),
        Binding("tab", "next_tile(1)", show=False),
        Binding("shift+tab", "next_tile(-1)", show=False),
        Binding("w", "keep", show=False),
    ]
    CSS = """
    ViewScreen { align: left top; }
    #tiles { layout: grid; width: 100%; height: 100%; }
    #tiles Tile { border: solid $rule; border-title-color: $quiet; border-subtitle-color: $quiet; }
    #tiles Tile:focus { border: solid $primary; border-title-color: $primary; }
    """

    def __init__(self, console: Console, *subjects: Subject) -> None:
        super().__init__()
        self.console = console
        self._first = [_tile(console, subject) for subject in subjects[:MOST_TILES]]
        self._box = Container(*self._first, id="tiles")
        self._is_zoomed = False
        self._given = Spacing()
        self.pane = self._first[0]

    def compose(self) -> ComposeResult:
        yield self._box

    @property
    def tiles(self) -> list[Tile]:
        return list(self._box.query(Tile))

    @property
    def content(self) -> Cells | Pixels | Series | None:
        """The picture in the tile that keys are for, or None."""
        return self.pane.content if isinstance(self.pane, PictureTile) else None

    def on_mount(self) -> None:
        self.pane.focus()
        self.call_after_refresh(self._lay_out)
        self.set_interval(_ROOM_EVERY, self._follow_box)

    def on_resize(self) -> None:
        self.call_after_refresh(self._lay_out)

    # -- layout -------------------------------------------------------------------------------------------------------

    def _lay_out(self) -> None:
        """Arrange the tiles, and end those that are out of sight."""
        tiles = self.tiles
        if not tiles:  # it is being closed
            return
        self._given = room = self._room()
        self._box.styles.margin = room
        size = Size(self.size.width - room.width, self.size.height - room.height)
        columns = _columns(len(tiles), size)
        rows = -(-len(tiles) // columns)
        fits = size.width // columns >= _LEAST.width and size.height // rows >= _LEAST.height
        shown = tiles if fits and not self._is_zoomed else [self.pane]
        if len(shown) == 1:
            columns = rows = 1
        self._box.styles.grid_size_columns, self._box.styles.grid_size_rows = columns, rows
        for number, tile in enumerate(tiles):
            tile.display = tile in shown
            # The first tile gets what is left of the last row.
            tile.styles.column_span = 1 + (columns * rows - len(shown) if number == 0 and len(shown) > 1 else 0)
        self.call_after_refresh(self._turn_shown, shown)

    def _turn_shown(self, shown: list[Tile]) -> None:
        for tile in self.tiles:
            tile.turn(on=tile in shown)
        self._show_keys()
        if self.pane.terminal.facts.pixels == "sixel":
            self.app.refresh()  # sixels of the former layout go only with text that is drawn over them

    def _follow_box(self) -> None:
        """Lay out anew if the box beside the tiles has come, gone or grown."""
        if self._room() != self._given:
            self._lay_out()

    def _room(self) -> Spacing:
        """Return the room that a box beside the tiles takes."""
        # A question on the box leaves it where it is.
        boxes = (each for each in self.app.screen_stack if isinstance(each, SideBox))
        return next((box.room(self.size) for box in boxes), Spacing())

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        if isinstance(event.widget, Tile):
            self.pane = event.widget
        self._show_keys()

    def _go_to(self, tile: Tile) -> None:
        """Give a tile the keys, and lay out anew: it may have been hidden, or is new."""
        self.pane = tile
        self._lay_out()
        tile.focus()

    def action_next_tile(self, step: int) -> None:
        tiles = self.tiles
        self._go_to(tiles[(tiles.index(self.pane) + step) % len(tiles)])

    def _show_keys(self) -> None:
        tiles = self.tiles
        more = _KEYS if len(tiles) > 1 else _KEYS[2:3]
        if not all(tile.display for tile in tiles):
            more = (f"{tiles.index(self.pane) + 1} of {len(tiles)}", *more)
        for tile in tiles:
            tile.show_keys(more)

    # -- keys ---------------------------------------------------------------------------------------------------------

    def action_leave(self) -> None:
        """Drop the goal, show all tiles again, or close the screen."""
        tile = self.pane
        if isinstance(tile, PictureTile) and tile.drop_goal():
            return
        if self._is_zoomed:
            self.action_zoom_tile()
        else:
            self.dismiss(None)

    def action_text(self) -> None:
        """Show the messages of a picture as text."""
        if len(self.tiles) == 1:
            self.dismiss(True)

    @work(group=DIALOG)
    async def action_on_robot(self, name: str) -> None:
        """Do an action on the robot of the tile, which stays in sight."""
        if self.app.check_action(name, ()):
            await ON_ROBOT[name].run(self.console, self.pane.routes, self.pane.sight)

    def action_zoom_tile(self) -> None:
        """Give one tile the whole screen, or show all again."""
        self._is_zoomed = not self._is_zoomed and len(self.tiles) > 1
        self._lay_out()

    @work(group=DIALOG)
    async def action_add(self) -> None:
        """Add tiles, which the operator chooses."""
        chosen = await self.console.ask(LookScreen(self.console))
        if isinstance(chosen, LookOption):
            await chosen.show(self.console, self.app)
            return
        tiles = [_tile(self.console, subject) for subject in chosen or ()]
        if not tiles:
            return
        if len(self.tiles) + len(tiles) > MOST_TILES:
            self.notify(TilesText.FULL(limit=MOST_TILES), severity="warning", markup=False)
            return
        self._is_zoomed = False
        await self._box.mount(*tiles)
        self._go_to(tiles[0])

    async def action_close_tile(self) -> None:
        """Close the tile that keys are for, or the screen with the last one."""
        tiles, tile = self.tiles, self.pane
        if len(tiles) == 1:
            self.dismiss(None)
            return
        await tile.remove()
        self._is_zoomed = False
        self._go_to(tiles[tiles.index(tile) - 1])

    @work(group=DIALOG)
    async def action_keep(self) -> None:
        """Keep the present tiles as a layout in console.yaml."""
        if (name := await self.console.ask(_NameScreen())) is None:
            return
        known = {each.name: as_written(each) for each in LAYOUTS.of(self.console.preferences).values()}
        if self.console.remember("layouts", known | {name: [written(tile.subject) for tile in self.tiles]}):
            self.notify(TilesText.KEPT(name=name), markup=False)


def _columns(count: int, size: Size) -> int:
    """Return in how many columns tiles have the best shape."""

    def misfit(columns: int) -> float:
        rows = -(-count // columns)
        shape = (size.width / columns) / max(1, size.height / rows)
        return abs(math.log(max(shape, 0.01) / _WIDE)) + 0.2 * (columns * rows - count)

    return min(range(1, count + 1), key=misfit)


def _tile(console: Console, subject: Subject) -> Tile:
    kind = LinesTile if subject.topics[0] in added_tiles() else PictureTile
    return kind(console, subject)


def view(console: Console, route: RouteSnapshot) -> ViewScreen:
    """Return the pictures of a bridged topic; of a map with the other topics that can be laid over it."""
    layers = (each.topic for each in console.snapshot().routes if is_layer(each.type_name))
    others = tuple(topic for topic in layers if topic != route.topic)
    return ViewScreen(console, Subject((route.topic,), "", route.type_name, others))


async def look(screen: MainScreen) -> None:
    """Look at topics of either side, bridged or not, at a layout, or at rates, the log and the like."""
    console = screen.console
    if console.engine is None or not (chosen := await console.ask(LookScreen(console))):
        return
    if isinstance(chosen, LookOption):
        await chosen.show(console, screen.app)
    else:
        screen.app.push_screen(ViewScreen(console, *chosen))
