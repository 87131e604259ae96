"""Pictures of one peer's topics for this side's viewers, and of this side's topics for the peer's.

Each view has an internal route of its own, at the lowest priority. So its pictures are sealed, limited and counted like
messages, and give way to them. `Look` tells the sending side what to draw.
"""

from __future__ import annotations

import asyncio
import contextlib
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from rsb_bridge.config.rights import Use
from rsb_bridge.feature_api import (
    BytesDrain,
    BytesSource,
    ControlMessageBase,
    Count,
    DeniedUse,
    Extension,
    InternalRoutes,
    Level,
    LinkError,
    Name,
    Purpose,
    Questions,
    Reason,
    RouteId,
    Wording,
    check_names,
    sanitize_text,
)
from rsb_extras.pictures.picture import (
    PICTURE_LIMIT,
    TOPICS_AT_ONCE,
    Picture,
    PictureError,
    Viewed,
    Wish,
    decode_picture,
    encode_picture,
    is_unchanged,
)
from rsb_extras.pictures.topic_view import TopicView

if TYPE_CHECKING:
    from rsb_bridge.feature_api import Context, Link, Rights, Route
    from rsb_extras.pictures.picture import Cells, Pixels, Series

VIEWS_OF_PEER = 9
"""Views that one peer has at the same time (docs/picture-protocol.md): as many as a screen has tiles."""
_ANSWERED_WITHIN = 15.0
"""s: the other side may have to ask three nodes for a type, 2.5 s each (`ros.type_descriptions`). A round figure."""
_LOOK_EVERY = 0.5
"""s after which a viewer that waits finds out that its route has another opening. A round figure: a restart takes as
long."""
_ENDED = "the view is closed"


VIEW = Purpose(
    "view",
    is_shown=False,
    type_name="rsb_bridge/msg/Picture",
    type_hash="RIHS01_" + "1" * 64,
)
"""Pictures of messages, for a viewer on the side that proposes the route."""


class ViewCode(StrEnum):
    """Codes of the events that views log; they stay as they are, for programs that read the log."""

    BEGAN = "link.view_began"
    """The other side looks at pictures of a topic of this side."""
    ENDED = "link.view_ended"


class Look(ControlMessageBase, frozen=True):
    """A viewer wants pictures of topics of the other side. Answered by a `LookAnswer` of the same number.

    Attributes:
        route: id of the route that carries the pictures.
        topics: names on the receiving side.
    """

    request: Count
    route: RouteId
    topics: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=TOPICS_AT_ONCE)]
    wish: Wish


class LookAnswer(ControlMessageBase, frozen=True):
    """The answer to `Look`.

    Attributes:
        problem: the reason for a refusal, for an operator, or empty.
    """

    request: Count
    problem: Reason = ""


class ViewRefused(Wording):
    """The reason why the peer gets no picture, or this side none from the peer."""

    TOO_MANY = "{limit} views of this link are open already: close one of them"
    NO_SENDING = "{owner} takes no view from {peer}: the right look lets it receive only"
    NOT_THERE = "the installation of {link} has no pictures: install all of rsb-console there"
    NO_VIEW = "this route carries no pictures"
    NOT_OPENED = "the view was not opened: {reason}"


class PeerView:
    """One view of the peer's topics, on the side of its viewer.

    Attributes:
        unseen: the newest pictures that the viewer has not seen: one with a content, and one that leaves it out.
        content: number and content of the newest one that it has seen.
    """

    def __init__(self, route: Route) -> None:
        self.route = route
        self.unseen: list[bytes] = []
        self.content: tuple[int, Cells | Pixels | Series | None] = 0, None
        self.news = asyncio.Event()
        self.asked: tuple[int, tuple[str, ...], Wish] | None = None
        """The opening, topics and wish that the peer knows, or None if that is not sure."""
        self.sink: BytesDrain | None = None

    def receive(self, encoded: bytes) -> None:
        """Take a picture."""
        if is_unchanged(encoded):
            self.unseen = [*self.unseen[:1], encoded]
        else:
            self.unseen = [encoded]
        self.news.set()


class LinkViews(Extension):
    """One link's views, in both directions."""

    purpose = VIEW

    def __init__(self, link: Link) -> None:
        self._context = link.context
        self._link = link
        self._internal = InternalRoutes(link, link.table, VIEW, BytesSource, BytesDrain)
        self._peer_has = False
        self.messages = {Look: self._asked, LookAnswer: self._answered}
        self._questions: Questions[LookAnswer] = Questions(link, _ANSWERED_WITHIN)
        self._request = 0
        self._number = 0
        self._drawing: dict[int, tuple[TopicView, asyncio.Task[None], _Sender]] = {}
        """Views that are drawn for the peer, by the id of their route's opening."""

    # --- for the peer

    def denial(self, rights: Rights, *, sends: bool) -> DeniedUse | None:
        if not sends:
            return rights.no_look()
        text = ViewRefused.NO_SENDING(owner=rights.owner, peer=rights.peer)
        return DeniedUse(text, "propose it from the side that receives")

    def refusal(self, name: str) -> str:
        # The same view, proposed again, takes its own place.
        own = [route for route in self._internal.proposed(here=False) if route.local_topic != name]
        return ViewRefused.TOO_MANY(limit=VIEWS_OF_PEER) if len(own) >= VIEWS_OF_PEER else ""

    def _asked(self, look: Look) -> None:
        self._questions.answer(look.request, partial(self._answer, look))

    def _answered(self, answer: LookAnswer) -> None:
        self._questions.answered(answer.request, answer)

    async def _answer(self, look: Look) -> LookAnswer:
        try:
            await self._show(look)
        except LinkError as error:
            return LookAnswer(look.request, sanitize_text(str(error)))
        return LookAnswer(look.request)

    async def _show(self, look: Look) -> None:
        """Begin to draw for the peer, or draw something else.

        Raises:
            LinkError: the peer may not, or the topic cannot be viewed.
        """
        route = self._link.ids.open_route(look.route)
        if route is None or route.proposed_here or not route.outgoing or route.purpose is not VIEW:
            raise LinkError(ViewRefused.NO_VIEW())
        check_names(look.topics)
        if refusal := self._refusal(look.topics, route):
            raise LinkError(refusal)
        wish = self._limited(look.topics, look.wish)
        if (drawing := self._drawing.get(look.route)) is not None:
            view, _, sender = drawing
            # The same wish again comes from a viewer that lacks a content.
            sender.send_whole()
            view.change(look.topics, wish, again=True)
            return
        await self._internal.opened(route, look.route)  # the peer may have found it open before this side does
        if (source := self._internal.source(route)) is None:
            raise LinkError(ViewRefused.NO_VIEW())
        sender = _Sender(self._context, source)
        view = TopicView(
            self._context,
            look.topics,
            wish,
            sender.send,
            may_look=lambda topic: not self._refusal((topic,), route),
        )
        await view.check()
        if self._link.ids.open_route(look.route) is not route:  # it was closed while the graph was asked
            view.close()
            raise LinkError(ViewRefused.NO_VIEW())
        self._drawing[look.route] = view, view.start(self._link.spawn), sender
        self._log(look.topics[0], begins=True)

    def _refusal(self, topics: tuple[str, ...], route: Route) -> str:
        """Return why the peer may not look at topics, or an empty string."""
        uses = (Use(topic, "look", route.proposal.transport) for topic in topics)
        return next((str(refusal) for use in uses if (refusal := self._link.end.rights.refusal(use))), "")

    def _limited(self, topics: tuple[str, ...], wish: Wish) -> Wish:
        """Return a wish with the highest rate that the peer may have."""
        limits = [limit for topic in topics if (limit := self._link.end.rights.max_rate(Use(topic, "look")))]
        return msgspec.structs.replace(wish, rate=min(wish.rate, *limits)) if limits else wish

    def _log(self, topic: str, *, begins: bool) -> None:
        text = f"{topic}: {self._link.peer_name} {'looks at pictures of it' if begins else 'stopped looking'}"
        code = ViewCode.BEGAN if begins else ViewCode.ENDED
        self._context.log(Level.INFO, code, text, link=self._link.name, topic=topic)

    def tick(self) -> None:
        """End views whose routes are closed, or whose topics the peer may no longer look at."""
        for opening, (view, task, _) in list(self._drawing.items()):
            route = self._link.ids.open_route(opening)
            if route is not None and (refusal := self._refusal(view.topics, route)):
                self._link.table.deny(route, refusal)
                route = None
            if route is None or task.done():
                self._end(opening)

    def _end(self, opening: int) -> None:
        view, task, _ = self._drawing.pop(opening)
        task.cancel()
        self._log(view.topics[0], begins=False)

    def connected(self) -> None:
        self._peer_has = True

    def disconnected(self) -> None:
        self._peer_has = False
        self._questions.disconnected()
        for opening in [*self._drawing]:  # the next connection may use the same ids
            self._end(opening)

    # --- for this side's viewers

    async def open(self) -> PeerView:
        """Open a view of the peer's topics.

        Raises:
            LinkError: it cannot be opened.
        """
        if not self._link.linked:
            raise LinkError(f"{self._link.name} is not linked: {self._link.down_reason}")
        if not self._peer_has:
            raise LinkError(ViewRefused.NOT_THERE(link=self._link.name))
        if len(self._internal.proposed(here=True)) >= VIEWS_OF_PEER:
            raise LinkError(ViewRefused.TOO_MANY(limit=VIEWS_OF_PEER))
        self._number += 1
        name = VIEW.route_name(str(self._number))
        view = PeerView(
            self._internal.open(
                name, "receive" if self._link.is_client else "transmit", depth=1, compression="zstd", priority="low"
            )
        )
        try:
            await self._opened(view)
        except BaseException:  # the asker may be cancelled
            self.close_view(view)
            raise
        return view

    async def next_picture(self, view: PeerView, topics: tuple[str, ...], wish: Wish, seconds: float) -> Viewed | None:
        """Return the next picture, or None if none comes within so many seconds.

        Args:
            topics: names on the peer's side.

        Raises:
            LinkError: the peer refuses, or the link is lost.
        """
        deadline = self._context.now() + seconds
        while (left := deadline - self._context.now()) > 0:
            await self._ask(view, topics, wish)
            if not view.unseen:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(min(left, _LOOK_EVERY)):
                        await view.news.wait()
            if view.unseen and (viewed := self._viewed(view, view.unseen.pop(0))) is not None:
                return viewed
            view.news.clear()
        return None

    async def _ask(self, view: PeerView, topics: tuple[str, ...], wish: Wish) -> None:
        """Tell the peer what to draw, unless it knows: a link that comes back has a new opening, of which it does not.

        Raises:
            LinkError: the peer refuses, or the link is lost.
        """
        await self._opened(view)
        asked = view.route.id, topics, wish
        if view.asked == asked:
            return
        view.asked = None  # without an answer, the peer may know the former wish or this one
        self._request += 1
        answer = await self._questions.ask(self._request, Look(self._request, *asked))
        if answer.problem:
            raise LinkError(answer.problem)
        view.asked = asked

    def _viewed(self, view: PeerView, encoded: bytes) -> Viewed | None:
        """Return a picture, or None if it leaves out a content that has not come."""
        try:
            picture = decode_picture(encoded)
        except PictureError as error:
            raise LinkError(f"{self._link.name} sent no valid picture: {error}") from None
        if picture.is_unchanged:
            number, content = view.content
            if number != picture.number:
                view.asked = None  # the link has dropped the content: ask for it
                return None
            picture = msgspec.structs.replace(picture, content=content)
        else:
            view.content = picture.number, picture.content
        offset, age = self._link.clock.offset, None
        if picture.taken and offset is not None:
            age = max(0.0, self._context.wall() - picture.taken / 1e9 + offset)
        return Viewed(picture, self._link.name, age, len(encoded))

    def close_view(self, view: PeerView) -> None:
        """End a view."""
        if self._link.routes.get(view.route.key) is view.route:
            self._link.table.remove(view.route, _ENDED)

    async def _opened(self, view: PeerView) -> None:
        """Wait until pictures can cross."""
        route = view.route
        sink = self._internal.drain(route) if await self._internal.opened(route) else None
        if sink is None:
            trouble = route.trouble()
            raise LinkError(
                str(route.life.refusal) or ViewRefused.NOT_OPENED(reason=trouble.text if trouble is not None else "")
            )
        if view.sink is not sink:  # each opening has its own, and numbers contents anew
            view.unseen, view.content = [], (0, None)
            view.sink, sink.taken = sink, partial(self._arrived, view)

    def _arrived(self, view: PeerView, encoded: bytes) -> None:
        """Take a picture; on the ROS thread, if that does the I/O thread's work."""
        self._context.call(partial(view.receive, encoded))


class _Sender:
    """Sends one view's pictures, and a content that stays the same only once."""

    def __init__(self, context: Context, source: BytesSource) -> None:
        self._context, self._source = context, source
        self._content: Cells | Pixels | Series | None = None
        self._number = 0

    def send_whole(self) -> None:
        """Send the next picture with its content, which the viewer may lack."""
        self._content = None

    async def send(self, picture: Picture) -> None:
        """Send a picture, on a thread that may wait for the link's queue.

        The link counts from now: the time before, in which the picture was drawn, is no sign that the link is full.
        """
        if picture.content is not None and picture.content == self._content:
            picture = msgspec.structs.replace(picture, content=None, number=self._number, is_unchanged=True)
        else:
            self._number += 1
            self._content = picture.content
            picture = msgspec.structs.replace(picture, number=self._number)
        encoded = encode_picture(picture)
        assert len(encoded) <= PICTURE_LIMIT
        await asyncio.to_thread(self._source.send, encoded, self._context.wall_ns())
