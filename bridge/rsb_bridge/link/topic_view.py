"""One viewer's pictures of topics in this side's domain: subscribes, and has the newest messages drawn."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.link.errors import LinkError
from rsb_bridge.model.pictures import MOST_RATE, Picture, Wish
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.ros_graph import agreed_type
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.view.worker import Sample, Task

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import RawMessage, Subscription
    from rsb_bridge.view.renderer import Renderer

KEPT_BYTES, KEPT_MESSAGES = 256 << 10, 2000
"""Messages between two pictures that are kept for the next one, of each topic; the newest is always kept."""
MESSAGE_LIMIT = 64 << 20
"""Bytes of a message that is drawn at most."""
_RESOLVE_EVERY = 2.0
"""s without a message after which publishers and their QoS are looked up again."""
_DEPTH = 10
_SLOWEST = 0.05
"""Hz of pictures at the least, whatever is wished."""


class ViewProblem(Wording):
    """The reason why a topic cannot be viewed."""

    NO_PUBLISHER = "{topic} has no publisher here"
    TYPES_DIFFER = "{topic} has publishers of several types"
    TYPE_UNKNOWN = "{topic}: the type {type_name} is not installed there, and no node of the topic describes it"


class Viewable(NamedTuple):
    """A topic as it is published here.

    Attributes:
        type_name: ``pkg/msg/Name``.
        type_hash: ``RIHS01_...``.
        qos: of a subscription that gets its messages.
    """

    type_name: str
    type_hash: str
    qos: Qos


class _Feed:
    """The messages of one topic between two pictures. The ROS thread adds, the I/O thread takes."""

    def __init__(self, topic: str, viewable: Viewable) -> None:
        self.topic = topic
        self.viewable = viewable
        self.subscription: Subscription | None = None
        self.seen = 0
        self.size = 0
        self._lock = threading.Lock()
        self._kept: deque[RawMessage] = deque()
        self._bytes = 0

    def add(self, batch: Sequence[RawMessage]) -> None:
        """Add messages, and forget the oldest beyond the limits."""
        with self._lock:
            self.seen += len(batch)
            self.size = len(batch[-1].payload)
            for message in batch:
                self._kept.append(message)
                self._bytes += len(message.payload)
            while len(self._kept) > 1 and (self._bytes > KEPT_BYTES or len(self._kept) > KEPT_MESSAGES):
                self._bytes -= len(self._kept.popleft().payload)

    def take(self) -> list[Sample]:
        """Return the kept messages, and keep none."""
        with self._lock:
            kept, self._kept, self._bytes = self._kept, deque(), 0
        name = self.viewable.type_name
        return [
            Sample(self.topic, name, each.payload, each.stamp) for each in kept if len(each.payload) <= MESSAGE_LIMIT
        ]

    def close(self) -> None:
        if self.subscription is not None:
            self.subscription.close()


class TopicView:
    """Draws topics for one viewer until it is closed.

    Args:
        context: the engine's.
        renderer: draws.
        number: of the view, among all of the engine.
        topics: their names here; the first one gives the kind of picture.
        wish: the viewer's.
        deliver: takes each picture, and returns when the next one may be drawn.
        bridged: returns a topic that this bridge itself publishes, or None.

    Attributes:
        wish: may be changed at any time by `change`.
    """

    def __init__(
        self,
        context: Context,
        renderer: Renderer,
        number: int,
        topics: tuple[str, ...],
        wish: Wish,
        deliver: Callable[[Picture], Awaitable[None]],
        bridged: Callable[[str], Viewable | None] = lambda _: None,
    ) -> None:
        self._context = context
        self._renderer = renderer
        self._number = number
        self._origin: Hashable = ("view", number)
        self._deliver = deliver
        self._bridged = bridged
        self.topics = topics
        self.wish = wish
        self._feeds: dict[str, _Feed] = {}
        self._descriptions: dict[str, tuple[str, str, str]] = {}
        self._news = asyncio.Event()
        self._has_news = False

    def change(self, topics: tuple[str, ...], wish: Wish) -> None:
        """Draw other topics, or in another way."""
        if (topics, wish) != (self.topics, self.wish):
            self.topics, self.wish = topics, wish
            self._news.set()

    async def check(self) -> None:
        """Find the first topic.

        Raises:
            LinkError: it cannot be viewed.
        """
        await self._feed(self.topics[0])

    async def run(self) -> None:
        """Draw until this is cancelled."""
        now = self._context.now
        try:
            while True:
                began = now()
                try:
                    await self._open_feeds()
                    picture = await self._draw()
                except LinkError as error:
                    picture = Picture(problem=str(error))
                if picture.content is not None or picture.problem or picture.messages:
                    await self._deliver(picture)
                await asyncio.sleep(began + 1 / max(_SLOWEST, min(MOST_RATE, self.wish.rate)) - now())
                await self._until_news()
        finally:
            for feed in self._feeds.values():
                feed.close()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.shield(self._renderer.forget(self._number))

    async def _until_news(self) -> None:
        """Wait for a message or a changed wish, or for the time to look publishers up again."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_RESOLVE_EVERY):
                await self._news.wait()
        self._news.clear()
        self._has_news = False

    async def _draw(self) -> Picture:
        samples: list[Sample] = []
        seen = size = 0
        for topic in self.topics:
            if (feed := self._feeds.get(topic)) is not None:
                samples += feed.take()
                seen += feed.seen
                size = size or feed.size
        first = self._feeds[self.topics[0]].viewable.type_name
        task = Task(self._number, first, self.wish, tuple(samples), seen, size, tuple(self._descriptions.values()))
        return await self._renderer.draw(task)

    async def _open_feeds(self) -> None:
        for topic in [topic for topic in self._feeds if topic not in self.topics]:
            self._feeds.pop(topic).close()
        for topic in self.topics:
            try:
                await self._feed(topic)
            except LinkError:
                if topic == self.topics[0]:
                    raise

    async def _feed(self, topic: str) -> None:
        """Subscribe to a topic, or again if its publishers have changed."""
        viewable = await self._resolve(topic)
        feed = self._feeds.get(topic)
        if feed is not None and feed.viewable == viewable:
            return
        if feed is not None:
            feed.close()
        text = await self._context.descriptions.find(viewable.type_name, viewable.type_hash, topic)
        if text is None:
            raise LinkError(ViewProblem.TYPE_UNKNOWN(topic=topic, type_name=viewable.type_name))
        self._descriptions[viewable.type_name] = viewable.type_name, text, viewable.type_hash
        feed = self._feeds[topic] = _Feed(topic, viewable)
        try:
            feed.subscription = self._context.ros.subscribe(
                topic, viewable.type_name, viewable.type_hash, viewable.qos, self._sink(feed), self._origin
            )
        except RosError as error:
            del self._feeds[topic]
            raise LinkError(str(error)) from None

    def _sink(self, feed: _Feed) -> Callable[[Sequence[RawMessage]], None]:
        def sink(batch: Sequence[RawMessage]) -> None:
            feed.add(batch)
            if not self._has_news:
                self._has_news = True
                self._context.call(self._news.set)

        return sink

    async def _resolve(self, topic: str) -> Viewable:
        feed = self._feeds.get(topic)
        if feed is not None and self._has_news:
            return feed.viewable
        if (viewable := self._bridged(topic)) is not None:
            return viewable
        try:
            publishers = await asyncio.to_thread(self._context.ros.publishers, topic)
        except RosError as error:
            raise LinkError(str(error)) from None
        if not publishers:
            if feed is not None:
                return feed.viewable
            raise LinkError(ViewProblem.NO_PUBLISHER(topic=topic))
        type_name, type_hash = agreed_type(publishers)
        if not type_name:
            raise LinkError(ViewProblem.TYPES_DIFFER(topic=topic))
        return Viewable(type_name, type_hash, _qos_for([each.qos for each in publishers]))


def _qos_for(offered: Sequence[Qos]) -> Qos:
    """Return the QoS of a subscription that matches all publishers, and gets the messages kept for late joiners."""
    return Qos(
        reliability="reliable" if all(each.reliability == "reliable" for each in offered) else "best_effort",
        durability="transient_local" if all(each.latched for each in offered) else "volatile",
        depth=_DEPTH,
    )
