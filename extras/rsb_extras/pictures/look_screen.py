"""Chooses what to look at: a topic of either side, bridged or not, a layout, or a tile without a topic."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from textual import on, work
from textual.widgets import Input

from rsb_bridge.feature_api import EngineError, State, escape_text, other_side
from rsb_console.feature_console import LookOption, Suggestion, added_tiles, look_options
from rsb_extras.pictures.drawing import has_picture, is_layer, is_map
from rsb_extras.pictures.layouts import Subject, layouts_for
from rsb_extras.pictures.own_tiles import RatesLines
from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.search_screen import SearchScreen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.snapshot import TopicInfo
    from rsb_console.feature_console import Console, Line

_KEYS = "type to search   ↑ ↓ choose   ⏎ look   esc close"
_SIDE, _TOPIC = 14, 34
_OVERVIEW = (
    (("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"), Wish(rate=5.0)),
    (("nav_msgs/msg/OccupancyGrid",), Wish()),
    (("nav_msgs/msg/Odometry",), Wish(how="plot")),
)
"""Types of the tiles of an overview, and how to draw them."""
_ASKED_EVERY = 3.0
"""s between two questions to all sides. A round figure: each asks for the whole graph, over the link."""


class LookScreen(SearchScreen[tuple[Subject, ...] | LookOption]):
    """Lists layouts, the topics of all sides, those with a picture first, tiles without a topic, and other options."""

    def __init__(self, console: Console) -> None:
        super().__init__("Look at a topic", _KEYS, Input(id="look-search"))
        self.console = console
        self._found: dict[str, tuple[TopicInfo, ...]] = {}
        self._choices: dict[str, tuple[Subject, ...] | LookOption] = {}
        self._problems: list[str] = []
        self._asking = True
        self._options = look_options()

    def on_mount(self) -> None:
        self.relist()
        self._ask()

    @work
    async def _ask(self) -> None:
        """Ask all sides for their topics, again and again: a side may be linked later."""
        while (engine := self.console.engine) is not None:
            linked = [link.name for link in self.console.snapshot().links if link.state is State.OK]
            found: dict[str, tuple[TopicInfo, ...]] = {}
            problems = []
            for side in ("", *linked):
                try:
                    found[side] = await asyncio.wrap_future(engine.topics(side or None))
                except EngineError as error:
                    problems.append(str(error))
                # The first time, each side is shown as it answers: a slow one must not hold up the others.
                if self._asking:
                    self._found = {**found}
                    self.relist()
            if (found, problems) != (self._found, self._problems) or self._asking:
                self._found, self._problems, self._asking = found, problems, False
                self.relist()
            await asyncio.sleep(_ASKED_EVERY)

    def why_empty(self) -> str:
        problems = "".join(f"; {problem}" for problem in self._problems)
        return "asking both sides …" if self._asking else f"no topic that matches has a publisher{problems}"

    def suggestions(self) -> Iterator[Suggestion]:
        found = [
            (side, info)
            for side, infos in self._found.items()
            for info in infos
            if info.kind == "topic" and info.publishers
        ]
        for layout in layouts_for(self.console):
            shown = ", ".join(", ".join(tile.topics) for tile in layout.tiles)
            yield self._other(f"layout {layout.name}", escape_text(shown), *map(self._known, layout.tiles))
        for side in self._found:
            if tiles := self._overview(side):
                shown = ", ".join(tile.topics[0] for tile in tiles)
                yield self._other(f"overview {side or 'here'}", escape_text(shown), *tiles)
        yield from self._topics(found)
        for tile in added_tiles().values():
            yield self._other(tile.name, tile.about, Subject((tile.name,)))
        for option in self._options:
            name, about = escape_text(option.name), escape_text(option.about)
            yield self._row(f"{name}\n{about}", name, about, option)

    def _overview(self, side: str) -> tuple[Subject, ...]:
        """Return tiles of a side's camera, map and speed, and of the rates; none if it has only one of these."""
        tiles = []
        for types, wish in _OVERVIEW:
            infos = [each for each in self._found[side] if each.type_name in types and each.publishers]
            # The shortest name: /map comes before /global_costmap/costmap, and /camera/image_raw before its like.
            if infos:
                info = min(infos, key=lambda each: (len(each.topic), each.topic))
                layers = self._layers(side, info) if is_map(info.type_name) and not wish.how else ()
                tiles.append(Subject((info.topic,), side, info.type_name, layers, wish))
        return (*tiles, Subject((RatesLines.name,), side)) if len(tiles) > 1 else ()

    def _other(self, name: str, shown: str, *subjects: Subject) -> Suggestion:
        return self._row(name, name, shown, subjects)

    def _row(self, key: str, name: str, shown: str, choice: tuple[Subject, ...] | LookOption) -> Suggestion:
        self._choices[key] = choice
        # A search for a topic finds that, and not what contains it.
        contents = "" if self.text.value else shown
        line: Line = ((f"{name:<{_TOPIC + _SIDE}} ", "strong"), (contents, "dim"))
        return Suggestion(key, name, lambda _width: line)

    def _known(self, subject: Subject) -> Subject:
        """Return a tile of a layout with what is known of its topic: its type, and what can be laid over it."""
        # The side that a topic comes from knows more of what lies on a map than the side that it is bridged to.
        for side, infos in sorted(self._found.items(), reverse=True):
            info = next((each for each in infos if each.topic == subject.topics[0] and each.publishers), None)
            if info is not None and subject.link in ("", side):
                layers = self._layers(side, info) if len(subject.topics) == 1 else ()
                return subject._replace(link=side, type_name=info.type_name, layers=layers)
        return subject

    def _layers(self, side: str, info: TopicInfo) -> tuple[str, ...]:
        """Return the other topics of a side that can be laid over a map."""
        layers = (each.topic for each in self._found[side] if is_layer(each.type_name) and each.publishers)
        return tuple(topic for topic in layers if topic != info.topic)

    def _topics(self, found: list[tuple[str, TopicInfo]]) -> Iterator[Suggestion]:
        role = self.console.snapshot().role
        for side, info in sorted(found, key=lambda each: (not has_picture(each[1].type_name), each[1].topic, each[0])):
            key = f"{side}\n{info.topic}"
            self._choices[key] = (Subject((info.topic,), side, info.type_name, self._layers(side, info)),)
            shown = escape_text(other_side(role, side) if side else "here")[: _SIDE - 1]
            line: Line = (
                (f"{escape_text(info.topic):<{_TOPIC}} ", ""),
                (f"{shown:<{_SIDE}}", "dim"),
                (escape_text(info.type_name), "strong" if has_picture(info.type_name) else "dim"),
            )
            yield Suggestion(key, info.topic, lambda _width, line=line: line)  # type: ignore[misc]

    @on(Input.Submitted)
    def _choose(self) -> None:
        if (current := self.list.current) is not None:
            self.dismiss(self._choices[current.key])

    def on_selectable_list_chosen(self) -> None:
        self._choose()
