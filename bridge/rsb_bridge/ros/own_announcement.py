"""What this bridge announces to the others in its domain: its publishers and the services that it offers."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from rsb_bridge.ros.api import Endpoint, RosError
from rsb_bridge.wire.fields import Hops, Name

if TYPE_CHECKING:
    from collections.abc import Hashable

    from rsb_bridge.model.sources import Via

LONGEST = 4 << 20
"""Bytes of one announcement."""
_A_LINK = 1 << 20
"""Bytes of this bridge's announcement about what it has for one link."""
_FRAME = 1024


class PublisherEntry(msgspec.Struct, frozen=True):
    """A publisher, as it is announced."""

    topic: Name
    gid: Annotated[str, Meta(pattern=r"\A([0-9a-f]{2}){1,24}\Z")]
    via: Hops
    live: bool = True


class ServiceEntry(msgspec.Struct, frozen=True):
    """A service that is offered, as it is announced."""

    service: Name
    via: Hops


class Announcement(msgspec.Struct, frozen=True):
    """What a bridge announces."""

    version: Literal[1]
    publishers: list[PublisherEntry]
    services: list[ServiceEntry] = []


_encode = msgspec.json.Encoder().encode


class Origin(NamedTuple):
    """Where a publisher's messages, or a server's answers, come from.

    Attributes:
        via: the bridges that they crossed; empty: it is no bridge's.
        live: False: nothing reaches it any more.
    """

    via: Via
    live: bool = True


class _Own(NamedTuple):
    """A publisher of ours, or a service that we offer."""

    name: str
    link: Hashable
    endpoint: Endpoint
    origin: Origin
    entry: bytes


class OwnAnnouncement:
    """All of it, within bounds."""

    def __init__(self) -> None:
        self.size = 0
        self._sizes: Counter[Hashable] = Counter()  # parts of `size`, by link
        self._publishers = _Table()
        self._services = _Table()

    def content(self) -> bytes:
        """As others read it."""
        publishers, services = b",".join(self._publishers.entries()), b",".join(self._services.entries())
        return b'{"version":1,"publishers":[%s],"services":[%s]}' % (publishers, services)

    def put_publisher(self, topic: str, link: Hashable, endpoint: Endpoint, origin: Origin) -> bool:
        """A publisher of ours is there, or its messages come from elsewhere now; whether that is news.

        One whose messages are our own is known here only: what is not announced belongs to no bridge (PROTOCOL.md, 5).

        Raises:
            RosError: there are too many.
        """
        entry = _encode(PublisherEntry(topic, endpoint.gid.hex(), origin.via, origin.live)) if origin.via else b""
        return self._put(self._publishers, _Own(topic, link, endpoint, origin, entry))

    def put_service(self, service: str, link: Hashable, endpoint: Endpoint, via: Via) -> bool:
        """We offer a service, or its answers come from elsewhere now; whether that is news.

        Raises:
            RosError: there are too many.
        """
        return self._put(
            self._services, _Own(service, link, endpoint, Origin(via), _encode(ServiceEntry(service, via)))
        )

    def _put(self, table: _Table, own: _Own) -> bool:
        before = table.by_gid.get(own.endpoint.gid)
        more = len(own.entry) - (len(before.entry) if before else 0)
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
        """A publisher of ours is closed, or a service is offered no more; whether it was there."""
        own = self._publishers.pop(gid) or self._services.pop(gid)
        if own is None:
            return False
        self.size -= len(own.entry)
        self._sizes[own.link] -= len(own.entry)
        if not self._sizes[own.link]:
            del self._sizes[own.link]
        return True

    def origin_of(self, gid: bytes) -> Origin | None:
        """Of one of ours; None: it is not."""
        own = self._publishers.by_gid.get(gid) or self._services.by_gid.get(gid)
        return own.origin if own is not None else None

    def publishers(self, topic: str, besides: Hashable) -> list[Endpoint]:
        """What we publish on a topic, but for one link's messages."""
        return self._publishers.of(topic, besides)

    def servers(self, service: str, besides: Hashable) -> list[Endpoint]:
        """What we offer as a service, but for what one link answers."""
        return self._services.of(service, besides)


class _Table:
    """Those of one kind."""

    def __init__(self) -> None:
        self.by_gid: dict[bytes, _Own] = {}
        self._by_name: defaultdict[str, dict[bytes, _Own]] = defaultdict(dict)

    def entries(self) -> list[bytes]:
        return [own.entry for own in self.by_gid.values() if own.entry]

    def put(self, own: _Own) -> None:
        self.by_gid[own.endpoint.gid] = self._by_name[own.name][own.endpoint.gid] = own

    def pop(self, gid: bytes) -> _Own | None:
        own = self.by_gid.pop(gid, None)
        if own is not None:
            del self._by_name[own.name][gid]
            if not self._by_name[own.name]:
                del self._by_name[own.name]
        return own

    def of(self, name: str, besides: Hashable) -> list[Endpoint]:
        return [own.endpoint for own in self._by_name.get(name, {}).values() if own.link != besides]
