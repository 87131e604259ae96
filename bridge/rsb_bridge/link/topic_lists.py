"""The two sides of a link tell each other which topics their ROS graphs have."""

from __future__ import annotations

import asyncio
import itertools
from typing import TYPE_CHECKING

from rsb_bridge.link.errors import LinkError
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import TopicInfo
from rsb_bridge.wire.messages import ControlMessage, ListTopics, TopicList
from rsb_bridge.wire.records import TopicEntry

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine

_ANSWER_WITHIN = 5.0
_MOST_TOPICS = 2000
"""In one list: a control frame holds about three times as many of usual names (PROTOCOL.md section 1)."""


class TopicLists:
    """Asks the peer for its topics, and answers when it asks for ours.

    Args:
        local_topics: this side's topics, those only that the peer may see.
        send: sends a control message.
        spawn: runs a coroutine beside.
    """

    def __init__(
        self,
        local_topics: Callable[[], Awaitable[list[TopicInfo]]],
        send: Callable[[ControlMessage], None],
        spawn: Callable[[Coroutine[None, None, None]], object],
    ) -> None:
        self._local_topics = local_topics
        self._send = send
        self._spawn = spawn
        self._numbers = itertools.count(1)
        self._requests: dict[int, asyncio.Future[tuple[TopicEntry, ...]]] = {}
        self._answering = False

    def disconnected(self) -> None:
        """The connection is over: nobody will answer."""
        for future in self._requests.values():
            if not future.done():
                future.set_exception(LinkError("the link was lost"))
        self._requests.clear()

    def handle(self, message: ListTopics | TopicList) -> None:
        """Answer the peer's question, or take its answer."""
        match message:
            case ListTopics() if not self._answering:
                self._answering = True
                self._spawn(self._answer(message.request))
            case ListTopics():
                pass  # one at a time: the answer costs more than the question
            case TopicList():
                future = self._requests.get(message.request)
                if future is not None and not future.done():
                    future.set_result(message.topics)

    async def _answer(self, request: int) -> None:
        try:
            topics = await self._local_topics()
        finally:
            self._answering = False
        entries = tuple(
            TopicEntry(t.topic, t.type_name, t.type_hash, t.qos, t.publishers, t.subscriptions)
            for t in topics[:_MOST_TOPICS]
            if max(len(t.topic), len(t.type_name)) <= TEXT_LENGTH
        )
        self._send(TopicList(request=request, topics=entries))

    async def ask(self) -> list[TopicInfo]:
        """The peer's topics.

        Raises:
            LinkError: the link is lost meanwhile, or the peer does not answer.
        """
        request = next(self._numbers)
        future = self._requests[request] = asyncio.get_running_loop().create_future()
        self._send(ListTopics(request=request))
        try:
            async with asyncio.timeout(_ANSWER_WITHIN):
                entries = await future
        except TimeoutError:
            raise LinkError("the other side did not answer") from None
        finally:
            self._requests.pop(request, None)
        return [TopicInfo(e.topic, e.type, e.type_hash, e.qos, e.publishers, e.subscriptions) for e in entries]
