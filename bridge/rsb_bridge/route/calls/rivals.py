"""Servers on the callers' side that have what is provided over the link, too: nothing is offered beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.sources import node_of
from rsb_bridge.model.verdict import Cause
from rsb_bridge.route.calls.verdict import Trouble
from rsb_bridge.route.verdict import named

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable

    from rsb_bridge.context import Context
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.peer import Peer

_ANNOUNCED_WITHIN = 3.0
"""s in which a bridge that is alive has told a new one what it offers."""


class Rivals:
    """Finds those of one route.

    An earlier process of this bridge that was killed is none, though it is seen for up to 40 s more. It has this one's
    name, and is told from another bridge of that name by the peer that answers its calls, or as it announces nothing.

    Args:
        context: what every part of the engine shares.
        peer: that provides.
        look_again: has the route look.

    Attributes:
        unknown: it cannot be said yet of some server whether it is one.
    """

    def __init__(self, context: Context, peer: Peer, look_again: Callable[[], None]) -> None:
        self.unknown = False
        self._context = context
        self._peer = peer
        self._look_again = look_again
        self._first_seen: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def look(self, services: Iterable[str], *, offered: bool) -> Trouble | None:
        """Why services are not offered here; None: there is no rival.

        Args:
            services: their names here.
            offered: they are now. Of two bridges that have begun at once, the one with the lesser name goes on.
        """
        context, now = self._context, self._context.now()
        before, self._first_seen, self.unknown = self._first_seen, {}, False
        trouble: Trouble | None = None
        for service in services:
            rivals = []
            for server in context.ros.servers(service):
                is_rival = self._is_rival(server, service, offered=offered)
                if is_rival is None:
                    seen = self._first_seen[server.gid] = before.get(server.gid, now)
                    self.unknown = self.unknown or now - seen < _ANNOUNCED_WITHIN
                elif is_rival:
                    rivals.append(server)
            trouble = trouble or self._trouble(service, rivals)
        if self.unknown and self._timer is None:
            self._timer = context.loop.call_later(_ANNOUNCED_WITHIN, self._due)
        return trouble

    def nodes(self, services: Iterable[str]) -> list[str]:
        """The nodes, no bridges, that serve some of these here."""
        found = [(service, each) for service in services for each in self._context.ros.servers(service)]
        return [each.node for service, each in found if self._is_node(each, service)]

    def close(self) -> None:
        """Look no more for now."""
        self.unknown = False
        self._first_seen.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        self._look_again()

    def _is_node(self, server: Endpoint, service: str) -> bool:
        origin = self._context.announcements.origin_of_server(server, service)
        return origin is not None and not origin.via and bool(self._is_rival(server, service, offered=False))

    def _is_rival(self, server: Endpoint, service: str, *, offered: bool) -> bool | None:
        """Whether a server is one; None: it is a bridge of our name that has announced nothing."""
        ros, bridges, node = self._context.ros, self._peer.bridges, server.node.lstrip("/")
        origin = self._context.announcements.origin_of_server(server, service)
        yields = offered and origin is not None and bool(origin.via) and ros.node_name < node
        if not node.startswith(ros.node_name.removesuffix(ros.instance_id)):
            return not yields
        if origin is None or not origin.via:  # its announcements may be gone before its servers
            return None
        return not yields and (not bridges or node_of(origin.via[-1]) != bridges[0])

    def _trouble(self, service: str, rivals: list[Endpoint]) -> Trouble | None:
        if rivals:
            text = (
                f"{named(each.node for each in rivals)} serves {service} on the callers' side, too: it is not offered "
                "there a second time; stop that node, or give the bridged one another name"
            )
            return Trouble(Cause.SERVED_HERE, text)
        if self._context.announcements.own_servers(service, self._peer.name):
            text = f"this bridge offers {service} here already, from another link: give one of them another name"
            return Trouble(Cause.SERVED_HERE, text)
        return None
