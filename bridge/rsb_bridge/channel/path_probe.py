"""Probes: whether datagrams of a connection get through."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.wire.datagram import PROBE_ROUTE, Probe, Receipt, unpack_probe
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from rsb_bridge.channel.data_keys import DataKeys
    from rsb_bridge.wire.sealing import Buffer


class PathProbe:
    """Seals and opens the probes of one connection, over all its UDP channels: one key, one sequence each way.

    Attributes:
        link_id: the connection's, in every datagram.
    """

    def __init__(self, keys: DataKeys) -> None:
        self.link_id = keys.keys.link_id
        self._writer = keys.datagram_writer(PROBE_ROUTE)
        self._reader = keys.datagram_reader(PROBE_ROUTE)

    def write(self, probe: Probe | Receipt, size: int) -> list[bytes]:
        """The probe, or receipt, as datagrams of at most `size` bytes."""
        return self._writer.write(probe.pack(), 0, 0, size)

    def read(self, datagram: Buffer, now: float) -> Probe | Receipt | None:
        """What a datagram says; None: forged, replayed, or neither of the two."""
        message = self._reader.receive(datagram, now)
        if message is None:
            return None
        try:
            return unpack_probe(message[0])
        except ProtocolError:
            return None
