"""Several operators ask the other side at once: each gets an answer, and a peer's questions stay few."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.slices import take
from tests.support.wording import pattern

from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.link.questions import QUESTIONS_KEPT, Questions, TopicLists
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.wire.codec import pack_topics
from rsb_bridge.wire.messages import AskType, ListTopics, TopicList, TypeText

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from tests.support.virtual_time import VirtualLoop

    from rsb_bridge.wire.messages import ControlMessageBase


def link_for(loop: VirtualLoop, send: Callable[..., object], spawn: Callable[..., object]) -> Any:
    return SimpleNamespace(
        context=SimpleNamespace(ros=NoRos(), now=loop.time), shows=lambda *_: True, send=send, spawn=spawn
    )


class Side:
    """One side's questions; an answer is found after 1 s."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.sent: list[ControlMessageBase] = []
        self.found: list[int] = []
        self._loop = loop
        self.questions: Questions[bytes] = Questions(link_for(loop, self.sent.append, self.spawn), 5.0)

    def spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        return self._loop.create_task(work)

    def asked(self, number: int) -> None:
        self.questions.answer(number, self._finder(number))

    def _finder(self, number: int) -> Callable[[], Coroutine[None, None, ControlMessageBase]]:
        async def find() -> ControlMessageBase:
            self.found.append(number)
            await asyncio.sleep(1.0)
            return TypeText(route=number)

        return find

    async def ask(self, number: int = 3) -> bytes:
        return await self.questions.ask(number, AskType(route=number))


@pytest.fixture
def side(loop: VirtualLoop) -> Side:
    return Side(loop)


async def test_who_lists_topics_meanwhile_shares_the_question(loop: VirtualLoop) -> None:
    sent: list[Any] = []
    lists = TopicLists(link_for(loop, sent.append, loop.create_task))
    asking = [asyncio.ensure_future(lists.ask()) for _ in range(3)]
    await asyncio.sleep(0.0)
    assert sent == [ListTopics(1)]
    take(lists, TopicList(1, pack_topics([])))
    later = asyncio.ensure_future(lists.ask())
    assert await asyncio.gather(*asking) == [[], [], []]
    await asyncio.sleep(0.0)
    assert sent == [ListTopics(1), ListTopics(2)], "an answer that was there is not used again"
    take(lists, TopicList(1, pack_topics([])))
    assert not later.done()
    take(lists, TopicList(2, pack_topics([])))
    assert await later == []


async def test_slow_list_serves_later_askers_too(loop: VirtualLoop) -> None:
    """On a thin link, a second list would have to wait for the first."""
    sent: list[Any] = []
    lists = TopicLists(link_for(loop, sent.append, loop.create_task))
    gives_up = asyncio.ensure_future(lists.ask())
    await asyncio.sleep(1.0)
    gives_up.cancel()
    await asyncio.sleep(1.0)
    later = asyncio.ensure_future(lists.ask())
    await asyncio.sleep(20.0)
    assert sent == [ListTopics(1)]
    take(lists, TopicList(1, pack_topics([])))
    assert await later == []


async def test_earlier_asker_s_timeout_harms_no_later_one(loop: VirtualLoop, side: Side) -> None:
    first = asyncio.ensure_future(side.ask())
    await asyncio.sleep(3.0)
    second = asyncio.ensure_future(side.ask())
    with pytest.raises(LinkError, match=pattern(Denied.NO_ANSWER)):
        await first
    assert loop.time() == 5.0
    third = asyncio.ensure_future(side.ask())
    await asyncio.sleep(1.0)
    assert side.sent == [AskType(route=3)] * 2, "after a timeout it is asked again"
    side.questions.answered(3, b"yes")
    assert [await second, await third] == [b"yes", b"yes"]
    assert not side.questions.awaited(3)


async def test_an_asker_who_leaves_harms_no_other(side: Side) -> None:
    first, second = asyncio.ensure_future(side.ask()), asyncio.ensure_future(side.ask())
    await asyncio.sleep(1.0)
    first.cancel()
    await asyncio.sleep(1.0)
    side.questions.answered(3, b"yes")
    assert await second == b"yes"
    alone = asyncio.ensure_future(side.ask())
    await asyncio.sleep(1.0)
    alone.cancel()
    await asyncio.sleep(1.0)
    assert not side.questions.awaited(3), "nobody waits"


async def test_questions_are_answered_one_after_the_other(side: Side) -> None:
    for number in (1, 2, 3, 2):
        side.asked(number)
    await asyncio.sleep(1.5)
    assert side.found == [1, 2]
    side.asked(2)
    await asyncio.sleep(9.0)
    assert side.sent == [TypeText(route=1), TypeText(route=2), TypeText(route=3)]
    side.asked(2)
    await asyncio.sleep(2.0)
    assert side.found == [1, 2, 3, 2], "it is answered again once it was answered"


async def test_a_peer_cannot_make_the_questions_many(side: Side) -> None:
    for number in range(1000):
        side.asked(number)
    await asyncio.sleep(2000.0)
    assert side.found == list(range(QUESTIONS_KEPT))
    side.asked(1000)
    await asyncio.sleep(2.0)
    assert side.sent[-1] == TypeText(route=1000)


async def test_next_connection_gets_no_answers_of_last(side: Side) -> None:
    side.asked(1)
    side.asked(2)
    asking = asyncio.ensure_future(side.ask())
    await asyncio.sleep(0.5)
    side.questions.disconnected()
    with pytest.raises(LinkError, match=pattern(Denied.LINK_LOST)):
        await asking
    side.asked(1)
    await asyncio.sleep(9.0)
    assert side.found == [1, 1]
    assert side.sent == [AskType(route=3), TypeText(route=1)]


async def test_a_failure_ends_what_waits(side: Side) -> None:
    async def fails() -> ControlMessageBase:
        raise ValueError("broken")

    side.questions.answer(1, fails)
    side.asked(2)
    await asyncio.sleep(2.0)
    side.asked(3)
    await asyncio.sleep(2.0)
    assert side.sent == [TypeText(route=3)]


async def test_lists_are_answered_once_a_second(loop: VirtualLoop) -> None:
    """Of what a peer asks meanwhile, its newest question counts: it waits for no other one."""
    sent: list[ControlMessageBase] = []
    lists = TopicLists(link_for(loop, sent.append, loop.create_task))
    ask = lists.messages[ListTopics]
    for number in range(80):
        ask(ListTopics(number))
        await asyncio.sleep(0.125)
    await asyncio.sleep(2.0)
    answers = [each.request for each in sent if isinstance(each, TopicList)]
    assert 10 <= len(answers) <= 12
    assert (answers[0], answers[-1]) == (0, 79)
    await asyncio.sleep(5.0)
    ask(ListTopics(80))
    await asyncio.sleep(0.01)
    assert [each.request for each in sent if isinstance(each, TopicList)][-1] == 80


async def test_types_are_answered_at_a_limited_rate(side: Side) -> None:
    async def find() -> ControlMessageBase:
        return TypeText(route=1)

    for number in range(1000):
        side.questions.answer(number, find)
        await asyncio.sleep(0.01)
    assert QUESTIONS_KEPT < len(side.sent) < 60


async def test_questions_are_asked_again_on_next_connection(side: Side) -> None:
    """Neither questions nor answers are kept while there is none."""
    asking = asyncio.ensure_future(side.ask())
    side.asked(1)
    await asyncio.sleep(0.5)
    side.questions.suspend()
    await asyncio.sleep(2.0)
    assert side.sent == [AskType(route=3)]
    side.questions.resume()
    assert side.sent == [AskType(route=3)] * 2
    side.questions.answered(3, b"yes")
    assert await asking == b"yes"
