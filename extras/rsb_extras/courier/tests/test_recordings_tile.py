"""Lines of the tile of recordings: what it shows where there is little room, and while something is missing."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from msgspec.structs import replace

from rsb_bridge.api import EngineError
from rsb_extras.courier.courier_requests import FetchState, ListFetches, NewestRecordings, RecordingGroup
from rsb_extras.courier.recordings_tile import RecordingsLines, RecordingsTileText
from rsb_extras.courier.tests.scripted_answers import DONE, DRIVE, FETCH, GROUPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.commands import Command
    from rsb_console.console_api import Console
    from rsb_extras.courier.courier_requests import FetchReport

WAITS = replace(FETCH, name="robot1-night", state=FetchState.WAITING, share=0.0, rate=0.0, rest=None, reason="waits")
FAILED = replace(FETCH, name="robot1-old", state=FetchState.FAILED, reason="the recording has changed")
THERE = replace(GROUPS[1], recordings=(DRIVE, DRIVE, DRIVE), age=200.0)
HERE = replace(GROUPS[0], recordings=GROUPS[0].recordings * 3)


class Bridge:
    """Answers a tile's questions.

    Attributes:
        lists: how often it was asked for recordings.
    """

    def __init__(self, *fetches: FetchReport, groups: Sequence[RecordingGroup] = (HERE, THERE)) -> None:
        self.fetches, self.groups = fetches, groups
        self.lists = 0
        self.problem = ""

    def do(self, command: Command[Any]) -> Future[Any]:
        future: Future[Any] = Future()
        if self.problem:
            future.set_exception(EngineError(self.problem))
        elif isinstance(command, NewestRecordings):
            self.lists += 1
            future.set_result(self.groups)
        else:
            assert isinstance(command, ListFetches), "a tile asks for nothing else"
            future.set_result(self.fetches)
        return future


def tile(bridge: Bridge | None) -> RecordingsLines:
    console = SimpleNamespace(engine=bridge, snapshot=lambda: SimpleNamespace(role="server"))
    return RecordingsLines(cast("Console", console), "")


def shown(lines: RecordingsLines, height: int) -> list[str]:
    return ["".join(text for text, _ in line) for line in lines.lines(height)]


def renewed(lines: RecordingsLines, height: int = 20) -> list[str]:
    asyncio.run(lines.renew())
    return shown(lines, height)


def test_fetches_come_first_those_under_way_before_others() -> None:
    found = renewed(tile(Bridge(FAILED, WAITS, DONE, FETCH)))
    assert [line.strip() for line in found[:6]] == [
        FETCH.name, "[#.....] 25%, 1.5 MB/s, 84 s left",
        WAITS.name, "[......] 0%, waits",
        FAILED.name, FAILED.reason,
    ]  # fmt: skip
    assert DONE.name not in "".join(found), "its file is among the newest ones"


def test_each_part_has_room_in_a_low_tile() -> None:
    lines = tile(Bridge(WAITS, WAITS, WAITS, WAITS))
    renewed(lines)
    for height in range(7, 16):
        found = shown(lines, height)
        assert len(found) <= height
        assert any(WAITS.name in line for line in found)
        assert any("fault: /scan stopped" in line for line in found), height
        assert RecordingsTileText.HERE() in found or height < 8


def test_a_side_that_has_listed_nothing_is_not_asked() -> None:
    found = renewed(tile(Bridge(groups=(GROUPS[0], RecordingGroup("robot1", age=None)))))
    assert found[0] == RecordingsTileText.UNKNOWN(side="robot1")


def test_lists_are_renewed_when_a_fetch_is_done() -> None:
    bridge = Bridge(FETCH)
    lines = tile(bridge)
    renewed(lines)
    renewed(lines)
    assert bridge.lists == 1
    bridge.fetches = (DONE,)
    renewed(lines)
    assert bridge.lists == 2


def test_what_is_missing_is_said() -> None:
    assert renewed(tile(None)) == [RecordingsTileText.NO_SESSION()]
    bridge = Bridge()
    lines = tile(bridge)
    assert shown(lines, 9) == [RecordingsTileText.ASKING()]
    bridge.problem = "the bridge is gone"
    assert renewed(lines) == ["the bridge is gone"]
    bridge.problem = ""
    assert renewed(lines) != ["the bridge is gone"]
