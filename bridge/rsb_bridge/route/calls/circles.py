"""Which servers a bridge may call without closing a circle of bridges.

Every bridge tells, in its domain, by which bridges the answers of each service that it offers come there
(`rsb_bridge.ros.announcements`). The providing half calls no server whose answers come from where its callers are, or
from here, under the service's name: it would end up calling itself.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from rsb_bridge.model.sources import MOST_HOPS, Via, hop, place
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.graph import UnavailableError
from rsb_bridge.route.verdict import named

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.peer import Peer

_EXPLAINED_WITHIN = 3.0
"""s that a node has to say where the answers of what it offers come from; then it is taken for no bridge."""

_BRIDGE = re.compile(r"/rsb_\w+_[0-9a-f]{8}")
"""The node of a bridge: it is never taken for anything else, however late it says so on a busy machine."""


class Usable(NamedTuple):
    """The servers of a service, sorted.

    Attributes:
        servers: that may be called.
        via: the bridges that their answers cross.
        circular: that must not be called.
        unexplained: of which that is not known yet.
    """

    servers: list[Endpoint]
    via: Via
    circular: list[Endpoint]
    unexplained: list[Endpoint]

    def check(self, service: str, domain_id: int) -> None:
        """Tell why none may be called though there are some.

        Raises:
            UnavailableError: none may.
        """
        if not self.servers and self.circular:
            text = (
                f"calls would go in a circle: {service} is answered in domain {domain_id} by "
                f"{named(each.node for each in self.circular)} only, whose answers come from where its callers are; "
                "remove this route or that one"
            )
            raise UnavailableError(Cause.LOOP, text)
        if not self.servers and self.unexplained:
            nodes = named(each.node for each in self.unexplained)
            raise UnavailableError(Cause.NO_SERVER, f"waiting for {nodes} to announce where the answers come from")


class Circles:
    """Sorts the servers of one route's services, this bridge's own offers for other links among them.

    Args:
        context: what every part of the engine shares.
        peer: where the callers are.

    Attributes:
        waits: of some server of the service that was sorted last, it is not known yet whether it may be called.
    """

    def __init__(self, context: Context, peer: Peer) -> None:
        self.waits = False
        self._context = context
        self._peer = peer
        self._first_seen: dict[str, dict[bytes, float]] = {}  # by service

    def sort(self, service: str, remote_service: str) -> Usable:
        """See which servers of a service may be called.

        Args:
            service: its name here.
            remote_service: its name where the callers are.
        """
        announcements, ros, now = self._context.announcements, self._context.ros, self._context.now()
        here = place(announcements.bridges, service)
        there = place(self._peer.bridges, remote_service)
        own = hop(ros.node_name, service)
        usable = Usable([], (), [], [])
        via: dict[str, None] = {}
        before, first_seen = self._first_seen.get(service, {}), {}
        for server in (*ros.servers(service), *announcements.own_servers(service, self._peer.name)):
            origin = announcements.origin_of_server(server, service)
            if origin is None:
                first_seen[server.gid] = before.get(server.gid, now)
                if _BRIDGE.fullmatch(server.node) or now - first_seen[server.gid] < _EXPLAINED_WITHIN:
                    usable.unexplained.append(server)
                    continue
            crossed = origin.via if origin is not None else ()
            if not here.isdisjoint(crossed) or not there.isdisjoint((*crossed, own)) or len(crossed) >= MOST_HOPS - 1:
                usable.circular.append(server)
            else:
                usable.servers.append(server)
                via.update(dict.fromkeys(crossed))
        self._first_seen[service] = first_seen
        self.waits = bool(usable.unexplained)
        return usable._replace(via=tuple(via)[: MOST_HOPS - 1])


def way_here(via: Via, bridges: tuple[str, ...], remote_service: str) -> Via:
    """The bridges that answers cross on their way to the callers' side: those before the providing one, and that one.

    Args:
        via: as the providing side says.
        bridges: in the providing side's domain, its own first; empty: not known.
        remote_service: the service's name there.
    """
    return (*via, hop(bridges[0], remote_service)) if bridges else via
