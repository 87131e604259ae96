"""Messages by hand: tickets."""

from __future__ import annotations

import asyncio

import pytest
from tests.console.scripted import ScriptedEngine
from tests.support.wording import pattern

from rsb_bridge.api import EngineError
from rsb_bridge.model.by_hand import Published
from rsb_console.session.manual_messages import ByHandText, publish

DONE, OLD = Published(is_done=True, ticket=9), Published(is_done=False, ticket=7)


def published_with(*answers: Published | EngineError) -> tuple[Published, list[int]]:
    """Publish on an engine that gives these answers. Return the result, and the ticket of each command."""
    engine = ScriptedEngine()
    engine.published = [*answers]
    result = asyncio.run(publish(engine, "/cmd", "data: x", "a/msg/B"))
    sent = [each[1] for each in engine.commands]
    assert {(each.topic, each.fields, each.type_name) for each in sent} == {("/cmd", "data: x", "a/msg/B")}  # type: ignore[attr-defined]
    return result, [each.ticket for each in sent]  # type: ignore[attr-defined]


def test_a_command_is_repeated_with_the_ticket_of_its_answer() -> None:
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
        asyncio.run(publish(None, "/cmd", ""))
