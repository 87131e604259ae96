"""What the two sides of a link say to each other about routes and topics."""

from __future__ import annotations

import asyncio
import itertools
from typing import TYPE_CHECKING

from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.proposals import same_route, topic_of
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import ROUTES_PER_LINK, TEXT_LENGTH
from rsb_bridge.model.snapshot import Level, TopicInfo
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.graph import topics_of
from rsb_bridge.route.incoming import IncomingRoute
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.route import Route, route_key
from rsb_bridge.transport.transport import ListenError
from rsb_bridge.wire.messages import (
    Accept,
    Close,
    ControlMessage,
    Describe,
    ListTopics,
    Pause,
    Ping,
    Pong,
    Propose,
    Ready,
    Refuse,
    Report,
    Shutdown,
    TopicList,
)
from rsb_bridge.wire.records import TopicEntry

if TYPE_CHECKING:
    from rsb_bridge.link.link import Link
    from rsb_bridge.wire.fields import RefuseCode

_ANSWER_WITHIN = 30.0
"""Seconds; a peer that is gone ends the link sooner, and a long list takes its time on a slow one."""
_MOST_TOPICS = 2000
"""In one list: a control frame holds about three times as many of usual names (PROTOCOL.md section 1)."""


class LinkError(Exception):
    """A link can't do what was asked; the message says why."""


class Negotiation:
    """Acts on the peer's control messages, and asks it for its topics.

    Attributes:
        newest_route: the newest id of those that the peer has proposed on this connection; 0: none.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._numbers = itertools.count(1)
        self.newest_route = 0
        self._requests: dict[int, asyncio.Future[tuple[TopicEntry, ...]]] = {}
        self._listing = False
        self._refused: dict[str, str] = {}

    def end(self) -> None:
        """The connection is over: nobody will answer."""
        for future in self._requests.values():
            if not future.done():
                future.set_exception(LinkError(f"{self._link.name}: the link was lost"))
        self._requests.clear()
        self._refused.clear()
        self.newest_route = 0

    def handle(self, message: ControlMessage) -> None:
        """Do what a control message says."""
        match message:
            case Propose():
                self._proposed(message)
            case Ping():
                self._link.send(self._link.keepalive.answer(message))
            case Pong():
                self._link.keepalive.answered(message)
            case Report():
                self._take_report(message)
            case ListTopics() if not self._listing:
                self._listing = True
                self._link.spawn(self._list_topics(message.request))
            case ListTopics():
                pass  # one at a time: it costs more than the question
            case TopicList():
                future = self._requests.get(message.request)
                if future is not None and not future.done():
                    future.set_result(message.topics)
            case Shutdown():
                self._link.on_shutdown(message)
            case Accept() | Refuse() | Describe() | Ready() | Close() | Pause():
                route = self._link.open_route(message.route)
                if route is not None:  # else it was closed here while the message was under way
                    self._about_route(route, message)

    def _proposed(self, proposal: Propose) -> None:
        link = self._link
        assert link.control is not None
        if proposal.route % 2 == link.is_client or proposal.route <= self.newest_route:
            link.control.abort(f"the peer broke the format: {proposal.route} is no new route id of its own")
            return
        self.newest_route = proposal.route
        try:
            route = self._taken_up(proposal)
        except LinkError as error:
            self._refuse(proposal, "denied", str(error))
        else:
            link.spawn(self._accept(route, proposal))

    def _taken_up(self, proposal: Propose) -> Route:
        """This side's half of what the peer proposes; LinkError where it may not be."""
        link = self._link
        for problem in validate_topic(topic_of(proposal)):  # first: a prefix can make a valid name of an invalid one
            raise LinkError(str(problem))
        admitted = link.authorize(proposal)
        for problem in validate_topic(topic_of(admitted), link.context.session):
            raise LinkError(str(problem))
        incoming = admitted.from_client != link.is_client
        if incoming and admitted.remote_topic == link.context.session.shutdown_topic:
            raise LinkError(f"{admitted.remote_topic} shuts this side down: only its own programs may say so")
        if len(link.routes) >= ROUTES_PER_LINK:
            raise LinkError(f"this link has {ROUTES_PER_LINK} topics already, and no more are let in")
        known = link.routes.get(route_key(link.name, admitted))
        if known is not None and known.proposed_here and link.is_client:
            raise LinkError(f"{admitted.topic} is bridged in that direction already")
        if known is not None and (known.proposed_here or not same_route(known.proposal, admitted)):
            # Where both propose, the client's is the one that stays.
            link.forget(known, EventCode.ROUTE_REPLACED, "replaced by the other side's")
            known = None
        route = known or link.add(topic_of(admitted), admitted, proposed_here=False)
        known_process = route.instance == link.instance
        link.reopen(route, proposal.route)
        route.pause_from_peer(proposal.paused, proposal.pause_revision, known=known_process)
        if (route.paused, route.pausing.revision) != (proposal.paused, proposal.pause_revision):
            link.send_pause(route)  # an operator of this side changed it while the link was down
        return route

    async def _accept(self, route: Route, proposal: Propose) -> None:
        link, control = self._link, self._link.control
        try:
            await link.prepare_port(route)
        except ListenError as error:
            if link.control is control and route.id == proposal.route:
                link.end_opening(route, EventCode.ROUTE_PORT_UNAVAILABLE, str(error))
                self._refuse(proposal, "port_taken", str(error))
            return
        if link.control is not control or route.id != proposal.route:
            return  # it was closed while its port was being bound
        link.send(Accept(route=route.id, topic=route.local_topic))
        route.on_accepted()

    def _refuse(self, proposal: Propose, code: RefuseCode, reason: str) -> None:
        if self._refused.get(proposal.topic) != reason:  # the other side goes on trying; once is enough
            if len(self._refused) >= ROUTES_PER_LINK:
                self._refused.clear()
            self._refused[proposal.topic] = reason
            text = f"refused {proposal.topic}: {reason}"
            self._link.log(Level.WARNING, EventCode.ROUTE_REFUSED, text, topic=proposal.topic)
        self._link.send(Refuse(route=proposal.route, code=code, reason=sanitize_text(reason)))

    def _about_route(self, route: Route, message: Accept | Refuse | Describe | Ready | Close | Pause) -> None:
        match message:
            case Accept():
                route.set_peer_topic(message.topic)
                route.on_accepted()
            case Refuse():
                self._link.end_opening(route, EventCode.ROUTE_REFUSED, f"refused by the other side: {message.reason}")
            case Describe() if isinstance(route, IncomingRoute):
                route.described(message)
            case Ready() if isinstance(route, OutgoingRoute):
                route.peer_ready(message.before)
            case Close() if message.removed:
                self._link.forget(route, EventCode.ROUTE_REMOVED, f"removed by the other side: {message.reason}")
            case Close():
                self._link.end_opening(route, EventCode.ROUTE_CLOSED, f"closed by the other side: {message.reason}")
            case Pause():
                route.pause_from_peer(message.paused, message.revision)

    def _take_report(self, report: Report) -> None:
        for sent in report.sent:
            route = self._link.open_route(sent.route)
            if isinstance(route, IncomingRoute):
                route.reported(sent)
        for received in report.received:
            route = self._link.open_route(received.route)
            if isinstance(route, OutgoingRoute):
                route.reported(received)

    async def _list_topics(self, request: int) -> None:
        link = self._link

        def shown() -> list[TopicInfo]:
            return [topic for topic in topics_of(link.context.ros) if link.shows(topic.topic)]

        try:
            topics = await asyncio.to_thread(shown)
        finally:
            self._listing = False
        entries = tuple(
            TopicEntry(t.topic, t.type_name, t.type_hash, t.qos, t.publishers, t.subscriptions)
            for t in topics[:_MOST_TOPICS]
            if max(len(t.topic), len(t.type_name)) <= TEXT_LENGTH
        )
        link.send(TopicList(request=request, topics=entries))

    async def remote_topics(self) -> list[TopicInfo]:
        """The peer's graph.

        Raises:
            LinkError: there is no peer now, or it doesn't answer.
        """
        if self._link.control is None:
            raise LinkError(f"{self._link.name} is not linked: {self._link.reason}")
        request = next(self._numbers)
        future = self._requests[request] = self._link.context.loop.create_future()
        self._link.send(ListTopics(request=request))
        try:
            async with asyncio.timeout(_ANSWER_WITHIN):
                entries = await future
        except TimeoutError:
            raise LinkError(f"{self._link.name} did not answer") from None
        finally:
            self._requests.pop(request, None)
        return [TopicInfo(e.topic, e.type, e.type_hash, e.qos, e.publishers, e.subscriptions) for e in entries]
