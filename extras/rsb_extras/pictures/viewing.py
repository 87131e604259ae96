"""The views of an engine's consoles: opens each where its topic is published, and ends it when nobody looks."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from rsb_bridge.feature_api import EnginePart, LinkError, Receiver, RosError, Sender, TopicSpec, Wording, check_names
from rsb_bridge.tasks import Tasks
from rsb_extras.pictures.link_views import LinkViews
from rsb_extras.pictures.look_requests import EndLook, LookAtTopics
from rsb_extras.pictures.picture import Picture, Viewed, encode_picture
from rsb_extras.pictures.renderer import renderer_of
from rsb_extras.pictures.topic_view import TopicView

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.feature_api import Bridge, Context, Link, Snapshot
    from rsb_extras.pictures.link_views import PeerView

VIEWS = 12
"""Views of all consoles at the same time. A round figure: one process draws them all."""
WAITS_AT_MOST = 10.0
"""s after which a console gets None, and asks again, as `route.peeking.WAITS_AT_MOST`."""
ENDS_AFTER = 5.0
"""s without a question after which a view ends: its console is gone. A round figure."""


class LookProblem(Wording):
    """The reason why a console gets no picture."""

    NOWHERE = "{topic} has no publisher on this side or {others}"


class _OwnView:
    """A view of topics of this side, which has them drawn."""

    def __init__(self, context: Context, command: LookAtTopics, bridged: Callable[[str], TopicSpec | None]) -> None:
        self._context = context
        self._newest: Picture | None = None
        self._news = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._drawing = TopicView(context, command.topics, command.wish, self._deliver, bridged)

    async def begin(self, tasks: Tasks) -> None:
        """Find the topic, and draw from now on.

        Raises:
            LinkError: it cannot be viewed.
        """
        await self._drawing.check()
        self._task = self._drawing.start(tasks.spawn)

    async def _deliver(self, picture: Picture) -> None:
        self._newest = picture
        self._news.set()

    async def next(self, command: LookAtTopics) -> Viewed | None:
        self._drawing.change(command.topics, command.wish)
        try:
            async with asyncio.timeout(WAITS_AT_MOST):
                await self._news.wait()
        except TimeoutError:
            return None
        self._news.clear()
        picture, self._newest = self._newest, None
        if picture is None:
            return None
        # The clock may have been set back since.
        age = max(0.0, self._context.wall() - picture.taken / 1e9) if picture.taken else None
        return Viewed(picture, "", age, len(encode_picture(picture)))

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._drawing.close()


class _ViewThere:
    """A view of a peer's topics."""

    def __init__(self, link: Link, view: PeerView) -> None:
        self._link, self._view = link, view

    async def next(self, command: LookAtTopics) -> Viewed | None:
        topics = tuple(_peer_name(self._link, topic) for topic in command.topics)
        return await views_of(self._link).next_picture(self._view, topics, command.wish, WAITS_AT_MOST)

    def close(self) -> None:
        views_of(self._link).close_view(self._view)


class _View:
    """A console's view, which may change its topics.

    Attributes:
        place: link and topics of `open`.
        open: what shows them, or None if the next question has to look for the topics.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Lock()
        self.asking = 0
        self.used_at = 0.0
        self.place: tuple[str, tuple[str, ...]] = ("", ())
        self.open: _OwnView | _ViewThere | None = None

    def close(self) -> None:
        if self.open is not None:
            self.open.close()
            self.open = None


class Viewing(EnginePart):
    """Answers `LookAtTopics` and `EndLook`."""

    def __init__(self, bridge: Bridge) -> None:
        super().__init__()
        self._context = bridge.context
        self._links = bridge.role.links
        self._renderer = bridge.context.shared(renderer_of)
        self._tasks = Tasks(bridge.context.loop, lambda: None)
        self._views: dict[str, _View] = {}
        self.handlers = {EndLook: self.end, LookAtTopics: self.next_picture}

    async def next_picture(self, command: LookAtTopics) -> Viewed | None:
        """Return a console's next picture, or None if none comes for some time.

        Raises:
            LinkError: there is no picture of the topic.
        """
        view = self._views.get(command.viewer)
        if view is None:
            if len(self._views) >= VIEWS:
                raise LinkError(f"{VIEWS} views are open here already: close one of them")
            view = self._views[command.viewer] = _View()
        view.asking += 1
        try:
            async with view.turn:  # a console that gave up may ask again at once
                return await self._next(view, command)
        except LinkError:
            view.close()  # the next question looks for the topic again
            raise
        finally:
            view.asking -= 1
            view.used_at = self._context.now()
            if self._views.get(command.viewer) is not view:  # it was ended while it was opened
                view.close()

    async def end(self, command: EndLook) -> None:
        """End a console's view, which may have ended."""
        if (view := self._views.pop(command.viewer, None)) is not None:
            view.close()

    async def _next(self, view: _View, command: LookAtTopics) -> Viewed | None:
        place = command.link, command.topics
        if view.open is None or view.place != place:
            view.close()
            view.open, view.place = await self._opened(command), place
            if self._views.get(command.viewer) is not view:
                raise LinkError("the view is closed")
        return await view.open.next(command)

    async def _opened(self, command: LookAtTopics) -> _OwnView | _ViewThere:
        check_names(command.topics)
        link = await self._place(command.topics[0], command.link)
        if link is not None:
            return _ViewThere(link, await views_of(link).open())
        view = _OwnView(self._context, command, self._bridged)
        try:
            await view.begin(self._tasks)
        except BaseException:  # the asker may be cancelled
            view.close()
            raise
        return view

    async def _place(self, topic: str, link_name: str) -> Link | None:
        """Return the link to the side that publishes a topic, or None if this side does.

        Raises:
            LinkError: neither side publishes it, as far as this one knows.
        """
        links = self._links()
        if link_name:
            named = next((each for each in links if each.name == link_name), None)
            if named is None:
                raise LinkError(f"there is no link {link_name!r}")
            return named
        if self._bridged(topic) is not None:
            return None
        try:
            if await asyncio.to_thread(self._context.ros.publishers, topic):
                return None
        except RosError as error:
            raise LinkError(str(error)) from None
        for link in links:
            if not link.linked:
                continue
            with contextlib.suppress(LinkError):  # one side that does not answer hides no other
                if any(
                    each.topic == _peer_name(link, topic) and each.publishers for each in await link.topic_lists.ask()
                ):
                    return link
        others = "any side that is linked" if links else "another side"
        raise LinkError(LookProblem.NOWHERE(topic=topic, others=others))

    def _bridged(self, topic: str) -> TopicSpec | None:
        """Return a topic that a link brings to this side, or None."""
        for link in self._links():
            for route in link.routes.values():
                if not isinstance(route.half, Sender | Receiver) or route.outgoing or route.local_topic != topic:
                    continue
                flow = route.half.flow
                if route.crossing.flows and flow.type_hash and flow.qos is not None:
                    return TopicSpec(topic, flow.type_name, flow.type_hash, flow.qos)
        return None

    def tick(self, snapshot: Snapshot) -> None:
        """End the views that nobody looks at, and the process that draws if it has nothing to do."""
        now = self._context.now()
        for viewer, view in list(self._views.items()):
            # A question may wait for longer than that.
            if not view.asking and now - view.used_at > ENDS_AFTER:
                del self._views[viewer]
                view.close()
        self._renderer.end_if_idle()

    async def close(self) -> None:
        """End all views."""
        for view in self._views.values():
            view.close()
        self._views.clear()
        self._renderer.close()


def views_of(link: Link) -> LinkViews:
    return link.extensions.find(LinkViews)


def _peer_name(link: Link, topic: str) -> str:
    """Return the peer's name of a topic that this side's operator may name with the client's name before it."""
    prefix = f"/{link.name}/"
    return topic[len(prefix) - 1 :] if not link.is_client and topic.startswith(prefix) else topic
