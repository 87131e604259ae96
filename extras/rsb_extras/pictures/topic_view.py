"""One viewer's pictures of topics in this side's domain: subscribes, and has the newest messages drawn."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
from collections import deque
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.feature_api import LinkError, Qos, RosError, TopicSpec, Wording, sanitize_text
from rsb_bridge.model.qos import AUTO_DEPTH
from rsb_bridge.ros.ros_graph import agreed_type
from rsb_bridge.wire.framing import MESSAGE_LIMIT
from rsb_extras.pictures.drawing import VIEWS, is_map
from rsb_extras.pictures.picture import MOST_RATE, Picture, Wish
from rsb_extras.pictures.renderer import renderer_of
from rsb_extras.pictures.worker import TakenSample, Task

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Hashable, Sequence

    from rsb_bridge.feature_api import Context, RawMessage, Tap
    from rsb_bridge.ros.ros_interface import Subscription

KEPT_BYTES, KEPT_MESSAGES = 256 << 10, 2000
"""Messages between two pictures that are kept for the next one, of each topic; the newest is always kept. Round
figures: nothing was measured."""
_RESOLVE_EVERY = 2.0
"""s after which publishers and their QoS are looked up again. A round figure, as the two below."""
_LATCHED_AGAIN_AFTER = 10.0
"""s after which kept messages may be asked for once more: one of them may be what ends the process that draws."""
_LARGE = (VIEWS["sensor_msgs/msg/Image"], VIEWS["sensor_msgs/msg/PointCloud2"])
"""Views of types whose messages may be larger than what DDS has room for."""
FRAMES = ("/tf", "/tf_static")
"""Topics of transforms, which a map needs though its viewer does not name them: they do not leave this side."""
_SLOWEST = 0.05
"""Hz of pictures at the least, also where less is wished."""


class ViewProblem(Wording):
    """The reason why a topic cannot be viewed."""

    MESSAGE_TOO_LARGE = "{topic}: a message of {size:,} bytes is not drawn; the limit is {limit:,} bytes"
    UNHEARD = "{publishers}, nothing heard in {seconds:.0f} s"
    UNHEARD_LARGE = "{publishers}, nothing heard in {seconds:.0f} s; large messages need a Fast DDS profile there"
    TYPE_UNKNOWN = "{topic}: the type {type_name} is not installed there, and no node of the topic describes it"


class _Feed:
    """The messages of one topic between two pictures. The ROS thread adds, the I/O thread takes.

    Attributes:
        is_asked: whether the viewer named the topic.
        authors: names of the nodes that publish it, by their publishers' ids, or None if this bridge publishes it.
    """

    def __init__(self, viewable: TopicSpec, description: str, *, is_asked: bool) -> None:
        self.viewable = viewable
        self.is_asked = is_asked
        self.description = viewable.type_name, description, viewable.type_hash
        self.resolved_at = 0.0
        self.subscription: Subscription | None = None
        self.authors: dict[bytes, str] | None = None
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
                if len(message.payload) <= MESSAGE_LIMIT:
                    self._kept.append(message)
                    self._bytes += len(message.payload)
            while len(self._kept) > 1 and (self._bytes > KEPT_BYTES or len(self._kept) > KEPT_MESSAGES):
                self._bytes -= len(self._kept.popleft().payload)

    def take(self) -> list[TakenSample]:
        """Return the kept messages, and keep none."""
        with self._lock:
            kept, self._kept, self._bytes = self._kept, deque(), 0
        topic, name, *_ = self.viewable
        authors = self.authors or {}
        return [
            TakenSample(topic, name, each.payload, each.stamp, authors.get(each.gid, ""), self.is_asked)
            for each in kept
        ]

    def close(self) -> None:
        if self.subscription is not None:
            self.subscription.close()


class TopicView:
    """Draws topics for one viewer until it is closed.

    Args:
        topics: their names here; the first one gives the kind of picture.
        deliver: takes each picture, and returns when the next one may be drawn.
        bridged: returns a topic that this bridge itself publishes, or None.
        may_look: whether the viewer may look at a topic that it did not name.

    Attributes:
        wish: may be changed at any time by `change`.
    """

    def __init__(
        self,
        context: Context,
        topics: tuple[str, ...],
        wish: Wish,
        deliver: Callable[[Picture], Awaitable[None]],
        bridged: Callable[[str], TopicSpec | None] = lambda _: None,
        may_look: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self._context = context
        self._renderer = context.shared(renderer_of)
        self._number = self._renderer.next_view()
        self._origin: Hashable = ("view", self._number)
        self._deliver = deliver
        self._bridged = bridged
        self._may_look = may_look
        self._finding_frames: asyncio.Task[None] | None = None
        self.topics = topics
        self.wish = wish
        self._feeds: dict[str, _Feed] = {}
        self._news = asyncio.Event()
        self._has_news = False
        self._is_closed = False
        self._absent: dict[str, float] = {}
        """Layers that could not be subscribed to lately, and when."""
        self._seen_before = 0
        """Messages of feeds that are closed."""
        self._began = context.now()
        self._starts = 0
        """Of the renderer, with the last picture."""
        self._lacks_latched = False
        """Whether a view that is drawn again lacks the messages that publishers keep, since they come only once."""
        self._latched_at = -math.inf

    def change(self, topics: tuple[str, ...], wish: Wish, *, again: bool = False) -> None:
        """Draw other topics, or in another way, or the same again without waiting for a message."""
        if again or (topics, wish) != (self.topics, self.wish):
            self._lacks_latched |= wish.how != self.wish.how
            self.topics, self.wish = topics, wish
            self._news.set()

    async def check(self) -> None:
        """Find the first topic.

        Raises:
            LinkError: it cannot be viewed.
        """
        await self._feed(self.topics[0])

    def start(self, spawn: Callable[[Coroutine[None, None, None]], asyncio.Task[None]]) -> asyncio.Task[None]:
        """Draw in a task. When that ends, even if it never began to run, the view is closed."""
        task = spawn(self._run())
        task.add_done_callback(lambda _: self.close())
        return task

    def close(self) -> None:
        """End the subscriptions, for good."""
        if not self._is_closed:
            self._is_closed = True
            if self._finding_frames is not None:
                self._finding_frames.cancel()
            for topic in [*self._feeds]:
                self._close_feed(topic)
            self._renderer.forget(self._number)

    async def _run(self) -> None:
        now = self._context.now
        while True:
            began, topics = now(), self.topics  # which may change meanwhile
            try:
                await self._open_feeds(topics)
                picture = await self._draw(topics)
            except LinkError as error:
                picture = Picture(problem=sanitize_text(str(error)))
            await self._deliver(picture)
            due = began + 1 / max(_SLOWEST, min(MOST_RATE, self.wish.rate))
            await asyncio.sleep(max(due - now(), self._renderer.pause_after(self._number)))
            await self._until_news()

    async def _until_news(self) -> None:
        """Wait for a message or a changed wish, or for the time to look publishers up again."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_RESOLVE_EVERY):
                await self._news.wait()
        self._news.clear()
        self._has_news = False

    async def _draw(self, topics: tuple[str, ...]) -> Picture:
        samples: list[TakenSample] = []
        seen, size, problem = self._seen_before, 0, ""
        feeds = [feed for topic in topics if (feed := self._feeds.get(topic)) is not None]
        frames = [feed for topic, feed in self._feeds.items() if topic not in topics]
        for feed in frames:
            samples += feed.take()
        for feed in feeds:
            samples += feed.take()
            seen += feed.seen
            size = size or feed.size
            if feed.size > MESSAGE_LIMIT:
                problem = ViewProblem.MESSAGE_TOO_LARGE(topic=feed.viewable.topic, size=feed.size, limit=MESSAGE_LIMIT)
        descriptions = tuple({feed.viewable.type_name: feed.description for feed in (*frames, *feeds)}.values())
        now = int(self._context.wall() * 1e9)
        task = Task(self._number, feeds[0].viewable.type_name, self.wish, tuple(samples), seen, size, descriptions, now)
        picture = await self._renderer.draw(task)
        self._lacks_latched |= self._starts not in (0, self._renderer.starts)
        self._starts = self._renderer.starts
        waiting = "" if seen or picture.problem else self._unheard(feeds[0])
        return msgspec.structs.replace(picture, problem=picture.problem or sanitize_text(problem), waiting=waiting)

    def _unheard(self, feed: _Feed) -> str:
        """Describe a topic without a message: its publishers, and how long it is silent."""
        count = None if feed.authors is None else len(feed.authors)
        publishers = "published by the bridge" if count is None else f"{count or 'no'} publisher{'s' * (count != 1)}"
        reliability = feed.viewable.qos.reliability.replace("_", " ")
        text = ViewProblem.UNHEARD_LARGE if VIEWS.get(feed.viewable.type_name) in _LARGE else ViewProblem.UNHEARD
        return text(publishers=f"{publishers}, {reliability}", seconds=self._context.now() - self._began)

    async def _open_feeds(self, topics: tuple[str, ...]) -> None:
        now = self._context.now()
        again = self._lacks_latched and now - self._latched_at > _LATCHED_AGAIN_AFTER
        if again:
            self._lacks_latched, self._latched_at = False, now
        frames = self._frames(topics)
        for topic, feed in [*self._feeds.items()]:
            if topic not in (*topics, *frames) or (again and feed.viewable.qos.latched):
                self._close_feed(topic)
                if topic in FRAMES and not feed.is_asked and not self._may_look(topic):
                    self._renderer.forget(self._number)  # what the viewer may no longer see is in no further picture
                    self._lacks_latched = True
        self._absent = {
            topic: at for topic, at in self._absent.items() if topic in (*topics, *frames) and now - at < _RESOLVE_EVERY
        }
        for topic in topics:
            if topic in self._absent:
                continue
            try:
                await self._feed(topic)
            except LinkError:
                if topic == topics[0]:
                    raise
                self._absent[topic] = now
        frames = self._frames(topics)  # the first topic's type is known by now
        if frames and (self._finding_frames is None or self._finding_frames.done()):
            # Not awaited: to ask nodes for a type takes seconds, in which the map would stand still.
            self._finding_frames = asyncio.create_task(self._open_frames(frames))

    def _frames(self, topics: tuple[str, ...]) -> tuple[str, ...]:
        """Return the topics of transforms that a map needs, and that its viewer may look at but did not name."""
        first = self._feeds.get(topics[0])
        how = self.wish.how or ("" if first is None else first.viewable.type_name)
        if not (how == "map" or is_map(how)):
            return ()
        return tuple(topic for topic in FRAMES if topic not in topics and self._may_look(topic))

    async def _open_frames(self, frames: tuple[str, ...]) -> None:
        for topic in frames:
            if topic not in self._absent:
                try:
                    await self._feed(topic)
                except LinkError:
                    self._absent[topic] = self._context.now()

    def _close_feed(self, topic: str) -> None:
        feed = self._feeds.pop(topic)
        self._seen_before += feed.seen * feed.is_asked
        feed.close()

    async def _feed(self, topic: str) -> None:
        """Subscribe to a topic, or again if its publishers have changed."""
        viewable, authors = await self._resolve(topic)
        feed, is_asked = self._feeds.get(topic), topic in self.topics
        if feed is not None and feed.viewable == viewable and feed.is_asked == is_asked:
            feed.authors = authors
            return
        text = await self._context.descriptions.find(viewable.type_name, viewable.type_hash, topic)
        if text is None:
            raise LinkError(ViewProblem.TYPE_UNKNOWN(topic=topic, type_name=viewable.type_name))
        if self._is_closed:  # while its type was asked for: nobody would close the subscription
            raise LinkError("the view is closed")
        if feed is not None:
            self._close_feed(topic)
        feed = self._feeds[topic] = _Feed(viewable, text, is_asked=is_asked)
        feed.resolved_at, feed.authors = self._context.now(), authors
        try:
            feed.subscription = self._context.ros.subscribe(viewable, self._sink(feed), self._origin)
        except RosError as error:
            del self._feeds[topic]
            raise LinkError(str(error)) from None

    def _sink(self, feed: _Feed) -> Callable[[Sequence[RawMessage]], None]:
        def sink(batch: Sequence[RawMessage]) -> None:
            feed.add(batch)
            if not self._has_news:
                self._has_news = True
                self._context.call(self._news.set)

        tap = self._context.tap_of(feed.viewable.topic, feed.viewable)
        if tap is None:
            return sink

        def tapped(batch: Sequence[RawMessage]) -> None:
            sink(batch)
            self._context.call(partial(_hand_to, tap, batch, self._context.wall_ns()))

        return tapped

    async def _resolve(self, topic: str) -> tuple[TopicSpec, dict[bytes, str] | None]:
        """Return a topic as it is published now, and its publishers' nodes as in `_Feed.authors`.

        Raises:
            LinkError: it cannot be viewed.
        """
        feed = self._feeds.get(topic)
        if feed is not None and self._context.now() - feed.resolved_at < _RESOLVE_EVERY:
            return feed.viewable, feed.authors
        if feed is not None:  # before the graph is asked: a look that fails is not repeated for each picture
            feed.resolved_at = self._context.now()
        if (viewable := self._bridged(topic)) is not None:
            return viewable, None
        try:
            publishers = await asyncio.to_thread(self._context.ros.publishers, topic)
        except RosError as error:
            raise LinkError(str(error)) from None
        if not publishers:
            if feed is not None:  # its publisher may come back, and is heard then
                return feed.viewable, {}
            raise LinkError(f"{topic} has no publisher here")
        type_name, type_hash = agreed_type(publishers)
        if not type_name:
            raise LinkError(f"{topic} has publishers of several types")
        authors = {each.gid: each.node for each in publishers}
        return TopicSpec(topic, type_name, type_hash, _qos_for([each.qos for each in publishers])), authors


def _hand_to(tap: Tap, batch: Sequence[RawMessage], time_ns: int) -> None:
    for each in batch:
        tap(each.payload, time_ns, each.source or time_ns, each.gid, each.number)


def _qos_for(offered: Sequence[Qos]) -> Qos:
    """Return the QoS of a subscription that matches all publishers, and gets the messages kept for late joiners."""
    return Qos(
        reliability="reliable" if all(each.reliability == "reliable" for each in offered) else "best_effort",
        durability="transient_local" if all(each.latched for each in offered) else "volatile",
        depth=AUTO_DEPTH,
    )
