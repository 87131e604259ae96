"""Pictures of a topic's messages, drawn by the side that publishes it."""

from __future__ import annotations

import asyncio
import math
import secrets
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import msgspec
from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual import work
from textual.binding import Binding
from textual.content import Content
from textual.geometry import Region
from textual.message import Message as TextualMessage
from textual.strip import Strip
from textual.widget import Widget

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import replace_file
from rsb_bridge.model.names import other_side
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import ACTIONS, BY_ID
from rsb_console.notation import formats
from rsb_console.screens.dialog import FullScreen
from rsb_console.terminal.input_queue import DIALOG
from rsb_console.widgets.lines import LOOK_CLASSES, yield_gil
from rsb_extras.pictures.blocks import COLOURS, QUADRANTS, Part, UnreadableError, reads_webp, wished_pixels
from rsb_extras.pictures.drawing import VIEWS, is_layer, is_map
from rsb_extras.pictures.goal_on_map import POSE, Goal
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.look_screen import LookScreen, Subject
from rsb_extras.pictures.picture import (
    MOST_COLUMNS,
    MOST_RATE,
    MOST_ROWS,
    TOPICS_AT_ONCE,
    Cells,
    Pixels,
    Series,
    Wish,
    in_cells,
    in_full,
)
from rsb_extras.pictures.picture_files import formats_of, picture_file
from rsb_extras.pictures.picture_rows import AXIS, picture_rows, with_mark

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from textual.app import ComposeResult
    from textual.events import Click

    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen
    from rsb_extras.pictures.blocks import Row
    from rsb_extras.pictures.picture import Scale, Viewed

_TRIED_AGAIN_AFTER = 1.0  # s; a round figure: how long a refusal outlives its cause
_IN_FULL_WITHIN = 5.0  # s. A round figure: an operator waits for the file
_RATES = (0.2, 0.5, 1.0, 2.0, 5.0, MOST_RATE)
_ZOOM, _PAN, _TILT = 1.5, 0.1, 15.0
_WAYS = ("", "plot", "tree")
_LOOKS = {
    "dim": "dim", "strong": "strong", "axis": "dim", "ok": "ok", "warning": "stale", "error": "down",
    "robot": "ok", "path": "key", "scan": "plot", "free": "dim", "goal": "stale",
}  # fmt: skip
"""The theme's look of each style of a picture."""
_KEYS = ("space hold", "t text", "+- zoom", "p file", "h how", "<> rate", "←→↑↓")
"""The more important ones first: on a narrow screen, the others are not shown."""
_MAP_KEYS, _POINT_KEYS = ("l layers",), ("[] tilt", "c colour")
_ON_ROBOT = {action.id: action.on_robot for action in ACTIONS if action.on_robot is not None}
_PUBLISH = next((action.with_message for action in ACTIONS if action.with_message is not None), None)
_TURN = 15.0
"""Degrees by which a key turns a goal."""
_GOAL_TOPIC = "/goal_pose"
_FRAME = 4
"""Cells that the frame takes from a line of keys."""


class ViewText(Wording):
    """Texts of the screen."""

    WAITING = "waiting for a picture, {waited}"
    HELD = "HELD: space goes on"
    OLD = "{age} old"
    SIDE = "drawn by {side}"
    SIZE = "{size} a picture"
    WRITTEN = "written: {file}"
    NOT_WRITTEN = "the picture cannot be written: {error}"
    NO_PICTURE = "there is no picture yet"
    NO_MAP = "a goal needs a map with a frame"
    GOAL_PLACE = "GOAL at {x:.2f}, {y:.2f} m in {frame}: arrows move it, ⏎ turns it, esc leaves"
    GOAL_HEADING = "GOAL at {x:.2f}, {y:.2f} m, heading {degrees:.0f}°: ←→ turn it, ⏎ publishes, esc leaves"


def _joined(parts: Sequence[str], width: int) -> str:
    """Join as many parts as have room in so many cells, at least the first two."""
    shown = list(parts)
    while cell_len(text := " · ".join(shown)) > width and len(shown) > 2:
        shown.pop()
    return text


def _is_points(type_name: str) -> bool:
    return VIEWS.get(type_name) == VIEWS["sensor_msgs/msg/PointCloud2"]


def _write(topic: str, content: Cells | Pixels | Series) -> str:
    """Write a picture to a file in the present folder; return a text that names it.

    Raises:
        OSError: it cannot be written; UnreadableError: the other side's image is damaged.
    """
    suffix = formats_of(content)[0]
    name = topic.strip("/").replace("/", "_")
    file = Path(f"{name}-{time.strftime('%Y%m%d-%H%M%S')}{suffix}").absolute()
    replace_file(file, picture_file(content, suffix))
    size = f", {content.width}×{content.height}" if isinstance(content, Pixels) else ""
    return ViewText.WRITTEN(file=file) + size


class PicturePane(Widget, can_focus=True):
    """Shows the rows of a picture."""

    def __init__(self) -> None:
        super().__init__(classes="dialog -whole")
        self._rows: list[Row] = []
        self._strips: dict[int, Strip] = {}
        self._title = ""
        self._styles: dict[tuple[str, str], Style] = {}

    def show(self, rows: list[Row]) -> None:
        yield_gil()
        self._rows = rows
        self._strips.clear()
        self.refresh()

    class Clicked(TextualMessage):
        """A cell was clicked."""

        def __init__(self, column: int, row: int) -> None:
            super().__init__()
            self.column, self.row = column, row

    def on_click(self, event: Click) -> None:
        """Tell the screen."""
        offset = event.get_content_offset(self)
        if offset is not None:
            self.post_message(self.Clicked(offset.x, offset.y))

    def entitle(self, title: str) -> None:
        """Show a title, which is plain text, and draw only its line."""
        if title == self._title:
            return
        self._title = title
        if self.is_mounted:
            self._border_title = Content(title)  # Textual's public attribute would have all rows drawn
            self.refresh(Region(0, -1, self.size.width, 1))
        else:
            self.border_title = Content(title)

    def notify_style_update(self) -> None:
        self._styles.clear()
        self._strips.clear()
        super().notify_style_update()

    def render_line(self, y: int) -> Strip:
        """Draw screen row `y` (Textual's line API)."""
        strip = self._strips.get(y)
        if strip is None or strip.cell_length != self.size.width:
            row = self._rows[y] if y < len(self._rows) else ()
            strip = Strip([Segment(part.text, self._style(part.style, part.background)) for part in row])
            strip = self._strips[y] = strip.adjust_cell_length(self.size.width, self.visual_style.rich_style)
        return strip

    def _style(self, name: str, background: str) -> Style:
        style = self._styles.get((name, background))
        if style is None:
            if len(self._styles) > 20_000:  # each pixel of an image may have colours of its own
                self._styles.clear()
            style = self.visual_style.rich_style
            if name.startswith("#"):
                style += Style(color=name, bgcolor=background or None)
            elif (look := _LOOKS.get(name)) is not None:
                style += self.app.get_component_styles(LOOK_CLASSES[look]).partial_rich_style
            self._styles[name, background] = style
        return style


class ViewScreen(FullScreen[bool]):
    """Shows pictures of topics until it is closed. The result is true if messages are to be shown in another way."""

    BINDINGS: ClassVar = [
        Binding("escape", "leave", show=False),
        Binding("q,v", "dismiss", show=False),
        Binding("t", "dismiss(True)", show=False),
        Binding("g", "goal", show=False),
        Binding("enter", "place", show=False),
        *(Binding(each.key, f"on_robot({name!r})", show=False) for name, each in _ON_ROBOT.items()),
        Binding("h", "way", show=False),
        Binding("plus,equals_sign", f"zoom({_ZOOM})", show=False),
        Binding("minus", f"zoom({1 / _ZOOM})", show=False),
        Binding("left", f"move({-_PAN}, 0)", show=False),
        Binding("right", f"move({_PAN}, 0)", show=False),
        Binding("up", f"move(0, {_PAN})", show=False),
        Binding("down", f"move(0, {-_PAN})", show=False),
        Binding("left_square_bracket", f"tilt({-_TILT})", show=False),
        Binding("right_square_bracket", f"tilt({_TILT})", show=False),
        Binding("c", "colour", show=False),
        Binding("0", "reset", show=False),
        Binding("l", "layers", show=False),
        Binding("less_than_sign", "rate(-1)", show=False),
        Binding("greater_than_sign", "rate(1)", show=False),
        Binding("space", "hold", show=False),
        Binding("p", "write", show=False),
    ]

    def __init__(self, console: Console, subject: Subject) -> None:
        super().__init__()
        self.console = console
        self._subject = subject
        # The map itself is one of them.
        self._layers = subject.layers[: TOPICS_AT_ONCE - 1] if is_map(subject.type_name) else ()
        self._shows_layers = bool(self._layers)
        self._viewer = secrets.token_hex(8)
        self._wish = Wish(webp=reads_webp())
        self._viewed: Viewed | None = None
        self._came = time.monotonic()
        self._goes_on = asyncio.Event()
        self._goes_on.set()
        self._problem = ""
        self._waiting = ""
        """The publishing side's reason why no picture has come yet."""
        self._cursor: int | None = None
        """Column of a plot whose values are shown."""
        self._goal: Goal | None = None
        self._turns_goal = False

    def compose(self) -> ComposeResult:
        self.pane = PicturePane()
        self._entitle()
        yield self.pane

    @property
    def content(self) -> Cells | Pixels | Series | None:
        """The picture in sight, or None."""
        return None if self._viewed is None else self._viewed.picture.content

    def on_mount(self) -> None:
        # The age of a picture grows without a new one.
        self.set_interval(1.0, self._entitle)
        # The first wish has the size of the pane, which has none before its layout.
        self.call_after_refresh(self._begin)

    def on_unmount(self) -> None:
        """End the view, so that the next one finds room: there are few."""
        if (engine := self.console.engine) is not None:
            engine.do(EndLook(self._viewer))

    def on_resize(self) -> None:
        self.call_after_refresh(self._fit)

    def _begin(self) -> None:
        self._fit()
        self._follow()

    def _keys(self, width: int) -> str:
        """Return the keys that have room in so many cells."""
        type_name = self._subject.type_name
        keys = ["esc", *(_MAP_KEYS if self._layers else ()), *(_POINT_KEYS if _is_points(type_name) else ())]
        keys += ["g goal"] if is_map(type_name) and _PUBLISH and not self.console.readonly else []
        routes = self._routes
        for name, action in _ON_ROBOT.items():
            if self.app.check_action(name, ()) and any(map(action.suits, routes)):
                keys.append(f"{action.key} {BY_ID[name].label}")
        return _joined([*keys, *_KEYS], width)

    def _fit(self) -> None:
        size = self.pane.scrollable_content_region.size
        # The other side refuses a wish beyond these bounds.
        width, height = max(1, min(MOST_COLUMNS, size.width)), max(1, min(MOST_ROWS, size.height))
        wish = msgspec.structs.replace(self._wish, width=width, height=height)
        self._wish = in_cells(wish, *wished_pixels(self._colours, QUADRANTS), 2.0)
        self.pane.border_subtitle = Content(f" {self._keys(size.width - _FRAME)} ")
        self._draw()

    # -- pictures -----------------------------------------------------------------------------------------------------

    @work
    async def _follow(self) -> None:
        """Take pictures until the screen is closed."""
        while True:
            await self._goes_on.wait()
            try:
                viewed = await self._next()
                self._problem = ""
            except EngineError as error:
                self._problem = str(error)
                self._draw()
                await asyncio.sleep(_TRIED_AGAIN_AFTER)
                continue
            if viewed is not None and self._goes_on.is_set():  # it may have been held since it asked
                picture = viewed.picture
                if picture.content is None and self._viewed is not None:  # keep the last good one in sight
                    self._problem = picture.problem or picture.waiting
                elif not picture.waiting:
                    self._viewed, self._came = viewed, time.monotonic()
                self._waiting = picture.waiting
                self._draw()

    async def _next(self) -> Viewed | None:
        engine = self.console.engine
        if engine is None:
            raise EngineError("no session runs")
        return await asyncio.wrap_future(
            engine.do(LookAtTopics(self._viewer, self._topics, self._wish, self._subject.link))
        )

    @property
    def _topics(self) -> tuple[str, ...]:
        is_usual = not self._wish.how
        return self._subject.topics + (self._layers if self._shows_layers and is_usual else ())

    @property
    def _colours(self) -> int:
        colours = COLOURS[self.app.console.color_system]
        return min(colours, COLOURS["standard"]) if self.app.ansi_color else colours

    def _draw(self) -> None:
        if not self.pane.is_attached:
            return
        content = self.content
        rows: list[Row] = []
        if content is not None:
            try:
                width, height = self._wish.width, self._wish.height
                rows = picture_rows(content, width, height, colours=self._colours, cursor=self._cursor)
                if (scale := self._scale) is not None and self._goal is not None and self._goal.frame != scale.frame:
                    self._goal = None  # its coordinates mean another place
                if scale is not None and self._goal is not None:
                    mark = Part(self._goal.arrow, "goal")
                    rows = with_mark(rows, *self._goal.cell(scale), mark, width)
            except UnreadableError as error:
                self._problem = str(error)
        self.pane.show(rows or self._reason())
        self._entitle()

    def _reason(self) -> list[Row]:
        """Return the rows of an empty pane: the reason why there is no picture."""
        problem = "" if self._viewed is None else self._viewed.picture.problem
        lines = textwrap.wrap(escape_text(self._problem or problem or self._waiting), self._wish.width)
        return [(Part(line),) for line in lines]

    def _entitle(self) -> None:
        """Show what the picture is of, and how old it is."""
        topics = () if self._goal is not None else (", ".join(self._topics),)
        parts = [escape_text(part) for part in (*topics, *self._status()) if part]
        self.pane.entitle(f" {_joined(parts, self.pane.size.width - _FRAME)} ")

    def _status(self) -> Iterable[str]:
        """Return the facts about the picture, the most important first."""
        if (goal := self._goal) is not None:
            degrees = math.degrees(goal.heading)
            text = ViewText.GOAL_HEADING if self._turns_goal else ViewText.GOAL_PLACE
            return (text(x=goal.x, y=goal.y, frame=goal.frame, degrees=degrees),)
        if not self._goes_on.is_set():
            return (ViewText.HELD(),)
        if self._viewed is None:
            waited = time.monotonic() - self._came
            return (self._problem or ViewText.WAITING(waited=formats.age(waited)),)
        where = self._viewed.where
        side = other_side(self.console.snapshot().role, where) if where else "this side"
        picture, parts = self._viewed.picture, [self._problem or self._viewed.picture.problem]
        if self._viewed.age is not None:
            age = self._viewed.age + time.monotonic() - self._came
            parts.append(ViewText.OLD(age=formats.age(age)))
        size = ViewText.SIZE(size=formats.byte_count(self._viewed.encoded))
        return [
            *parts,
            *picture.notes,
            ViewText.SIDE(side=side),
            size,
            f"at most {self._wish.rate:g} Hz",
            picture.type_name,
        ]

    # -- keys ---------------------------------------------------------------------------------------------------------

    def _change(self, **changes: object) -> None:
        self._wish = msgspec.structs.replace(self._wish, **changes)
        self._entitle()

    def action_way(self) -> None:
        """Draw another kind of picture."""
        # Another kind of picture has other coordinates.
        self._viewed = self._goal = None
        self._change(how=_WAYS[(_WAYS.index(self._wish.how) + 1) % len(_WAYS)])

    def action_zoom(self, factor: float) -> None:
        self._change(zoom=max(0.05, min(200.0, self._wish.zoom * factor)))

    def action_move(self, right: float, up: float) -> None:
        """Move the goal, a plot's cursor, or the view."""
        content = self.content
        columns, rows = round(right / _PAN), round(-up / _PAN)
        if self._goal is not None and (scale := self._scale) is not None:
            turned, moved = self._goal.turned(-columns * _TURN), self._goal.moved(scale, columns, rows)
            self._goal = turned if self._turns_goal else moved
            self._draw()
        elif isinstance(content, Series):
            last = max(0, self._wish.width - AXIS - 1)
            at = last if self._cursor is None else self._cursor + columns
            self._cursor = max(0, min(last, at))
            self._draw()
        else:
            self._change(x=self._wish.x + right, y=self._wish.y + up)

    def action_tilt(self, degrees: float) -> None:
        self._change(tilt=max(0.0, min(90.0, self._wish.tilt + degrees)))

    def action_colour(self) -> None:
        self._change(colour="intensity" if self._wish.colour == "height" else "height")

    def action_reset(self) -> None:
        """Show the whole picture from above, without a cursor."""
        self._cursor = None
        self._change(zoom=1.0, x=0.0, y=0.0, tilt=0.0)

    def action_layers(self) -> None:
        """Lay the other topics over the map, or show the map alone."""
        self._shows_layers = not self._shows_layers
        self._entitle()

    # -- goals and driving --------------------------------------------------------------------------------------------

    @property
    def _scale(self) -> Scale | None:
        content = self.content
        return content.scale if isinstance(content, Cells) else None

    def action_leave(self) -> None:
        """Drop the goal, or close the view."""
        if self._goal is None:
            self.dismiss(None)
        else:
            self._goal = None
            self._draw()

    def action_goal(self) -> None:
        """Begin to set a goal in the middle of the map."""
        if self.console.readonly or _PUBLISH is None:
            return
        if (scale := self._scale) is None:
            self.notify(ViewText.NO_MAP(), severity="warning", markup=False)
            return
        self._goal, self._turns_goal = Goal.at(scale, self._wish.width / 2, self._wish.height / 2), False
        self._draw()

    def on_picture_pane_clicked(self, event: PicturePane.Clicked) -> None:
        """Put the goal where the operator clicks."""
        if self._goal is not None and not self._turns_goal and (scale := self._scale) is not None:
            self._goal = Goal.at(scale, event.column + 0.5, event.row + 0.5)
            self._draw()

    def action_place(self) -> None:
        """Go on to the goal's heading, and then to the form that publishes it."""
        if self._goal is None:
            return
        if not self._turns_goal:
            self._turns_goal = True
            self._draw()
            return
        fields, self._goal = self._goal.fields(), None
        self._draw()
        self._publish(fields)

    @work(group=DIALOG)
    async def _publish(self, fields: str) -> None:
        if _PUBLISH is not None:
            await _PUBLISH(self.console, self._goal_topic(), POSE, fields)

    @property
    def _where(self) -> str:
        """The link to the side that the picture comes from, or an empty string if that is unknown, or this side."""
        return self._subject.link or (self._viewed.where if self._viewed is not None else "")

    def _goal_topic(self) -> str:
        """Return a topic of poses that goes to the side of the map, or the usual name."""
        poses = (each.topic for each in self._routes if each.outgoing and formats.full_type(each) in (POSE, ""))
        return next((topic for topic in poses if topic.endswith(_GOAL_TOPIC)), _GOAL_TOPIC)

    @property
    def _routes(self) -> list[RouteSnapshot]:
        """Those to the robot of the picture: nobody watches another one here, whose map is not this one."""
        where = self._where
        return [each for each in self.console.snapshot().routes if where in ("", each.link)]

    @work(group=DIALOG)
    async def action_on_robot(self, name: str) -> None:
        """Do an action on the robot of the picture, which stays in sight."""
        if self.app.check_action(name, ()):
            await _ON_ROBOT[name].run(self.console, self._routes)

    # -- the rest -----------------------------------------------------------------------------------------------------

    def action_rate(self, step: int) -> None:
        at = _RATES.index(self._wish.rate) + step
        self._change(rate=_RATES[max(0, min(len(_RATES) - 1, at))])

    def action_hold(self) -> None:
        """Hold the picture, or go on."""
        if self._goes_on.is_set():
            self._goes_on.clear()
        else:
            self._goes_on.set()
        self._entitle()

    @work(group=DIALOG)
    async def action_write(self) -> None:
        """Write the picture to a file in the present folder, an image in its own resolution."""
        content = self.content
        if content is None:
            self.notify(ViewText.NO_PICTURE(), markup=False)
            return
        if isinstance(content, Pixels) and self._goes_on.is_set():
            content = await self._image_in_full() or content
        try:
            text = await asyncio.to_thread(_write, self._subject.topics[0], content)
        except (OSError, UnreadableError) as error:
            self.notify(ViewText.NOT_WRITTEN(error=error), severity="error", markup=False)
        else:
            self.notify(text, markup=False)

    async def _image_in_full(self) -> Pixels | None:
        """Return the image that comes next in its own resolution, or None if none comes."""
        engine, viewer = self.console.engine, secrets.token_hex(8)
        if engine is None:
            return None
        try:
            async with asyncio.timeout(_IN_FULL_WITHIN):
                while True:
                    asked = engine.do(LookAtTopics(viewer, self._topics, in_full(self._wish), self._subject.link))
                    viewed = await asyncio.wrap_future(asked)
                    if viewed is not None and isinstance(viewed.picture.content, Pixels):
                        return viewed.picture.content
                    if viewed is not None and viewed.picture.problem:
                        return None
        except (EngineError, TimeoutError):
            return None
        finally:
            engine.do(EndLook(viewer))


def view(console: Console, route: RouteSnapshot) -> ViewScreen:
    """Return the pictures of a bridged topic; of a map with the other topics that can be laid over it."""
    layers = (each.topic for each in console.snapshot().routes if is_layer(each.type_name))
    others = tuple(topic for topic in layers if topic != route.topic)
    return ViewScreen(console, Subject((route.topic,), "", route.type_name, others))


async def look(screen: MainScreen) -> None:
    """Look at a topic of either side, bridged or not."""
    console = screen.console
    if console.engine is not None and (subject := await console.ask(LookScreen(console))) is not None:
        screen.app.push_screen(ViewScreen(console, subject))
