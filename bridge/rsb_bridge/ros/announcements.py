"""Announcements between the bridges of a domain: the publishers and services of each, and the bridges behind them.

Each bridge keeps one latched message on a common topic (PROTOCOL.md, 5). Other nodes may publish anything there:
messages are bounded in size, number and rate, and unreadable messages are ignored.
"""

from __future__ import annotations

import contextlib
import re
import threading
from collections import Counter, OrderedDict, defaultdict
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple

import msgspec
from msgspec import Meta

from rsb_bridge.cdr.known_types import STRING, STRING_HASH, serialize_string, string_bytes
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.hops import MOST_BRIDGES
from rsb_bridge.model.names import ANNOUNCEMENT_TOPIC
from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.lasting_subscription import LastingSubscription
from rsb_bridge.ros.ros_interface import Endpoint, RosError, TopicSpec
from rsb_bridge.wire.records import Hops, Name

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Hashable, Sequence

    from rsb_bridge.model.hops import Via
    from rsb_bridge.ros.ros_interface import OnFailure, Publisher, RawMessage, RosInterface, Subscription

LONGEST = 4 << 20
"""Bytes of one announcement (PROTOCOL.md, 5)."""
_A_LINK = 1 << 20
"""Bytes of this bridge's announcement for one link: a peer with long names must leave room to the other links."""
_FRAME = 1024
"""Bytes around the entries. A round figure."""
_A_SECOND = 4 << 20
"""Bytes of others' announcements read in a second: about 40 ms of the I/O thread's time."""
_KEPT = 8 << 20
"""Bytes of others' announcements that are kept, and of announcements that wait to be read: two of the longest."""
_SOON = 0.02  # s: changes within it make one announcement
_READ_EVERY = 0.05
"""s. A round figure: a node that publishes without pause is read 20 times a second, and the newest message counts."""
_SAY_AGAIN = 1.0  # s
_MOST_UNREAD = 2 * MOST_BRIDGES
"""More than there are bridges, because strangers may publish on the topic, too."""
_NODE_NAME = re.compile(r"[A-Za-z0-9_/]{1,255}")
_ORDINARY_REMEMBERED = 4096
"""Nodes that are no bridges. A round figure: the graph is asked again for a node that is forgotten."""
_SAID = Qos(durability="transient_local", depth=1)
_HEARD = Qos(durability="transient_local", depth=_MOST_UNREAD)
"""A reader's depth counts the messages of all publishers: with 1, a new bridge would hear only one other."""


class PublisherEntry(msgspec.Struct, frozen=True):
    """A publisher, as it is announced."""

    topic: Name
    gid: Annotated[str, Meta(pattern=r"\A([0-9a-f]{2}){1,24}\Z")]
    via: Hops
    live: bool = True
    alive: bool = False


class ServiceEntry(msgspec.Struct, frozen=True):
    """A service that is offered, as it is announced."""

    service: Name
    via: Hops


class Announcement(msgspec.Struct, frozen=True):
    """A bridge's message to the others."""

    version: Literal[1]
    publishers: list[PublisherEntry]
    services: list[ServiceEntry] = []


_encode = msgspec.json.Encoder().encode


class Origin(NamedTuple):
    """The origin of a publisher's messages, or of a server's answers.

    Attributes:
        via: the bridges that they crossed, or empty for an endpoint of an ordinary node.
        live: whether messages still reach the endpoint.
        alive: whether a bridge asserts the publisher's liveliness.
    """

    via: Via
    live: bool = True
    alive: bool = False


BY_HAND: Final = ("by hand",)
"""The link of publishers of operators' messages. No link has such a name."""


def _always() -> bool:
    return True


class Own(NamedTuple):
    """A publisher of ours, or a service that we offer.

    Attributes:
        crosses: returns whether messages of its link may come now, which depends on who has armed it.
    """

    name: str
    link: Hashable
    endpoint: Endpoint
    origin: Origin
    entry: bytes
    crosses: Callable[[], bool] = _always

    @property
    def size(self) -> int:
        """Bytes of its entry with a comma, or 0 if it is not announced."""
        return len(self.entry) + 1 if self.entry else 0


class OwnAnnouncement:
    """This bridge's announcement, within bounds."""

    def __init__(self) -> None:
        self.size = 0
        self._sizes: Counter[Hashable] = Counter()  # parts of `size`, by link
        self.publishers = _Table()
        self.services = _Table()

    def content(self) -> bytes:
        """Return the message's bytes."""
        publishers, services = b",".join(self.publishers.entries()), b",".join(self.services.entries())
        return b'{"version":1,"publishers":[%s],"services":[%s]}' % (publishers, services)

    def put_publisher(
        self, topic: str, link: Hashable, endpoint: Endpoint, origin: Origin, crosses: Callable[[], bool] = _always
    ) -> bool:
        """Add a publisher of ours or change its origin; return whether the announcement changed.

        A publisher of our own messages is not announced: unannounced publishers belong to no bridge (PROTOCOL.md, 5).

        Raises:
            RosError: the announcement is full.
        """
        entry = _encode(PublisherEntry(topic, endpoint.gid.hex(), *origin)) if origin.via else b""
        return self._put(self.publishers, Own(topic, link, endpoint, origin, entry, crosses))

    def put_service(self, service: str, link: Hashable, endpoint: Endpoint, via: Via) -> bool:
        """Add a service that we offer or change its origin; return whether the announcement changed.

        Raises:
            RosError: the announcement is full.
        """
        return self._put(self.services, Own(service, link, endpoint, Origin(via), _encode(ServiceEntry(service, via))))

    def _put(self, table: _Table, own: Own) -> bool:
        before = table.by_gid.get(own.endpoint.gid)
        more = own.size - (before.size if before else 0)
        if self._sizes[own.link] + more > _A_LINK or self.size + more > LONGEST - _FRAME:
            raise RosError(
                "this bridge publishes more than it can announce to the other bridges in its domain: "
                "bridge fewer topics over one link"
            )
        self.size += more
        self._sizes[own.link] += more
        table.put(own)
        return before is None or before.entry != own.entry

    def remove(self, gid: bytes) -> bool:
        """Remove a publisher or service; return whether it was there."""
        own = self.publishers.pop(gid) or self.services.pop(gid)
        if own is None:
            return False
        self.size -= own.size
        self._sizes[own.link] -= own.size
        if not self._sizes[own.link]:
            del self._sizes[own.link]
        return True

    def origin_of(self, gid: bytes) -> Origin | None:
        """Return the origin of an endpoint of ours, or None for any other."""
        own = self.publishers.by_gid.get(gid) or self.services.by_gid.get(gid)
        return own.origin if own is not None else None


class _Table:
    """Our publishers, or our services, by id and by name."""

    def __init__(self) -> None:
        self.by_gid: dict[bytes, Own] = {}
        self._by_name: defaultdict[str, dict[bytes, Own]] = defaultdict(dict)

    def entries(self) -> list[bytes]:
        return [own.entry for own in self.by_gid.values() if own.entry]

    def put(self, own: Own) -> None:
        self.by_gid[own.endpoint.gid] = self._by_name[own.name][own.endpoint.gid] = own

    def pop(self, gid: bytes) -> Own | None:
        own = self.by_gid.pop(gid, None)
        if own is not None:
            del self._by_name[own.name][gid]
            if not self._by_name[own.name]:
                del self._by_name[own.name]
        return own

    def of(self, name: str, besides: Hashable) -> list[Endpoint]:
        return [own.endpoint for own in self._by_name.get(name, {}).values() if own.link != besides]


_decode = msgspec.json.Decoder(Announcement).decode
_ORDINARY = Origin(())


class AnnouncementContent(NamedTuple):
    """The contents of another bridge's announcement.

    Attributes:
        publishers: the origin of each publisher's messages, by id.
        services: the origin of each service's answers, by name.
    """

    publishers: dict[bytes, Origin]
    services: dict[str, Origin]


class _Heard(NamedTuple):
    """A bridge's announcement."""

    size: int
    content: AnnouncementContent


class _Inbox:
    """Unread announcements: the newest of each publisher, and only the shortest if they are too many."""

    def __init__(self) -> None:
        self._payloads: dict[bytes, bytes] = {}
        self._size = 0

    def put(self, gid: bytes, payload: bytes) -> None:
        """Keep a new announcement."""
        if len(payload) > LONGEST:
            payload = b""  # not an announcement
        self._size += len(payload) - len(self._payloads.get(gid, b""))
        self._payloads[gid] = payload
        while self._size > _KEPT or len(self._payloads) > _MOST_UNREAD:
            # The longest goes: what strangers publish there must not displace the announcements of bridges.
            longest = max(self._payloads, key=lambda each: len(self._payloads[each]))
            self._size -= len(self._payloads.pop(longest))

    def put_back(self, gid: bytes, payload: bytes) -> None:
        """Keep an announcement that was taken but not read."""
        if gid not in self._payloads:  # a newer one may have come meanwhile
            self.put(gid, payload)

    def take(self) -> list[tuple[bytes, bytes]]:
        """Take all announcements, the shortest first."""
        taken, self._payloads, self._size = self._payloads, {}, 0
        return sorted(taken.items(), key=lambda item: len(item[1]))


class AnnouncementError(Exception):
    """A message is not a bridge's announcement."""


class Announcements:
    """This bridge's announcement and the others'. Belongs to the I/O thread.

    Attributes:
        bridges: the names of the domain's bridge nodes, our own first.
        changed: has the routes check for loops again.
        own_publishers: returns our publishers on a topic, without the given link's.
        own_of: returns our publisher of an id, or None for others'.
        own_servers: returns our servers of a service, without the given link's.
    """

    def __init__(self, ros: RosInterface, loop: asyncio.AbstractEventLoop, warn: Callable[[str], None]) -> None:
        """Create them; `start` connects them with the domain."""
        self.bridges: tuple[str, ...] = (ros.node_name,)
        self._ros = ros
        self._loop = loop
        self._warn = warn
        self.changed: Callable[[], None] = lambda: None  # until `start`
        self._publisher: Publisher | None = None
        self._subscription: LastingSubscription | None = None
        self._own = OwnAnnouncement()
        self.own_publishers = self._own.publishers.of
        self.own_of = self._own.publishers.by_gid.get
        self.own_servers = self._own.services.of
        self._offers = 0
        self._published = b""
        self._saying: asyncio.TimerHandle | None = None
        self._lock = threading.Lock()
        self._inbox = _Inbox()  # under the lock
        self._reads = False  # whether `_read` will be called; under the lock
        self._reading: asyncio.TimerHandle | None = None
        self._readable = TokenBucket(LONGEST, _A_SECOND, loop.time())
        self._announcers: dict[bytes, str] = {}  # nodes by their announcements' publishers
        self._heard: dict[bytes, _Heard] = {}  # by their publishers
        self._by_node: dict[str, list[_Heard]] = {}
        self._ordinary: OrderedDict[str, None] = OrderedDict()
        self._warnings = TokenBucket(3, 0.01, loop.time())  # a node that publishes nonsense must not fill the log

    @property
    def gid(self) -> bytes:
        """Id of this bridge's publisher of announcements in the middleware, or empty bytes before the start."""
        return self._publisher.gid if self._publisher is not None else b""

    def start(self, changed: Callable[[], None]) -> None:
        """Publish the announcement and subscribe to the others'.

        Args:
            changed: called when `bridges` or an origin has changed.
        """
        self.changed = changed
        # The hash of the installed package: another one would be refused as another version of the type.
        type_hash = self._ros.installed_hash(STRING) or STRING_HASH
        spec = TopicSpec(ANNOUNCEMENT_TOPIC, STRING, type_hash, _SAID)

        def subscribe(on_failure: OnFailure) -> Subscription:
            return self._ros.subscribe(spec._replace(qos=_HEARD), self._arrived, ANNOUNCEMENT_TOPIC, on_failure)

        try:
            # One origin for both ends, so that this bridge does not hear itself.
            self._publisher = self._ros.advertise(spec, ANNOUNCEMENT_TOPIC)
            self._subscription = LastingSubscription(self._loop, subscribe, self._subscription_changed)
        except RosError as error:
            self._unnoticed(str(error))
        # At once and also without entries: only nodes with such a message count as bridges.
        self._say()

    def _subscription_changed(self) -> None:
        if self._subscription is not None and self._subscription.failure:
            self._unnoticed(self._subscription.failure)

    def _unnoticed(self, reason: str) -> None:
        self._warn(f"this bridge cannot hear the other bridges in its domain, and cannot detect loops: {reason}")

    def stop(self) -> None:
        """Close the publisher and the subscription."""
        for timer in (self._saying, self._reading):
            if timer is not None:
                timer.cancel()
        for endpoint in (self._subscription, self._publisher):
            if endpoint is not None:
                endpoint.close()
        self._subscription = self._publisher = None

    # --- our own

    def announce(
        self, topic: str, link: Hashable, endpoint: Endpoint, origin: Origin, crosses: Callable[[], bool] = _always
    ) -> None:
        """Announce a publisher of ours, or its new origin.

        Args:
            link: the link whose messages it publishes, or `BY_HAND`.
            crosses: returns whether these may come now.

        Raises:
            RosError: the announcement is full.
        """
        if self._own.put_publisher(topic, link, endpoint, origin, crosses):
            self._say_soon()

    def offer(self, service: str, link: Hashable, type_name: str, type_hash: str, via: Via) -> bytes:
        """Announce a service that is about to be offered here.

        Args:
            link: the link that carries the calls.
            via: the bridges that the answers cross.

        Returns:
            An id for `withdraw`.

        Raises:
            RosError: the announcement is full.
        """
        self._offers += 1
        gid = b"offer%d" % self._offers
        self._own.put_service(service, link, Endpoint(f"/{self._ros.node_name}", type_name, type_hash, Qos(), gid), via)
        self._say_soon()
        return gid

    def withdraw(self, gid: bytes) -> None:
        """Remove a publisher or service from the announcement."""
        if self._own.remove(gid):
            self._say_soon()

    def is_own(self, gid: bytes) -> bool:
        """Whether a publisher is one of ours, which publishes messages of a link."""
        return self._own.origin_of(gid) is not None

    def _say_soon(self) -> None:
        if self._saying is None and self._publisher is not None:
            # Others read only so many bytes in a second.
            self._saying = self._loop.call_later(max(_SOON, self._own.size / _A_SECOND), self._say)

    def _say(self) -> None:
        self._saying = None
        self.changed()  # for our own routes that subscribe to our publishers
        content = self._own.content()
        if content == self._published or self._publisher is None:
            return
        try:
            self._publisher.publish(serialize_string(content))
        except RosError as error:
            if self._warnings.take(1, self._loop.time()):
                self._warn(f"this bridge cannot announce its publishers to the other bridges in its domain: {error}")
            self._saying = self._loop.call_later(_SAY_AGAIN, self._say)
        else:
            self._published = content

    # --- the others'

    def origin_of(self, publisher: Endpoint) -> Origin | None:
        """Return a publisher's origin, or None if its bridge has not announced it or its node is unknown."""
        return self._origin_of(publisher, lambda content: content.publishers.get(publisher.gid))

    def origin_of_server(self, server: Endpoint, service: str) -> Origin | None:
        """Return the origin of a server's answers, or None as `origin_of` does."""
        return self._origin_of(server, lambda content: content.services.get(service))

    def _origin_of(self, endpoint: Endpoint, find: Callable[[AnnouncementContent], Origin | None]) -> Origin | None:
        own = self._own.origin_of(endpoint.gid)
        if own is not None:
            return own
        node = endpoint.node.lstrip("/")
        if not node:
            return None
        # Each node is looked up once: a robot has many publishers, and the question to DDS takes some 50 µs.
        if node not in self._by_node and node not in self._ordinary:
            self.update()
        if node in self._by_node:
            found = (find(heard.content) for heard in self._by_node[node])
            return next((origin for origin in found if origin is not None), None)
        if node not in self._ordinary:
            while len(self._ordinary) >= _ORDINARY_REMEMBERED:
                self._ordinary.popitem(last=False)
            self._ordinary[node] = None
        return _ORDINARY

    def update(self) -> None:
        """Update the list of bridges. Call it when the graph has changed."""
        if self._subscription is None:
            return
        if (present := self._present()) != self._announcers:
            self._announcers = present
            self._sort()

    def _present(self) -> dict[bytes, str]:
        """Return the announcing nodes by their publishers' ids."""
        try:
            publishers = self._ros.publishers(ANNOUNCEMENT_TOPIC)
        except RosError:
            return self._announcers  # the ROS side has failed, and the engine is about to stop
        return {each.gid: node for each in publishers if _NODE_NAME.fullmatch(node := each.node.lstrip("/"))}

    def _sort(self) -> None:
        self._by_node = {}
        for gid, node in self._announcers.items():
            heard = self._by_node.setdefault(node, [])
            if gid in self._heard:
                heard.append(self._heard[gid])
        bridges = sorted({node for gid, node in self._announcers.items() if gid in self._heard})
        self.bridges = (self._ros.node_name, *bridges[: MOST_BRIDGES - 1])
        self.changed()

    def _arrived(self, batch: Sequence[RawMessage]) -> None:
        """Take messages on the ROS thread."""
        with self._lock:
            for message in batch:
                self._inbox.put(message.gid, message.payload)
            if self._reads:
                return
            self._reads = True
        with contextlib.suppress(RuntimeError):  # the loop is closed: the engine has stopped
            self._loop.call_soon_threadsafe(self._read)

    def _read(self) -> None:
        """Read the new announcements, the shortest first, as many as the budget admits."""
        with self._lock:
            unread = self._inbox.take()
            # True until a reading finds nothing: until then, the timer below reads new messages.
            self._reads = bool(unread)
        if not unread or self._subscription is None:
            return
        now, before = self._loop.time(), self._heard.copy()
        for gid, payload in unread:
            if self._readable.take(len(payload), now):
                self._hear(gid, payload)
            else:
                with self._lock:
                    self._inbox.put_back(gid, payload)
        if self._heard != before:
            self._announcers = self._present()
            self._sort()
        self._reading = self._loop.call_later(_READ_EVERY, self._read)

    def _hear(self, gid: bytes, payload: bytes) -> None:
        try:
            content = read_announcement(payload)
        except AnnouncementError:
            self._heard.pop(gid, None)
            if self._warnings.take(1, self._loop.time()):
                node = self._announcers.get(gid, "a node")
                self._warn(
                    f"{node} publishes a message on {ANNOUNCEMENT_TOPIC} that is not a bridge's announcement: stop it, "
                    "only rsb-console may publish there"
                )
            return
        self._heard.pop(gid, None)
        if not self._has_room(len(payload)):
            for other in self._heard.keys() - self._announcers.keys():
                del self._heard[other]
        if self._has_room(len(payload)):
            self._heard[gid] = _Heard(len(payload), content)

    def _has_room(self, size: int) -> bool:
        return len(self._heard) < MOST_BRIDGES and size + sum(heard.size for heard in self._heard.values()) <= _KEPT


def read_announcement(payload: bytes) -> AnnouncementContent:
    """Read another bridge's announcement.

    Raises:
        AnnouncementError: the message is not an announcement.
    """
    try:
        announcement = _decode(string_bytes(payload))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise AnnouncementError("no announcement of a bridge") from None
    return AnnouncementContent(
        {bytes.fromhex(each.gid): Origin(each.via, each.live, each.alive) for each in announcement.publishers},
        {each.service: Origin(each.via) for each in announcement.services},
    )
