"""Messages that operators publish by hand, in this side's domain."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.cdr.known_types import reduced, speeds_of, stamped
from rsb_bridge.config.fields_text import ITEMS, STEPS, read_fields, write_fields
from rsb_bridge.feature_api import (
    Endpoint,
    EventCode,
    Level,
    LinkError,
    MovingPart,
    Qos,
    Receiver,
    RosError,
    Sender,
    TopicSpec,
    Wording,
    check_names,
    join_first,
    sanitize_text,
)
from rsb_bridge.link.link import topics_of_peer
from rsb_bridge.link.peer_operators import acting_operator
from rsb_bridge.model.by_hand import TICKET_LIFE, TWISTS, smallest_limits
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.commands import account, console
from rsb_bridge.model.demands import NO_DEMAND
from rsb_bridge.model.qos import match_publishers, match_subscriptions
from rsb_bridge.model.type_names import expand_type_name
from rsb_bridge.ros.announcements import BY_HAND, Origin
from rsb_bridge.route.arming import without_history
from rsb_bridge.route.crossing import Crossing
from rsb_bridge.route.gates import why_not_by_hand
from rsb_bridge.route.listeners import audience, mismatch
from rsb_bridge.route.peeking import PeekError
from rsb_bridge.wire.messages import ByHand
from rsb_extras.driving.publish_requests import Draft, DraftMessage, Publish, Published

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from rsb_bridge.feature_api import Bridge, Publisher, Snapshot
    from rsb_bridge.telemetry.event_log import About

TOPICS = 32
"""Topics with publishers for messages by hand. A round figure: every node of the domain learns of each publisher."""
ENDS_AFTER = 10.0
"""s without a message after which a publisher is closed. A round figure: a message that comes earlier does not wait for
discovery again."""
MATCHED_WITHIN = 3.0
"""s in which subscriptions and routes have to find a new publisher. A round figure: a subscription that DDS never
matches, though type and QoS fit, delays the first message by so much."""
_LOOK_EVERY = 0.02
"""s between two looks for that: this side's ROS interface tells of no match. A round figure."""
_RESOLVE_EVERY = 2.0
"""s after which the graph is asked again for the topic's type and QoS. A drive does not ask at each of its commands.
A round figure."""
_NAMED = 5
"""Operators in one event."""
_LAST_WITHIN = 1.0
"""s in which a message has to pass to be the beginning of an operator's. A round figure."""
_DEPTH = 10
"""Messages: ROS's default."""
AT_ONCE = 4
"""Messages of one operator on one topic that may wait for their turn, before other operators' messages. A round
figure."""
_LONG = 4_096
"""Characters of fields that take 20 ms to read. Such messages are read one at a time, while short ones go on."""
_REST_CROSSES = 0.1
"""s in which the message that ends a motion is sent, before its topic is disarmed or the bridge stops.
A round figure: if it gets lost, the robot's side publishes a rest by itself."""
_STAMP = {"sec", "nanosec"}


class PublishProblem(Wording):
    """The reason why a message is not published by hand."""

    TOO_FAST = "{limit} messages of yours on {topic} are not published yet: wait for the answers"
    TOO_MANY = "messages are published by hand on {limit} topics already: wait some seconds"
    NO_TYPE = "{topic} has no publisher and no subscription here, and no route knows its type: name the type"
    TYPES_DIFFER = "{topic} has several types here ({types}): name one"
    OTHER_TYPE = "{topic} has the type {actual}, not {wanted}"
    OTHER_VERSION = (
        "{type_name} is installed here in another version than {topic} has: install that one, and restart this bridge"
    )
    NOT_ARMED = "{topic} has to be armed{reason}: arm it first"
    NOT_HEARD = "{topic} is armed, but the other side has not answered for 1 s: nothing passes until it does"
    ENDING = "{topic} is about to be disarmed, or the bridge to stop: nothing more is published by hand"
    ANOTHER_DRIVES = "{topic} is armed by {who}, whose messages by hand pass alone: ask for it (arm --ask)"
    NO_ROUTE_TO_ARM = "{topic} has to be armed, and no route of it is open: nothing can arm it"
    BEYOND_LIMITS = "{topic}: {linear:g} m/s, {angular:g} rad/s by hand is beyond {limits} ({lines}): ask for less"
    LIMITS_OF_OTHER_TYPE = (
        "{topic}: limits ({lines}) are for Twist and TwistStamped, and its type is {type_name}: leave them out there"
    )
    NO_DEADMAN = "{topic} cannot be driven: that needs arm: true and max_age on the topic, so that the robot stops"


class _Rest(NamedTuple):
    """A message that ends a motion.

    Attributes:
        timer: publishes it if no other comes in time.
        openings: armed routes, and their ids then: nothing of an earlier arming is published.
    """

    timer: asyncio.TimerHandle
    payload: bytes
    openings: tuple[tuple[Sender | Receiver, int], ...]


class _Publication:
    """The publisher of one topic, and the operators' messages on it.

    Attributes:
        turn: held while a message is published.
        commands: how many are being published, by operator.
        operators: who publish, and when each did last.
        rest: the message that ends the motion, or None if nobody drives.
        subscriptions: of other nodes, as of `looked_at` (s).
    """

    def __init__(self) -> None:
        self.turn = asyncio.Lock()
        self.commands: Counter[str] = Counter()
        self.used_at = self.resolved_at = 0.0
        self.looked_at = float("-inf")
        self.subscriptions: Sequence[Endpoint] = ()
        self.resolved: TopicSpec | None = None
        self.publisher: Publisher | None = None
        self.count = 0
        self.operators: dict[str, float] = {}
        self.rest: _Rest | None = None

    def take_rest(self) -> _Rest | None:
        """Return the message that ends the motion, which is due no more."""
        rest, self.rest = self.rest, None
        if rest is not None:
            rest.timer.cancel()
        return rest


class Publishing(MovingPart):
    """Executes `Publish` and `DraftMessage`."""

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self._context = context = bridge.context
        self._publications: dict[str, _Publication] = {}
        self._long = asyncio.Lock()
        self._first_ticket = context.random.getrandbits(40)  # tickets of another engine, or an earlier one, are void
        self.handlers = {DraftMessage: self.draft, Publish: self.publish}

    # --- commands

    async def draft(self, command: DraftMessage) -> Draft:
        """Return a message to begin with.

        Raises:
            LinkError: the topic's type is unknown.
            RosError: its type is not installed.
        """
        resolved = await self._resolve(command.topic, command.type_name)
        text = await asyncio.to_thread(self._description, resolved.type_name)
        if (passed := await self._passing(resolved)) is not None:
            fields = await asyncio.to_thread(_fields_of, text, passed)
            if fields:
                return Draft(resolved.type_name, fields, is_last=True)
        defaults = await self._serialize(resolved, "")
        return Draft(resolved.type_name, await asyncio.to_thread(_fields_of, text, defaults))

    async def publish(self, command: Publish) -> Published:
        """Publish a message.

        Raises:
            LinkError: it may not be published, or the topic's type is unknown.
            RosError: its type is not installed, or the middleware refuses it.
            FieldError: a field does not fit.
        """
        topic = command.topic
        check_names([topic])
        publication = self._publications.get(topic)
        if publication is None:
            if len(self._publications) >= TOPICS:
                raise LinkError(PublishProblem.TOO_MANY(limit=TOPICS))
            publication = self._publications[topic] = _Publication()
        who = acting_operator()
        if publication.commands[who] >= AT_ONCE:
            raise LinkError(PublishProblem.TOO_FAST(limit=AT_ONCE, topic=topic))
        publication.commands[who] += 1
        try:
            async with publication.turn:
                return await self._publish(publication, command)
        finally:
            publication.commands -= Counter((who,))  # without operators that have none left
            publication.used_at = self._context.now()
            # Commands that fail must not take up the places for topics.
            if publication.publisher is None and not publication.commands:
                self._publications.pop(topic, None)

    async def _publish(self, publication: _Publication, command: Publish) -> Published:
        topic, context, driven = command.topic, self._context, bool(command.rest)
        resolved = publication.resolved
        if (
            resolved is None
            or command.type_name not in ("", resolved.type_name)
            or context.now() - publication.resolved_at > _RESOLVE_EVERY
        ):
            resolved = await self._resolve(topic, command.type_name)
        # Before anything shows in the graph:
        self._check_armed(topic, resolved.type_name, self._routes(topic), driven=driven)
        payload = await self._serialize(resolved, command.fields)
        rest = await self._serialize(resolved, command.rest) if driven else b""
        self._within_limits(command, resolved.type_name, self._routes(topic), (payload, rest))
        if context.now() - publication.looked_at > _RESOLVE_EVERY:
            publication.subscriptions = await asyncio.to_thread(context.ros.subscriptions, topic)
            publication.looked_at = context.now()
        await self._open(publication, resolved)
        assert publication.publisher is not None
        # Nothing is awaited from here on.
        routes = self._routes(topic)
        # Again: arming and limits may have changed while the above was awaited.
        armed = self._check_armed(topic, resolved.type_name, routes, driven=driven)
        if armed and not 0 <= self._ticket() - command.ticket <= TICKET_LIFE * 1e3:
            return Published(is_done=False, ticket=self._ticket(), type_name=resolved.type_name)
        payload, rest = self._within_limits(command, resolved.type_name, routes, (payload, rest))
        rests = [half.rest for half in armed if isinstance(half, Receiver)]
        # First: a motion that no rest can follow must not begin.
        for each in rests:
            each.prepare(resolved)
        publication.publisher.publish(payload)
        for each in rests:
            each.moved_by_hand(payload, publication.publisher)
        if driven:
            # Else the timer of the command before ends the motion that goes on.
            publication.take_rest()
            timer = context.loop.call_later(command.rest_after, self._rest, publication, topic)
            publication.rest = _Rest(timer, rest, tuple((route, route.route.id) for route in armed))
        gid = publication.publisher.gid
        taking = [route for route in _outgoing(routes) if route.route.crossing.flows and route.takes(gid)]
        self._record(publication, topic, command.fields, taking)
        links = tuple(sorted({route.route.peer.name for route in taking}))
        count = publication.publisher.subscriber_count
        heard = audience(resolved.type_name, resolved.qos, publication.subscriptions, count)
        return Published(True, self._ticket(), resolved.type_name, heard, links)

    def _rest(self, publication: _Publication, topic: str) -> None:
        """Publish the message that ends a motion. Nothing of it crosses after the arming of the motion has ended."""
        rest, now = publication.take_rest(), self._context.now()
        if rest is None or publication.publisher is None or publication.resolved is None:
            return
        armed = [
            (route, opening) for route, opening in rest.openings if route.route.arming.crossing(now) is Crossing.YES
        ]
        if armed and all(route.route.id != opening for route, opening in armed):
            return  # somebody else has armed it since, and may be driving
        try:
            # It was made with the message before, and a robot may drop old ones.
            payload = stamped(publication.resolved.type_name, rest.payload, self._context.wall_ns())
            publication.publisher.publish(payload)
            publication.count += 1
        except RosError as error:
            self._context.log(Level.WARNING, EventCode.OPERATOR_PUBLISH_ENDED, f"{topic}: {error}", topic=topic)

    async def end_motions(self, topics: Collection[str] | None) -> bool:
        named = self._publications if topics is None else topics
        moving = {topic: each for topic, each in self._publications.items() if topic in named and each.rest}
        for topic, publication in moving.items():
            self._rest(publication, topic)
        if moving:
            await asyncio.sleep(_REST_CROSSES)
        return bool(moving)

    def _ticket(self) -> int:
        return self._first_ticket + int(self._context.clock.steady() * 1e3)

    # --- safety

    def _check_armed(
        self, topic: str, type_name: str, routes: Sequence[Sender | Receiver], *, driven: bool
    ) -> list[Sender | Receiver]:
        """Return the routes that are armed, or an empty list if the topic needs no arming.

        Args:
            driven: whether the topic has to be one on which robots may be driven.

        Raises:
            LinkError: it has to be armed, and is not; or it may not be driven.
        """
        now = self._context.now()
        demand = self._context.demands.read().of("topic", topic, type_name)
        requiring = [route for route in routes if route.route.arming.required]
        refusals = [why_not_by_hand(route.route, now) for route in requiring]
        armed = [route for route, why in zip(requiring, refusals, strict=True) if why is None]
        if not armed and requiring:
            # To arm it would not help: it is armed.
            if Refused.UNHEARD in refusals:
                raise LinkError(PublishProblem.NOT_HEARD(topic=topic))
            _, reason = requiring[0].route.arming.why_at(now)
            raise LinkError(PublishProblem.NOT_ARMED(topic=topic, reason=f" ({reason})"))
        if armed and not self._bridge.may_move(topic):
            raise LinkError(PublishProblem.ENDING(topic=topic))
        for route in armed:
            if not route.route.arming.is_held_by(console(), account()):
                raise LinkError(PublishProblem.ANOTHER_DRIVES(topic=topic, who=route.route.arming.by))
        if not armed and demand is not None and demand.arm:
            raise LinkError(PublishProblem.NO_ROUTE_TO_ARM(topic=topic))
        if driven and not (armed and all(_stops_by_itself(route) for route in routes)):
            raise LinkError(PublishProblem.NO_DEADMAN(topic=topic))
        return armed

    def _within_limits(
        self,
        command: Publish,
        type_name: str,
        routes: Iterable[Sender | Receiver],
        payloads: tuple[bytes, bytes],
    ) -> tuple[bytes, bytes]:
        """Return a command's message and rest within the limits that the sessions of all sides set on a hand.

        Raises:
            LinkError: one is beyond them, and is not to be reduced; or the type has no velocity.
        """
        topic = command.topic
        demand = self._context.demands.read().of("topic", topic, type_name) or NO_DEMAND
        found = [(route.route.arming.limits, route.route.arming.limited_by) for route in routes]
        found.append((demand.limits, tuple(map(self._context.demands.origin, demand.limited_by))))
        limits = smallest_limits(each for each, _ in found)
        if limits is None:
            return payloads
        by = dict.fromkeys(line for each, lines in found if each is not None and each.are_in(limits) for line in lines)
        lines = ", ".join(by)
        if type_name not in TWISTS:
            raise LinkError(PublishProblem.LIMITS_OF_OTHER_TYPE(topic=topic, lines=lines, type_name=type_name))
        for payload in payloads:
            speeds = speeds_of(type_name, payload)
            # What is not finite stays so however much it is reduced.
            if speeds is None or limits.allow(*speeds) or (command.reduce and all(map(isfinite, speeds))):
                continue
            linear, angular = speeds
            raise LinkError(
                PublishProblem.BEYOND_LIMITS(topic=topic, linear=linear, angular=angular, limits=limits, lines=lines)
            )
        message, rest = (reduced(type_name, payload, limits) for payload in payloads)
        return message, rest

    # --- types

    def _routes(self, topic: str) -> list[Sender | Receiver]:
        routes = [route for link in self._bridge.role.links() for route in link.routes.values()]
        return [
            route.half for route in routes if isinstance(route.half, Sender | Receiver) and route.local_topic == topic
        ]

    async def _resolve(self, topic: str, wanted: str) -> TopicSpec:
        """Return a topic as it is to be published.

        Raises:
            LinkError: the type is unknown, or not the wanted one.
            RosError: the graph cannot be read.
        """
        check_names([topic])
        ros = self._context.ros
        publishers = await asyncio.to_thread(ros.publishers, topic)
        subscriptions = await asyncio.to_thread(ros.subscriptions, topic)
        routes = self._routes(topic)
        known: dict[str, set[str]] = {}
        for name, type_hash in [
            *((each.type_name, each.type_hash) for each in (*publishers, *subscriptions)),
            *(route.facts.present_type for route in routes),
        ]:
            if name:
                known.setdefault(name, set()).add(type_hash)
        if not known:
            known = {
                expand_type_name(route.route.spec.type): set() for route in routes if route.route.spec.type != "auto"
            }
        name = expand_type_name(wanted) if wanted else ""
        if not known and not name:
            known = await self._types_there(routes)
            # Of what nobody has any more, the type that it had.
            known = known or {
                route.carried.type_name: {route.carried.type_hash} for route in routes if route.carried.type_name
            }
        if not name and len(known) > 1:
            raise LinkError(PublishProblem.TYPES_DIFFER(topic=topic, types=", ".join(sorted(known))))
        name = name or next(iter(known), "")
        if not name:
            raise LinkError(PublishProblem.NO_TYPE(topic=topic))
        if known and name not in known:
            raise LinkError(PublishProblem.OTHER_TYPE(topic=topic, actual=", ".join(sorted(known)), wanted=name))
        installed = await asyncio.to_thread(ros.installed_hash, name)
        type_hash = installed or ""
        # Other nodes would read the bytes as other fields. Empty: the middleware does not tell the version.
        if type_hash and known.get(name, set()) - {"", type_hash}:
            raise LinkError(PublishProblem.OTHER_VERSION(type_name=name, topic=topic))
        return TopicSpec(topic, name, type_hash, self._qos(topic, name, publishers, subscriptions, routes))

    async def _types_there(self, routes: Sequence[Sender | Receiver]) -> dict[str, set[str]]:
        """Return the types that the other sides of routes know for their topics: of a robot's motors, for example."""
        types: dict[str, set[str]] = {}
        for route in routes:
            # A side that does not answer hides none of the others.
            with contextlib.suppress(LinkError):
                for info in await topics_of_peer(self._bridge.role.links(), route.route.peer.name):
                    if info.topic == route.route.far_topic and info.kind == "topic" and info.type_name:
                        types[info.type_name] = set()
        return types

    def _qos(
        self,
        topic: str,
        type_name: str,
        publishers: Sequence[Endpoint],
        subscriptions: Sequence[Endpoint],
        routes: Sequence[Sender | Receiver],
    ) -> Qos:
        """Return the QoS of the other publishers, so that routes see no change, or what subscriptions ask for."""
        offered = [each.qos for each in publishers if each.type_name == type_name]
        offered += [
            route.flow.qos for route in routes if route.flow.qos is not None and route.carried.type_name == type_name
        ]
        if offered:
            qos = match_publishers(offered)
        else:
            requested = [each.qos for each in subscriptions if each.type_name == type_name]
            qos = match_subscriptions(requested) if requested else Qos()
        # Subscriptions of either reliability hear a reliable publisher.
        qos = msgspec.structs.replace(qos, reliability="reliable", depth=1 if qos.latched else _DEPTH)
        demand = self._context.demands.read().of("topic", topic, type_name)
        is_armed = any(route.route.arming.required for route in routes) or (demand is not None and demand.arm)
        return without_history(qos) if is_armed else qos

    async def _serialize(self, resolved: TopicSpec, fields: str) -> bytes:
        async with self._long if len(fields) > _LONG else contextlib.nullcontext():
            return await asyncio.to_thread(self._serialized, resolved, fields)

    def _serialized(self, resolved: TopicSpec, fields: str) -> bytes:
        """Return a message as bytes. Slow: not for the I/O thread."""
        return self._context.ros.serialize(resolved.type_name, read_fields(fields), self._context.wall_ns())

    def _description(self, type_name: str) -> str:
        text = self._context.ros.installed_description(type_name)
        if text is None:
            self._context.ros.serialize(type_name, {}, 0)  # which names the package to install
        return text or ""

    async def _passing(self, resolved: TopicSpec) -> bytes | None:
        """Return a message that passes soon, or None."""
        routes, type_hash = self._routes(resolved.topic), resolved.type_hash
        route = next(
            (route for route in routes if route.route.crossing.flows and route.carried.type_hash == type_hash), None
        )
        if route is None:
            return None
        try:
            async with asyncio.timeout(_LAST_WITHIN):
                peeked = await self._bridge.peeking.peek(route.flow, kept=True)
        except (TimeoutError, PeekError):
            return None
        return peeked.payload if peeked is not None and len(peeked.payload) == peeked.size else None

    # --- publishers

    async def _open(self, publication: _Publication, resolved: TopicSpec) -> None:
        """Have a publisher that subscriptions and routes have found. The one before stays until then, for a rest."""
        publication.resolved_at = self._context.now()
        topic, before = resolved.topic, publication.resolved
        if publication.publisher is not None and before is not None:
            if before == resolved:
                return
            if before[:3] != resolved[:3]:  # this bridge may have one type of a topic at a time
                if publication.rest is not None:
                    raise LinkError(
                        PublishProblem.OTHER_TYPE(topic=topic, actual=before.type_name, wanted=resolved.type_name)
                    )
                self._close(publication)
        ros = self._context.ros
        publisher = ros.advertise(resolved, self)
        try:
            endpoint = Endpoint(f"/{ros.node_name}", *resolved[1:], publisher.gid)
            # As a node's, so that routes take its messages.
            self._context.announcements.announce(topic, BY_HAND, endpoint, Origin(()))
            await self._found(publisher, resolved, publication.subscriptions)
        # Also if the command is cancelled meanwhile.
        except BaseException:
            self._withdraw(publisher)
            raise
        self._close(publication)
        publication.publisher, publication.resolved = publisher, resolved

    async def _found(self, publisher: Publisher, spec: TopicSpec, subscriptions: Iterable[Endpoint]) -> None:
        """Wait until subscriptions that can hear a publisher, and routes, have found it, or for some time."""
        began = self._context.now()
        expected = sum(mismatch(spec.type_name, spec.qos, each) is None for each in subscriptions)
        while self._context.now() - began < MATCHED_WITHIN:
            if publisher.subscriber_count >= expected and not self._awaited(spec.topic, publisher.gid):
                return
            await asyncio.sleep(_LOOK_EVERY)

    def _awaited(self, topic: str, gid: bytes) -> list[Sender]:
        """Return the routes that may take the messages of a new publisher soon."""
        return [
            route
            for route in _outgoing(self._routes(topic))
            if route.route.peer.linked
            and not route.route.life.refusal  # one whose proposal is not answered yet takes the first message, too
            and not route.route.crossing.is_held_back
            and not route.takes(gid)
        ]

    def _close(self, publication: _Publication) -> None:
        publisher, publication.publisher = publication.publisher, None
        if publisher is not None:
            self._withdraw(publisher)

    def _withdraw(self, publisher: Publisher) -> None:
        self._context.announcements.withdraw(publisher.gid)
        publisher.close()

    # --- records

    def _record(self, publication: _Publication, topic: str, fields: str, taking: Sequence[Sender]) -> None:
        """Record the first message of an operator, here and on the other side."""
        now, who = self._context.now(), acting_operator()
        publication.count += 1
        is_first = now - publication.operators.get(who, float("-inf")) > ENDS_AFTER
        publication.operators[who] = now
        if not is_first:
            return
        line = sanitize_text(" ".join(fields.split()))
        self._bridge.log.add(EventCode.OPERATOR_PUBLISHED, "published", topic=topic, new=line)
        for route in taking:
            route.route.peer.send(ByHand(route=route.route.id, lane=0, request=line, who=who))

    def tick(self, snapshot: Snapshot) -> None:
        """Close publishers that are not used any more."""
        now = self._context.now()
        for topic, publication in list(self._publications.items()):
            if publication.commands or publication.rest is not None or now - publication.used_at < ENDS_AFTER:
                continue
            del self._publications[topic]
            self._close(publication)
            # A single message has its event already.
            if publication.count > 1:
                who = join_first(sorted(publication.operators), _NAMED)
                text = f"{topic}: {publication.count:,} messages published by {who}"
                about: About = {"topic": topic, "who": who, "new": f"{publication.count:,}"}
                self._context.log(Level.INFO, EventCode.OPERATOR_PUBLISH_ENDED, text, **about)

    async def close(self) -> None:
        """End all motions, and close all publishers. No message follows."""
        await self.end_motions(None)
        for publication in self._publications.values():
            self._close(publication)
        self._publications.clear()


def _outgoing(routes: Iterable[Sender | Receiver]) -> list[Sender]:
    return [half for half in routes if isinstance(half, Sender)]


def _stops_by_itself(route: Sender | Receiver) -> bool:
    """Whether a robot at the other end of a route is not driven by old messages, or not at all."""
    if route.route.arming.required:
        return route.route.age.max_age > 0
    return not (isinstance(route, Sender) and route.route.crossing.flows)


def _fields_of(description: str, payload: bytes) -> str:
    """Return a message as YAML whose header has the time of its publishing, or an empty string if it is too long."""
    decoded = decode(read_description(description, hash_of_text(description)), payload, items=ITEMS, steps=STEPS)
    header = decoded.message.get("header")
    if isinstance(header, dict) and isinstance(stamp := header.get("stamp"), dict) and stamp.keys() == _STAMP:
        header["stamp"] = "now"
    text = write_fields(decoded)
    return "" if any(line.startswith("#") for line in text.splitlines()) else text
