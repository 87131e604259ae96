"""What seals and opens the messages of a link's routes, while the link is up."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rsb_bridge.channel.large_messages import Scratch
from rsb_bridge.channel.metered import MeteredDatagramReader, MeteredDataReader
from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
from rsb_bridge.wire.framing import DataReader, DataWriter

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.channel.metered import Meter
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.sealing import Role, SessionKeys


@dataclass(frozen=True, slots=True)
class DataKeys:
    """Makes the codecs of channels.

    Attributes:
        keys: of the present connection.
        role: of this side.
        budget: what the link's incomplete messages may hold together.
        scratch: what large messages are sealed in.
        meter_of: gives the meter of a route by its id, or None for a route that has none.
    """

    keys: SessionKeys
    role: Role
    budget: Budget
    scratch: Scratch = field(default_factory=Scratch)
    meter_of: Callable[[int], Meter | None] = lambda _: None

    @property
    def peer_role(self) -> Role:
        """Role of the other side."""
        return "server" if self.role == "client" else "client"

    def stream_writer(self, route_id: int) -> DataWriter:
        """Seals a route's messages for a stream. A route id gets one writer, of whatever kind, in a link's life."""
        return DataWriter(self.keys.route_sealer(route_id, self.role), route_id)

    def stream_reader(self, route_id: int) -> DataReader:
        """Opens a route's messages from a stream."""
        opener = self.keys.stream_opener(route_id, self.peer_role)
        if (meter := self.meter_of(route_id)) is not None:
            return MeteredDataReader(opener, route_id, meter, self.budget)
        return DataReader(opener, route_id, budget=self.budget)

    def datagram_writer(self, route_id: int) -> DatagramWriter:
        """Seals a route's messages as datagrams. A route id gets one writer, of whatever kind, in a link's life."""
        return DatagramWriter(self.keys.route_sealer(route_id, self.role), self.keys.link_id, route_id)

    def datagram_reader(self, route_id: int) -> DatagramReader:
        """Opens a route's messages from datagrams."""
        opener = self.keys.datagram_opener(route_id, self.peer_role)
        if (meter := self.meter_of(route_id)) is not None:
            return MeteredDatagramReader(opener, route_id, meter, self.budget)
        return DatagramReader(opener, route_id, budget=self.budget)
