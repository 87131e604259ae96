"""Events for an attached console: a connection that takes megabytes at once gets no more than it passes on in time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from tests.support.virtual_time import virtual_loop

from rsb_bridge.control import protocol
from rsb_bridge.control.attached_console import AttachedConsole
from rsb_bridge.control.protocol import VERSION, BridgeInfo, ConsoleHello, FollowEvents, Goodbye, encode
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import ActingOperator
from rsb_bridge.model.snapshot import Level
from rsb_bridge.telemetry.event_log import EventLog

INFO = BridgeInfo("robot1", "client", "10.0.0.20:49152", 1, 0.0, "x", "0.1.0")
EVENTS = 3000


class Thin:
    """A connection that takes everything at once, and passes so many bytes a second on to its console.

    Attributes:
        events: that have come, each with the time (s) from when it was sent.
    """

    operator, read_only_reason, never_takes_reason = ActingOperator("uid 1000", "anna"), "", ""
    of_this_machine, closing, buffered = False, False, 0

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._free_at = 0.0
        self._frames = protocol.frames_to_console()
        self._loop = asyncio.get_running_loop()
        self.console: AttachedConsole
        self.answers = True
        self.delays: list[float] = []
        self.numbers: list[int] = []
        self.ended = False

    def write(self, data: bytes) -> None:
        now = self._loop.time()
        self._free_at = max(now, self._free_at) + len(data) / self._rate
        self._loop.call_at(self._free_at, self._arrived, data, now)

    def _arrived(self, data: bytes, sent_at: float) -> None:
        for message in self._frames.feed(data):
            self.ended |= isinstance(message, Goodbye)
            if isinstance(message, protocol.Events):
                self.delays.append(self._loop.time() - sent_at)
                self.numbers += [event.number for event in message.events]
                if self.answers:
                    self.console.received(encode(FollowEvents(self.numbers[-1])))

    def close(self) -> None:
        self.closing = True

    abort = close_lingering = close


async def follow(rate: float, seconds: float, *, answers: bool = True) -> Thin:
    log = EventLog(Clock())
    for number in range(EVENTS):
        log.add(Level.INFO, EventCode.LINK_UP, f"robot1: linked for the {number}th time")
    connection = Thin(rate)
    connection.answers = answers
    served: Any = SimpleNamespace(
        info=INFO, engine=SimpleNamespace(events=log.after), encoded=None, summary=lambda: b""
    )
    connection.console = AttachedConsole(served, connection)
    connection.console.received(encode(ConsoleHello(VERSION, "0.1.0")) + encode(FollowEvents(0)))
    await asyncio.sleep(seconds)
    return connection


def test_events_leave_room_on_a_thin_connection() -> None:
    with virtual_loop() as loop:
        thin = loop.run_until_complete(follow(14e3, 120.0))
        assert thin.numbers == list(range(1, EVENTS + 1))
        assert max(thin.delays) < 1.0
        thin.console.gone()


def test_fast_connection_has_all_events_at_once() -> None:
    with virtual_loop() as loop:
        fast = loop.run_until_complete(follow(40e6, 0.1))
        assert len(fast.numbers) == EVENTS
        fast.console.gone()


def test_console_without_events_gets_few_until_end() -> None:
    with virtual_loop() as loop:
        deaf = loop.run_until_complete(follow(40e6, 60.0, answers=False))
        assert 0 < len(deaf.numbers) < 100
        deaf.console.end("the bridge stops")
        loop.run_until_complete(asyncio.sleep(1.0))
        assert deaf.ended
        assert deaf.numbers == list(range(1, EVENTS + 1))
        deaf.console.gone()
