"""The keys that seal and open the messages of a link's routes while the link is up."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from rsb_bridge.wire.datagram import DatagramReader, DatagramWriter
from rsb_bridge.wire.framing import DataReader, DataWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rsb_bridge.wire.framing import Budget, Message
    from rsb_bridge.wire.sealing import Buffer, ConnectionKeys, Role, StreamOpener

_Reader = TypeVar("_Reader", bound=DatagramReader)
Meter: TypeAlias = "Callable[[int], bool]"
"""Takes so many bytes, with their headers and seals, or returns False: then nothing more of the route is taken."""


class MeteredDataReader(DataReader):
    """Opens frames as long as the meter allows, and ignores all further ones; the meter ends the route."""

    def __init__(self, opener: StreamOpener, meter: Meter, budget: Budget) -> None:
        super().__init__(opener, budget=budget)
        self._meter = meter
        self._ended = False

    def open_frames(self, frames: Iterable[Buffer]) -> list[Message]:
        return super().open_frames(frame for frame in frames if self._takes(len(frame)))

    def _takes(self, size: int) -> bool:
        if not self._ended and not self._meter(size):
            self._ended = True
            self.close()
        return not self._ended


class Scratch:
    """Memory that pieces of large messages are sealed into, one by one, so that it stays in the processor's cache.

    A link's channels share it, on the I/O loop.
    """

    def __init__(self) -> None:
        self._memory = bytearray()

    def lend(self, size: int) -> bytearray:
        """Memory of at least that size, for as long as the caller does not return to the loop."""
        if len(self._memory) < size:
            self._memory = bytearray(size)
        return self._memory

    def lost(self) -> None:
        """Forget the lent memory, which its borrower still holds."""
        self._memory = bytearray()


@dataclass(frozen=True, slots=True)
class DataKeys:
    """Makes the codecs of channels.

    Attributes:
        keys: of the present connection.
        budget: what the link's incomplete messages may hold together.
        meter_of: gives the meter of a route by its id, or None for a route that has none.
    """

    keys: ConnectionKeys
    role: Role
    budget: Budget
    scratch: Scratch = field(default_factory=Scratch)
    meter_of: Callable[[int], Meter | None] = lambda _: None

    @property
    def peer_role(self) -> Role:
        """Role of the other side."""
        return "server" if self.role == "client" else "client"

    def stream_writer(self, route_id: int) -> DataWriter:
        """Return a sealing writer for a stream. A route id gets one writer, for either kind, in a link's life."""
        return DataWriter(self.keys.route_sealer(route_id, self.role), route_id)

    def stream_reader(self, route_id: int) -> DataReader:
        """Opens a route's messages from a stream."""
        opener = self.keys.stream_opener(route_id, self.peer_role)
        if (meter := self.meter_of(route_id)) is not None:
            return MeteredDataReader(opener, meter, self.budget)
        return DataReader(opener, budget=self.budget)

    def datagram_writer(self, route_id: int) -> DatagramWriter:
        """Return a sealing writer for datagrams. A route id gets one writer, for either kind, in a link's life."""
        return DatagramWriter(self.keys.route_sealer(route_id, self.role), self.keys.link_id, route_id)

    def datagram_reader(self, route_id: int, kind: type[_Reader]) -> _Reader:
        """Opens a route's messages from datagrams."""
        opener = self.keys.datagram_opener(route_id, self.peer_role)
        return kind(opener, route_id, budget=self.budget, meter=self.meter_of(route_id))
