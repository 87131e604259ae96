"""A tile with pictures of topics, drawn by the side that publishes them."""

from __future__ import annotations

import asyncio
import math
import secrets
import textwrap
import time
from collections import deque
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import msgspec
from textual import work
from textual.binding import Binding

from rsb_bridge.api import EngineError
from rsb_bridge.config.files import replace_file
from rsb_bridge.model.names import other_side
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import escape_text
from rsb_bridge.model.wording import Wording
from rsb_console.actions.all_actions import ACTIONS
from rsb_console.notation import formats
from rsb_console.terminal.input_queue import DIALOG
from rsb_extras.pictures.blocks import image_rows, wished_pixels
from rsb_extras.pictures.cell_image import Marked, fine_for, image_of, is_drawn, styles_in
from rsb_extras.pictures.drawing import VIEWS, is_map
from rsb_extras.pictures.field_chooser import FieldChooser
from rsb_extras.pictures.goal_on_map import POSE, Goal
from rsb_extras.pictures.graphics import USUAL_CELL, protocol_of
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import (
    MOST_RATE,
    TOPICS_AT_ONCE,
    Cells,
    Pixels,
    Series,
    in_full,
    sized,
    split_field,
)
from rsb_extras.pictures.picture_files import SVG_SHAPE, formats_of, picture_file, squared, svg
from rsb_extras.pictures.picture_rows import AXIS, Part, UnreadableError, picture_rows, reads_webp, with_mark
from rsb_extras.pictures.tile import FRAME, Tile, joined

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from concurrent.futures import Future

    from rsb_console.console_api import Console
    from rsb_extras.pictures.layouts import Subject
    from rsb_extras.pictures.picture import Scale, Viewed, Wish
    from rsb_extras.pictures.picture_rows import Row

_TRIED_AGAIN_AFTER = 1.0  # s; a round figure: how long a refusal outlives its cause
_RENEWED_AFTER = 0.15  # s; a round figure: eight such questions may be under way on a link with a round trip of 1.2 s
_IN_FULL_WITHIN = 5.0  # s. A round figure: an operator waits for the file
_RATES = (0.2, 0.5, 1.0, 2.0, 5.0, MOST_RATE)
_ZOOM, _PAN, _TILT = 1.5, 0.1, 15.0
_WAYS = ("", "plot", "tree")
_SPANS = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
"""s of a plot's time axis."""
_KEYS = ("space hold", "t text", "+- zoom", "p file", "f fields", "h how", "<> rate", "←→↑↓")
_MAP_KEYS, _POINT_KEYS = ("l layers",), ("[] tilt", "c colour")
_PUBLISH = next((action.with_message for action in ACTIONS if action.with_message is not None), None)
_TURN = 15.0
"""Degrees by which a key turns a goal."""
_GOAL_TOPIC = "/goal_pose"
_SLOW, _IN_CHARACTERS = 0.3, 3
"""s that a line may take for an image, in which keys wait; and how often its resolution is halved until it is drawn in
characters, which come in pieces between other things."""
_DEAR = 50_000
"""Bytes/s of a line below which 256 colours are worth more than true ones: an image in blocks comes twice as fast."""
_COST_OVER = 5.0
"""s over which the cost of a tile is measured."""


class ViewText(Wording):
    WAITING = "waiting for a picture, {waited}"
    AWAY = "OLD PICTURE: {link} is not linked: {reason}"
    HELD = "HELD: space goes on"
    OLD = "{age} old"
    TO_TERMINAL = "{rate} to this terminal"
    SIDE = "drawn by {side}"
    ASCII = "ASCII: LC_ALL=C.UTF-8 shows more, if the terminal has Unicode"
    FEW_COLOURS = "{colours} colours: COLORTERM=truecolor or terminal: {{colours: true}} in console.yaml shows more"
    WRITTEN = "written: {files}"
    NOT_WRITTEN = "the picture cannot be written: {error}"
    NO_PICTURE = "there is no picture yet"
    NO_MAP = "a goal needs a map with a frame"
    GOAL_PLACE = "GOAL at {x:.2f}, {y:.2f} m in {frame}: arrows move it, ⏎ turns it, esc leaves"
    GOAL_HEADING = "GOAL at {x:.2f}, {y:.2f} m, heading {degrees:.0f}°: ←→ turn it, ⏎ publishes, esc leaves"


class PictureTile(Tile):
    """Pictures of topics, of a map with others laid over it, and the goal that an operator sets on it.

    It has more than 40 methods because Textual calls one for each key, and they all change one wish.
    """

    BINDINGS: ClassVar = [
        Binding("g", "goal", show=False),
        Binding("enter", "place", show=False),
        Binding("h", "way", show=False),
        Binding("f", "fields", show=False),
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
        super().__init__(console, subject)
        # The map itself is one of them.
        self._layers: list[tuple[str, ...]] = _sets_of_layers(subject) if is_map(subject.type_name) else [()]
        """The topics laid over a map: one set after the other, by a key."""
        self._viewer = secrets.token_hex(8)
        self._wish = msgspec.structs.replace(subject.wish, webp=reads_webp())
        self._viewed: Viewed | None = None
        self._image: Pixels | None = None
        """The image in sight."""
        self._blocks: list[Row] = []
        """The same in characters."""
        self._came = time.monotonic()
        self._sizes: deque[tuple[float, int]] = deque()
        """When pictures came lately, and their bytes."""
        self._goes_on = asyncio.Event()
        self._goes_on.set()
        self._asked: Future[Viewed | None] | None = None
        self._renews = False
        self._problem = ""
        self._unreadable = ""
        """The damage of the image in sight, or an empty string."""
        self._waiting = ""
        """The publishing side's reason why no picture has come yet."""
        self._showing = asyncio.Lock()
        self._cursor: int | None = None
        """Column of a plot whose values are shown."""
        self._strain = 0
        """How often the resolution is halved for a terminal that reads slowly."""
        self._goal: Goal | None = None
        self._turns_goal = False

    @property
    def content(self) -> Cells | Pixels | Series | None:
        """The picture in sight, or None."""
        return None if self._viewed is None else self._viewed.picture.content

    @property
    def cost(self) -> float:
        """Bytes a second that it takes of a link."""
        now = time.monotonic()
        while self._sizes and now - self._sizes[0][0] > _COST_OVER:
            self._sizes.popleft()
        return sum(size for _, size in self._sizes) / _COST_OVER

    def on_mount(self) -> None:
        # The age of a picture grows without a new one.
        self.set_interval(1.0, self._entitle)

    def begin(self) -> None:
        self.fit()
        self._follow()

    def end(self) -> None:
        self.workers.cancel_node(self)
        if (engine := self.console.engine) is not None:  # at once, so that the next one finds room: there are few
            engine.do(EndLook(self._viewer))

    def keys(self) -> list[str]:
        type_name = self.subject.type_name
        keys = [*(_MAP_KEYS if len(self._layers) > 1 else ()), *(_POINT_KEYS if _is_points(type_name) else ())]
        keys += ["g goal"] if self._is_map and _PUBLISH and not self.console.readonly else []
        return [*keys, *self.robot_keys(), *_KEYS]

    def fit(self) -> None:
        size, facts = self.size, self.terminal.facts
        if self._shows_pixels and facts.cell is not None:
            across, down = (round(each / 2**self._strain) for each in facts.cell)
        else:
            across, down = wished_pixels(self._image_colours, sextants=facts.draws_sextants)
        wish = sized(self._wish, size.width, size.height, across, down, facts.shape)
        self._take(msgspec.structs.replace(wish, fine=fine_for(self._cell) if self._shows_pixels else 1))
        self._redraw()  # the picture in sight, in the new size

    @property
    def _cell(self) -> tuple[float, float]:
        """Pixels of a character, as far as the line takes them."""
        across, down = self.terminal.facts.cell or USUAL_CELL
        return across / 2**self._strain, down / 2**self._strain

    def _is_image(self, content: object) -> bool:
        """Whether a picture is shown as an image, in pixels or in blocks."""
        return isinstance(content, Pixels) or (is_drawn(content) and (self._shows_pixels or isinstance(content, Cells)))

    def _redraw(self) -> None:
        """Draw the picture in sight once more, as the operator or the terminal has changed something."""
        if self._is_image(self.content):
            self.cover_changed()
        else:
            self._draw()

    @property
    def _colours(self) -> int:
        facts = self.terminal.facts
        if self.app.no_color or self.app.console.color_system is None:
            return 0
        # With more, a map has half blocks of two tints, in which ASCII would show walls.
        if self.app.ansi_color or self.terminal.ascii_only:
            return min(facts.colours, 16)
        return min(facts.colours, 256) if self.terminal.writer.line.rate < _DEAR else facts.colours

    @property
    def _image_colours(self) -> int:
        """The colours for an image: in ASCII, which has no shapes for two of them, characters show its brightness."""
        return 0 if self.terminal.ascii_only else self._colours

    @property
    def _shows_pixels(self) -> bool:
        can = not self.terminal.ascii_only and protocol_of(self.terminal.facts) != ""
        return can and self._strain < _IN_CHARACTERS

    # -- pictures -----------------------------------------------------------------------------------------------------

    @work
    async def _follow(self) -> None:
        """Take pictures until the tile is hidden or closed."""
        while True:
            await self._goes_on.wait()
            try:
                viewed = await self._next()
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
            if viewed is None or not self._goes_on.is_set():  # it may have been held since it asked
                continue
            picture = viewed.picture
            self._sizes.append((time.monotonic(), viewed.encoded if viewed.where else 0))
            if picture.content is None and self._viewed is not None:  # keep the last good one in sight
                self._problem = picture.problem or picture.waiting
            elif not picture.waiting:
                self._viewed, self._came = viewed, time.monotonic()
            self._waiting = picture.waiting
            await self._show_content()
            await self.is_taken()
            self._spare()

    def _ask_anew_soon(self) -> None:
        """Put the present wish in the place of the one that waits, so that a key has its effect at once.

        A key that is held changes the wish 30 times a second, and the other side answers only some questions at a time.
        """
        if self._asked is not None and not self._renews:
            self._renews = True
            self.set_timer(_RENEWED_AFTER, self._ask_anew)

    def _ask_anew(self) -> None:
        self._renews = False
        if self._asked is not None:
            self._asked.cancel()

    def _spare(self) -> None:
        """Draw fewer pixels, and at last characters, for a line that takes long for an image; or more again."""
        before, seconds = self._strain, self.image_bytes / self.terminal.writer.line.rate
        finer = seconds * (4 if self._shows_pixels else 1)
        if self._shows_pixels and seconds > _SLOW:
            self._strain += 1
        elif self._strain and finer < _SLOW / 2:
            self._strain -= 1
        if self._strain != before:
            self.fit()

    async def _next(self) -> Viewed | None:
        engine = self.console.engine
        if engine is None:
            raise EngineError("no session runs")
        asked = LookAtTopics(self._viewer, self._topics, self._wish, self.subject.link)
        self._asked = engine.do(asked)
        return await asyncio.wrap_future(self._asked)

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
        # One after the other: of two threads, the one with the former picture or size may be the last.
        async with self._showing:
            content, self._unreadable = self.content, ""
            if self._is_image(content):
                self._image = content if isinstance(content, Pixels) else await self._drawn_image()
                blocks = partial(self._in_blocks, self._image, self._wish)
                try:
                    if self._shows_pixels:
                        await self.show_image(self._image, self._wish, blocks, few_colours=self._strain > 0)
                    else:
                        self._blocks = await asyncio.to_thread(blocks)
                except UnreadableError as error:
                    self._unreadable, self._blocks = str(error), []
            self._draw()

    async def _drawn_image(self) -> Pixels:
        """Return the map or the plot in sight as an image, with the goal or the cursor on it."""
        content, wish = self.content, self._wish
        assert isinstance(content, Cells | Series)
        inks = self.inks(styles_in(content), self._cell)
        place, goal = self._placed_goal(), self._goal
        mark = None if place is None or goal is None else Marked(*place, goal.arrow)
        size = wish.width, wish.height
        return await asyncio.to_thread(image_of, content, size, wish.shape, inks, cursor=self._cursor, mark=mark)

    def _placed_goal(self) -> tuple[int, int] | None:
        """Return column and row of the goal, and drop it if the map has another frame by now."""
        if (scale := self._scale) is None or self._goal is None:
            return None
        if self._goal.frame != scale.frame:  # its coordinates mean another place
            self._goal = None
            return None
        return self._goal.cell(scale)

    def _in_blocks(self, content: Pixels, wish: Wish) -> list[Row]:
        return image_rows(content, wish, colours=self._image_colours, sextants=self.terminal.facts.draws_sextants)

    @work(exclusive=True, group="image")
    async def cover_changed(self) -> None:
        await self._show_content()

    def _draw(self) -> None:
        if not self.is_attached:
            return
        content = self.content
        rows: list[Row] = []
        is_image = self._is_image(content)
        if is_image:
            rows = self._blocks
        elif content is not None and not isinstance(content, Pixels):
            rows = picture_rows(
                content, self._wish.width, self._wish.height, colours=self._colours, cursor=self._cursor
            )
            if (place := self._placed_goal()) is not None and self._goal is not None:
                rows = with_mark(rows, *place, Part(self._goal.arrow, "goal"), self._wish.width)
        if not (is_image and self._shows_pixels) or self._unreadable:
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
        topics = () if self._goal is not None else (f"{first} +{len(others)}" if others else first,)
        parts = [escape_text(part) for part in (*topics, *self._status()) if part]
        self.entitle(f" {joined(parts, self.size.width - FRAME)} ")

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
            formats.byte_rate(self.cost) if where else "",
            ViewText.TO_TERMINAL(rate=formats.byte_rate(sent))
            if (sent := self.terminal.writer.line.per_second)
            else "",
            ViewText.SIDE(side=side),
            f"at most {self._wish.rate:g} Hz",
            self._how_shown if isinstance(picture.content, Pixels) else "",
            picture.type_name,
        ]

    @property
    def _how_shown(self) -> str:
        """What the terminal was found to show, or how to get more."""
        facts = self.terminal.facts
        if self.terminal.ascii_only:
            return ViewText.ASCII()
        few = facts.colours <= 16 and not self.app.no_color
        return ViewText.FEW_COLOURS(colours=facts.colours or "no") if few else facts.line()

    # -- keys ---------------------------------------------------------------------------------------------------------

    def _change(self, **changes: object) -> None:
        self._take(msgspec.structs.replace(self._wish, **changes))

    def _take(self, wish: Wish) -> None:
        if wish != self._wish:
            self._wish = wish
            self._ask_anew_soon()
        self._entitle()

    def action_way(self) -> None:
        """Draw another kind of picture."""
        # Another kind of picture has other coordinates.
        self._viewed = self._goal = None
        self._change(how=_WAYS[(_WAYS.index(self._wish.how) + 1) % len(_WAYS)] if self._wish.how in _WAYS else "")

    @work(group=DIALOG)
    async def action_fields(self) -> None:
        """Choose numbers to plot, of this topic or of several."""
        fields = await self.console.ask(FieldChooser(self.console, self.subject, self._wish.fields))
        if fields is not None:
            self._viewed = self._goal = None
            self._change(how="plot" if fields else "", fields=fields)

    def action_zoom(self, factor: float) -> None:
        """Show less, larger; of a plot, a shorter time."""
        if isinstance(self.content, Series):
            longer = [each for each in _SPANS if each > self._wish.seconds]
            shorter = [each for each in _SPANS if each < self._wish.seconds]
            self._change(seconds=(shorter or _SPANS[:1])[-1] if factor > 1 else (longer or _SPANS[-1:])[0])
            return
        self._change(zoom=max(0.05, min(200.0, self._wish.zoom * factor)))

    def action_move(self, right: float, up: float) -> None:
        """Move the goal, a plot's cursor, or the view."""
        content = self.content
        columns, rows = round(right / _PAN), round(-up / _PAN)
        if self._goal is not None and (scale := self._scale) is not None:
            turned, moved = self._goal.turned(-columns * _TURN), self._goal.moved(scale, columns, rows)
            self._goal = turned if self._turns_goal else moved
            self._redraw()
        elif isinstance(content, Series):
            last = max(0, self._wish.width - AXIS - 1)
            at = last if self._cursor is None else self._cursor + columns
            self._cursor = max(0, min(last, at))
            self._redraw()
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
        """Lay other topics over the map, with costmaps or without, or show it alone."""
        self._layers.append(self._layers.pop(0))
        self._ask_anew_soon()
        self._entitle()

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

    # -- goals ------------------------------------------------------------------------------------------------------

    @property
    def _scale(self) -> Scale | None:
        """The place of the map in the world, by characters."""
        content = self.content
        if not isinstance(content, Cells) or content.scale is None or content.fine == 1:
            return content.scale if isinstance(content, Cells) else None
        scale, fine = content.scale, content.fine
        return msgspec.structs.replace(scale, column=scale.column * fine, row=scale.row * fine)

    def drop_goal(self) -> bool:
        """Drop the goal, and return whether there was one."""
        had, self._goal = self._goal is not None, None
        if had:
            self._redraw()
        return had

    def action_goal(self) -> None:
        """Begin to set a goal in the middle of the map."""
        if self.console.readonly or _PUBLISH is None:
            return
        if (scale := self._scale) is None:
            self.notify(ViewText.NO_MAP(), severity="warning", markup=False)
            return
        self._goal, self._turns_goal = Goal.at(scale, self._wish.width / 2, self._wish.height / 2), False
        self._redraw()

    def on_picture_pane_clicked(self, event: Tile.Clicked) -> None:
        """Put the goal where the operator clicks."""
        if self._goal is not None and not self._turns_goal and (scale := self._scale) is not None:
            self._goal = Goal.at(scale, event.column + 0.5, event.row + 0.5)
            self._redraw()

    def action_place(self) -> None:
        """Go on to the goal's heading, and then to the form that publishes it."""
        if self._goal is None:
            return
        if not self._turns_goal:
            self._turns_goal = True
            self._redraw()
            return
        fields, self._goal = self._goal.fields(), None
        self._redraw()
        self._publish(fields)

    @work(group=DIALOG)
    async def _publish(self, fields: str) -> None:
        if _PUBLISH is not None:
            await _PUBLISH(self.console, self._goal_topic(), POSE, fields)

    @property
    def where(self) -> str:
        return self.subject.link or (self._viewed.where if self._viewed is not None else "")

    def _goal_topic(self) -> str:
        """Return a topic of poses that goes to the side of the map, or the usual name."""
        poses = (each.topic for each in self.routes if each.outgoing and formats.full_type(each) in (POSE, ""))
        return next((topic for topic in poses if topic.endswith(_GOAL_TOPIC)), _GOAL_TOPIC)

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
            drawn, content = content, (await self._image_in_full() if self._goes_on.is_set() else None) or content
        try:
            if drawn is not None:
                of_file = msgspec.structs.replace(self._wish, shape=SVG_SHAPE)
                drawing = await asyncio.to_thread(self._in_blocks, drawn, of_file)
            files = await asyncio.to_thread(_write, self.subject.topics[0], content, drawing)
        except (OSError, UnreadableError) as error:
            self.notify(ViewText.NOT_WRITTEN(error=error), severity="error", markup=False)
        else:
            self.notify(ViewText.WRITTEN(files=files), markup=False)

    async def _image_in_full(self) -> Pixels | None:
        """Return the image that comes next in its own resolution, or None if none comes."""
        engine, viewer = self.console.engine, secrets.token_hex(8)
        if engine is None:
            return None
        try:
            async with asyncio.timeout(_IN_FULL_WITHIN):
                while True:
                    asked = engine.do(LookAtTopics(viewer, self._topics, in_full(self._wish), self.subject.link))
                    viewed = await asyncio.wrap_future(asked)
                    if viewed is not None and isinstance(viewed.picture.content, Pixels):
                        return viewed.picture.content
                    if viewed is not None and viewed.picture.problem:
                        return None
        except (EngineError, TimeoutError):
            return None
        finally:
            engine.do(EndLook(viewer))


def _sets_of_layers(subject: Subject) -> list[tuple[str, ...]]:
    """Return what may be laid over a map: all but costmaps, which hide the rest; all; nothing."""
    costs = tuple(topic for topic in subject.layers if "costmap" in topic)
    others = tuple(topic for topic in subject.layers if topic not in costs)
    most = TOPICS_AT_ONCE - len(subject.topics)
    return [*dict.fromkeys((others[:most], (*costs[:2], *others)[:most], ()))]


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
