"""An engine in a few figures, for a screen of many: how often they come, and what they cost."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support import constants
from tests.support.operators import BOB, Reachable
from tests.support.virtual_time import virtual_loop
from tests.support.wording import pattern

from rsb_bridge.control import protocol
from rsb_bridge.control.attached_console import AttachedConsole
from rsb_bridge.control.control_sockets import AttachProblem, ControlError
from rsb_bridge.control.protocol import VERSION, BridgeInfo, ConsoleHello, ConsoleWelcome, Summary, Watch, encode
from rsb_bridge.control.remote_engine import UnixSocket
from rsb_bridge.control.sealed import OperatorRefused
from rsb_bridge.control.summaries import watch
from rsb_bridge.model.commands import ActingOperator
from rsb_bridge.model.robot_summary import SUMMARY_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.control import Machine

    from rsb_bridge.control.remote_engine import Connector

INFO = BridgeInfo("robot1", "client", "10.0.0.20:49152", 1, 0.0, "x", "0.1.0")


class Taking:
    """A connection that takes everything at once."""

    operator, read_only_reason, of_this_machine, closing = ActingOperator("uid 1000", "anna"), "", True, False
    never_takes_reason = ""

    def __init__(self) -> None:
        self.buffered = 0
        self.taken = bytearray()

    def write(self, data: bytes) -> None:
        self.taken += data

    def close(self) -> None:
        raise AssertionError("it goes on")

    abort = close_lingering = close


def told(summarize: Callable[[float], bytes], seconds: float, *, stalls: bool = False) -> list[bytes]:
    """Return the messages to a watching console in so many s."""
    with virtual_loop() as loop:
        connection = Taking()
        served: Any = SimpleNamespace(info=INFO, engine=None, encoded=None, summary=lambda: summarize(loop.time()))

        async def serve() -> None:
            console = AttachedConsole(served, connection)
            console.received(encode(ConsoleHello(VERSION, "0.1.0", read_only=True)) + encode(Watch()))
            connection.buffered = int(stalls)
            await asyncio.sleep(seconds)
            console.gone()

        loop.run_until_complete(serve())
    welcome, *summaries = protocol.frames_to_console().feed(bytes(connection.taken))
    assert isinstance(welcome, ConsoleWelcome)
    return [each.content for each in summaries if isinstance(each, Summary)]


def test_what_changes_all_time_comes_once_second() -> None:
    contents = told(lambda now: str(now).encode(), 10.1)
    assert len(contents) == len(set(contents)) == 11


def test_unchanged_state_comes_as_sign_of_life() -> None:
    assert told(lambda _: b"same", 10.1) == [b"same"] * 3


def test_where_nobody_makes_figures_none_come() -> None:
    assert told(lambda _: b"", 10.1) == []


def test_who_does_not_take_them_skips_some() -> None:
    assert len(told(lambda now: str(now).encode(), 10.1, stalls=True)) == 1


def seen(way: Connector, count: int) -> list[bytes]:
    async def see() -> list[bytes]:
        contents: list[bytes] = []
        figures = watch(way)
        async for content in figures:
            contents.append(content)
            if len(contents) == count:
                break
        await figures.aclose()
        return contents

    return asyncio.run(see())


@pytest.mark.parametrize("by", ["socket", "network"])
def test_figures_come_by_every_way(machine: Machine, monkeypatch: pytest.MonkeyPatch, by: str) -> None:
    constants.SUMMARY_EVERY.set(monkeypatch, 0.0)
    robot = Reachable(machine)
    numbers = iter(range(1000))
    robot.server.summarize = lambda: str(next(numbers)).encode()
    way: Connector = UnixSocket(machine.folder / "robot1.sock") if by == "socket" else robot.way("bob", BOB)
    assert seen(way, 3) == [b"0", b"1", b"2"]


def test_bridge_that_makes_no_figures_does_not_answer(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.SUMMARY_SILENT_FOR.set(monkeypatch, 0.2)
    robot = Reachable(machine)
    with pytest.raises(ControlError, match=pattern(AttachProblem.SILENT)):
        seen(robot.way(), 1)


@pytest.mark.parametrize("content", [bytes(SUMMARY_BYTES + 1), bytes(protocol.TO_WATCHER_LIMIT)])
def test_figures_that_are_too_long_are_refused(reachable: Reachable, content: bytes) -> None:
    reachable.server.summarize = lambda: content
    with pytest.raises(ControlError):
        seen(reachable.way(), 1)


def test_why_it_ends_is_said(reachable: Reachable) -> None:
    reachable.server.summarize = lambda: b"figures"

    async def see() -> None:
        async for _ in watch(reachable.way()):
            reachable.access.grant({})

    with pytest.raises(ControlError, match=pattern(OperatorRefused.REMOVED, name="anna")):
        asyncio.run(see())
    with pytest.raises(ControlError, match="anna"):
        seen(reachable.way(), 1)
