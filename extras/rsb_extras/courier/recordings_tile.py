"""A tile with the fetches under way, what the other side has kept for a cause, and the newest recordings here."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EngineError, Wording
from rsb_bridge.model.verdict import duration
from rsb_console.feature_console import TileLines, side_of
from rsb_console.notation.formats import byte_count
from rsb_extras.courier.courier_command import NOTHING, pace_texts, progress_bar
from rsb_extras.courier.courier_records import has_date
from rsb_extras.courier.courier_requests import FetchState, ListFetches, NewestRecordings
from rsb_extras.courier.courier_screen import FETCH_LOOKS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rsb_console.feature_console import Console, Line
    from rsb_extras.courier.courier_records import ListedRecording
    from rsb_extras.courier.courier_requests import FetchReport, RecordingGroup

_LISTED_EACH = 10
"""Renewals, which are a second apart. A round figure: the bridge looks through folders for it."""
_BAR = 6  # cells: with a rate and a rest it has room in a tile of half of 80 columns
_TIME = "%m-%d %H:%M"


class RecordingsTileText(Wording):
    NO_SESSION = "no session runs"
    ASKING = "asking the bridge"
    HERE = "newest of this side"
    NONE_HERE = "this side has no recordings"
    THERE = "kept by {side}, listed {age} ago"
    NONE_THERE = "{side} kept nothing for a cause, {age} ago"
    UNKNOWN = "{side}: not listed yet, F asks"


class RecordingsLines(TileLines):
    """Fetches and recordings of one robot, or of all.

    It asks its own bridge alone: a tile that stays open costs the link nothing.
    """

    name = "recordings"
    about = "fetches under way, what robots have kept, the newest ones here"

    def __init__(self, console: Console, link: str) -> None:
        super().__init__(console, link)
        self._fetches: Sequence[FetchReport] = ()
        self._groups: Sequence[RecordingGroup] | None = None
        self._renewals = 0
        self._problem = ""

    async def renew(self) -> None:
        if (engine := self.console.engine) is None:
            self._problem = RecordingsTileText.NO_SESSION()
            return
        try:
            fetches = await asyncio.wrap_future(engine.do(ListFetches(self.link)))
            has_new = _done(fetches) != _done(self._fetches)
            self._fetches = fetches
            if has_new or self._renewals % _LISTED_EACH == 0:
                self._groups = await asyncio.wrap_future(engine.do(NewestRecordings(self.link)))
            self._renewals += 1
            self._problem = ""
        except EngineError as error:
            self._problem = str(error)

    def lines(self, height: int) -> Sequence[Line]:
        if self._problem:
            return [((self._problem, "down"),)]
        if self._groups is None:
            return [((RecordingsTileText.ASKING(), "dim"),)]
        here, *others = self._groups
        role = self.console.snapshot().role
        fetches, own = [*_fetch_lines(self._fetches)], [*_own_lines(here.recordings)]
        there = [line for group in others for line in _kept_lines(group, side_of(role, group.link))]
        fetches = fetches[: max(height // 4 * 2, height - len(there) - len(own))]  # each has two lines
        left = height - len(fetches)
        there = there[: max(left // 2, left - len(own))]
        return [*fetches, *there, *own[: left - len(there)]]


def _done(fetches: Sequence[FetchReport]) -> set[str]:
    return {each.name for each in fetches if each.state is FetchState.DONE}


def _fetch_lines(fetches: Sequence[FetchReport]) -> Iterator[Line]:
    """Yield two lines of each fetch that is not done: first those under way, then those that wait or have failed."""
    for fetch in sorted(fetches, key=lambda each: (each.state is FetchState.FAILED, each.state is FetchState.WAITING)):
        if fetch.state is FetchState.DONE:
            continue
        look = FETCH_LOOKS[fetch.state]
        yield ((fetch.name, "strong"),)
        if fetch.state is FetchState.FAILED:
            yield ((f" {fetch.reason}", look),)
        else:
            yield ((f" {progress_bar(fetch, _BAR)} ", look), (", ".join(_progress(fetch)), ""))


def _progress(fetch: FetchReport) -> Iterator[str]:
    yield f"{fetch.share:.0%}"
    if fetch.state is FetchState.FETCHING:
        yield from pace_texts(fetch)
    else:
        yield fetch.reason or fetch.state


def _kept_lines(group: RecordingGroup, side: str) -> Iterator[Line]:
    if group.age is None:
        yield ((RecordingsTileText.UNKNOWN(side=side), "dim"),)
        return
    heading = RecordingsTileText.THERE if group.recordings else RecordingsTileText.NONE_THERE
    yield ((heading(side=side, age=duration(group.age)), "dim"),)
    for each in group.recordings:
        look = "stale" if each.cause == "fault" else ""
        size = byte_count(each.size)
        yield (f"  {_begin(each)}  ", "dim"), (f"{each.cause}: {each.note or each.name}", look), (f"  {size}", "dim")


def _own_lines(recordings: Sequence[ListedRecording]) -> Iterator[Line]:
    yield ((RecordingsTileText.HERE() if recordings else RecordingsTileText.NONE_HERE(), "dim"),)
    for each in recordings:
        yield (f"  {byte_count(each.size):>7}  ", "dim"), (each.name, ""), (f"  {_begin(each)}", "dim")


def _begin(listed: ListedRecording) -> str:
    return datetime.fromtimestamp(listed.begin / 1e9).strftime(_TIME) if has_date(listed.begin) else f"{NOTHING:11}"
