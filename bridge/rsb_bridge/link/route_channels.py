"""Gives a link's routes their channels, as soon as the streams or the UDP channel that carry them are open."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.channel.datagram_channel import datagram_channel
from rsb_bridge.link.extension import Extension
from rsb_bridge.tasks import in_slices
from rsb_bridge.transport.transport import StreamTransport

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.route.route import Route


class RouteChannels(Extension):
    """The channels of one link's routes.

    Attributes:
        awaiting: the routes that wait for streams, by their transport and port, then by the ids of their openings.
    """

    def __init__(self, link: BaseLink) -> None:
        self.awaiting: dict[tuple[str, int], dict[int, Route]] = {}
        self._link = link
        self._carriers = link.channels

    def disconnected(self) -> None:
        self.awaiting.clear()

    def open(self, route: Route) -> None:
        """Open the channel of a route, or begin to."""
        port, transport, carriers = route.proposal.port or self._link.shared_port(), route.transport, self._carriers
        if isinstance(transport, StreamTransport):
            self._use_streams(route, transport, port)
            return
        udp_channel = carriers.udp.get(port)
        if udp_channel is None and (udp_channel := self._link.open_udp_channel(transport, port)) is not None:
            carriers.udp.open(port, udp_channel)
        # Without one, a client tries again, and a server waits for its client's probe; both then call `udp_ready`.
        if udp_channel is not None:
            assert carriers.keys is not None
            assert carriers.scheduler is not None
            route.channel = datagram_channel(udp_channel, route, carriers.keys, carriers.scheduler)

    def _use_streams(self, route: Route, transport: StreamTransport, port: int) -> None:
        pair = self._carriers.pair_of(transport.name, port)
        if pair is not None:
            self._carriers.carry(route, pair)
            return
        self.awaiting.setdefault((transport.name, port), {})[route.id] = route
        self._link.open_streams(transport, port)

    def streams_opened(self, transport: str, port: int) -> None:
        """Open the channels of the routes that wait for streams, if these are complete."""
        pair = self._carriers.pair_of(transport, port)
        if pair is None:
            return
        for route in self._take_awaiting(transport, port):
            self._carriers.carry(route, pair)
            route.advance()

    def streams_failed(self, transport: str, port: int, reason: str) -> None:
        """Report to the routes that wait for streams that these cannot be opened."""
        for route in self._take_awaiting(transport, port):
            route.channel_lost(reason)

    def _take_awaiting(self, transport: str, port: int) -> Iterator[Route]:
        """Yield the routes that wait for streams, and for which nothing else has come first; none of them waits on."""
        for route_id, route in self.awaiting.pop((transport, port), {}).items():
            if route.id == route_id and route.channel is None:  # else it was closed meanwhile
                yield route

    def udp_ready(self) -> None:
        """Advance the routes that wait for a UDP channel: one has found its path, or can be opened now."""
        self._link.spawn(self._advance())

    async def _advance(self) -> None:
        def advance(route: Route) -> None:
            if route.id:  # a slice before this one may have closed it
                route.advance()

        await in_slices(self._link.ids.open_routes(), advance)  # hundreds may wait for the same path
