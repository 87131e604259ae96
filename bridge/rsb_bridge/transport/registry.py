"""The transports that an engine can use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.transport.udp import Udp

if TYPE_CHECKING:
    from rsb_bridge.transport.transport import Transport


class Transports:
    """Transports by name.

    A test makes one of its own, for example ``Transports(SimulatedTcp(network), SimulatedUdp(network))``, and passes it
    to `rsb_bridge.engine.Engine`.
    """

    def __init__(self, *transports: Transport) -> None:
        """Register transports; for an address that several carry links to, the first is used."""
        self._by_name: dict[str, Transport] = {transport.name: transport for transport in transports}

    def __getitem__(self, name: str) -> Transport:
        return self._by_name[name]

    def of_link(self, host: str) -> StreamTransport:
        """The transport of a link whose session has that `server_ip`."""
        return next(
            transport
            for transport in self._by_name.values()
            if isinstance(transport, StreamTransport) and transport.carries_links_to(host)
        )


def default_transports() -> Transports:
    """TCP, UDP and Bluetooth RFCOMM over the kernel's sockets."""
    return Transports(Rfcomm(), Tcp(), Udp())
