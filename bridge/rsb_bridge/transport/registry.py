"""The transports that an engine can use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.installed_features import added
from rsb_bridge.model.budgets import Strangers
from rsb_bridge.model.transports import of_link
from rsb_bridge.transport.rfcomm import Rfcomm
from rsb_bridge.transport.tcp import Tcp
from rsb_bridge.transport.transport import StreamTransport
from rsb_bridge.transport.udp import Udp

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

    def __init__(self, *transports: Transport, strangers: Strangers | None = None) -> None:
        self._by_name: dict[str, Transport] = {transport.name: transport for transport in transports}
        self.strangers = strangers or Strangers()

    def __getitem__(self, name: str) -> Transport:
        return self._by_name[name]

    def find(self, name: str) -> Transport | None:
        """Return a transport, or None if the session does not use it."""
        return self._by_name.get(name)

    def close(self) -> None:
        """Release what the transports share, once all sockets are closed."""
        for transport in self._by_name.values():
            transport.close()

    def of_link(self, host: str) -> StreamTransport:
        """Return the transport of a link whose session has that `server_ip`."""
        transport = self[of_link(host).name]
        assert isinstance(transport, StreamTransport)
        return transport


def default_transports() -> Transports:
    """TCP, UDP and Bluetooth RFCOMM over the kernel's sockets."""
    return Transports(Rfcomm(), Tcp(), Udp())


def transports_of(session: Session, base: Path, random: Random) -> Transports:
    """Return the transports for a session's links and topics.

    Args:
        base: the folder that its files are relative to.
    """
    strangers = Strangers()
    of_core = (Rfcomm(), Tcp(several_ways=session.multipath), Udp())
    of_features = added(
        "transports", session, base, random, strangers,
        name_of=lambda transport: transport.name, taken=[transport.name for transport in of_core],
    )  # fmt: skip
    return Transports(*of_core, *of_features, strangers=strangers)
