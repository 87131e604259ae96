"""What client and server do differently on a link."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.channel.udp_channel import UdpChannel
    from rsb_bridge.route.route import Route
    from rsb_bridge.transport.transport import DatagramTransport, StreamTransport
    from rsb_bridge.wire.messages import Propose, Shutdown


class Side(ABC):
    """One end's part: who calls, what is bound, whose names hold."""

    @property
    @abstractmethod
    def address(self) -> str:
        """The peer's address in words."""

    @abstractmethod
    def shared_port(self) -> int:
        """The port or channel of the link itself."""

    @property
    @abstractmethod
    def use_name(self) -> bool:
        """Whether the server's names of the client's topics have the client's before them, as far as is known."""

    @abstractmethod
    def open_stream(self, route: Route, transport: StreamTransport) -> None:
        """Get the route's stream going, or on it; a server waits for the client's."""

    @abstractmethod
    def open_udp_channel(self, transport: DatagramTransport, port: int) -> UdpChannel | None:
        """Datagrams to and from the peer by that port; None: not now."""

    @abstractmethod
    async def prepare_port(self, route: Route) -> None:
        """Have the port that a route names ready for the client; ListenError where it is taken."""

    @abstractmethod
    def authorize(self, proposal: Propose) -> Propose:
        """The peer's proposal with this side's name for the topic; LinkError where it may not be."""

    @abstractmethod
    def shows(self, topic: str) -> bool:
        """Whether the peer may know that a topic is in this side's graph. May be called from any thread."""

    @abstractmethod
    def on_shutdown(self, message: Shutdown) -> None:
        """The peer closes the link on purpose."""
