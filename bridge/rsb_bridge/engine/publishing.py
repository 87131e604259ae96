"""Messages that operators publish by hand, in this side's domain."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.config.fields_text import ITEMS, STEPS, read_fields, write_fields
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.link.topic_view import check_names
from rsb_bridge.model.benchmark import is_bench_topic
from rsb_bridge.model.by_hand import TICKET_LIFE, Draft, Published
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.names import expand_type_name
from rsb_bridge.model.pictures import is_view_topic
from rsb_bridge.model.qos import Qos, match_publishers, match_subscriptions
from rsb_bridge.model.snapshot import Level
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint, RosError
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.outgoing import OutgoingRoute
from rsb_bridge.route.peeking import PeekError
from rsb_bridge.route.topic_route import TopicRoute
from rsb_bridge.wire.messages import ByHand

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.channel.channel import DataChannel
    from rsb_bridge.context import Context
    from rsb_bridge.engine.topic_commands import CommandLog
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.commands import DraftMessage, Publish
    from rsb_bridge.ros.ros_interface import Publisher
    from rsb_bridge.route.peeking import Peeking
    from rsb_bridge.telemetry.event_log import About

TOPICS = 32
"""Topics with publishers for messages by hand."""
ENDS_AFTER = 10.0
"""s without a message after which a publisher is closed."""
_MATCHED_WITHIN = 3.0
"""s in which subscriptions and routes have to find a new publisher."""
_LOOK_EVERY = 0.02
_RESOLVE_EVERY = 2.0
"""s after which the graph is asked again for the topic's type and QoS."""
_LAST_WITHIN = 1.0
"""s in which a message has to pass to be the beginning of an operator's."""
_DEPTH = 10
_STAMP = {"sec", "nanosec"}


class PublishProblem(Wording):
    """The reason why a message is not published by hand."""

    TOO_MANY = "messages are published by hand on {limit} topics already: wait some seconds"
    NOT_BY_HAND = "{topic} is for the bridges themselves"
    NO_TYPE = "{topic} has no publisher and no subscription here, and no route knows its type: name the type"
    TYPES_DIFFER = "{topic} has several types here ({types}): name one"
    OTHER_TYPE = "{topic} has the type {actual}, not {wanted}"
    OTHER_VERSION = "{type_name} is installed here in another version than {topic} has: install that one"
    NOT_ARMED = "{topic} has to be armed{reason}: arm it first"
    NO_ROUTE_TO_ARM = "{topic} has to be armed, and no route of it is open: nothing can arm it"
    NO_DEADMAN = "{topic} cannot be driven: that needs arm: true and max_age on the topic, so that the robot stops"


class _Resolved(NamedTuple):
    """The type and QoS of a topic's publisher."""

    type_name: str
    type_hash: str
    qos: Qos


class _Publication:
    """The publisher of one topic, and the operator's messages on it.

    Attributes:
        turn: held while a message is published.
        count: messages so far.
        rest: the timer of a message that is published if no other comes in time, or None.
    """

    def __init__(self) -> None:
        self.turn = asyncio.Lock()
        self.used_at = self.resolved_at = 0.0
        self.resolved: _Resolved | None = None
        self.publisher: Publisher | None = None
        self.count = 0
        self.who = ""
        self.rest: asyncio.TimerHandle | None = None

    def cancel_rest(self) -> None:
        if self.rest is not None:
            self.rest.cancel()
            self.rest = None


class Publishing:
    """Executes `Publish` and `DraftMessage`.

    Args:
        context: the engine's.
        links: gives the links.
        log: records the commands.
        peeking: gives messages that pass.
    """

    def __init__(
        self, context: Context, links: Callable[[], Sequence[Link]], log: CommandLog, peeking: Peeking
    ) -> None:
        self._context = context
        self._links = links
        self._log = log
        self._peeking = peeking
        self._publications: dict[str, _Publication] = {}

    # --- commands

    async def draft(self, command: DraftMessage) -> Draft:
        """Return a message to begin with.

        Raises:
            LinkError: the topic's type is unknown.
            RosError: its type is not installed.
        """
        resolved = await self._resolve(command.topic, command.type_name)
        text = await asyncio.to_thread(self._description, resolved.type_name)
        if (passed := await self._passing(command.topic, resolved)) is not None:
            fields = await asyncio.to_thread(_fields_of, text, passed)
            if fields:
                return Draft(resolved.type_name, fields, is_last=True)
        defaults = await asyncio.to_thread(self._serialized, resolved, "")
        return Draft(resolved.type_name, await asyncio.to_thread(_fields_of, text, defaults))

    async def publish(self, command: Publish) -> Published:
        """Publish a message.

        Raises:
            LinkError: it may not be published, or the topic's type is unknown.
            RosError: its type is not installed, or the middleware refuses it.
            FieldError: a field does not fit.
        """
        topic = command.topic
        self._check_name(topic)
        publication = self._publications.get(topic)
        if publication is None:
            if len(self._publications) >= TOPICS:
                raise LinkError(PublishProblem.TOO_MANY(limit=TOPICS))
            publication = self._publications[topic] = _Publication()
        try:
            async with publication.turn:
                return await self._publish(publication, command)
        finally:
            publication.used_at = self._context.now()

    async def _publish(self, publication: _Publication, command: Publish) -> Published:
        topic, context = command.topic, self._context
        self._check_armed(topic, command.type_name, driven=bool(command.rest))  # before anything shows in the graph
        resolved = publication.resolved
        if (
            resolved is None
            or command.type_name not in ("", resolved.type_name)
            or context.now() - publication.resolved_at > _RESOLVE_EVERY
        ):
            resolved = await self._resolve(topic, command.type_name)
        payload = await asyncio.to_thread(self._serialized, resolved, command.fields)
        rest = await asyncio.to_thread(self._serialized, resolved, command.rest) if command.rest else b""
        await self._open(publication, topic, resolved)
        assert publication.publisher is not None
        # Nothing is awaited from here on.
        armed = self._check_armed(topic, resolved.type_name, driven=bool(rest))
        if armed and not 0.0 <= context.now() - command.ticket / 1e3 <= TICKET_LIFE:
            return Published(is_done=False, ticket=self._ticket(), type_name=resolved.type_name)
        publication.cancel_rest()
        publication.publisher.publish(payload)
        self._record(publication, topic, command.fields)
        if rest:
            act = partial(self._rest, publication, topic, resolved.type_name, rest)
            publication.rest = context.loop.call_later(command.rest_after, act)
        nodes, links = publication.publisher.subscriber_count, tuple(self._taking(topic))
        return Published(True, self._ticket(), resolved.type_name, nodes, links)

    def _rest(self, publication: _Publication, topic: str, type_name: str, payload: bytes) -> None:
        """Publish the message that is due if an operator's console is silent."""
        publication.rest = None
        try:
            self._check_armed(topic, type_name)
            if publication.publisher is not None:
                publication.publisher.publish(payload)
                publication.count += 1
        except (LinkError, RosError) as error:
            self._context.log(Level.WARNING, EventCode.OPERATOR_PUBLISH_ENDED, f"{topic}: {error}", topic=topic)

    def _ticket(self) -> int:
        return int(self._context.now() * 1e3)

    # --- safety

    def _check_name(self, topic: str) -> None:
        check_names([topic])
        if is_bench_topic(topic) or is_view_topic(topic):
            raise LinkError(PublishProblem.NOT_BY_HAND(topic=topic))

    def _check_armed(self, topic: str, type_name: str, *, driven: bool = False) -> bool:
        """Return whether a topic has to be armed.

        Args:
            topic: its name here.
            type_name: its type, or empty if unknown.
            driven: whether the topic has to be one on which robots may be driven.

        Raises:
            LinkError: it has to be, and is not; or it may not be driven.
        """
        routes = self._routes(topic)
        demand = self._context.demands.of("topic", topic, type_name)
        requiring = [route for route in routes if route.arming.required]
        if not requiring and (demand is None or not demand.arm):
            if driven:
                raise LinkError(PublishProblem.NO_DEADMAN(topic=topic))
            return False
        now = self._context.now()
        armed = [route for route in requiring if route.arming.passes(now)]
        if armed:
            if driven and not all(route.age.max_age for route in armed):
                raise LinkError(PublishProblem.NO_DEADMAN(topic=topic))
            return True
        if not requiring:
            raise LinkError(PublishProblem.NO_ROUTE_TO_ARM(topic=topic))
        reason = next((each.reason for route in requiring if (each := route.arming.snapshot(now)) is not None), "")
        raise LinkError(PublishProblem.NOT_ARMED(topic=topic, reason=f" ({reason})" if reason else ""))

    # --- types

    def _routes(self, topic: str) -> list[TopicRoute[DataChannel]]:
        routes = [route for link in self._links() for route in link.routes.values()]
        return [route for route in routes if isinstance(route, TopicRoute) and route.local_topic == topic]

    async def _resolve(self, topic: str, wanted: str) -> _Resolved:
        """Return type and QoS of a topic's publisher.

        Raises:
            LinkError: the type is unknown, or not the wanted one.
            RosError: the graph cannot be read.
        """
        self._check_name(topic)
        ros = self._context.ros
        publishers = await asyncio.to_thread(ros.publishers, topic)
        subscriptions = await asyncio.to_thread(ros.subscriptions, topic)
        routes = self._routes(topic)
        known: dict[str, set[str]] = {}
        for name, type_hash in [
            *((each.type_name, each.type_hash) for each in (*publishers, *subscriptions)),
            *(route.known_type for route in routes),
        ]:
            if name:
                known.setdefault(name, set()).add(type_hash)
        if not known:
            known = {expand_type_name(route.spec.type): set() for route in routes if route.spec.type != "auto"}
        name = expand_type_name(wanted) if wanted else ""
        if not name and len(known) > 1:
            raise LinkError(PublishProblem.TYPES_DIFFER(topic=topic, types=", ".join(sorted(known))))
        name = name or next(iter(known), "")
        if not name:
            raise LinkError(PublishProblem.NO_TYPE(topic=topic))
        if known and name not in known:
            raise LinkError(PublishProblem.OTHER_TYPE(topic=topic, actual=", ".join(sorted(known)), wanted=name))
        type_hash = ros.installed_hash(name) or ""
        if type_hash and known.get(name, set()) - {"", type_hash}:
            raise LinkError(PublishProblem.OTHER_VERSION(type_name=name, topic=topic))
        return _Resolved(name, type_hash, self._qos(topic, name, publishers, subscriptions, routes))

    def _qos(
        self,
        topic: str,
        type_name: str,
        publishers: Sequence[Endpoint],
        subscriptions: Sequence[Endpoint],
        routes: Sequence[TopicRoute[DataChannel]],
    ) -> Qos:
        """Return the QoS of the other publishers, so that routes see no change, or what subscriptions ask for."""
        offered = [each.qos for each in publishers if each.type_name == type_name]
        offered += [route.qos for route in routes if route.qos is not None]
        if offered:
            qos = match_publishers(offered)
        else:
            requested = [each.qos for each in subscriptions if each.type_name == type_name]
            qos = match_subscriptions(requested) if requested else Qos()
            qos = msgspec.structs.replace(qos, reliability="reliable")
        qos = msgspec.structs.replace(qos, depth=1 if qos.latched else _DEPTH)
        demand = self._context.demands.of("topic", topic, type_name)
        is_armed = any(route.arming.required for route in routes) or (demand is not None and demand.arm)
        return without_history(qos) if is_armed else qos

    def _serialized(self, resolved: _Resolved, fields: str) -> bytes:
        """Return a message as bytes. Slow: not for the I/O thread."""
        return self._context.ros.serialize(resolved.type_name, read_fields(fields), self._context.wall_ns())

    def _description(self, type_name: str) -> str:
        text = self._context.ros.installed_description(type_name)
        if text is None:
            self._context.ros.serialize(type_name, {}, 0)  # which names the package to install
        return text or ""

    async def _passing(self, topic: str, resolved: _Resolved) -> bytes | None:
        """Return a message that passes soon, or None."""
        flowing = (route for route in self._routes(topic) if route.flowing and route.type_hash == resolved.type_hash)
        route = next(flowing, None)
        if route is None:
            return None
        try:
            async with asyncio.timeout(_LAST_WITHIN):
                peeked = await self._peeking.peek(route, kept=True)
        except (TimeoutError, PeekError):
            return None
        return peeked.payload if peeked is not None and len(peeked.payload) == peeked.size else None

    # --- publishers

    async def _open(self, publication: _Publication, topic: str, resolved: _Resolved) -> None:
        """Have a publisher that subscriptions and routes have found."""
        now = self._context.now()
        publication.resolved_at = now
        if publication.publisher is not None and publication.resolved == resolved:
            return
        self._close(publication)
        ros = self._context.ros
        publisher = ros.advertise(topic, *resolved, self)
        try:
            endpoint = Endpoint(f"/{ros.node_name}", *resolved, publisher.gid)
            self._context.announcements.announce(topic, self, endpoint, Origin(()))
        except RosError:
            publisher.close()
            raise
        publication.publisher, publication.resolved = publisher, resolved
        expected = len(await asyncio.to_thread(ros.subscriptions, topic))
        while self._context.now() - now < _MATCHED_WITHIN:
            if publisher.subscriber_count >= expected and not any(self._awaited(topic, publisher.gid)):
                return
            await asyncio.sleep(_LOOK_EVERY)

    def _outgoing(self, topic: str) -> list[OutgoingRoute]:
        return [route for route in self._routes(topic) if isinstance(route, OutgoingRoute)]

    def _awaited(self, topic: str, gid: bytes) -> list[OutgoingRoute]:
        """Return the routes that may take the messages of a new publisher soon."""
        now = self._context.now()
        return [
            route
            for link in self._links()
            if link.linked
            for route in self._outgoing(topic)
            if route.key in link.routes
            and route.accepted
            and not route.paused
            and route.arming.stands(now)
            and not route.takes(gid)
        ]

    def _taking(self, topic: str) -> list[str]:
        """Return the links that take the messages of a topic to the other side."""
        publication = self._publications[topic]
        assert publication.publisher is not None
        gid = publication.publisher.gid
        return sorted({route.peer.name for route in self._outgoing(topic) if route.flowing and route.takes(gid)})

    def _close(self, publication: _Publication) -> None:
        publication.cancel_rest()
        if publication.publisher is not None:
            self._context.announcements.withdraw(publication.publisher.gid)
            publication.publisher.close()
            publication.publisher = None

    # --- records

    def _record(self, publication: _Publication, topic: str, fields: str) -> None:
        """Record the first message of an operator, here and on the other side."""
        publication.count += 1
        who = acting_operator()
        if publication.count > 1 and publication.who == who:
            return
        publication.who, publication.count = who, 1
        line = sanitize_text(" ".join(fields.split()))
        self._log.add(EventCode.OPERATOR_PUBLISHED, "published", topic=topic, new=line)
        for link in self._links():
            for route in self._outgoing(topic):
                if route.id and link.routes.get(route.key) is route and route.flowing:
                    link.send(ByHand(route=route.id, lane=0, request=line, who=who))

    def tick(self) -> None:
        """Close publishers that are not used any more. Called once a second."""
        now = self._context.now()
        for topic, publication in list(self._publications.items()):
            if publication.turn.locked() or publication.rest is not None or now - publication.used_at < ENDS_AFTER:
                continue
            del self._publications[topic]
            self._close(publication)
            if publication.count > 1:
                text = f"{topic}: {publication.count:,} messages published by {publication.who}"
                about: About = {"topic": topic, "who": publication.who, "new": f"{publication.count:,}"}
                self._context.log(Level.INFO, EventCode.OPERATOR_PUBLISH_ENDED, text, **about)

    def close(self) -> None:
        """Close all publishers."""
        for publication in self._publications.values():
            self._close(publication)
        self._publications.clear()


def _fields_of(description: str, payload: bytes) -> str:
    """Return a message as YAML whose header has the time of its publishing, or an empty string if it is too long."""
    decoded = decode(read_description(description, hash_of_text(description)), payload, items=ITEMS, steps=STEPS)
    header = decoded.message.get("header")
    if isinstance(header, dict) and isinstance(stamp := header.get("stamp"), dict) and stamp.keys() == _STAMP:
        header["stamp"] = "now"
    text = write_fields(decoded)
    return "" if any(line.startswith("#") for line in text.splitlines()) else text
