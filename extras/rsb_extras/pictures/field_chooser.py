"""Chooses numbers of messages to plot, of one or more topics."""

from __future__ import annotations

import asyncio
import secrets
from typing import TYPE_CHECKING, ClassVar

from textual import on, work
from textual.binding import Binding
from textual.content import Content
from textual.widgets import Input

from rsb_bridge.feature_api import EngineError, Wording, escape_text
from rsb_console.feature_console import Suggestion
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import TOPICS_AT_ONCE, Wish, field_of, split_field
from rsb_extras.pictures.plots import MOST_CURVES
from rsb_extras.pictures.search_screen import SearchScreen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.snapshot import TopicInfo
    from rsb_console.feature_console import Console, Line
    from rsb_extras.pictures.layouts import Subject
    from rsb_extras.pictures.picture import FieldNumber

_KEYS = "type to search   ↑ ↓ move   space choose, open a topic   ⏎ plot   esc close"
_RATE = 2.0
_TRIED_AGAIN_AFTER = 1.0  # s; a round figure: how long a refusal outlives its cause
_ASKED_EVERY = 5.0
"""s between two questions for the topics of the side. A round figure: each asks for the whole graph, over the link."""
_PATH, _VALUE = 44, 12
_NO_PATH = ""
"""The path of a row that stands for a topic."""


class ChooserText(Wording):
    """Texts of the screen."""

    TITLE = "Numbers to plot, {count} of {most} chosen"
    WAITING = "waiting for a message"
    NONE = "no number matches"
    TOO_MANY = "a plot has at most {most} curves: take one away first"
    TOO_MANY_TOPICS = "a plot has at most {most} topics"


class _Search(Input):
    """A search box that leaves blanks to the list: no path has one."""

    def check_consume_key(self, key: str, character: str | None) -> bool:
        return key != "space" and super().check_consume_key(key, character)


class FieldChooser(SearchScreen[tuple[str, ...]]):
    """Lists the numbers in a view's topics with their values, and further topics of that side.

    The result is None, or paths as `Wish.fields` has them: with their topics if those are several.

    Args:
        chosen: the paths that are plotted now.
    """

    BINDINGS: ClassVar = [Binding("space", "choose", show=False, priority=True)]

    def __init__(self, console: Console, subject: Subject, chosen: tuple[str, ...]) -> None:
        super().__init__("", _KEYS, _Search(id="field-search"))
        self.console = console
        self._link = subject.link
        self._viewer = secrets.token_hex(8)
        first = subject.topics[0]
        split = [(topic or first, path) for topic, path in map(split_field, chosen)]
        self._chosen = dict.fromkeys(split)
        self._topics = tuple(dict.fromkeys((*subject.topics, *(topic for topic, _ in split))))[:TOPICS_AT_ONCE]
        self._numbers: tuple[FieldNumber, ...] = ()
        self._others: tuple[TopicInfo, ...] = ()
        self._problem = ""
        self._rows: dict[str, tuple[str, str]] = {}
        """Topic and path of each row, by its key."""

    def on_mount(self) -> None:
        self._count()
        self._follow()
        self._ask_topics()

    def on_unmount(self) -> None:
        """End the view: there are few."""
        if (engine := self.console.engine) is not None:
            engine.do(EndLook(self._viewer))

    @work
    async def _follow(self) -> None:
        """Take the numbers and their values until the screen is closed."""
        wish = Wish(how="fields", rate=_RATE)
        while (engine := self.console.engine) is not None:
            try:
                asked = engine.do(LookAtTopics(self._viewer, self._topics, wish, self._link))
                viewed = await asyncio.wrap_future(asked)
            except EngineError as error:
                self._problem = str(error)
                self.relist()
                await asyncio.sleep(_TRIED_AGAIN_AFTER)
                continue
            if viewed is not None:
                self._link = self._link or viewed.where
                self._numbers = viewed.picture.numbers
                self._problem = viewed.picture.problem or viewed.picture.waiting
                self.relist()

    @work
    async def _ask_topics(self) -> None:
        """Ask the side for its topics, again and again."""
        while (engine := self.console.engine) is not None:
            try:
                found = await asyncio.wrap_future(engine.topics(self._link or None))
            except EngineError:  # the numbers' question says why
                found = self._others
            self._others = tuple(each for each in found if each.kind == "topic" and each.publishers)
            self.relist()
            await asyncio.sleep(_ASKED_EVERY)

    def why_empty(self) -> str:
        return self._problem or (ChooserText.NONE() if self._numbers else ChooserText.WAITING())

    def suggestions(self) -> Iterator[Suggestion]:
        self._rows = {}
        types = {each.topic: each.type_name for each in self._others}
        for topic in self._topics:
            yield self._row(topic, _NO_PATH, (("▾ ", "key"), (f"{topic}  ", "strong"), (types.get(topic, ""), "dim")))
            values = {number.path: number.value for number in self._numbers if number.topic == topic}
            missing = (path for chosen, path in self._chosen if chosen == topic and path not in values)
            for path in (*missing, *values):
                is_chosen, value = (topic, path) in self._chosen, values.get(path)
                shown = "" if value is None else f"{value:.6g}"
                sign = ("  [✓] ", "ok") if is_chosen else ("  [ ] ", "dim")
                look = "strong" if is_chosen else ""
                yield self._row(topic, path, (sign, (f"{path:<{_PATH}} ", look), (f"{shown:>{_VALUE}}", "dim")))
        for each in self._others:
            if each.topic not in self._topics:
                line: Line = (("▸ ", "key"), (f"{each.topic}  ", ""), (each.type_name, "dim"))
                yield self._row(each.topic, _NO_PATH, line)

    def _row(self, topic: str, path: str, line: Line) -> Suggestion:
        key = f"{topic}\n{path}"
        self._rows[key] = topic, path
        escaped = tuple((escape_text(text), look) for text, look in line)
        return Suggestion(key, f"{topic} {path}", lambda _width: escaped)

    def action_choose(self) -> None:
        """Choose a number, or take it away; open a topic."""
        if (current := self.list.current) is None:
            return
        topic, path = row = self._rows[current.key]
        if path == _NO_PATH:
            self._open(topic)
        elif row in self._chosen:
            del self._chosen[row]
        elif len(self._chosen) >= MOST_CURVES:
            self.notify(ChooserText.TOO_MANY(most=MOST_CURVES), severity="warning", markup=False)
        else:
            self._chosen[row] = None
        self._count()

    def _count(self) -> None:
        """Show what is chosen, and how many."""
        self.dialog.border_title = Content(ChooserText.TITLE(count=len(self._chosen), most=MOST_CURVES))
        self.relist()

    def _open(self, topic: str) -> None:
        if topic in self._topics:
            return
        if len(self._topics) >= TOPICS_AT_ONCE:
            self.notify(ChooserText.TOO_MANY_TOPICS(most=TOPICS_AT_ONCE), severity="warning", markup=False)
        else:
            self._topics = (*self._topics, topic)

    @on(Input.Submitted)
    def _done(self) -> None:
        """Plot what is chosen, or, if that is nothing, the number under the cursor."""
        current = self.list.current
        under = () if current is None else (self._rows[current.key],)
        chosen = list(self._chosen) or [row for row in under if row[1] != _NO_PATH]
        if not chosen:
            self.action_choose()
            return
        several = {topic for topic, _ in chosen} != {self._topics[0]}
        self.dismiss(tuple(field_of(topic, path) if several else path for topic, path in chosen))

    def on_selectable_list_chosen(self) -> None:
        self.action_choose()
