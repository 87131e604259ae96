"""Commands that an operator gave before something stood still, and goals on maps of a side that is not trusted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
from tests.support import replaced

from rsb_bridge.api import EngineError
from rsb_bridge.model.by_hand import OLD_AFTER, Published
from rsb_bridge.model.clock import Clock
from rsb_console.command import pub_command
from rsb_console.session import manual_messages


class Slow:
    """An engine whose first answer comes late; it takes each ticket."""

    def __init__(self, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.published = 0
        self._now, self._seconds = 100.0, seconds
        replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(lambda: self._now))

    def publish(self, *_: object, ticket: int, **_end: object) -> Future[Published]:
        self._now += 0.0 if ticket else self._seconds
        self.published += bool(ticket)
        done: Future[Published] = Future()
        done.set_result(Published(bool(ticket), 7))
        return done


def by_command(engine: Any) -> Published:
    return pub_command.publish(engine, "/cmd", "", "", 0, Clock.steady())


def by_screen(engine: Any) -> Published:
    return asyncio.run(manual_messages.publish(engine, "/cmd", ""))


@pytest.mark.parametrize("publish", [by_command, by_screen])
def test_an_old_message_gets_no_further_ticket(
    publish: Callable[[Any], Published], monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Slow(OLD_AFTER - 0.1, monkeypatch)
    assert publish(engine).is_done
    engine = Slow(OLD_AFTER + 0.1, monkeypatch)
    with pytest.raises(EngineError):
        publish(engine)
    assert not engine.published
