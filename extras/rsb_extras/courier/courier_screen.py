"""The recordings of both sides on a screen, with a key that gets one from the other side, and how that goes."""

from __future__ import annotations

import asyncio
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
from rsb_extras.courier.courier_command import HEADINGS, CourierCommandText, bar_text, newest_first, texts_of
from rsb_extras.courier.courier_requests import CancelFetch, FetchRecording, FetchState, ListFetches, ListRecordings

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from textual.app import ComposeResult

    from rsb_console.feature_console import Line, MainScreen
    from rsb_extras.courier.courier_records import ListedRecording
    from rsb_extras.courier.courier_requests import FetchReport, RecordingGroup

HELP = "⏎ get   x give up   esc close"
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


class RecordingRow(NamedTuple):
    """A recording with the link to its side, or an empty text for this side, and its last fetch."""

    link: str
    side: str
    recording: ListedRecording
    fetch: FetchReport | None

    @property
    def key(self) -> str:
        return f"{self.link}/{self.recording.id}"


class RecordingsTable(CellTable[RecordingRow]):
    HEADINGS = HEADINGS
    WHOLE = frozenset({"BEGIN", "TOPICS"})

    def cells(self, row: RecordingRow) -> tuple[tuple[str, str], ...]:
        look = "strong" if row.fetch is None else FETCH_LOOKS[row.fetch.state]
        begin, span, size, cause, topics = texts_of(row.recording)
        figures = (begin, ""), (span, ""), (size, ""), (cause, ""), (topics, "dim")
        return (row.recording.name, look), (row.side, ""), *figures


class RecordingsScreen(SidesScreen["RecordingGroup"]):
    """The recordings of this side and of its links, and how their fetches go."""

    BINDINGS: ClassVar = [
        Binding("enter,g", "get", show=False),
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
        self._groups: Sequence[RecordingGroup] = ()
        self._fetches: tuple[FetchReport, ...] = ()

    def compose(self) -> ComposeResult:
        yield Dialog("Recordings", self.problems, self.table, self.detail, keys=HELP, shape="-high")

    def on_mount(self) -> None:
        super().on_mount()
        self.set_interval(_FETCHES_EVERY, self._renew_fetches)
        self._renew_fetches()

    def request(self) -> ListRecordings:
        return ListRecordings(self.link)

    def show(self, groups: Sequence[RecordingGroup]) -> None:
        self._groups = groups
        self._show_rows()
        self.show_problems(groups, CourierCommandText.NONE(), is_empty=self.table.selected is None)

    def _show_rows(self) -> None:
        role = self.console.snapshot().role
        sides = [(group, side_of(role, group.link)) for group in self._groups]
        self.table.show(
            [
                RecordingRow(group.link, side, each, self._fetch_of(group.link, each.name))
                for group, side in sides
                for each in newest_first(group)
            ]
        )
        self._show_detail()

    def _fetch_of(self, link: str, name: str) -> FetchReport | None:
        found = [each for each in self._fetches if link and (each.link, each.recording) == (link, name)]
        return found[-1] if found else None

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
        row = self._chosen()
        if row is None:
            return
        if not row.link:
            self.warn(RecordingsScreenText.HERE(name=row.recording.name))
        else:
            self._get(row)

    @work(group=DIALOG)
    async def _get(self, row: RecordingRow) -> None:
        if (engine := self.console.engine) is None:
            return
        try:
            await asyncio.wrap_future(engine.do(FetchRecording(row.link, row.recording.id)))
        except EngineError as error:
            self.warn(str(error))
        else:
            self.notify(RecordingsScreenText.BEGUN(name=row.recording.name, side=row.side), markup=False, timeout=4)
            self._renew_fetches()

    def action_give_up(self) -> None:
        row = self._chosen()
        if row is None:
            return
        if row.fetch is None or row.fetch.state in (FetchState.DONE, FetchState.FAILED):
            self.warn(RecordingsScreenText.NO_FETCH(name=row.recording.name))
        else:
            self._give_up(row.fetch)

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


def _lines(row: RecordingRow, width: int) -> Iterator[Line]:
    listed = row.recording
    if row.fetch is not None:
        yield from wrapped(bar_text(row.fetch), width, FETCH_LOOKS[row.fetch.state])
    if listed.problem:
        yield from wrapped(RecordingsScreenText.PROBLEM(problem=listed.problem), width, "waiting")
    if listed.note:
        yield from wrapped(RecordingsScreenText.NOTE(note=listed.note), width)
    if listed.topics:
        topics = join_first([each.name for each in listed.topics], _TOPICS)
        yield from wrapped(RecordingsScreenText.TOPICS(topics=topics), width, "dim")


async def show_recordings(screen: MainScreen) -> None:
    await screen.console.ask(RecordingsScreen(screen, asked_link(screen)))
