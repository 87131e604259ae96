"""The transports that an engine can use, and the ports that its server has open on them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rsb_bridge.model.budgets import Strangers
from rsb_bridge.model.transports import of_link
from rsb_bridge.model.wording import Wording
from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.transport import ListenError, StreamTransport
from rsb_bridge.transport.udp import Udp
from rsb_bridge.transport.zenoh.network import Network
from rsb_bridge.transport.zenoh.zenoh_transport import Links, Zenoh, ZenohDrop

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from random import Random

    from rsb_bridge.model.session import Session
    from rsb_bridge.transport.transport import Acceptor, Listener, Transport


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


class PortProblem(Wording):
    """The reasons why a port is not open."""

    CLOSED_AGAIN = "{kind} {number} was closed while it was being opened"


@dataclass(slots=True)
class _Port:
    listener: Listener
    users: int = 0


class Ports:
    """Bound ports by transport and number, each open as long as somebody uses it."""

    def __init__(self, session: Session, transports: Transports, acceptor: Acceptor) -> None:
        self._session = session
        self._transports = transports
        self._acceptor = acceptor
        self._ports: dict[tuple[str, int], _Port] = {}
        self._opening = asyncio.Lock()
        self._closings = 0

    async def open(self, name: str, number: int) -> Callable[[], None]:
        """Use a port of the transport of that name; it is bound if nobody uses it yet.

        Returns:
            What to call when it is no longer used.

        Raises:
            ListenError: it can't be bound, or all are closed meanwhile.
        """
        key, closed = (name, number), self._closings
        # Two topics that name one port would bind it twice.
        async with self._opening:
            port = self._ports.get(key)
            if port is None:
                transport = self._transports[name]
                port = _Port(await transport.listen(transport.host(self._session), number, self._acceptor))
                if closed != self._closings:  # a server that has stopped meanwhile would leave the port bound
                    port.listener.close()
                    raise ListenError(PortProblem.CLOSED_AGAIN(kind=transport.port_kind, number=number))
                self._ports[key] = port
        port.users += 1
        return lambda: self._release(key, port)

    def _release(self, key: tuple[str, int], port: _Port) -> None:
        port.users -= 1
        # After `close`, a new one may have the same number.
        if not port.users and self._ports.get(key) is port:
            del self._ports[key]
            port.listener.close()

    def close(self) -> None:
        """Close all ports, including ports that are being opened."""
        self._closings += 1
        for port in self._ports.values():
            port.listener.close()
        self._ports.clear()
