"""Tickets of messages by hand, and commands that an operator gave before something stood still."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
from tests.support import replaced
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.model.by_hand import OLD_AFTER
from rsb_bridge.model.clock import Clock
from rsb_extras.driving import landing, pub_command
from rsb_extras.driving.landing import ByHandText
from rsb_extras.driving.publish_requests import Publish, Published
from rsb_extras.driving.tests.publishing_engine import PublishingEngine


class Slow:
    """An engine whose first answer comes late; it takes each ticket."""

    def __init__(self, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.published = 0
        self._now, self._seconds = 100.0, seconds
        replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(lambda: self._now))

    def do(self, command: Publish) -> Future[Published]:
        self._now += 0.0 if command.ticket else self._seconds
        self.published += bool(command.ticket)
        done: Future[Published] = Future()
        done.set_result(Published(bool(command.ticket), 7))
        return done


def by_command(engine: Any) -> Published:
    return pub_command.publish(engine, "/cmd", "", "", 0, Clock.steady())


def by_screen(engine: Any) -> Published:
    return asyncio.run(landing.publish(engine, "/cmd", ""))


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


# -- tickets

TYPE = "geometry_msgs/msg/PoseStamped"
DONE, OLD = Published(is_done=True, ticket=9), Published(is_done=False, ticket=7)


def published_with(*answers: Published | EngineError) -> tuple[Published, list[int]]:
    """Publish on an engine that gives these answers. Return the result, and the ticket of each command."""
    engine = PublishingEngine()
    engine.published = [*answers]
    result = asyncio.run(landing.publish(engine, "/cmd", "data: x", TYPE))
    sent = [each[1] for each in engine.commands]
    assert {(each.topic, each.fields, each.type_name) for each in sent} == {("/cmd", "data: x", TYPE)}  # type: ignore[attr-defined]
    return result, [each.ticket for each in sent]  # type: ignore[attr-defined]


def test_command_is_repeated_with_ticket_of_its_answer() -> None:
    assert published_with(DONE) == (DONE, [0])
    assert published_with(OLD, DONE) == (DONE, [0, 7])
    assert published_with(OLD, OLD, DONE) == (DONE, [0, 7, 7])


def test_a_bridge_that_answers_too_slowly_publishes_nothing() -> None:
    with pytest.raises(EngineError, match=pattern(ByHandText.TOO_SLOW, topic="/cmd")):
        published_with(OLD, OLD, OLD, DONE)


def test_a_refusal_is_not_repeated() -> None:
    with pytest.raises(EngineError, match="no luck"):
        published_with(EngineError("no luck"), DONE)


def test_without_a_session_nothing_is_published() -> None:
    with pytest.raises(EngineError, match=pattern(ByHandText.NO_SESSION)):
        asyncio.run(landing.publish(None, "/cmd", ""))
