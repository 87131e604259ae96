"""The recordings of both sides on a screen, with keys that get or complete one of the other side, and how that goes."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from textual import work
from textual.binding import Binding

from rsb_bridge.feature_api import Effect, EngineError, Wording, join_first
from rsb_console.feature_console import (
    DIALOG,
    CellTable,
    ConfirmScreen,
    Dialog,
    ScrolledLines,
    SidesScreen,
    asked_link,
    side_of,
    wrapped,
)
from rsb_extras.courier.completed_screen import CompletedScreen
from rsb_extras.courier.completing_form import CompletingForm
from rsb_extras.courier.courier_command import HEADINGS, CourierCommandText, bar_text, newest_first, texts_of
from rsb_extras.courier.courier_requests import (
    CancelFetch,
    FetchRecording,
    ListFetches,
    ListRecordings,
    ReadCompleted,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.app import ComposeResult

    from rsb_console.feature_console import Line, MainScreen
    from rsb_extras.courier.completed_recording import CompletedRecording
    from rsb_extras.courier.courier_records import ListedRecording
    from rsb_extras.courier.courier_requests import FetchReport, RecordingGroup

HELP = "⏎ get   c complete   m what is missing   x give up   esc close"
_WIDTH = 76  # cells, until the screen is laid out
_TOPICS = 40  # that are named. A round figure
_FETCHES_EVERY = 1.0  # s
FETCH_LOOKS = {"waiting": "waiting", "fetching": "ok", "writing": "ok", "done": "ok", "failed": "down"}


class RecordingsScreenText(Wording):
    READ_ONLY = "this console is read-only"
    HERE = "{name} is on this side already"
    BEGUN = "{name} comes from {side}"
    NO_FETCH = "{name} is not being got"
    ASK = "Give up {name}?"
    MEANS = "What has come of it is removed."
    GIVE_UP = "Give up"
    NOTE = "note: {note}"
    TOPICS = "topics: {topics}"
    PROBLEM = "not all of it is known: {problem}"
    FETCH = "{name} {bar}"
    NOT_COMPLETED = "{name} has not been completed since the bridge began: press c on it, or m on an earlier file"
    COMPLETING = "{name} is being completed: wait until that is over"
    MISSING = "m: what neither side has of it, and why"


class RecordingRow(NamedTuple):
    """A recording with the link to its side, or an empty text for this side.

    Attributes:
        fetches: of it, or those that have made it; the last one is last.
    """

    link: str
    side: str
    recording: ListedRecording
    fetches: tuple[FetchReport, ...]

    @property
    def key(self) -> str:
        return f"{self.link}/{self.recording.id}"

    @property
    def under_way(self) -> FetchReport | None:
        """The last fetch that is not over."""
        return next((each for each in reversed(self.fetches) if not each.is_over), None)

    @property
    def completed(self) -> FetchReport | None:
        """The last fetch that has completed what came live."""
        return next((each for each in reversed(self.fetches) if each.completed is not None), None)


class RecordingsTable(CellTable[RecordingRow]):
    HEADINGS = HEADINGS
    WHOLE = frozenset({"BEGIN", "TOPICS"})

    def cells(self, row: RecordingRow) -> tuple[tuple[str, str], ...]:
        look = FETCH_LOOKS[row.fetches[-1].state] if row.link and row.fetches else "strong"
        begin, span, size, cause, topics = texts_of(row.recording)
        figures = (begin, ""), (span, ""), (size, ""), (cause, ""), (topics, "dim")
        return (row.recording.name, look), (row.side, ""), *figures


class RecordingsScreen(SidesScreen["RecordingGroup"]):
    """The recordings of this side and of its links, and how their fetches go."""

    BINDINGS: ClassVar = [
        Binding("enter,g", "get", show=False),
        Binding("c", "complete", show=False),
        Binding("m", "missing", show=False),
        Binding("x", "give_up", show=False),
    ]
    AUTO_FOCUS = "#recordings"
    EVERY = 10.0  # a round figure: lists of the other side cross the link
    DEFAULT_CSS = """
    #recordings { height: 1fr; background: $surface; }
    #recordings-detail { max-height: 50%; margin-top: 1; background: $surface; }
    """

    def __init__(self, main: MainScreen, link: str) -> None:
        super().__init__(main.console, link)
        self.main, self.table = main, RecordingsTable(id="recordings")
        self.detail = ScrolledLines(id="recordings-detail")
        self._here: Sequence[RecordingGroup] = ()
        self._there: Sequence[RecordingGroup] = ()
        self._here_came = self._there_came = False
        self._fetches: tuple[FetchReport, ...] = ()

    def compose(self) -> ComposeResult:
        yield Dialog("Recordings", self.problems, self.table, self.detail, keys=HELP, shape="-high")

    def on_mount(self) -> None:
        self._renew_here()
        super().on_mount()
        self.set_interval(_FETCHES_EVERY, self._renew_fetches)
        self._renew_fetches()

    def request(self) -> ListRecordings:
        return ListRecordings(self.link, there=True)

    def renew(self) -> None:
        self._renew_here()
        super().renew()

    @work(group="here", exclusive=True)
    async def _renew_here(self) -> None:
        """List this side's recordings at once: the other side's answer may take long, or never come."""
        if (engine := self.console.engine) is None:
            return
        with suppress(EngineError):
            self._here = await asyncio.wrap_future(engine.do(ListRecordings(here=True)))
        self._here_came = True
        self._show_lists()

    def show(self, groups: Sequence[RecordingGroup]) -> None:
        self._there, self._there_came = groups, True
        self._show_lists()

    def _show_lists(self) -> None:
        """Show what has come; that there is nothing is known once both lists have."""
        self._show_rows()
        if self._there_came:
            is_empty = self._here_came and self.table.selected is None
            self.show_problems(self._there, CourierCommandText.NONE(), is_empty=is_empty)

    def _show_rows(self) -> None:
        role = self.console.snapshot().role
        self.table.show(
            [
                RecordingRow(group.link, side_of(role, group.link), each, (*self._fetches_of(group.link, each.name),))
                for group in (*self._here, *self._there)
                for each in newest_first(group)
            ]
        )
        self._show_detail()

    def _fetches_of(self, link: str, name: str) -> Iterator[FetchReport]:
        for fetch in self._fetches:
            if (fetch.link, fetch.recording) == (link, name) or (not link and Path(fetch.path).name == name):
                yield fetch

    @work(group="fetches", exclusive=True)
    async def _renew_fetches(self) -> None:
        if (engine := self.console.engine) is None:
            return
        try:
            self._fetches = await asyncio.wrap_future(engine.do(ListFetches(self.link)))
        except EngineError:
            return  # the list itself says why
        self._show_rows()

    def _show_detail(self) -> None:
        row, width = self.table.selected, self.table.size.width or _WIDTH
        self.detail.put([] if row is None else [*_lines(row, width)])

    def on_selectable_list_cursor_moved(self) -> None:
        self._show_detail()

    def action_get(self) -> None:
        if (row := self._chosen_there()) is not None:
            self._get(row)

    @work(group=DIALOG)
    async def _get(self, row: RecordingRow) -> None:
        await self._fetch_recording(row, FetchRecording(row.link, row.recording.id))

    def action_complete(self) -> None:
        if (row := self._chosen_there()) is not None:
            self._complete(row)

    @work(group=DIALOG)
    async def _complete(self, row: RecordingRow) -> None:
        here = [each for group in self._here for each in newest_first(group)]
        completing = await self.console.ask(CompletingForm(row.side, row.recording, here))
        if completing is not None:
            topics, live = completing
            command = FetchRecording(row.link, row.recording.id, topics, completes=True, live=live)
            await self._fetch_recording(row, command)

    async def _fetch_recording(self, row: RecordingRow, command: FetchRecording) -> None:
        if (engine := self.console.engine) is None:
            return
        try:
            await asyncio.wrap_future(engine.do(command))
        except EngineError as error:
            self.warn(str(error))
        else:
            self.notify(RecordingsScreenText.BEGUN(name=row.recording.name, side=row.side), markup=False, timeout=4)
            self._renew_fetches()

    def action_missing(self) -> None:
        row = self.table.selected
        if row is None or not self.table.is_seen():
            return
        name = row.recording.name
        if (fetch := row.completed) is not None and fetch.completed is not None:
            self._show_missing(fetch.name, fetch.completed, fetch.path)
        elif row.under_way is not None and row.under_way.completes:
            self.warn(RecordingsScreenText.COMPLETING(name=name))
        elif row.link:
            self.warn(RecordingsScreenText.NOT_COMPLETED(name=name))
        else:
            self._read_missing(row.recording)

    @work(group=DIALOG)
    async def _show_missing(self, name: str, completed: CompletedRecording, path: str) -> None:
        await self.console.ask(CompletedScreen(name, completed, path))

    @work(group=DIALOG)
    async def _read_missing(self, recording: ListedRecording) -> None:
        """Show what a file of this side says itself: the bridge knows of fetches since it began only."""
        if (engine := self.console.engine) is None:
            return
        try:
            completed = await asyncio.wrap_future(engine.do(ReadCompleted(recording.id)))
        except EngineError as error:
            self.warn(str(error))
        else:
            await self.console.ask(CompletedScreen(recording.name, completed))

    def action_give_up(self) -> None:
        row = self._chosen()
        if row is None:
            return
        if row.under_way is None:
            self.warn(RecordingsScreenText.NO_FETCH(name=row.recording.name))
        else:
            self._give_up(row.under_way)

    @work(group=DIALOG)
    async def _give_up(self, fetch: FetchReport) -> None:
        title, means = RecordingsScreenText.ASK(name=fetch.name), RecordingsScreenText.MEANS()
        question = ConfirmScreen(title, means, RecordingsScreenText.GIVE_UP(), Effect.LOSES)
        if await self.console.ask(question) is not True or (engine := self.console.engine) is None:
            return
        try:
            await asyncio.wrap_future(engine.do(CancelFetch(fetch.name)))
        except EngineError as error:
            self.warn(str(error))
        self._renew_fetches()

    def _chosen(self) -> RecordingRow | None:
        row = self.table.selected
        if row is None or not self.table.is_seen():
            return None
        if self.console.readonly:
            self.warn(RecordingsScreenText.READ_ONLY())
            return None
        return row

    def _chosen_there(self) -> RecordingRow | None:
        """Return the chosen recording if the other side has it."""
        row = self._chosen()
        if row is not None and not row.link:
            self.warn(RecordingsScreenText.HERE(name=row.recording.name))
            return None
        return row


def _lines(row: RecordingRow, width: int) -> Iterator[Line]:
    listed = row.recording
    for fetch in row.fetches if row.link else ():
        text = RecordingsScreenText.FETCH(name=fetch.name, bar=bar_text(fetch))
        yield from wrapped(text, width, FETCH_LOOKS[fetch.state])
    if row.completed is not None:
        yield from wrapped(RecordingsScreenText.MISSING(), width, "strong")
    if listed.problem:
        yield from wrapped(RecordingsScreenText.PROBLEM(problem=listed.problem), width, "waiting")
    if listed.note:
        yield from wrapped(RecordingsScreenText.NOTE(note=listed.note), width)
    if listed.topics:
        topics = join_first([each.name for each in listed.topics], _TOPICS)
        yield from wrapped(RecordingsScreenText.TOPICS(topics=topics), width, "dim")


async def show_recordings(screen: MainScreen) -> None:
    await screen.console.ask(RecordingsScreen(screen, asked_link(screen)))
