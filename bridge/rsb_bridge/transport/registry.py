"""The transports that an engine can use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import Strangers
from rsb_bridge.model.transports import of_link
from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.transport.udp import Udp
from rsb_bridge.transport.zenoh.network import Network
from rsb_bridge.transport.zenoh.zenoh_transport import Links, Zenoh, ZenohDrop

if TYPE_CHECKING:
    from pathlib import Path
    from random import Random

    from rsb_bridge.model.session import Session
    from rsb_bridge.transport.transport import Transport


class Transports:
    """Transports by name.

    Attributes:
        strangers: the budget of all peers that have not proven yet that they have a key.

    A test makes one of its own, for example ``Transports(SimulatedTcp(network), SimulatedUdp(network))``, and passes it
    to `rsb_bridge.engine.Engine`.
    """

    def __init__(self, *transports: Transport) -> None:
        self._by_name: dict[str, Transport] = {transport.name: transport for transport in transports}
        self.network: Network | None = None
        self.strangers = Strangers()

    def __getitem__(self, name: str) -> Transport:
        return self._by_name[name]

    def close(self) -> None:
        """Release what the transports share, once all sockets are closed."""
        for transport in self._by_name.values():
            transport.close()

    def of_link(self, host: str) -> StreamTransport:
        """Return the transport of a link whose session has that `server_ip`."""
        transport = self[of_link(host).name]
        assert isinstance(transport, StreamTransport)
        return transport


def default_transports(*others: Transport) -> Transports:
    """TCP, UDP and Bluetooth RFCOMM over the kernel's sockets, and others."""
    return Transports(Rfcomm(), Tcp(), Udp(), *others)


def transports_of(session: Session, base: Path, random: Random) -> Transports:
    """Return the transports for a session's links and topics.

    Args:
        base: the folder that its files are relative to.
    """
    if session.zenoh is None:
        return default_transports()
    network = Network(session.zenoh, base, random.random())
    links = Links(network, session.name)
    found = default_transports(Zenoh(links), ZenohDrop(links))
    found.network = network
    found.strangers = network.strangers
    return found
