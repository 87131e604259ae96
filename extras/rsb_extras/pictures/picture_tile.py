"""A tile with pictures of topics, drawn by the side that publishes them."""

from __future__ import annotations

import asyncio
import textwrap
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import msgspec
from textual import work
from textual.binding import Binding

from rsb_bridge.feature_api import EngineError, State, Wording, escape_text, other_side, replace_file
from rsb_console.feature_console import ACTIONS, DIALOG, CameraSight
from rsb_console.notation import formats
from rsb_extras.pictures.drawing import VIEWS, is_map
from rsb_extras.pictures.field_chooser import FieldChooser
from rsb_extras.pictures.goal_keys import GoalKeys
from rsb_extras.pictures.goal_on_map import POSE
from rsb_extras.pictures.graphics import frame_of
from rsb_extras.pictures.image_style import ImageStyle
from rsb_extras.pictures.picture import (
    TOPICS_AT_ONCE,
    Cells,
    Pixels,
    Series,
    split_field,
)
from rsb_extras.pictures.picture_files import SVG_SHAPE, formats_of, picture_file, squared, svg
from rsb_extras.pictures.picture_rows import AXIS, Part, UnreadableError, has_pillow, picture_rows
from rsb_extras.pictures.picture_source import PictureSource
from rsb_extras.pictures.tile import FRAME, Tile, joined
from rsb_extras.pictures.wish_keys import CHANGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rsb_bridge.feature_api import RouteSnapshot
    from rsb_console.feature_console import Console
    from rsb_extras.pictures.graphics import Extent
    from rsb_extras.pictures.layouts import Subject
    from rsb_extras.pictures.picture import Scale, Viewed, Wish
    from rsb_extras.pictures.picture_rows import Row

_TRIED_AGAIN_AFTER = 1.0  # s; a round figure: how long a refusal outlives its cause
_ZOOM, _PAN, _TILT = 1.5, 0.1, 15.0
_KEYS = ("space hold", "t text", "+- zoom", "p file", "f fields", "h how", "<> rate", "arrows move")
_MAP_KEYS, _POINT_KEYS = ("l layers",), ("[] tilt", "c colour")
_PUBLISH = next((action.with_message for action in ACTIONS if action.with_message is not None), None)
_GOAL_TOPIC = "/goal_pose"


class ViewText(Wording):
    WAITING = "waiting for a picture, {waited}"
    AWAY = "OLD PICTURE: {link} is not linked: {reason}"
    HELD = "HELD: space goes on"
    OLD = "{age} old"
    TO_TERMINAL = "{rate} to this terminal"
    SIDE = "drawn by {side}"
    WRITTEN = "written: {files}"
    NOT_WRITTEN = "the picture cannot be written: {error}"
    NOT_DRAWN = "the picture cannot be drawn: {error}"
    NO_PICTURE = "there is no picture yet"
    NO_MAP = "a goal needs a map with a frame"
    OUTSIDE = "that place is outside of the map: click on the map, or move the goal with the arrows"


class SeenMap(NamedTuple):
    """A map on the screen.

    Attributes:
        scale: its place in the world, by cells of the pane.
        columns: cells of the pane that it fills, the last one in part.
        rows: the same.
    """

    scale: Scale
    columns: float
    rows: float

    def has(self, column: int, row: int) -> bool:
        """Whether the middle of a cell is on it."""
        return column + 0.5 <= self.columns and row + 0.5 <= self.rows


class PictureTile(Tile):
    """Pictures of topics, of a map with others laid over it, and the goal that an operator sets on it."""

    BINDINGS: ClassVar = [
        Binding("g", "goal", show=False),
        Binding("enter", "place", show=False),
        Binding("h", "change('way')", show=False),
        Binding("f", "fields", show=False),
        Binding("plus,equals_sign", f"change('zoom', {_ZOOM})", show=False),
        Binding("minus", f"change('zoom', {1 / _ZOOM})", show=False),
        Binding("left", f"move({-_PAN}, 0)", show=False),
        Binding("right", f"move({_PAN}, 0)", show=False),
        Binding("up", f"move(0, {_PAN})", show=False),
        Binding("down", f"move(0, {-_PAN})", show=False),
        Binding("left_square_bracket", f"change('tilt', {-_TILT})", show=False),
        Binding("right_square_bracket", f"change('tilt', {_TILT})", show=False),
        Binding("c", "change('colour')", show=False),
        Binding("0", "change('reset')", show=False),
        Binding("l", "layers", show=False),
        Binding("less_than_sign", "change('rate', -1)", show=False),
        Binding("greater_than_sign", "change('rate', 1)", show=False),
        Binding("space", "hold", show=False),
        Binding("p", "write", show=False),
    ]

    def __init__(self, console: Console, subject: Subject) -> None:
        super().__init__(console, subject)
        # The map itself is one of them.
        self._layers: list[tuple[str, ...]] = _sets_of_layers(subject) if is_map(subject.type_name) else [()]
        """The topics laid over a map: one set after the other, by a key."""
        self._source = PictureSource(console, subject.link)
        self._look = ImageStyle(self)
        self._goal = GoalKeys()
        self._wish = msgspec.structs.replace(subject.wish, webp=has_pillow())
        self._viewed: Viewed | None = None
        self._image: Pixels | None = None
        """The image in sight."""
        self._blocks: list[Row] = []
        """The same in characters."""
        self._came = time.monotonic()
        self._on_terminal: tuple[Viewed | None, float] | None = None
        """The picture that the terminal has, and when it came to this console."""
        self._problem = ""
        self._unreadable = ""
        """Why the newest image cannot be drawn, or an empty string."""
        self._waiting = ""
        """The publishing side's reason why no picture has come yet."""
        self._seen: SeenMap | None = None
        """The place of the map in sight in the world, by cells of the pane: it may have been made for another size."""
        self._showing = asyncio.Lock()
        self._changes = self._drawn = 0
        """How often what is in sight changed, and how many of these changes are drawn or under way."""
        self._cursor: int | None = None
        """Column of a plot whose values are shown."""

    @property
    def content(self) -> Cells | Pixels | Series | None:
        """The picture in sight, or None."""
        return None if self._viewed is None else self._viewed.picture.content

    def on_mount(self) -> None:
        # The age of a picture grows without a new one.
        self.set_interval(1.0, self._entitle)

    def sight(self) -> CameraSight | None:
        content, type_name = self.content, self.subject.type_name
        may_be_image = not type_name or VIEWS.get(type_name) == VIEWS["sensor_msgs/msg/Image"]
        if not (isinstance(content, Pixels) if content else may_be_image):
            return None
        viewed, came = self._on_terminal or (None, 0.0)
        if viewed is None or viewed.age is None or self._unreadable:
            return CameraSight(None)
        age = self.console.as_seen(viewed.age + time.monotonic() - came)
        return CameraSight(age, (viewed.picture.taken - viewed.picture.changed) / 1e9)

    def begin(self) -> None:
        self.fit()
        self._follow()

    def end(self) -> None:
        self.workers.cancel_node(self)
        self._source.end()

    def keys(self) -> list[str]:
        type_name = self.subject.type_name
        keys = [*(_MAP_KEYS if len(self._layers) > 1 else ()), *(_POINT_KEYS if _is_points(type_name) else ())]
        keys += ["g goal"] if self._is_map and _PUBLISH and not self.console.readonly else []
        return [*keys, *self.robot_keys(), *_KEYS]

    def fit(self) -> None:
        self._take(self._look.fitted(self._wish))
        self.show_again()  # the picture in sight, in the new size

    # Not exclusive: a held key would end each drawing before it is in sight.
    @work(group="image")
    async def show_again(self) -> None:
        """Show the picture in sight once more, as the operator or the terminal has changed something."""
        await self._show_content()

    # -- pictures -----------------------------------------------------------------------------------------------------

    @work
    async def _follow(self) -> None:
        """Take pictures until the tile is hidden or closed."""
        while True:
            await self._source.goes_on.wait()
            try:
                viewed = await self._source.next(self._topics, self._wish)
                self._problem = ""
            except asyncio.CancelledError:
                if (task := asyncio.current_task()) is None or task.cancelling():
                    raise
                continue  # another wish takes the question's place
            except EngineError as error:
                self._problem = str(error)
                self._draw()
                await asyncio.sleep(_TRIED_AGAIN_AFTER)
                continue
            if viewed is None or not self._source.goes_on.is_set():  # it may have been held since it asked
                continue
            picture = viewed.picture
            if picture.content is None and self._viewed is not None:  # keep the last good one in sight
                self._problem = picture.problem or picture.waiting
            elif not picture.waiting:
                self._viewed, self._came = viewed, time.monotonic()
            self._waiting = picture.waiting
            await self._show_content()
            came = self._viewed, self._came
            if await self.is_taken():
                self._on_terminal = came
            async with self._showing:  # what is drawn meanwhile is measured first
                if self._look.spare():
                    self._take(self._look.fitted(self._wish))

    @property
    def _is_map(self) -> bool:
        return self._wish.how == "map" or (not self._wish.how and is_map(self.subject.type_name))

    @property
    def _topics(self) -> tuple[str, ...]:
        of_fields = tuple(dict.fromkeys(filter(None, (split_field(each)[0] for each in self._wish.fields))))
        if of_fields and self._wish.how == "plot":
            return of_fields
        is_usual = not self._wish.how
        return self.subject.topics + (self._layers[0] if is_usual else ())

    async def _show_content(self) -> None:
        """Show the newest picture; an image is drawn on a thread, so that keys do not wait for it."""
        self._changes += 1
        number = self._changes
        # One after the other: of two threads, the one with the former picture or size may be the last.
        async with self._showing:
            if self._drawn >= number:  # one drawing has all that changed during the one before
                return
            self._drawn, self._unreadable = self._changes, ""
            content = self.content
            if content is not None and self._look.is_image(content):
                try:
                    await self._show_image_of(content)
                    while self.is_left_out and self._look.shows_pixels and self._look.spare():
                        self._take(self._look.fitted(self._wish))
                        await self._show_image_of(content)  # of a picture that is held, no coarser one comes
                except UnreadableError as error:
                    self._unreadable, self._blocks = str(error), []
                except Exception as error:  # noqa: BLE001 -- a stranger's picture must not end the console
                    self._unreadable, self._blocks = ViewText.NOT_DRAWN(error=error), []
            self._draw()

    async def _show_image_of(self, content: Cells | Pixels | Series) -> None:
        wish = self._wish
        mark = self._goal.mark(self._scale)
        self._image = await self._look.image(content, wish, cursor=self._cursor, mark=mark)
        blocks = partial(self._look.in_blocks, self._image, wish)
        if self._look.shows_pixels:
            await self.show_image(self._image, wish, blocks, few_colours=self._look.strain > 0)
        else:
            self._blocks = await asyncio.to_thread(blocks)
            if self._look.is_measured:  # what would it take in pixels?
                await self.cut(self._image, wish, few_colours=True)
        self._seen = _seen_map(content, frame_of(self._image, wish))

    def _draw(self) -> None:
        if not self.is_attached:
            return
        content = self.content
        rows: list[Row] = []
        is_image = self._look.is_image(content)
        if is_image:
            rows = self._blocks
        elif isinstance(content, Cells | Series):
            rows = picture_rows(
                content, self._wish.width, self._wish.height, colours=self._look.colours, cursor=self._cursor
            )
            rows = self._goal.marked(rows, self._scale, self._wish.width)
            self._seen = _seen_map(content)
        if not (is_image and self._look.shows_pixels) or self._unreadable:
            self.show(rows or self._reason())
        self._entitle()

    def _reason(self) -> list[Row]:
        """Return the rows of an empty pane: the reason why there is no picture."""
        lines = textwrap.wrap(escape_text(self._reasons() or self._waiting), self._wish.width)
        return [(Part(line),) for line in lines]

    def _reasons(self) -> str:
        """Return why there is no picture, or why it is incomplete or old, or an empty string."""
        problem = "" if self._viewed is None else self._viewed.picture.problem
        # A picture stays in sight while its link is away, and must not look like a new one.
        links = self.console.snapshot().links
        away = next((link for link in links if link.name == self.where and link.state is not State.OK), None)
        lost = "" if away is None else ViewText.AWAY(link=away.name, reason=away.reason)
        return self._problem or self._unreadable or lost or problem

    def _entitle(self) -> None:
        """Show what the picture is of, and how old it is."""
        first, *others = self._topics
        topics = () if self._goal.goal is not None else (f"{first} +{len(others)}" if others else first,)
        parts = [escape_text(part) for part in (*topics, *self._status()) if part]
        self.entitle(f" {joined(parts, self.size.width - FRAME)} ")

    def _status(self) -> Iterable[str]:
        """Return the facts about the picture, the most important first."""
        if self._goal.goal is not None:
            return (self._goal.text(),)
        if not self._source.goes_on.is_set():
            return (ViewText.HELD(),)
        if self._viewed is None:
            waited = time.monotonic() - self._came
            return (self._problem or ViewText.WAITING(waited=formats.age(self.console.as_seen(waited))),)
        where = self._viewed.where
        side = other_side(self.console.snapshot().role, where) if where else "this side"
        picture, parts = self._viewed.picture, [self._reasons()]
        if self._viewed.age is not None:
            age = self._viewed.age + time.monotonic() - self._came
            parts.append(ViewText.OLD(age=formats.age(self.console.as_seen(age))))
        return [
            *parts,
            *picture.notes,
            formats.byte_rate(self._source.cost) if where else "",
            ViewText.TO_TERMINAL(rate=formats.byte_rate(sent))
            if (sent := self.terminal.writer.line.per_second)
            else "",
            ViewText.SIDE(side=side),
            f"at most {self._wish.rate:g} Hz",
            self._look.line() if isinstance(picture.content, Pixels) else "",
            picture.type_name,
        ]

    # -- keys ---------------------------------------------------------------------------------------------------------

    def _take(self, wish: Wish) -> None:
        if wish != self._wish:
            self._wish = wish
            self._source.ask_anew_soon()
        self._entitle()

    def action_change(self, what: str, by: float = 0.0) -> None:
        """Change the wish, as `wish_keys.CHANGES` says."""
        wish = CHANGES[what](self._wish, self.content, by)
        if what == "way":  # another kind of picture has other coordinates
            self._viewed = self._goal.goal = None
        elif what == "reset":
            self._cursor = None
        self._take(wish)

    @work(group=DIALOG)
    async def action_fields(self) -> None:
        """Choose numbers to plot, of this topic or of several."""
        fields = await self.console.ask(FieldChooser(self.console, self.subject, self._wish.fields))
        if fields is not None:
            self._viewed = self._goal.goal = None
            self._take(msgspec.structs.replace(self._wish, how="plot" if fields else "", fields=fields))

    def action_move(self, right: float, up: float) -> None:
        """Move the goal, a plot's cursor, or the view."""
        content = self.content
        columns, rows = round(right / _PAN), round(-up / _PAN)
        if self._goal.goal is not None and (scale := self._scale) is not None:
            self._goal.move(scale, columns, rows)
            self.show_again()
        elif isinstance(content, Series):
            last = max(0, self._wish.width - AXIS - 1)
            at = last if self._cursor is None else self._cursor + columns
            self._cursor = max(0, min(last, at))
            self.show_again()
        else:
            self._take(msgspec.structs.replace(self._wish, x=self._wish.x + right, y=self._wish.y + up))

    def action_layers(self) -> None:
        """Lay other topics over the map, with costmaps or without, or show it alone."""
        self._layers.append(self._layers.pop(0))
        self._source.ask_anew_soon()
        self._entitle()

    def action_hold(self) -> None:
        """Hold the picture, or go on."""
        if self._source.goes_on.is_set():
            self._source.goes_on.clear()
        else:
            self._source.goes_on.set()
        self._entitle()

    # -- goals ------------------------------------------------------------------------------------------------------

    @property
    def _scale(self) -> Scale | None:
        """The place of the map in the world, by characters."""
        content = self.content
        if not isinstance(content, Cells) or (scale := content.scale) is None:
            return None
        return msgspec.structs.replace(scale, column=scale.column * content.fine, row=scale.row * content.fine)

    def drop_goal(self) -> bool:
        """Drop the goal, and return whether there was one."""
        had, self._goal.goal = self._goal.goal is not None, None
        if had:
            self.show_again()
        return had

    def action_goal(self) -> None:
        """Begin to set a goal in the middle of the map."""
        if self.console.readonly or _PUBLISH is None:
            return
        if self._scale is None or (seen := self._seen) is None:
            self.notify(ViewText.NO_MAP(), severity="warning", markup=False)
            return
        self._goal.begin(*seen)
        self.show_again()

    def on_picture_pane_clicked(self, event: Tile.Clicked) -> None:
        """Put the goal where the operator clicks."""
        if self._goal.goal is None or (seen := self._seen) is None or self._unreadable:
            return
        if not seen.has(event.column, event.row):
            self.notify(ViewText.OUTSIDE(), severity="warning", markup=False)
            return
        self._goal.put(seen.scale, event.column, event.row)
        self.show_again()

    def action_place(self) -> None:
        """Go on to the goal's heading, and then to the form that publishes it."""
        if self._goal.goal is None:
            return
        fields = self._goal.go_on()
        self.show_again()
        if fields:
            self._publish(fields)

    @work(group=DIALOG)
    async def _publish(self, fields: str) -> None:
        if _PUBLISH is not None:
            await _PUBLISH(self.console, _goal_topic(self.routes), POSE, fields)

    @property
    def where(self) -> str:
        return self.subject.link or (self._viewed.where if self._viewed is not None else "")

    # -- files --------------------------------------------------------------------------------------------------------

    @work(group=DIALOG)
    async def action_write(self) -> None:
        """Write the picture into the present folder: an image in its own resolution, and as this terminal draws it."""
        content = self.content
        if content is None:
            self.notify(ViewText.NO_PICTURE(), markup=False)
            return
        drawn = drawing = None
        if isinstance(content, Cells) and content.fine > 1 and self._image is not None:
            content = self._image
        elif isinstance(content, Pixels):
            drawn, content = content, await self._source.image_in_full(self._topics, self._wish) or content
        try:
            if drawn is not None:
                of_file = msgspec.structs.replace(self._wish, shape=SVG_SHAPE)
                drawing = await asyncio.to_thread(self._look.in_blocks, drawn, of_file)
            files = await asyncio.to_thread(_write, self.subject.topics[0], content, drawing)
        except (OSError, UnreadableError) as error:
            self.notify(ViewText.NOT_WRITTEN(error=error), severity="error", markup=False)
        else:
            self.notify(ViewText.WRITTEN(files=files), markup=False)


def _sets_of_layers(subject: Subject) -> list[tuple[str, ...]]:
    """Return what may be laid over a map: all but costmaps, which hide the rest; all; nothing."""
    costs = tuple(topic for topic in subject.layers if "costmap" in topic)
    others = tuple(topic for topic in subject.layers if topic not in costs)
    most = TOPICS_AT_ONCE - len(subject.topics)
    return [*dict.fromkeys((others[:most], (*costs[:2], *others)[:most], ()))]


def _seen_map(content: Cells | Pixels | Series, frame: Extent | None = None) -> SeenMap | None:
    """Return a map as it is seen, in its own cells or as an image in this part of the pane; None if it is no map."""
    if not isinstance(content, Cells) or (scale := content.scale) is None:
        return None
    columns, rows = max(map(len, content.rows), default=0), len(content.rows)
    width, height = (columns / content.fine, rows / content.fine) if frame is None else frame[2:]
    if not width or not height:
        return None
    seen = msgspec.structs.replace(scale, column=scale.column * columns / width, row=scale.row * rows / height)
    return SeenMap(seen, width, height)


def _goal_topic(routes: Iterable[RouteSnapshot]) -> str:
    """Return a topic of poses that goes to the side of the map, or the usual name."""
    poses = (each.topic for each in routes if each.outgoing and formats.full_type(each) in (POSE, ""))
    return next((topic for topic in poses if topic.endswith(_GOAL_TOPIC)), _GOAL_TOPIC)


def _is_points(type_name: str) -> bool:
    return VIEWS.get(type_name) == VIEWS["sensor_msgs/msg/PointCloud2"]


def _write(topic: str, content: Cells | Pixels | Series, drawing: Sequence[Row] | None) -> str:
    """Write a picture, and the terminal's drawing of it, into the present folder; return a text that names the files.

    Raises:
        OSError: it cannot be written.
        UnreadableError: the other side's image is damaged.
    """
    suffix, size = formats_of(content)[0], ""
    if isinstance(content, Pixels):
        content = squared(content)
        size = f", {content.width}×{content.height}"
    name = f"{topic.strip('/').replace('/', '_')}-{time.strftime('%Y%m%d-%H%M%S')}"
    file = Path(f"{name}{suffix}").absolute()
    replace_file(file, picture_file(content, suffix))
    if drawing is None:
        return f"{file}{size}"
    replace_file(file.with_suffix(".svg"), svg(drawing))
    return f"{file}{size}, and {name}.svg"
