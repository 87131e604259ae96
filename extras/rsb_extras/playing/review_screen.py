"""The screen that looks at a recording: its topics, and what the chosen one shows at the chosen time."""

from __future__ import annotations

import asyncio
import textwrap
import time
from typing import TYPE_CHECKING, ClassVar

from textual import work
from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.content import Content

from rsb_bridge.feature_api import Wording, escape_text
from rsb_bridge.model.snapshot import PEEK_LIMIT, PeekedMessage
from rsb_console.feature_console import FixedLines, FullScreen, ScrolledLines, SelectableList
from rsb_console.screens.message_screen import content_lines
from rsb_console.session.reading import read_message
from rsb_extras.pictures.drawing import has_picture
from rsb_extras.pictures.image_style import ImageStyle
from rsb_extras.pictures.picture import Cells, Series, Wish
from rsb_extras.pictures.picture_pane import PicturePane
from rsb_extras.pictures.picture_rows import Part, UnreadableError, has_pillow, picture_rows
from rsb_extras.pictures.renderer import Renderer
from rsb_extras.pictures.wish_keys import CHANGES
from rsb_extras.playing.recorded_pictures import SECOND, RecordedPictures
from rsb_extras.recording.reading.stored_message import RecordingError

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from rsb_console.feature_console import Line
    from rsb_extras.pictures.picture_rows import Row
    from rsb_extras.playing.recorded_pictures import Moment
    from rsb_extras.recording.reading.open_recording import OpenRecording
    from rsb_extras.recording.reading.stored_message import StoredMessage

_TURN = 0.2  # s between two pictures while it plays. A round figure
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 60.0)
_ITEMS, _STEPS = 64, 20_000  # of a message that is shown as text, as in `MessageScreen`
_KEYS = " space play · ← → 5 s · shift 60 s · , . message · < > speed · h how · + - zoom · t text · esc "


class ReviewText(Wording):
    """Texts of the screen."""

    PLACE = "{at:.3f} / {all:.1f} s  {clock}  {state}"
    PLAYS = "playing {speed:g}x"
    STANDS = "paused"
    BEFORE_FIRST = "no message of {topic} until here: . goes to the next one"
    NOT_DESCRIBED = "nobody describes the type {type_name}"
    CUT = "the recording: {reason}"
    NOT_DRAWN = "the picture cannot be drawn: {error}"


class RecordedTopics(SelectableList):
    """The topics of a recording, those with a picture first."""

    begins_at_top = True

    def __init__(self, recording: OpenRecording) -> None:
        super().__init__(id="recorded-topics")
        self._topics = recording.summary.topics
        self.order = sorted(self._topics, key=lambda topic: (not has_picture(self._topics[topic][0]), topic))

    def line(self, index: int) -> Line:
        topic = self.keys[index]
        type_name, count = self._topics[topic]
        look = "strong" if has_picture(type_name) else ""
        return ((escape_text(topic), look), (f"  {count:,}", "dim"), (f"  {escape_text(type_name)}", "dim"))


class ReviewScreen(FullScreen[None]):
    """Looks at a recording, as at topics: play, pause, step, seek.

    Args:
        topic: to begin with, or empty for the first one of the list.
        at: ns since the epoch to begin with, or None for the begin of the recording.
    """

    BINDINGS: ClassVar = [
        Binding("escape,q", "dismiss", show=False),
        Binding("space", "play", show=False),
        Binding("left", "seek(-5)", show=False, priority=True),
        Binding("right", "seek(5)", show=False, priority=True),
        Binding("shift+left", "seek(-60)", show=False, priority=True),
        Binding("shift+right", "seek(60)", show=False, priority=True),
        Binding("full_stop", "step(False)", show=False),
        Binding("comma", "step(True)", show=False),
        Binding("less_than_sign", "speed(-1)", show=False),
        Binding("greater_than_sign", "speed(1)", show=False),
        Binding("h", "change('way', 0)", show=False),
        Binding("plus,equals_sign", "change('zoom', 1.5)", show=False),
        Binding("minus", "change('zoom', 0.667)", show=False),
        Binding("0", "change('reset', 0)", show=False),
        Binding("t", "text", show=False),
    ]
    CSS = """
    ReviewScreen { align: left top; }
    #review { width: 100%; height: 1fr; }
    #review #recorded-topics { width: 36%; height: 100%; }
    #shown { width: 64%; height: 100%; }
    #shown PicturePane { width: 100%; height: 2fr; margin: 0; }
    #shown #recorded-message { width: 100%; height: 1fr; }
    ReviewScreen.-text #shown PicturePane { display: none; }
    #recorded-place { width: 100%; height: 2; }
    #recorded-topics, #recorded-message, #shown PicturePane {
        border: solid $rule; border-title-color: $quiet; border-subtitle-color: $quiet;
    }
    #review #recorded-topics:focus, #review #recorded-message:focus {
        border: solid $primary; border-title-color: $primary;
    }
    """

    def __init__(self, recording: OpenRecording, topic: str = "", at: int | None = None) -> None:
        super().__init__()
        self._recording = recording
        self._begin, self._end = recording.summary.begin, recording.summary.end
        self.position = self._begin if at is None else max(self._begin, min(at, self._end))
        self._topics = RecordedTopics(recording)
        self._first = topic
        self._renderer = Renderer()
        self._pictures = RecordedPictures(recording, self._renderer)
        self._pane = PicturePane()
        self._look = ImageStyle(self._pane)
        self._message = ScrolledLines(id="recorded-message")
        self._place = FixedLines(id="recorded-place")
        self._wish = Wish(webp=has_pillow())
        self._is_playing = False
        self._speed = _SPEEDS.index(1.0)
        self._since = 0.0
        self._wanted = asyncio.Event()

    def compose(self) -> ComposeResult:
        self._topics.border_title = Content(f" {escape_text(self._recording.path.name)} ")
        self._topics.border_subtitle = " ↑ ↓ topic "
        with Horizontal(id="review"):
            yield self._topics
            with Vertical(id="shown"):
                yield self._pane
                yield self._message
        yield self._place

    def on_mount(self) -> None:
        self._topics.show_keys(self._topics.order)
        if self._first in self._topics.order:
            self._topics.move_to(self._topics.order.index(self._first))
        self._topics.focus()
        self.set_interval(_TURN, self._go_on)
        self.call_after_refresh(self._show)
        self._follow()

    def on_unmount(self) -> None:
        self._renderer.close()

    def on_resize(self) -> None:
        self.call_after_refresh(self._show)

    def on_selectable_list_cursor_moved(self) -> None:
        self._show()

    # -- time ---------------------------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Move on while it plays."""
        if not self._is_playing:
            return
        now = time.monotonic()
        passed, self._since = now - self._since, now
        position = self.position + round(passed * _SPEEDS[self._speed] * SECOND)
        self._is_playing = position < self._end
        self._move_to(position)

    def _move_to(self, position: int) -> None:
        self.position = max(self._begin, min(position, self._end))
        self._show()

    def action_play(self) -> None:
        self._is_playing, self._since = not self._is_playing, time.monotonic()
        if self._is_playing and self.position >= self._end:
            self.position = self._begin
        self._show()

    def action_seek(self, seconds: int) -> None:
        self._move_to(self.position + seconds * SECOND)

    def action_speed(self, step: int) -> None:
        self._speed = max(0, min(len(_SPEEDS) - 1, self._speed + step))
        self._show_place()

    @work(exclusive=True, group="step")
    async def action_step(self, back: bool) -> None:
        """Go to the topic's next message, or to the one before."""
        self._is_playing = False
        if (topic := self._topics.cursor_key) is None:
            return
        try:
            found = await asyncio.to_thread(self._pictures.next_time, topic, self.position, back=back)
        except RecordingError as error:
            self.notify(str(error), severity="warning", markup=False)
            return
        if found is not None:
            self._move_to(found)

    # -- what is shown ------------------------------------------------------------------------------------------------

    def action_change(self, what: str, step: float) -> None:
        self._wish = CHANGES[what](self._wish, None, step)
        self._show()

    def action_text(self) -> None:
        """Give the message all the room, or show the picture again."""
        self.toggle_class("-text")
        self.call_after_refresh(self._show)

    def _show(self) -> None:
        self._show_place()
        self._wanted.set()

    def _show_place(self) -> None:
        state = ReviewText.PLAYS(speed=_SPEEDS[self._speed]) if self._is_playing else ReviewText.STANDS()
        clock = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.position / SECOND))
        at, all_of_it = ((each - self._begin) / SECOND for each in (self.position, self._end))
        line: list[Line] = [((f" {ReviewText.PLACE(at=at, all=all_of_it, clock=clock, state=state)}", "strong"),)]
        if cut := self._recording.summary.cut:
            line = [(*line[0], (f"  {escape_text(ReviewText.CUT(reason=cut))}", "stale"))]
        self._place.put([*line, ((_KEYS, "dim"),)])

    @work
    async def _follow(self) -> None:
        """Show the wanted topic and time, one picture after the other, until the screen is closed."""
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            topic = self._topics.cursor_key
            if topic is None or (not self._pane.size.width and not self.has_class("-text")):
                continue
            self._wish = self._look.fitted(self._wish) if self._pane.size.width else self._wish
            try:
                moment = await self._pictures.at(topic, self.position, self._wish)
                await self._show_moment(topic, moment)
            except RecordingError as error:
                self._message.show([((escape_text(str(error)), "down"),)])

    async def _show_moment(self, topic: str, moment: Moment) -> None:
        self._pane.entitle(f" {escape_text('  '.join(part for part in (topic, *moment.picture.notes) if part))} ")
        if moment.message is None:
            self._pane.show([])
            self._message.show([((escape_text(ReviewText.BEFORE_FIRST(topic=topic)), "waiting"),)])
            return
        width = self._message.scrollable_content_region.width
        self._message.show(await asyncio.to_thread(self._lines, moment.message, width))
        await self._show_picture(moment)

    def _lines(self, message: StoredMessage, width: int) -> list[Line]:
        channel = message.channel
        described = self._pictures.type_of(channel)
        why = ReviewText.NOT_DESCRIBED(type_name=channel.type_name)
        payload = bytes(message.content[:PEEK_LIMIT])
        seconds = message.time / SECOND
        text, type_hash = (None, "") if described is None else described
        peeked = PeekedMessage(payload, len(message.content), channel.type_name, type_hash, seconds, outgoing=False)
        read = read_message(peeked, text, why, items=_ITEMS, steps=_STEPS)
        at = f"{(message.time - self._begin) / SECOND:.3f} s"
        by = f"  by {channel.publisher}" if channel.publisher else ""
        head: Line = ((escape_text(channel.type_name), "strong"), (escape_text(f"  {at}{by}"), "dim"))
        return [head, (), *content_lines(read, width)]

    async def _show_picture(self, moment: Moment) -> None:
        content = moment.picture.content
        rows: list[Row] = []
        try:
            if content is not None and self._look.is_image(content):
                image = await self._look.image(content, self._wish, cursor=None, mark=None)
                if self._look.shows_pixels:
                    wish = self._wish
                    await self._pane.show_image(image, wish, lambda: self._look.in_blocks(image, wish))
                    return
                rows = await asyncio.to_thread(self._look.in_blocks, image, self._wish)
            elif isinstance(content, Cells | Series):
                rows = picture_rows(content, self._wish.width, self._wish.height, colours=self._look.colours)
        except UnreadableError as error:
            self._problem(str(error))
            return
        except Exception as error:  # noqa: BLE001 -- a stranger's picture must not end the console
            self._problem(ReviewText.NOT_DRAWN(error=error))
            return
        if rows:
            self._pane.show(rows)
        else:
            self._problem(moment.picture.problem)

    def _problem(self, text: str) -> None:
        lines = textwrap.wrap(escape_text(text), max(1, self._wish.width))
        self._pane.show([(Part(line),) for line in lines])
